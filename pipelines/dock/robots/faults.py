"""Fault injection: blocked wheels, a covered camera, a failing driver, a door that is closed.

What happens to the robot happens from a step on. A closed door stands in its world: the robot's
middle gets no nearer to the middle of the doorway than half a door's width, and the wheels stop
there. The images do not show it, as if it were of glass: that the way is blocked, the robot has to
find out by driving.
"""

from typing import Any

import cv2
import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError, quoted
from pipelines.dock.planar_motion import moved
from pipelines.dock.robot import KnowsTruth, Movement, Robot

KINDS = ("blocked", "slipping", "black", "frozen", "people", "cover", "driver")
# A closed door is given with its place, in metres: door@9.3,7.96. Half of its width, metres.
DOOR, DOOR_RADIUS = "door@", 0.45
# The movement that ends at a door is found to this share.
DOOR_SHARES = 40
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
            ``cover`` (something moving covers the lens from then on), ``driver`` (the driver
            raises an exception) or ``door@X,Y`` (the doorway whose middle is there is closed).
        step: number of movements after which the fault begins.

    Raises:
        OptionError: unknown kind, a negative step, or a door without a place.
    """

    def __init__(self, robot: Robot, kind: str, step: int) -> None:
        self._door = _door_place(kind) if kind.startswith(DOOR) else None
        if self._door is None and kind not in KINDS:
            raise OptionError(f"fault {quoted(kind)} is none of {', '.join(KINDS)}, {DOOR}X,Y")
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
        if is_faulty and self._door is not None:
            share = self._share_before(self._door, Movement(forward, left, turn))
            return self._robot.move(share * forward, share * left, share * turn)
        return self._robot.move(forward, left, turn)

    def _share_before(self, door: FloatArray, movement: Movement) -> float:
        """The share of a movement that a closed door at a place ``(2,)`` lets happen."""
        if movement.distance == 0.0:
            return 1.0
        state, done = self.true_state(), 0.0
        nearest = min(DOOR_RADIUS, float(np.linalg.norm(state[:2] - door)))
        for share in np.linspace(0.0, 1.0, DOOR_SHARES + 1)[1:].tolist():
            place = moved(state, movement.scaled(share))[:2]
            if np.linalg.norm(place - door) < nearest:
                break
            done = share
        return done

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


def _door_place(kind: str) -> FloatArray:
    """Place ``(2,)`` of the door in a fault's kind.

    Raises:
        OptionError: it is no place.
    """
    try:
        x, y = (float(number) for number in kind.removeprefix(DOOR).split(","))
    except ValueError:
        x = y = np.nan
    if not np.all(np.isfinite([x, y])):
        raise OptionError(f"fault {quoted(kind)} is not of the form {DOOR}X,Y, like door@9.3,7.96")
    return np.array([x, y])
