"""The robot protocol of docking: take an image, move, stop.

Any class with these members is a robot; nothing has to be inherited. ``docs/docking.md`` has a
complete example.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import LfnavError, OptionError
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import checked_poses

METHODS = ("take_image", "move", "stop")
ATTRIBUTES = ("camera", "base_from_camera")


class Robot(Protocol):
    """A robot on a floor with one camera."""

    @property
    def camera(self) -> Camera:
        """Model and intrinsics of the robot's camera."""

    @property
    def base_from_camera(self) -> FloatArray:
        """``(4, 4)`` the camera's mount."""

    def take_image(self) -> ImageArray:
        """A camera image, ``(height, width, 3)`` RGB, 8 bits, taken while standing still."""

    def move(self, forward: float, left: float, turn: float) -> Sequence[float]:
        """Moves and comes to a stop.

        Args:
            forward: metres along the robot's own x axis, as it stands before the movement.
            left: metres along its y axis; 0 for a robot that cannot drive sideways.
            turn: yaw change, radians, counter-clockwise.

        Returns:
            The movement by odometry: forward, left and turn, in the same frame.
        """

    def stop(self) -> None:
        """Stops the robot at once; called at the end of docking, however it ends."""


@runtime_checkable
class KnowsTruth(Protocol):
    """A simulated robot: its true pose is known, and only recorded, never used for docking."""

    def true_state(self) -> FloatArray:
        """True state ``(3,)``: x and y in metres, heading in radians."""


class RobotError(LfnavError):
    """The robot's driver raised an exception or violated the robot protocol."""


@dataclass(frozen=True)
class Movement:
    """A movement in the robot's frame before it.

    Attributes:
        forward: metres along the x axis.
        left: metres along the y axis.
        turn: yaw change, radians, counter-clockwise.
    """

    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0

    @property
    def distance(self) -> float:
        """Length of the translation, metres."""
        return math.hypot(self.forward, self.left)

    def vector(self) -> FloatArray:
        """``(3,)``: forward, left, turn."""
        return np.array([self.forward, self.left, self.turn])

    def scaled(self, share: float) -> "Movement":
        """The movement with all parts multiplied by a share."""
        return Movement(share * self.forward, share * self.left, share * self.turn)


STANDSTILL = Movement()


class CheckedRobot:
    """A robot whose answers are validated before they are used, and whose time is measured.

    Args:
        robot: any object with the members of ``Robot``.

    Attributes:
        name: of the robot's class.
        note: one line about the robot for the summary; may be empty.
        seconds: wall time spent in the robot's methods so far.
        camera: model and intrinsics of the robot's camera.
        base_from_camera: ``(4, 4)`` the camera's mount.

    Raises:
        RobotError: a member is missing, or the camera or its mount has the wrong type or shape.
    """

    def __init__(self, robot: Any) -> None:
        self.name = type(robot).__name__
        self.note = str(getattr(robot, "note", ""))
        missing = [name for name in METHODS if not callable(getattr(robot, name, None))]
        missing += [name for name in ATTRIBUTES if not hasattr(robot, name)]
        if missing:
            raise RobotError(
                f"robot {self.name} lacks {' and '.join(missing)}; it needs the methods "
                f"{', '.join(METHODS)} and the attributes {', '.join(ATTRIBUTES)}"
            )
        self._robot = robot
        self.seconds = 0.0
        self.camera = robot.camera
        if not isinstance(self.camera, Camera):
            raise RobotError(f"robot {self.name}: camera is no lfnav.Camera")
        try:
            self.base_from_camera = checked_poses(robot.base_from_camera, "base_from_camera")
        except OptionError as error:
            raise RobotError(f"robot {self.name}: {error}") from error

    @property
    def is_simulated(self) -> bool:
        """Whether the robot is simulated; its clock is then the number of the step."""
        return isinstance(self._robot, KnowsTruth)

    def take_image(self) -> ImageArray:
        """A camera image, ``(height, width, 3)`` RGB, 8 bits.

        Raises:
            RobotError: the driver raised, or the image is not of the camera's size and type.
        """
        image = np.asarray(self._ask("take_image"))
        wanted = (self.camera.height, self.camera.width, 3)
        if image.shape != wanted or image.dtype != np.uint8:
            raise RobotError(
                f"robot {self.name}: take_image returned {_shape_text(image)}, its camera says "
                f"{_shape_text(np.empty(wanted, np.uint8))}"
            )
        return image

    def move(self, movement: Movement) -> Movement:
        """Moves the robot; returns the movement by odometry.

        Raises:
            RobotError: the driver raised, or the odometry is not three finite numbers.
        """
        answer = self._ask("move", movement.forward, movement.left, movement.turn)
        measured = _floats(answer)
        if measured is None or measured.shape != (3,) or not np.all(np.isfinite(measured)):
            raise RobotError(
                f"robot {self.name}: move returned {str(answer)[:60]}, not the measured forward, "
                "left and turn as three finite numbers"
            )
        forward, left, turn = measured.tolist()
        return Movement(forward, left, turn)

    def stop(self) -> None:
        """Stops the robot at once.

        Raises:
            RobotError: the driver raised.
        """
        self._ask("stop")

    def true_state(self) -> FloatArray | None:
        """True state ``(3,)`` of a simulated robot; None for a real one."""
        return self._robot.true_state() if isinstance(self._robot, KnowsTruth) else None

    def _ask(self, method: str, *values: float) -> Any:
        """Calls a method of the robot and measures its time.

        Raises:
            RobotError: the method raised.
        """
        start = time.perf_counter()
        try:
            return getattr(self._robot, method)(*values)
        except LfnavError:
            raise
        except Exception as error:
            # A driver may raise anything; the run so far must be saved all the same.
            raise RobotError(
                f"robot {self.name}: {method} raised {type(error).__name__}: {error}"
            ) from error
        finally:
            self.seconds += time.perf_counter() - start


def _floats(values: Any) -> FloatArray | None:
    """Values as an array; None where they are no numbers."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        return None


def _shape_text(image: Any) -> str:
    """Size and type of an image array, for messages."""
    if image.ndim != 3:
        return f"an array of shape {image.shape}"
    height, width, channels = image.shape
    return f"{width}x{height} pixels with {channels} channels of {image.dtype}"
