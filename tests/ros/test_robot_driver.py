"""A robot that is driven by velocities, against wheels that are simulated; no ROS."""

import math
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, OptionError
from pipelines.dock.robot import CheckedRobot, Movement, RobotError
from pipelines.geometry.camera import Camera
from pipelines.localize.state_space import PLANAR
from pipelines.ros.live_localizer import MountedCamera
from pipelines.ros.pose_track import NANOSECONDS
from pipelines.ros.robot_driver import DrivenRobot, Watchdog
from pipelines.ros.robot_settings import RobotSettings, robot_settings_of
from pipelines.ros.velocity_control import (
    STOPPED,
    Velocity,
    VelocityControl,
    VelocityLimits,
    rest_of_way,
    screw_of,
)

LIMITS = VelocityLimits(0.2, 0.5, 0.3, 1.0)
CAMERA = Camera("SIMPLE_PINHOLE", 8, 6, (8.0, 3.5, 2.5))
WAYS = [(0.4, 0.0, 0.0), (0.0, 0.0, 0.7), (0.2, 0.1, -0.3), (-0.1, 0.0, 0.0), (0.003, 0.0, 0.001)]


def driven(state: FloatArray, velocity: Velocity, seconds: float) -> FloatArray:
    """Where a robot is after a moment."""
    step = np.array([velocity.forward, velocity.left, velocity.turn]) * seconds
    return PLANAR.composed(state, step)


@pytest.mark.parametrize(
    "way", [(0.3, 0.1, 0.5), (0.3, 0.0, 0.0), (0.0, 0.0, 2.0), (1.0, 2.0, -3.0)]
)
def test_a_screw_motion_ends_where_it_is_to(way: tuple[float, float, float]) -> None:
    velocity = Velocity(*screw_of(np.array(way)).tolist())
    state = np.zeros(3)
    for _ in range(20_000):
        state = driven(state, velocity, 1.0 / 20_000)
    np.testing.assert_allclose(state, way, atol=5e-4)


def test_the_arc_of_a_differential_drive_needs_no_motion_sideways() -> None:
    arc = np.array([0.3, 0.3 * math.tan(0.2), 0.4])
    assert screw_of(arc)[1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("way", WAYS)
def test_speeds_and_accelerations_stay_within_their_limits(way: tuple[float, ...]) -> None:
    control, period = VelocityControl(np.array(way), LIMITS), 0.05
    state, before, driving = np.zeros(3), STOPPED, 0
    while not control.has_arrived(state):
        velocity = control.velocity(state, period)
        speed = math.hypot(velocity.forward, velocity.left)
        assert speed <= LIMITS.speed + 1e-9
        assert abs(velocity.turn) <= LIMITS.turn_speed + 1e-9
        rise = speed - math.hypot(before.forward, before.left)
        assert rise <= LIMITS.acceleration * period + 1e-3
        assert abs(velocity.turn) - abs(before.turn) <= LIMITS.turn_acceleration * period + 1e-3
        state, before, driving = driven(state, velocity, period), velocity, driving + 1
        assert driving < 400
    np.testing.assert_allclose(rest_of_way(state, np.array(way)), 0.0, atol=3e-3)


class Wheels:
    """A base that does as it is told, and says so fifty times a second."""

    def __init__(self) -> None:
        self.state = np.zeros(3)
        self.velocity = STOPPED
        self.sent: list[Velocity] = []
        self.is_stuck = self.is_silent = False
        self.robot: DrivenRobot | None = None
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def send(self, velocity: Velocity) -> None:
        self.sent.append(velocity)
        self.velocity = velocity

    def start(self, robot: DrivenRobot) -> None:
        self.robot = robot
        self._thread.start()

    def close(self) -> None:
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        before = time.monotonic()
        while not self._end.wait(0.02):
            now = time.monotonic()
            if not self.is_stuck:
                self.state = driven(self.state, self.velocity, now - before)
            before = now
            if self.robot is not None and not self.is_silent:
                stamp = round(now * NANOSECONDS)
                self.robot.moved(PLANAR.poses(self.state), stamp)
                self.robot.saw(lambda: np.zeros((6, 8, 3), np.uint8), stamp)


@pytest.fixture
def wheels() -> Iterator[Wheels]:
    made = Wheels()
    settings = replace(RobotSettings(), max_speed=1.0, acceleration=5.0, stall_timeout=0.4)
    settings = replace(settings, max_turn_speed=2.0, turn_acceleration=10.0, image_timeout=0.3)
    robot = DrivenRobot(MountedCamera(CAMERA, np.eye(4)), settings, made.send)
    made.start(robot)
    yield made
    robot.close()
    made.close()


def robot_of(wheels: Wheels) -> CheckedRobot:
    return CheckedRobot(wheels.robot)


def test_a_movement_is_made_and_measured(wheels: Wheels) -> None:
    robot = robot_of(wheels)
    measured = robot.move(Movement(0.2, 0.05, 0.3))
    assert wheels.sent[-1] == STOPPED
    # The measure is odometry's, whatever the wheels have made of the command.
    np.testing.assert_allclose(measured.vector(), wheels.state, atol=2e-3)
    np.testing.assert_allclose(measured.vector(), [0.2, 0.05, 0.3], atol=0.05)
    assert robot.take_image().shape == (6, 8, 3)
    assert robot.move(Movement()).distance < 1e-3


def test_a_stuck_robot_is_stopped(wheels: Wheels) -> None:
    wheels.is_stuck = True
    measured = robot_of(wheels).move(Movement(0.5))
    assert measured.distance == 0.0
    assert wheels.sent[-1] == STOPPED


def test_a_robot_whose_odometry_falls_silent_is_stopped(wheels: Wheels) -> None:
    robot = robot_of(wheels)
    silence = threading.Timer(0.15, lambda: setattr(wheels, "is_silent", True))
    silence.start()
    with pytest.raises(RobotError, match="no odometry on odom for 0"):
        robot.move(Movement(50.0))
    assert wheels.sent[-1] == STOPPED
    with pytest.raises(RobotError, match="no image on camera/image_raw for 0"):
        robot.take_image()


def test_who_hangs_is_stopped() -> None:
    sent: list[Velocity] = []
    watchdog = Watchdog(sent.append, 0.01)
    watchdog.drive(Velocity(0.1))
    end = time.monotonic() + 20.0
    while STOPPED not in sent:
        assert time.monotonic() < end
        time.sleep(0.01)
    watchdog.close()
    assert sent[0] == Velocity(0.1)
    assert sent[-1] == STOPPED


def test_settings_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text('[robot]\nmax_speed = 0.5\nmax_turn_speed_deg = 90\ncamera = "c.toml"\n')
    settings = robot_settings_of(path)
    assert settings.limits.speed == 0.5
    assert settings.limits.turn_speed == pytest.approx(math.pi / 2)
    assert (settings.camera, settings.info_topic) == ("c.toml", "camera/camera_info")
    path.write_text("[robot]\nmax_sped = 0.5\n")
    with pytest.raises(InputError, match="max_sped"):
        robot_settings_of(path)
    with pytest.raises(OptionError, match="max_speed 0 is not between"):
        RobotSettings(max_speed=0.0)
