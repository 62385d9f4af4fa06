"""Simulated motion, odometry and camera noise.

Movements and odometry have noise, systematic errors and slip. Images have noise and a random gain.
"""

import math
from dataclasses import dataclass, fields

import numpy as np

from pipelines.artifacts.arguments import check_fields
from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.dock.planar_motion import moved
from pipelines.dock.robot import Movement
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import world_from_base_planar


@dataclass(frozen=True)
class MotionNoise:
    """Errors of movements and of odometry; zero means exact.

    Attributes:
        actuation: standard deviation of a movement from its command, as a share of the command.
        odometry: standard deviation of measured distances, as a share of the distance.
        odometry_turn: standard deviation of the measured rotation, radians a step.
        scale: systematic error of measured distances, as a share of the distance.
        drift: systematic error of the measured rotation, radians a metre driven.
        slip: probability that the wheels slip in a step.
        slip_share: share of a movement that is lost when they slip.

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
    """True pose of a simulated robot, and how movements change it.

    Args:
        start: ``(3,)`` its true state at the start.
        noise: errors of movements and odometry.
        rng: the random numbers of these errors.
    """

    def __init__(self, start: FloatArray, noise: MotionNoise, rng: np.random.Generator) -> None:
        self.state = np.array(start, dtype=np.float64)
        self._noise = noise
        self._rng = rng

    def move(self, command: Movement) -> Movement:
        """Moves the robot; returns the movement by odometry."""
        noise = self._noise
        # The same number of draws in every step keeps runs comparable.
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
        gain: largest deviation of the random gain from 1.

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
    """An exact image ``(H, W, 3)`` with the errors of a sensor."""
    gain = 1.0 + sensor.gain * rng.uniform(-1.0, 1.0)
    noisy = gain * image + sensor.noise * rng.standard_normal(image.shape)
    return np.asarray(np.clip(np.rint(noisy), 0.0, 255.0), dtype=np.uint8)


class SimulatedRobot:
    """What all robots that move without recorded images have in common; subclasses take images.

    Args:
        camera: without distortion.
        base_from_camera: ``(4, 4)`` the camera's mount.
        motion: the robot's true pose, and its errors of movements and odometry.
        sensor: errors of its images.
        rng: the random numbers of its images.
    """

    def __init__(
        self,
        camera: Camera,
        base_from_camera: FloatArray,
        motion: SimulatedMotion,
        sensor: SensorNoise,
        rng: np.random.Generator,
    ) -> None:
        self.camera = camera
        self.base_from_camera = base_from_camera
        self._motion, self._sensor, self._rng = motion, sensor, rng

    @property
    def _world_from_camera(self) -> FloatArray:
        """``(4, 4)`` true pose of the camera."""
        return world_from_base_planar(self._motion.state) @ self.base_from_camera

    def move(self, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Moves as ``Robot.move`` says; returns the movement by odometry."""
        measured = self._motion.move(Movement(forward, left, turn))
        return measured.forward, measured.left, measured.turn

    def stop(self) -> None:
        """Does nothing: the robot stands still between movements."""

    def true_state(self) -> FloatArray:
        """True state ``(3,)`` of the robot."""
        return self._motion.state
