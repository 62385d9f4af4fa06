"""The localizer as a node in a process of its own, with the real rclpy between.

One process goes through all of its life, for each takes seconds to start.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.dataset.dataset import Dataset, load_dataset
from pipelines.geometry.pose import planar_state_of, world_from_base_planar
from pipelines.lightfield.scene_file import load_scene
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.stage import localize_dataset
from tests.chain_samples import ELEVATORS, map_elevators
from tests.ros_samples import RobotNode, nanoseconds, node_process, planar

BEGIN = 1_700_000_000 * 10**9
START = (-3.3, -4.3, 66.0)
NAME = "amcl"
TOPIC = ("--image-topic", "camera/image_raw/compressed")


@dataclass(frozen=True)
class Heard:
    """Whether so many messages have come."""

    messages: list[Any]
    count: int

    def __call__(self) -> bool:
        return len(self.messages) >= self.count


@dataclass(frozen=True)
class Given:
    """What the tests share: a scene, the drive through it, and a robot that listens."""

    scene: Path
    drive: Dataset
    robot: RobotNode
    folder: Path


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Given]:
    folder = tmp_path_factory.mktemp("ros")
    scene = map_elevators(folder, "--geometry", "plane")
    robot = RobotNode()
    try:
        yield Given(scene, load_dataset(ELEVATORS / "test"), robot, folder)
    finally:
        robot.close()


def stamps_of(drive: Dataset) -> list[int]:
    return [BEGIN + round(10**9 * seconds) for seconds in drive.timestamps]


def test_the_drive_is_localized_as_from_the_data_set(given: Given) -> None:
    robot, drive = given.robot, given.drive
    log = given.folder / "drive.log"
    start = ",".join(map(str, START))
    options = ("--start", start, "--autostart", "--transform-timeout", "20")
    with node_process(log, "localize", str(given.scene), *TOPIC, *options):
        robot.publish_mount(drive)
        for index, stamp in enumerate(stamps_of(drive)):
            robot.see_until(drive, index, stamp, Heard(robot.poses, index + 1), f"pose {index}")
        robot.until(lambda: len(robot.transforms) == len(drive), "transforms")
    poses = robot.poses
    assert [nanoseconds(pose) for pose in poses] == stamps_of(drive)
    assert {pose.header.frame_id for pose in poses} == {"map"}
    settings = LocalizerSettings(start=(*START[:2], np.radians(START[2])))
    run = localize_dataset(load_scene(given.scene), drive, settings)
    states = np.array([frame.estimates["refined"] for frame in run.frames])
    heard = np.array([planar(pose.pose.pose) for pose in poses])
    np.testing.assert_allclose(heard, states, atol=1e-6)
    covariance = np.array(poses[-1].pose.covariance).reshape(6, 6)
    expected = run.frames[-1].refined_covariance
    assert expected is not None
    np.testing.assert_allclose(covariance[np.ix_([0, 1, 5], [0, 1, 5])], expected, rtol=1e-3)
    # From the map to odometry's frame: a second ahead of the image.
    ahead = [nanoseconds(item) - 10**9 for item in robot.transforms]
    assert ahead == stamps_of(drive)
    assert {item.header.frame_id for item in robot.transforms} == {"map"}


def test_the_life_of_a_node(given: Given) -> None:
    robot, drive = given.robot, given.drive
    log = given.folder / "life.log"
    stamps = stamps_of(drive)
    robot.poses.clear()
    robot.transforms.clear()
    # The first test's mount is still being told to whoever comes.
    robot.camera_frame = "second_camera"
    arguments = ("localize", str(given.scene), *TOPIC, "--camera-silence", "1")
    with node_process(log, *arguments):
        # An impossible parameter is refused; one that does not go with the scene fails configure.
        assert robot.state(NAME) == "unconfigured"
        taken, reason = robot.set_parameter(NAME, "particles", "many")
        assert not taken
        assert "particles" in reason
        assert robot.set_parameter(NAME, "area", [100.0, 101.0, 100.0, 101.0])[0]
        assert not robot.change_state(NAME, "configure")
        assert robot.state(NAME) == "unconfigured"
        assert "the area lies outside of the scene model" in log.read_text()
        assert robot.set_parameter(NAME, "area", "scene")[0]
        assert robot.change_state(NAME, "configure")
        assert robot.change_state(NAME, "activate")

        # The camera is silent, then tf does not say where it sits.
        says = Says(log, "no image on camera/image_raw/compressed for 1 s")
        robot.until(says, "word of the silence")
        says = Says(log, "tf has no frame 'second_camera'")
        robot.see_until(drive, 0, stamps[0], says, "word of the missing tf")
        assert not robot.poses
        assert not robot.transforms

        # With the mount the drive is found, whether searched for or told.
        robot.publish_mount(drive)
        search(given, stamps)
        robot.until(Heard(robot.transforms, 1), "transform")
        assert nanoseconds(robot.poses[-1]) == nanoseconds(robot.transforms[-1]) - 10**9
        error = planar(robot.poses[-1].pose.pose) - truth_at(drive, stamps, robot.poses[-1])
        assert np.abs(error[:2]).max() < 0.1

        # The clock is set back.
        earlier = [stamp - 1000 * 10**9 for stamp in stamps]
        robot.poses.clear()
        search(given, earlier)
        assert "the clock was set back" in log.read_text()
        assert nanoseconds(robot.poses[-1]) in earlier

        # A pose is told, in the wrong frame and in the right one.
        robot.poses.clear()
        pose = world_from_base_planar(truth_at(drive, stamps, stamps[5]))
        robot.give_pose(pose, 0.1, 0.1, frame="odom")
        robot.until(Says(log, "initialpose is in frame 'odom', not in 'map'"), "refusal")
        robot.give_pose(pose, 0.1, 0.1)
        robot.spin(0.5)
        robot.see_until(drive, 5, stamps[5], Heard(robot.poses, 1), "pose")

        # Inactive nodes publish nothing.
        assert robot.change_state(NAME, "deactivate")
        robot.poses.clear()
        robot.see(drive, 6, stamps[6])
        robot.spin(1.0)
        assert not robot.poses
        assert robot.change_state(NAME, "cleanup")
        assert robot.state(NAME) == "unconfigured"
        assert robot.change_state(NAME, "configure")


@dataclass(frozen=True)
class Says:
    """Whether a process has said something."""

    log: Path
    text: str

    def __call__(self) -> bool:
        return self.text in self.log.read_text()


def search(given: Given, stamps: list[int]) -> None:
    """Shows the drive image by image until a pose comes."""
    for index, stamp in enumerate(stamps):
        given.robot.see(given.drive, index, stamp)
        given.robot.spin_until(Heard(given.robot.poses, 1), 2.0)
        if given.robot.poses:
            return
    raise AssertionError("the drive was not found")


def truth_at(drive: Dataset, stamps: list[int], moment: Any) -> FloatArray:
    """The true state at a stamp, or at that of a message."""
    stamp = moment if isinstance(moment, int) else nanoseconds(moment)
    assert drive.groundtruth is not None
    return planar_state_of(drive.groundtruth.poses[stamps.index(stamp)])
