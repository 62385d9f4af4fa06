"""The motion model p(x_t | x_{t-1}, m_t): odometry increments with noise.

The odometry model of Thrun, Burgard and Fox, *Probabilistic Robotics*, chapter 5.4, decomposes a
motion into turn, drive, turn. A robot that can drive sideways has no such decomposition (and even
for one that cannot, the first turn is undefined when it hardly moves). So the same four parameters
act here on the increment itself, as measured in the robot's frame, with t the length of its
translation and r the size of its turn:

    variance of the heading             alpha1 r^2 + alpha2 t^2 + heading_floor^2
    variance of the translation, along
    and across the heading, each        alpha3 t^2 + alpha4 r^2 + position_floor^2

The floor keeps particles apart while the robot stands still, and stands for what odometry does not
know about: slip, a map that is some centimetres off.
"""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from pipelines.artifacts.array_types import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.pose import planar_state_of, wrap_angle


@dataclass(frozen=True)
class MotionModel:
    """How far odometry is trusted. Zero is allowed everywhere and means: exact.

    Attributes:
        alpha1: heading noise from turning, rad^2 a rad^2.
        alpha2: heading noise from driving, rad^2 a m^2.
        alpha3: position noise from driving, m^2 a m^2.
        alpha4: position noise from turning, m^2 a rad^2.
        position_floor: standard deviation of x and of y that each step adds, metres.
        heading_floor: standard deviation of the heading that each step adds, radians.

    Raises:
        OptionError: a value that is negative or not finite.
    """

    alpha1: float = 0.04
    alpha2: float = 0.02
    alpha3: float = 0.04
    alpha4: float = 0.01
    position_floor: float = 0.02
    heading_floor: float = 0.01

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (np.isfinite(value) and value >= 0.0):
                raise OptionError(f"motion noise {field.name} = {value:g} is not 0 or more")

    def standard_deviations(self, increment: ArrayLike) -> tuple[float, float]:
        """Noise of one step: of the translation along each axis (metres), of the heading (radians).

        Args:
            increment: ``(3,)`` dx, dy (metres), dheading (radians).
        """
        dx, dy, turn = np.asarray(increment, dtype=np.float64)
        translation_squared, turn_squared = dx * dx + dy * dy, turn * turn
        position_variance = (
            self.alpha3 * translation_squared + self.alpha4 * turn_squared + self.position_floor**2
        )
        heading_variance = (
            self.alpha1 * turn_squared + self.alpha2 * translation_squared + self.heading_floor**2
        )
        return float(np.sqrt(position_variance)), float(np.sqrt(heading_variance))


def planar_increment(odometry_pose_a: FloatArray, odometry_pose_b: FloatArray) -> FloatArray:
    """The motion between two odometry poses, seen from the first.

    Args:
        odometry_pose_a: ``(4, 4)`` world_from_base before, in odometry's own world.
        odometry_pose_b: ``(4, 4)`` world_from_base after, in the same world.

    Returns:
        ``(3,)``: dx forward and dy to the left in metres, dheading in radians, in (-pi, pi].

    Raises:
        OptionError: a pose that is not finite.
    """
    before, after = planar_state_of(odometry_pose_a), planar_state_of(odometry_pose_b)
    if not (np.all(np.isfinite(before)) and np.all(np.isfinite(after))):
        raise OptionError("an odometry pose is not finite")
    cosine, sine = np.cos(before[2]), np.sin(before[2])
    dx, dy = after[:2] - before[:2]
    turn = float(wrap_angle(after[2] - before[2]))
    return np.array([cosine * dx + sine * dy, -sine * dx + cosine * dy, turn])


def compose(states: FloatArray, increments: FloatArray) -> FloatArray:
    """States ``(..., 3)`` after motions ``(..., 3)`` given in each state's own frame."""
    cosine, sine = np.cos(states[..., 2]), np.sin(states[..., 2])
    moved = np.empty(np.broadcast_shapes(states.shape, increments.shape))
    moved[..., 0] = states[..., 0] + cosine * increments[..., 0] - sine * increments[..., 1]
    moved[..., 1] = states[..., 1] + sine * increments[..., 0] + cosine * increments[..., 1]
    moved[..., 2] = wrap_angle(states[..., 2] + increments[..., 2])
    return moved


def predict(
    states: FloatArray,
    increment: ArrayLike,
    model: MotionModel,
    rng: np.random.Generator,
    scale: float = 1.0,
) -> FloatArray:
    """Draws each particle's next state from p(x_t | x_{t-1}, m_t).

    Args:
        states: ``(M, 3)`` x, y (metres), heading (radians).
        increment: ``(3,)`` dx, dy, dheading as measured by odometry, in the robot's frame.
        model: the noise.
        rng: source of the draws; the same number is consumed whatever the noise.
        scale: factor on all standard deviations (a wide belief is searched with more noise).

    Returns:
        ``(M, 3)`` new states, headings in (-pi, pi].

    Raises:
        OptionError: an increment that is not three finite numbers, or a negative or infinite scale.
    """
    motion = np.asarray(increment, dtype=np.float64)
    if motion.shape != (3,) or not np.all(np.isfinite(motion)):
        raise OptionError("an odometry increment takes three finite numbers dx, dy, dheading")
    if not (np.isfinite(scale) and scale >= 0.0):
        raise OptionError(f"noise scale {scale:g} is not 0 or more")
    position_sigma, heading_sigma = model.standard_deviations(motion)
    spread = scale * np.array([position_sigma, position_sigma, heading_sigma])
    noisy_motions = motion + spread * rng.standard_normal((len(states), 3))
    return compose(states, noisy_motions)
