"""What can go wrong with a robot, on purpose: blocked wheels, a covered view, a failing driver."""

from typing import Any

import cv2
import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError, quoted
from pipelines.dock.robot import KnowsTruth, Robot

KINDS = ("blocked", "slipping", "black", "frozen", "people", "cover", "driver")
# Passers-by are seen in so many images, and leave so much of the width free.
PEOPLE_IMAGES, PEOPLE_FREE = 4, 0.25
# Their clothes have so many patches across the image, of any brightness.
PATCHES = (9, 12)


class FaultyRobot:
    """A simulated robot that is in order up to a step.

    Args:
        robot: the one that is in order.
        kind: ``blocked`` (wheels do not turn), ``slipping`` (they turn in vain), ``black`` (the
            camera shows nothing), ``frozen`` (it shows the same image for ever), ``people`` (they
            walk through the view and cover most of it in ``PEOPLE_IMAGES`` images), ``cover``
            (something that moves hangs in front of the lens for ever) or ``driver`` (it raises an
            exception).
        step: the number of movements after which it happens.

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
    def _happens(self) -> bool:
        return self._moves >= self._step

    def take_image(self) -> ImageArray:
        """See ``Robot.take_image``."""
        image = self._robot.take_image()
        if not self._happens:
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
        """The image ``(H, W, 3)`` behind somebody, with a free part of its width on one side."""
        height, width = image.shape[:2]
        clothes = self._rng.integers(0, 256, (*PATCHES, 3), dtype=np.uint8)
        front = cv2.resize(clothes, (width, height), interpolation=cv2.INTER_LINEAR)
        seen = round(free * width)
        kept = slice(0, seen) if self._disturbed_images % 2 else slice(width - seen, width)
        front[:, kept] = image[:, kept]
        return np.asarray(front, dtype=np.uint8)

    def move(self, forward: float, left: float, turn: float) -> Any:
        """See ``Robot.move``."""
        happens = self._happens
        self._moves += 1
        if happens and self._kind == "driver":
            raise ConnectionError("no answer from the motor controller")
        if happens and self._kind == "blocked":
            return self._robot.move(0.0, 0.0, 0.0)
        if happens and self._kind == "slipping":
            self._robot.move(0.0, 0.0, 0.0)
            return forward, left, turn
        return self._robot.move(forward, left, turn)

    def stop(self) -> None:
        """See ``Robot.stop``."""
        self.is_stopped = True
        self._robot.stop()

    def true_state(self) -> FloatArray:
        """See ``KnowsTruth``.

        Raises:
            OptionError: the robot is no simulator.
        """
        if not isinstance(self._robot, KnowsTruth):
            raise OptionError("faults are for simulated robots")
        return self._robot.true_state()
