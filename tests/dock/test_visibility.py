"""A goal whose view the map cannot show is refused before anything moves."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfnav_cli import common
from lfnav_cli.main import main
from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.dataset.images import encode_png
from pipelines.dock.dock import Equipment, equipment_of
from pipelines.dock.planar_motion import behind, distance_between
from pipelines.dock.robot import CheckedRobot
from pipelines.dock.settings import DockSettings
from pipelines.lightfield.scene import Scene
from tests.dock_samples import FILTER, GOAL, PaintedRobot, photo, wall_scene, written_scene
from tests.report_samples import facing_wall

SETTINGS = DockSettings(least_distance=0.4, staging_distance=0.5)


def equipped(
    goal: FloatArray, scene: Scene | None = None, settings: DockSettings = SETTINGS
) -> tuple[Equipment, PaintedRobot]:
    robot = PaintedRobot()
    equipment = equipment_of(
        wall_scene() if scene is None else scene,
        CheckedRobot(robot),
        goal,
        settings,
        FILTER,
        np.random.default_rng(0),
    )
    return equipment, robot


@pytest.mark.parametrize("yaw", [math.pi, math.pi / 2.0 + 0.8, -math.pi / 2.0 - 0.8])
def test_a_goal_facing_away_from_the_wall(yaw: float) -> None:
    with pytest.raises(OptionError, match=r"the map shows \d% of what the camera would see"):
        equipped(facing_wall(0.3, 1.2, yaw))


def bare_wall_scene() -> Scene:
    """Photos of a wall of one grey, with a sensor's noise."""
    rng = np.random.default_rng(2)
    noisy = [np.clip(rng.normal(128.0, 1.0, (36, 48, 3)), 0, 255).astype(np.uint8) for _ in "abc"]
    return replace(wall_scene(), encoded_images=tuple(encode_png(image) for image in noisy))


def test_a_goal_in_front_of_a_bare_wall() -> None:
    with pytest.raises(OptionError, match="too plain to tell 10 cm and 3 degrees apart"):
        equipped(GOAL, bare_wall_scene())


def striped_wall_scene() -> Scene:
    """Photos of horizontal stripes: nothing tells a place along the wall from the next."""
    images = []
    for x in (-1.0, 0.0, 1.0):
        image = photo(facing_wall(x, 2.0)).astype(np.float64)
        rows = np.random.default_rng(3).uniform(20.0, 230.0, (image.shape[0], 1, 1))
        images.append(np.broadcast_to(rows, image.shape).astype(np.uint8))
    return replace(wall_scene(), encoded_images=tuple(encode_png(image) for image in images))


def test_a_goal_that_looks_the_same_all_along_the_wall() -> None:
    with pytest.raises(OptionError, match="too plain"):
        equipped(GOAL, striped_wall_scene())


@pytest.mark.parametrize("x", [-1.9, -1.0, 0.0, 1.0, 1.9])
def test_a_goal_near_the_border_of_the_map_is_taken(x: float) -> None:
    # At 1.9 m from the middle the map, from -3 to 3 m, fills 80 % of a view 2.4 m wide or less.
    equipped(facing_wall(x, 1.2))


def test_a_staging_pose_that_shows_nothing_is_chosen_nearer() -> None:
    usual, _ = equipped(GOAL)
    assert usual.notes == ()
    np.testing.assert_allclose(usual.state_machine.staging, behind(GOAL, 0.5))
    # From so far back the wall is a speck.
    far = replace(SETTINGS, staging_distance=15.0)
    nearer, _ = equipped(GOAL, None, far)
    assert len(nearer.notes) == 1
    assert "nothing of the view at the staging pose, 15 m back: it is" in nearer.notes[0]
    distance = distance_between(nearer.state_machine.staging, GOAL)
    assert distance < 12.0
    assert nearer.settings.staging_distance == pytest.approx(distance)
    # In a narrow passage it lies where it was put.
    kept, _ = equipped(GOAL, None, replace(far, robot_radius=0.1))
    assert distance_between(kept.state_machine.staging, GOAL) == pytest.approx(15.0)
    assert "may not find the goal from there" in kept.notes[0]


def test_the_command_refuses_it_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, output = written_scene(tmp_path), tmp_path / "run.h5"
    arguments = [
        "dock", str(scene), "--robot", f"model:{scene}", "--camera-width", "48", "--threads", "1",
        "--least-distance", "0.4", "--staging-distance", "0.5",
    ]  # fmt: skip
    for more in (["--dry-run"], ["-o", str(output)]):
        code = common.run_command(main, [*arguments, *more, "--goal=0.3,-1.2,-90"])
        captured = capsys.readouterr()
        assert (code, captured.out) == (1, "")
        assert captured.err.count("\n") == 1
        assert "goal 0.30,-1.20,-90: the map shows 0%" in captured.err
        assert "choose a pose from which" in captured.err
    assert not output.exists()
    assert common.run_command(main, [*arguments, "--dry-run", "--goal=0.3,-1.2,90"]) == 0
    assert "the map shows what the camera sees there" in capsys.readouterr().out
