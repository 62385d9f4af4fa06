"""A robot that is driven by velocities and watched by odometry; nothing here is of ROS.

It is a robot as docking knows them: takes an image while standing, moves and comes to a stop. A
velocity holds for a moment only: whoever hangs, or is ended, stops the robot.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import planar_state_of
from pipelines.localize.state_space import PLANAR
from pipelines.ros.live_localizer import MountedCamera
from pipelines.ros.pose_track import NANOSECONDS
from pipelines.ros.robot_settings import RobotSettings
from pipelines.ros.velocity_control import (
    STOPPED,
    Velocity,
    VelocityControl,
    longest_time,
    rest_of_way,
)

# The robot stands when it has moved by less than this for so long; metres, radians, seconds. It is
# waited for no longer than ``LONGEST_STOP``.
STANDING_POSITION, STANDING_ANGLE, STANDING_SECONDS = 5e-4, 1e-3, 0.15
LONGEST_STOP = 2.0
# A velocity that is not renewed within so many periods is followed by a stop.
RENEWAL = 5.0


@dataclass(frozen=True)
class OdometryState:
    """Where odometry sees the robot: ``(3,)``, its stamp (ns), and when it came (monotonic)."""

    state: FloatArray
    stamp: int
    arrival: float


class Watchdog:
    """Sends the present velocity again and again; a stop once it is not renewed.

    Args:
        send: sends a velocity; called from a thread of its own.
        period: seconds from one to the next.
    """

    def __init__(self, send: Callable[[Velocity], None], period: float) -> None:
        self._send, self._period = send, period
        self._lock = threading.Lock()
        self._velocity, self._until = STOPPED, 0.0
        self._stops = 0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="velocities", daemon=True)
        self._thread.start()

    def drive(self, velocity: Velocity) -> None:
        """Sets the velocity for a moment."""
        with self._lock:
            self._velocity, self._until = velocity, time.monotonic() + RENEWAL * self._period
            self._stops = 0
            self._send(velocity)

    def stop(self) -> None:
        """Stops at once."""
        with self._lock:
            self._velocity, self._until = STOPPED, 0.0
            self._stops = 0
            self._send(STOPPED)

    def close(self) -> None:
        """Stops for the last time."""
        self._end.set()
        self._thread.join()
        self._send(STOPPED)

    def _run(self) -> None:
        while not self._end.wait(self._period):
            with self._lock:
                is_driving = time.monotonic() < self._until
                # A stop is repeated, for one message may be lost; then others may drive.
                if is_driving or self._stops < RENEWAL:
                    self._send(self._velocity if is_driving else STOPPED)
                    self._stops += not is_driving


class DrivenRobot:
    """Drives by velocities.

    Args:
        mounted: its camera.
        settings: limits and times.
        send: sends a velocity.
    """

    def __init__(
        self, mounted: MountedCamera, settings: RobotSettings, send: Callable[[Velocity], None]
    ) -> None:
        self._mounted, self._settings = mounted, settings
        self._changed = threading.Condition()
        self._odometry: OdometryState | None = None
        self._image: tuple[Callable[[], ImageArray], int, float] | None = None
        self._still_since = -1
        self._watchdog = Watchdog(send, 1.0 / settings.rate)

    @property
    def camera(self) -> Camera:
        """Model and intrinsics of the camera."""
        return self._mounted.camera

    @property
    def base_from_camera(self) -> FloatArray:
        """``(4, 4)`` the camera's mount."""
        return self._mounted.base_from_camera

    def saw(self, image: Callable[[], ImageArray], stamp: int) -> None:
        """An image has arrived, which is decoded when it is needed; stamp in ns."""
        with self._changed:
            self._image = (image, stamp, time.monotonic())
            self._changed.notify_all()

    def moved(self, odom_from_base: FloatArray, stamp: int) -> None:
        """Odometry has arrived: ``(4, 4)``, stamp in ns."""
        with self._changed:
            state = planar_state_of(odom_from_base)
            self._odometry = OdometryState(state, stamp, time.monotonic())
            self._changed.notify_all()

    def take_image(self) -> ImageArray:
        """The first image taken after the robot came to stand.

        Raises:
            TimeoutError: none came.
        """
        settings, begin = self._settings, time.monotonic()
        with self._changed:
            fresh = self._changed.wait_for(lambda: self._is_fresh(begin), settings.image_timeout)
            if not fresh or self._image is None:
                raise TimeoutError(
                    f"no image on {settings.image_topic} for {settings.image_timeout:g} s"
                )
            image = self._image[0]
        return image()

    def move(self, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Moves and comes to a stop; returns what odometry says of it.

        Raises:
            TimeoutError: odometry fell silent; the robot was stopped.
        """
        begin = self._newest_odometry().state
        way = np.array([forward, left, turn], dtype=np.float64)
        try:
            if np.any(way):
                self._drive(begin, way)
        finally:
            self._watchdog.stop()
        end = self._standing()
        self._still_since = end.stamp
        along, across, rotation = rest_of_way(begin, end.state).tolist()
        return along, across, rotation

    def stop(self) -> None:
        """Stops at once."""
        self._watchdog.stop()

    def close(self) -> None:
        """Stops for the last time."""
        self._watchdog.close()

    def _drive(self, begin: FloatArray, way: FloatArray) -> None:
        settings = self._settings
        target = PLANAR.composed(begin, way)
        control = VelocityControl(target, settings.limits, holonomic=settings.holonomic)
        now = time.monotonic()
        end = now + 2.0 * longest_time(way, settings.limits) + settings.stall_timeout
        progress, progressed = begin, now
        period = 1.0 / settings.rate
        while now < end:
            state = self._newest_odometry().state
            if control.has_arrived(state):
                return
            if not _is_same(rest_of_way(progress, state)):
                progress, progressed = state, now
            if now - progressed > settings.stall_timeout:
                return
            self._watchdog.drive(control.velocity(state, period))
            time.sleep(period)
            now = time.monotonic()

    def _newest_odometry(self) -> OdometryState:
        """The newest, which may not be old.

        Raises:
            TimeoutError: it is.
        """
        settings = self._settings
        with self._changed:
            is_new = self._changed.wait_for(self._has_odometry, settings.odometry_timeout)
            if not is_new or self._odometry is None:
                raise TimeoutError(
                    f"no odometry on {settings.odometry_topic} for {settings.odometry_timeout:g} s"
                )
            return self._odometry

    def _has_odometry(self) -> bool:
        newest = self._odometry
        if newest is None:
            return False
        return time.monotonic() - newest.arrival <= self._settings.odometry_timeout

    def _standing(self) -> OdometryState:
        """Odometry once the robot stands, or after ``LONGEST_STOP``."""
        end = time.monotonic() + LONGEST_STOP
        stood = newest = self._newest_odometry()
        while time.monotonic() < end:
            newest = self._newest_odometry()
            if not _is_same(rest_of_way(stood.state, newest.state)):
                stood = newest
            if newest.stamp - stood.stamp >= STANDING_SECONDS * NANOSECONDS:
                break
            time.sleep(0.005)
        return newest

    def _is_fresh(self, begin: float) -> bool:
        if self._image is None:
            return False
        _, stamp, arrival = self._image
        return arrival >= begin and stamp >= self._still_since


def _is_same(moved: FloatArray) -> bool:
    return bool(np.hypot(*moved[:2]) < STANDING_POSITION and abs(moved[2]) < STANDING_ANGLE)
