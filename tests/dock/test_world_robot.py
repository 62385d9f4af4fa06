"""``--robot model:WORLD``: images of a robot that goes from area to area of a world."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest

from pipelines.artifacts.arrays import IntArray
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.kinds import AREA_FOLDER, WORLD_FILE
from pipelines.artifacts.provenance import sha256_of_file
from pipelines.dock.robot import Movement
from pipelines.dock.robots import world_model
from pipelines.dock.robots.choice import RobotOptions, robot_named
from pipelines.dock.robots.model import NOTHING
from pipelines.dock.robots.noise import MotionNoise, SensorNoise
from pipelines.geometry.camera import Undistorter
from pipelines.geometry.pose import world_from_base_planar
from pipelines.lightfield.area_recognition import learn_recognition
from pipelines.lightfield.depth_storage import as_stored
from pipelines.lightfield.recorded_paths import recorded_paths
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import identified, load_part, load_scene, save_scene
from pipelines.lightfield.world_file import World, WorldArea, area_path, save_index
from pipelines.render.choices import Quality
from pipelines.render.renderer import Renderer
from tests.room_samples import HIGH, PARTITION_X, seen
from tests.two_room_samples import MOUNT, two_rooms

EXACT = RobotOptions(sensor=SensorNoise(0.0, 0.0), camera_width=96)
FAITHFUL = MotionNoise(0.0, 0.0, 0.0)


def part_of(scene: Scene, views: IntArray) -> Scene:
    """A scene of some of the views."""
    stored = [as_stored(d.inverse_depth, d.confident) for d in scene.depth]
    part = replace(
        scene,
        image_names=tuple(scene.image_names[view] for view in views),
        encoded_images=tuple(scene.encoded_images[view] for view in views),
        timestamps=scene.timestamps[views],
        camera_index=scene.camera_index[views],
        world_from_camera=scene.world_from_camera[views],
        depth=tuple(stored[view] for view in views),
    )
    return identified(part)


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The two rooms as a world of two areas, divided at the doorway."""
    path, scene = tmp_path_factory.mktemp("rooms") / "world", two_rooms()
    (path / AREA_FOLDER).mkdir(parents=True)
    x = scene.world_from_camera[:, 0, 3]
    ends = {"west": (0.0, PARTITION_X), "east": (PARTITION_X, float(HIGH[0]))}
    areas = []
    for name, (low, high) in ends.items():
        views = np.flatnonzero((x > low - 0.5) & (x < high + 0.5))
        part = part_of(scene, views)
        save_scene(area_path(path, name), part, overwrite=False)
        rectangle = np.array([low, high, 0.0, HIGH[1]])
        other = next(neighbour for neighbour in ends if neighbour != name)
        digest = sha256_of_file(area_path(path, name))
        areas.append(
            WorldArea(name, views, rectangle, rectangle, (other,), part.identifier, digest, 1, 1)
        )
    paths = recorded_paths(scene.world_from_camera)
    home = (x > PARTITION_X).astype(np.int64)
    index = World(
        scene.image_names, scene.timestamps, scene.world_from_camera, home, paths.links,
        paths.lengths, tuple(areas), {"method": "file"}, {},
    )  # fmt: skip
    # The robot's images do not depend on what finds areas.
    none = {photo: np.zeros((0, 128), dtype=np.uint8) for photo in range(len(home))}
    both = np.arange(2)
    recognition = learn_recognition(
        [lambda: none], index.world_from_camera[:, :3, 3], home, [both] * 2
    )
    save_index(path / WORLD_FILE, index, recognition)
    return path


@pytest.mark.parametrize("state", [(1.2, 1.5, 0.1), (3.3, 1.45, 0.0), (4.0, 1.45, 3.0)])
def test_it_sees_what_there_is_to_see_in_both_areas(
    world: Path, state: tuple[float, float, float]
) -> None:
    robot = robot_named(f"model:{world}", two_rooms(), replace(EXACT, true_start=state), 0)
    image = robot.take_image().astype(np.float64)
    truth = seen(world_from_base_planar(np.array(state)) @ MOUNT)[0].astype(np.float64)
    assert np.median(np.abs(image - truth)) < 4.0
    assert np.mean(np.all(image == 128.0, axis=2)) < 0.02


def test_through_the_door_it_sees_the_area_next_to_its_own(world: Path) -> None:
    state = np.array([3.3, 1.45, 0.0])
    robot = robot_named(f"model:{world}", two_rooms(), replace(EXACT, true_start=tuple(state)), 0)
    before = robot.take_image()
    area_path(world, "east").rename(world / "away.h5")
    try:
        with pytest.raises(InputError, match="is missing"):
            robot_named(f"model:{world}", two_rooms(), EXACT, 0)
    finally:
        (world / "away.h5").rename(area_path(world, "east"))
    np.testing.assert_array_equal(robot.take_image(), before)


def areas_read_for_every_image(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the areas that are read from now on, by robots that hold no more than they must."""
    monkeypatch.setattr(world_model, "HELD", 0.0)
    read: list[str] = []

    def counted(path: Path, views: Sequence[int]) -> Scene:
        read.append(path.stem)
        return load_part(path, views)

    monkeypatch.setattr(world_model, "load_part", counted)
    return read


def test_it_sees_the_same_however_few_areas_it_holds(
    world: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = areas_read_for_every_image(monkeypatch)
    options = replace(EXACT, true_start=(2.0, 1.45, 0.0), motion=FAITHFUL)
    robot = robot_named(f"model:{world}", two_rooms(), options, 0)
    scenes = [load_scene(area_path(world, name)) for name in ("west", "east")]
    whole = [Renderer.of_scene(scene, quality=Quality.FINE) for scene in scenes]
    pinhole = Undistorter(robot.camera).intrinsics
    for forward, order in ((0.0, (0, 1)), (1.2, (0, 1)), (0.8, (1, 0)), (-0.8, (0, 1))):
        robot.move(Movement(forward=forward))
        image = robot.take_image()
        state = robot.true_state()
        assert state is not None
        expected = np.full_like(image, NOTHING)
        for area in reversed(order):
            view = whole[area].render(world_from_base_planar(state) @ MOUNT, pinhole)
            expected[view.covered] = view.image[view.covered]
        np.testing.assert_array_equal(image, expected)
    # An area that was let go for the other is read again.
    assert [name for name, _ in groupby(read)][:3] == ["west", "east", "west"]


def test_areas_that_one_image_needs_are_held_for_the_next(
    world: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Close to a wall, the photos of the robot's own area do not show all that it sees.
    options = replace(EXACT, true_start=(2.2, 0.2, 1.5))
    robot = robot_named(f"model:{world}", two_rooms(), options, 0)
    read = areas_read_for_every_image(monkeypatch)
    robot.take_image()
    assert set(read) == {"west", "east"}
    read.clear()
    robot.take_image()
    assert read == []


def test_a_folder_that_is_no_world_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="world"):
        robot_named(f"model:{tmp_path}", two_rooms(), EXACT, 0)
