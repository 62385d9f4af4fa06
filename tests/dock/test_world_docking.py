"""Docking in a world of areas: from one room into the other, over the command line."""

import math
from pathlib import Path

import numpy as np
import pytest

from pipelines.artifacts.errors import InputError, OptionError
from pipelines.dock.docking_map import GOAL_VIEWS, docking_map
from pipelines.dock.goals import Goal
from pipelines.dock.stage import DockRequest, dry_run
from pipelines.lightfield.open_world import open_world
from pipelines.lightfield.scene_file import load_scene
from pipelines.lightfield.world_file import area_path
from pipelines.localize.run import load_run
from tests.chain_samples import lfnav
from tests.world_drive_samples import CAMERA, world_of_rooms

GOAL = (2.4, 0.4, 30.0)
OPTIONS = (
    "--goal", ",".join(map(str, GOAL)), "--true-start=-2.2,0.6,150", "--start=-2.2,0.6,150",
    "--robot-radius", "0.2", "--staging-distance", "0.5", "--camera-width", "96",
    "--particles", "100", "--threads", "1", "--seed", "1",
)  # fmt: skip


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The two rooms as a world of two areas, with a camera and its mount beside it."""
    folder = tmp_path_factory.mktemp("rooms")
    (folder / "camera.toml").write_text(
        f'model = "PINHOLE"\nwidth = {CAMERA.width}\nheight = {CAMERA.height}\n'
        f"params = {CAMERA.vector().tolist()}\n"
        "[mount]\nx = 0.0\ny = 0.0\nz = 1.0\nroll = 0.0\npitch = 0.0\nyaw = 0.0\n",
        encoding="utf-8",
    )
    return world_of_rooms(folder)


def arguments(world: Path, *more: object) -> list[str]:
    camera = world.parent / "camera.toml"
    robot = ["--robot", f"model:{world}", "--camera", str(camera)]
    return ["dock", str(world), *robot, *OPTIONS, *map(str, more)]


def test_a_robot_is_docked_in_the_other_area(world: Path, tmp_path: Path) -> None:
    outcome = lfnav(*arguments(world, "-o", tmp_path / "dock.h5"))
    assert outcome.code == 0, outcome.err
    run = load_run(tmp_path / "dock.h5")
    assert run.docking is not None
    assert run.groundtruth is not None
    assert "route" in run.docking.states
    x, y, heading = run.groundtruth[-1]
    assert math.hypot(x - GOAL[0], y - GOAL[1]) < 0.03
    assert abs(math.degrees(heading) - GOAL[2]) < 1.0
    assert run.areas is not None
    assert run.areas.names == ("west", "east")
    beliefs = np.array([frame.area_belief for frame in run.frames])
    assert beliefs[0].argmax() == 0
    assert beliefs[-1].argmax() == 1
    report = lfnav("report", tmp_path / "dock.h5", "-o", tmp_path / "report", "--frames", "0")
    assert report.code == 0, report.err
    assert "areas" in (tmp_path / "report" / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--memory", "10"), "--memory 10 is too small"),
        (("--strategy", "condensation"), "a world takes strategy mixture"),
        (("--goal=9,9,0",), "outside of the allowed area"),
        (("--goal=2.4,1.9,0",), "from the scene's surface, nearer than"),
    ],
)
def test_what_does_not_go_with_a_world_is_said_in_a_line(
    world: Path, tmp_path: Path, more: tuple[str, ...], said: str
) -> None:
    outcome = lfnav(*arguments(world, *more, "-o", tmp_path / "dock.h5"))
    assert outcome.code == 1
    assert outcome.err.count("\n") == 1
    assert said in outcome.err
    assert not (tmp_path / "dock.h5").exists()


def test_memory_is_of_worlds_only(world: Path, tmp_path: Path) -> None:
    request = DockRequest(area_path(world, "west"), f"model:{world}", None, memory=500.0)
    with pytest.raises(OptionError, match="a scene is one piece"):
        dry_run(request)


def test_a_missing_area_is_named(world: Path, tmp_path: Path) -> None:
    file = area_path(world, "east")
    file.rename(tmp_path / "east.h5")
    try:
        with pytest.raises(InputError, match="is missing"):
            dry_run(DockRequest(world, f"model:{world}", Goal(pose=(2.4, 0.4, 0.5))))
    finally:
        (tmp_path / "east.h5").rename(file)


def test_the_goal_is_seen_by_the_photos_around_it(world: Path) -> None:
    opened = open_world(world)
    whole = docking_map(opened)
    around = whole.around(np.array([[2.4, 0.4, 0.5]]))
    east = load_scene(area_path(world, "east"))
    names = np.array(opened.index.image_names)
    homes = opened.index.home[np.isin(names, around.image_names)]
    assert len(around) == len(around.depth) == min(GOAL_VIEWS, np.count_nonzero(homes == 1))
    for number, name in enumerate(around.image_names):
        same = east.image_names.index(name)
        np.testing.assert_array_equal(around.image(number), east.image(same))
        np.testing.assert_array_equal(
            around.world_from_camera[number], east.world_from_camera[same]
        )
    # At the doorway both areas show it.
    at_the_door = whole.around(np.array([[0.1, 0.0, 0.0]]))
    shown = opened.index.home[np.isin(names, at_the_door.image_names)]
    assert set(shown.tolist()) == {0, 1}
