"""``lfnav dock --robot ros2:``, a process of its own, and a robot that is simulated in this one."""

import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.dataset.camera_file import read_camera_file
from pipelines.dock.robots.model import ModelRobot
from pipelines.dock.robots.noise import MotionNoise, SensorNoise, SimulatedMotion
from pipelines.geometry.camera import Camera
from pipelines.lightfield.scene_file import load_scene
from pipelines.localize.state_space import PLANAR
from tests.chain_samples import ELEVATORS, map_elevators
from tests.ros_samples import LOOPBACK, RobotNode, time_message

GOAL = (-1.15, -1.65, 90.0)
ROBOT = """[robot]
image_topic = "camera/image_raw/compressed"
stamped = true
max_speed = 1.0
max_turn_speed_deg = 120
acceleration = 4.0
turn_acceleration_deg = 480
"""


class SimulatedBase(RobotNode):
    """Wheels and camera: does as the velocities say, and stops where none come any more."""

    def __init__(self, scene: Path, start: FloatArray) -> None:
        super().__init__()
        from geometry_msgs.msg import TwistStamped
        from nav_msgs.msg import Odometry

        content = read_camera_file(ELEVATORS / "test" / "camera.toml")
        assert content.base_from_camera is not None
        scale = 240 / content.camera.width
        fx, fy, cx, cy, *_ = content.camera.params
        params = (fx * scale, fy * scale, (cx + 0.5) * scale - 0.5, (cy + 0.5) * scale - 0.5)
        self.camera = Camera("OPENCV", 240, 180, (*params, 0.0, 0.0, 0.0, 0.0))
        self.mount = content.base_from_camera
        self.truth = start.copy()
        self._motion = SimulatedMotion(start, MotionNoise(), np.random.default_rng(0))
        sensor = SensorNoise()
        rng = np.random.default_rng(1)
        self._model = ModelRobot(
            load_scene(scene), self.camera, self.mount, self._motion, sensor, rng
        )
        self.velocities: list[tuple[float, float, float]] = []
        self._velocity, self._until = np.zeros(3), 0.0
        self._odometry = self.node.create_publisher(Odometry, "odom", 50)
        self.node.create_subscription(TwistStamped, "cmd_vel", self._on_velocity, 50)
        self.publish_transform("base_link", self.camera_frame, 0, self.mount)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._end.set()
        self._thread.join()
        super().close()

    def _on_velocity(self, message: Any) -> None:
        twist = message.twist
        self._velocity = np.array([twist.linear.x, twist.linear.y, twist.angular.z])
        self.velocities.append((twist.linear.x, twist.linear.y, twist.angular.z))
        self._until = time.monotonic() + 0.5

    def _run(self) -> None:
        import rclpy

        before = seen = time.monotonic()
        while not self._end.is_set():
            rclpy.spin_once(self.node, timeout_sec=0.02)
            now = time.monotonic()
            velocity = self._velocity if now < self._until else np.zeros(3)
            self.truth = PLANAR.composed(self.truth, velocity * (now - before))
            before = now
            stamp = time.time_ns()
            self._publish_odometry(stamp)
            if now - seen > 0.2 and not np.any(velocity):
                seen = now
                self._publish_view(stamp)

    def _publish_odometry(self, stamp: int) -> None:
        from nav_msgs.msg import Odometry

        message = Odometry(child_frame_id="base_link")
        message.header.frame_id = "odom"
        message.header.stamp = time_message(stamp)
        x, y, heading = self.truth.tolist()
        message.pose.pose.position.x, message.pose.pose.position.y = x, y
        message.pose.pose.orientation.z = math.sin(0.5 * heading)
        message.pose.pose.orientation.w = math.cos(0.5 * heading)
        self._odometry.publish(message)

    def _publish_view(self, stamp: int) -> None:
        import cv2

        self._motion.state = self.truth.copy()
        image = self._model.take_image()
        _, data = cv2.imencode(".png", np.ascontiguousarray(image[:, :, ::-1]))
        self.publish_image(data.tobytes(), self.camera, stamp, form="png")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return map_elevators(tmp_path_factory.mktemp("scene"), "--geometry", "plane")


@pytest.fixture
def base(scene: Path) -> Iterator[SimulatedBase]:
    made = SimulatedBase(scene, np.array([-0.6, -3.0, math.radians(100.0)]))
    yield made
    made.close()


def docking(scene: Path, folder: Path) -> "subprocess.Popen[str]":
    """``lfnav dock`` in a process of its own."""
    (folder / "robot.toml").write_text(ROBOT)
    goal = ",".join(map(str, GOAL))
    command = [sys.executable, "-m", "lfnav_cli.main", "dock", str(scene), "--goal", goal]
    command += ["--robot", f"ros2:{folder / 'robot.toml'}", "-o", str(folder / "run.h5")]
    return subprocess.Popen(
        command,
        env={**os.environ, **LOOPBACK},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def test_a_robot_is_docked_over_ros(scene: Path, base: SimulatedBase, tmp_path: Path) -> None:
    process = docking(scene, tmp_path)
    said, _ = process.communicate(timeout=300)
    assert process.returncode == 0, said
    x, y, heading = base.truth.tolist()
    assert math.hypot(x - GOAL[0], y - GOAL[1]) < 0.02
    assert abs(math.degrees(heading) - GOAL[2]) < 1.0
    assert base.velocities[-1] == (0.0, 0.0, 0.0)
    sent = np.array(base.velocities)
    assert np.hypot(sent[:, 0], sent[:, 1]).max() <= 1.0 + 1e-6
    assert np.abs(sent[:, 2]).max() <= math.radians(120.0) + 1e-6


@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)],
)
def test_an_end_stops_the_robot(
    scene: Path, base: SimulatedBase, tmp_path: Path, number: signal.Signals, code: int
) -> None:
    process = docking(scene, tmp_path)
    end = time.monotonic() + 120.0
    while not any(any(velocity) for velocity in base.velocities):
        assert time.monotonic() < end
        assert process.poll() is None, process.communicate()[0]
        time.sleep(0.01)
    process.send_signal(number)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == code, said
    time.sleep(0.5)
    assert base.velocities[-1] == (0.0, 0.0, 0.0)
