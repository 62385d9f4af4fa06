"""The motion model p(x_t | x_{t-1}, m_t): odometry increments with noise.

The odometry model of Thrun, Burgard and Fox, *Probabilistic Robotics*, chapter 5.4, decomposes a
motion into rotation, translation, rotation. A robot that can drive sideways has no such
decomposition (and even for one that cannot, the first rotation is undefined when it hardly moves).
So the same four parameters act here on the increment itself, as measured in the robot's frame, with
t the length of its translation and r the angle of its rotation:

    variance of the heading             alpha1 r^2 + alpha2 t^2 + heading_floor^2
    variance of the translation, along
    and across the heading, each        alpha3 t^2 + alpha4 r^2 + position_floor^2

The floor keeps particles apart while the robot stands still, and covers what odometry does not
measure: slip, a map that is some centimetres off. A pose with six degrees of freedom takes the same
variances along its three axes and about them. Where no odometry is known the motion is a random
walk.
"""

import numpy as np

from pipelines.artifacts.arrays import FloatArray, checked_array
from pipelines.artifacts.errors import OptionError
from pipelines.localize.settings import MotionModel
from pipelines.localize.state_space import StateSpace, sigmas_of


def checked_increment(space: StateSpace, increment: FloatArray | None) -> FloatArray | None:
    """An odometry increment as an array; None stays None.

    Raises:
        OptionError: not D finite numbers.
    """
    if increment is None:
        return None
    return checked_array(increment, "odometry increment", (space.dimension,))


def predict(
    space: StateSpace,
    states: FloatArray,
    increment: FloatArray | None,
    model: MotionModel,
    rng: np.random.Generator,
    scale: float = 1.0,
) -> FloatArray:
    """Draws each particle's next state from p(x_t | x_{t-1}, m_t).

    Args:
        space: what a state is.
        states: ``(M, D)`` of the particles.
        increment: ``(D,)`` as measured by odometry, in the body's frame; None: a random walk.
        model: how large the noise is.
        rng: source of the draws; the same number is consumed whatever the noise.
        scale: factor on all standard deviations (a wide belief is searched with more noise).

    Raises:
        OptionError: an increment that is not D finite numbers, or a negative or infinite scale.
    """
    motion = checked_increment(space, increment)
    if not (np.isfinite(scale) and scale >= 0.0):
        raise OptionError(f"noise scale {scale:g} is not 0 or more")
    position_sigma, heading_sigma = model.standard_deviations(space, motion)
    spread = scale * sigmas_of(space, position_sigma, heading_sigma)
    noise = spread * rng.standard_normal((len(states), space.dimension))
    return space.composed(states, noise if motion is None else motion + noise)
