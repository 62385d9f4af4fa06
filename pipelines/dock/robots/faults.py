"""What can go wrong with a robot, on purpose: blocked wheels, a black camera, a failing driver."""

from typing import Any

import numpy as np

from pipelines.artifacts.array_types import FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.dock.robot import KnowsTruth, Robot

KINDS = ("blocked", "slipping", "black", "driver")


class FaultyRobot:
    """A simulated robot that is in order up to a step.

    Args:
        robot: the one that is in order.
        kind: ``blocked`` (wheels do not turn), ``slipping`` (they turn in vain), ``black`` (the
            camera shows nothing) or ``driver`` (it raises an exception).
        step: the number of movements after which it happens.

    Raises:
        OptionError: unknown kind, or a negative step.
    """

    def __init__(self, robot: Robot, kind: str, step: int) -> None:
        if kind not in KINDS:
            raise OptionError(f"fault {kind!r} is none of {', '.join(KINDS)}")
        if step < 0:
            raise OptionError(f"a fault at step {step} is not possible")
        self.camera = robot.camera
        self.base_from_camera = robot.base_from_camera
        self.note = str(getattr(robot, "note", ""))
        self.is_stopped = False
        self._robot, self._kind, self._step = robot, kind, step
        self._moves = 0

    @property
    def _happens(self) -> bool:
        return self._moves >= self._step

    def take_image(self) -> ImageArray:
        """See ``Robot.take_image``."""
        image = self._robot.take_image()
        is_black = self._kind == "black" and self._happens
        return np.zeros_like(image) if is_black else image

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
