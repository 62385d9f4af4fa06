"""Fault injection: simulated robots with blocked wheels, a covered camera, a failing driver."""

from typing import Any

import cv2
import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError, quoted
from pipelines.dock.robot import KnowsTruth, Robot

KINDS = ("blocked", "slipping", "black", "frozen", "people", "cover", "driver")
# Passers-by cover this many images, and leave this share of the width free.
PEOPLE_IMAGES, PEOPLE_FREE = 4, 0.25
# Rows and columns of random colour patches in what covers the view.
PATCHES = (9, 12)


class FaultyRobot:
    """A simulated robot that works until a fault begins.

    Args:
        robot: the robot without the fault.
        kind: ``blocked`` (the wheels do not turn), ``slipping`` (the wheels turn, the robot does
            not move), ``black`` (the camera's images are black), ``frozen`` (the camera repeats its
            last image), ``people`` (passers-by cover most of the view in ``PEOPLE_IMAGES`` images),
            ``cover`` (something moving covers the lens from then on) or ``driver`` (the driver
            raises an exception).
        step: number of movements after which the fault begins.

    Raises:
        OptionError: unknown kind, or a negative step.
    """

    def __init__(self, robot: Robot, kind: str, step: int) -> None:
        if kind not in KINDS:
            raise OptionError(f"fault {quoted(kind)} is none of {', '.join(KINDS)}")
        if step < 0:
            raise OptionError(f"a fault at step {step} is not possible")
        self.camera = robot.camera
        self.base_from_camera = robot.base_from_camera
        self.note = str(getattr(robot, "note", ""))
        self.is_stopped = False
        self._robot, self._kind, self._step = robot, kind, step
        self._moves = 0
        self._disturbed_images = 0
        self._last: ImageArray | None = None
        self._rng = np.random.default_rng(step)

    @property
    def _is_faulty(self) -> bool:
        """Whether the fault has begun."""
        return self._moves >= self._step

    def take_image(self) -> ImageArray:
        """The robot's camera image, ``(H, W, 3)`` RGB, with the fault."""
        image = self._robot.take_image()
        if not self._is_faulty:
            self._last = image
            return image
        self._disturbed_images += 1
        if self._kind == "frozen" and self._last is not None:
            return self._last
        if self._kind == "black":
            return np.zeros_like(image)
        if self._kind == "people" and self._disturbed_images <= PEOPLE_IMAGES:
            return self._covered(image, PEOPLE_FREE)
        return self._covered(image, 0.0) if self._kind == "cover" else image

    def _covered(self, image: ImageArray, free: float) -> ImageArray:
        """An image ``(H, W, 3)`` covered by colour patches but for a share of its width."""
        height, width = image.shape[:2]
        patches = self._rng.integers(0, 256, (*PATCHES, 3), dtype=np.uint8)
        front = cv2.resize(patches, (width, height), interpolation=cv2.INTER_LINEAR)
        seen = round(free * width)
        kept = slice(0, seen) if self._disturbed_images % 2 else slice(width - seen, width)
        front[:, kept] = image[:, kept]
        return np.asarray(front, dtype=np.uint8)

    def move(self, forward: float, left: float, turn: float) -> Any:
        """Moves as ``Robot.move`` says, with the fault."""
        is_faulty = self._is_faulty
        self._moves += 1
        if is_faulty and self._kind == "driver":
            raise ConnectionError("no answer from the motor controller")
        if is_faulty and self._kind == "blocked":
            return self._robot.move(0.0, 0.0, 0.0)
        if is_faulty and self._kind == "slipping":
            self._robot.move(0.0, 0.0, 0.0)
            return forward, left, turn
        return self._robot.move(forward, left, turn)

    def stop(self) -> None:
        """Stops the robot at once."""
        self.is_stopped = True
        self._robot.stop()

    def true_state(self) -> FloatArray:
        """True state ``(3,)`` of the robot.

        Raises:
            OptionError: the robot is not a simulated one.
        """
        if not isinstance(self._robot, KnowsTruth):
            raise OptionError("faults are for simulated robots")
        return self._robot.true_state()
