"""The dock detector as a node; this process plays nav2's docking server."""

import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.dataset.dataset import Dataset, load_dataset
from pipelines.geometry.pose import inverse, planar_state_of, world_from_base_planar
from tests.chain_samples import ELEVATORS, map_elevators
from tests.ros_samples import RobotNode, nanoseconds, node_process, planar

GOAL = (-1.15, -1.65, 90.0)
INDEX = 12


@pytest.fixture
def robot() -> Iterator[RobotNode]:
    made = RobotNode()
    yield made
    made.close()


def trigger(robot: RobotNode, service: str) -> tuple[bool, str]:
    from std_srvs.srv import Trigger

    answer = robot.call(Trigger, service, Trigger.Request())
    return bool(answer.success), str(answer.message)


def test_the_dock_is_detected_between_two_triggers(robot: RobotNode, tmp_path: Path) -> None:
    from geometry_msgs.msg import PoseStamped

    drive = load_dataset(ELEVATORS / "test")
    assert drive.groundtruth is not None
    scene = map_elevators(tmp_path, "--geometry", "plane")
    heard: list[Any] = []
    robot.node.create_subscription(PoseStamped, "detected_dock_pose", heard.append, 10)
    truth = drive.groundtruth.poses[INDEX]
    x, y, heading = planar_state_of(truth).tolist()
    start = f"{x},{y},{math.degrees(heading)}"
    options = ("--image-topic", "camera/image_raw/compressed", "--start", start)
    log = tmp_path / "detector.log"
    with node_process(log, "dock-detector", str(scene), *options, "--max-age", "10"):
        assert robot.change_state("dock_detector", "configure")
        assert trigger(robot, "detect_dock") == (False, "parameter goal is none")
        assert robot.set_parameter("dock_detector", "goal", list(GOAL))[0]
        assert trigger(robot, "detect_dock") == (False, "the node is inactive")
        assert robot.change_state("dock_detector", "activate")
        robot.publish_mount(drive)
        # Nobody has asked yet.
        show(robot, drive, 5, lambda: False)
        assert not heard
        taken, text = trigger(robot, "detect_dock")
        assert taken, text
        show(robot, drive, 40, lambda: bool(heard))
        dock = heard[-1]
        assert dock.header.frame_id == "base_link"
        assert abs(time.time_ns() - nanoseconds(dock)) < 20e9
        goal = world_from_base_planar([*GOAL[:2], math.radians(GOAL[2])])
        expected = planar_state_of(inverse(truth) @ goal)
        error = planar(dock.pose) - expected
        assert np.hypot(*error[:2]) < 0.03
        assert abs(error[2]) < math.radians(1.0)
        # The same trigger ends it.
        assert trigger(robot, "detect_dock") == (True, "stopped")
        robot.spin(0.5)
        heard.clear()
        show(robot, drive, 5, lambda: False)
        assert not heard
        # What is old is not sent.
        assert robot.set_parameter("dock_detector", "max_age", 0.01)[0]
        assert trigger(robot, "detect_dock/start")[0]
        show(robot, drive, 40, lambda: "s old" in log.read_text())
        assert "no dock is detected: the image is" in log.read_text()
        assert not heard


def show(robot: RobotNode, drive: Dataset, most: int, condition: Any, age: float = 0.0) -> None:
    """Shows the view from one place up to ``most`` times, until something happens."""
    for _ in range(most):
        robot.see(drive, INDEX, time.time_ns())
        robot.spin_until(condition, 0.4)
        if condition():
            return
