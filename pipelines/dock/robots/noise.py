"""How a simulated robot errs: in its movements, in what its wheels say of them, in its images.

Movements and odometry have noise, systematic errors and slip; images have noise and a gain that
wanders.
"""

import math
from dataclasses import dataclass, fields

import numpy as np

from pipelines.artifacts.arguments import check_fields
from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.dock.planar_motion import moved
from pipelines.dock.robot import Movement


@dataclass(frozen=True)
class MotionNoise:
    """Errors of movements and of odometry. Zero is allowed everywhere and means: exact.

    Attributes:
        actuation: standard deviation of a movement from its command, as a share of it.
        odometry: standard deviation of measured distances, as a share.
        odometry_turn: standard deviation of the measured turn, radians a step.
        scale: systematic: odometry measures distances longer by this share.
        drift: systematic: odometry turns by so many radians a metre driven.
        slip: probability that a step's wheels turn in part in vain.
        slip_share: the share of such a step that does not happen.

    Raises:
        OptionError: a value that is not finite, negative noise, or a probability above 1.
    """

    actuation: float = 0.02
    odometry: float = 0.02
    odometry_turn: float = math.radians(0.5)
    scale: float = 0.0
    drift: float = 0.0
    slip: float = 0.0
    slip_share: float = 0.5

    def __post_init__(self) -> None:
        check_fields(self)
        signed = ("scale", "drift")
        for field in fields(self):
            value = getattr(self, field.name)
            if not math.isfinite(value) or (value < 0.0 and field.name not in signed):
                raise OptionError(f"motion noise {field.name} = {value:g} is not 0 or more")
        if self.slip > 1.0 or self.slip_share > 1.0:
            raise OptionError("slip and slip_share are between 0 and 1")


class SimulatedMotion:
    """Where a simulated robot is, and how it gets elsewhere.

    Args:
        start: ``(3,)`` its true state.
        noise: of movements and odometry.
        rng: the only source of randomness.
    """

    def __init__(self, start: FloatArray, noise: MotionNoise, rng: np.random.Generator) -> None:
        self.state = np.array(start, dtype=np.float64)
        self._noise = noise
        self._rng = rng

    def move(self, command: Movement) -> Movement:
        """Moves; returns what odometry measures."""
        noise = self._noise
        # The same number of draws in every step, whatever happens in it.
        errors, slips = self._rng.standard_normal(5), self._rng.random() < noise.slip
        turned = 1.0 + noise.actuation * errors[0]
        driven = 1.0 + noise.actuation * errors[1]
        rolled = Movement(driven * command.forward, driven * command.left, turned * command.turn)
        happened = rolled.scaled(1.0 - noise.slip_share) if slips else rolled
        self.state = moved(self.state, happened)
        measured = 1.0 + noise.scale + noise.odometry * errors[2]
        turn = rolled.turn + noise.drift * rolled.distance
        if rolled.distance > 0.0 or rolled.turn != 0.0:
            turn += noise.odometry_turn * errors[3]
        return Movement(measured * rolled.forward, measured * rolled.left, float(turn))


@dataclass(frozen=True)
class SensorNoise:
    """Errors of images.

    Attributes:
        noise: standard deviation of each pixel, grey levels.
        gain: the brightness wanders by up to this share.

    Raises:
        OptionError: negative or not finite, or a gain of 1 or more.
    """

    noise: float = 2.0
    gain: float = 0.05

    def __post_init__(self) -> None:
        check_fields(self)
        if not (0.0 <= self.noise <= 255.0 and 0.0 <= self.gain < 1.0):
            raise OptionError(
                f"sensor noise {self.noise:g} is not between 0 and 255, or gain {self.gain:g} not "
                "between 0 and 1"
            )


def as_recorded(image: ImageArray, sensor: SensorNoise, rng: np.random.Generator) -> ImageArray:
    """An exact image ``(H, W, 3)`` as the camera records it."""
    gain = 1.0 + sensor.gain * rng.uniform(-1.0, 1.0)
    noisy = gain * image + sensor.noise * rng.standard_normal(image.shape)
    return np.asarray(np.clip(np.rint(noisy), 0.0, 255.0), dtype=np.uint8)
