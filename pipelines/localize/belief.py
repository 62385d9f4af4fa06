"""The belief: weighted particles that stand for p(x_t | H_t) of the paper's equation (1).

A particle is a state (``state_space``) with a weight. Weights are kept as logarithms, since
the likelihood of an image is a product over thousands of pixels: as plain numbers nearly all
particles would underflow to zero, and the few that are left would look equally good. Only
differences of log-weights carry meaning, so that a belief is normalised after each update.

A set in which every weight is zero says nothing about where the robot is; ``normalise_log_weights``
reports that instead of inventing weights, and the filter calls the robot lost.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipelines.artifacts.arrays import BoolArray, FloatArray, checked_array
from pipelines.artifacts.errors import OptionError, StageError
from pipelines.lightfield.free_ground import FreeGround
from pipelines.localize.state_space import StateSpace, sigmas_of, state_space_of_dimension

# A belief's weights add up to 1 within this; looser than rounding over a million particles.
NORMALISATION_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Belief:
    """A normalised particle set.

    Attributes:
        states: ``(M, D)`` in one of the state spaces.
        log_weights: ``(M,)`` natural logarithms of weights that add up to 1; -inf is a weight of 0.

    Raises:
        OptionError: no particle, shapes that do not fit, or states that are not finite.
        StageError: weights that are NaN or do not add up to 1.
    """

    states: FloatArray
    log_weights: FloatArray

    def __post_init__(self) -> None:
        states = checked_array(self.states, "particles", (None, None))
        if len(states) == 0:
            raise OptionError(f"particles of shape {states.shape} instead of (M, D), M > 0")
        state_space_of_dimension(states.shape[1])
        # Of no weight a logarithm is -inf.
        checked_array(self.log_weights, "log-weights", (len(states),), finite=False)
        total = float(np.sum(np.exp(self.log_weights)))
        # Written so that NaN fails the test too.
        if not abs(total - 1.0) <= NORMALISATION_TOLERANCE:
            raise StageError(f"the particles' weights add up to {total:g} instead of 1")

    def __len__(self) -> int:
        return len(self.states)

    @property
    def weights(self) -> FloatArray:
        """``(M,)`` weights that add up to 1."""
        return np.exp(self.log_weights)


def log_sum(log_values: FloatArray) -> FloatArray:
    """Logarithm of the sum of exponentials along the first axis: ``(M, ...)`` to ``(...)``.

    The largest ones are kept out of the sum: what is added to them does not round (Blanchard,
    Higham, Higham 2021, "Accurately computing the log-sum-exp and softmax functions"). -inf adds
    nothing. SciPy has the same function, but takes 0.2 s to load.
    """
    largest = log_values.max(axis=0, keepdims=True)
    is_largest = log_values == largest
    shift = np.where(np.isfinite(largest), largest, 0.0)
    others = np.exp(np.where(is_largest, -np.inf, log_values - shift)).sum(axis=0)
    count = is_largest.sum(axis=0)
    return np.asarray(np.log1p(others / count) + np.log(count) + largest[0], dtype=np.float64)


def normalise_log_weights(log_weights: ArrayLike) -> tuple[FloatArray, bool]:
    """Log-weights shifted so that the weights add up to 1.

    Args:
        log_weights: ``(M,)`` of any common offset; -inf is a weight of 0.

    Returns:
        The normalised log-weights ``(M,)``, and whether any particle had weight. Where none had,
        the weights are equal: the image speaks against all hypotheses alike, and the caller has to
        say that the robot is lost.

    Raises:
        OptionError: no weight at all, or not a vector.
        StageError: NaN or +inf among them: the likelihood is broken, nothing can be concluded.
    """
    values = np.asarray(log_weights, dtype=np.float64)
    if values.ndim != 1 or len(values) == 0:
        raise OptionError(f"log-weights have shape {values.shape} instead of (M,), M > 0")
    broken = int(np.count_nonzero(np.isnan(values) | np.isposinf(values)))
    if broken:
        raise StageError(f"{broken} of {len(values)} log-weights are NaN or +inf")
    largest = float(np.max(values))
    if np.isneginf(largest):
        return np.full(len(values), -np.log(len(values))), False
    # Largest first at 0: the sum lies in [1, M] and can neither underflow nor overflow.
    shifted = values - largest
    return shifted - np.log(np.sum(np.exp(shifted))), True


def effective_sample_size(log_weights: FloatArray) -> float:
    """How many equally weighted particles the set is worth: 1 / sum of squared weights.

    Args:
        log_weights: ``(M,)``, of any common offset.

    Returns:
        In [1, M]; 0 where no particle has weight.
    """
    largest = float(np.max(log_weights))
    if np.isneginf(largest):
        return 0.0
    relative = np.exp(log_weights - largest)
    return float(np.sum(relative) ** 2 / np.sum(relative**2))


@dataclass(frozen=True)
class Region:
    """Where a body may be: positions between two corners, above free ground, in any orientation.

    Attributes:
        low: ``(P,)`` smallest coordinates, metres.
        high: ``(P,)`` largest.
        ground: the ground between the corners that is free; None: all of it.

    Raises:
        OptionError: corners that are not finite or enclose nothing.
    """

    low: FloatArray
    high: FloatArray
    ground: FreeGround | None = None

    def __post_init__(self) -> None:
        if not (np.all(np.isfinite(self.low)) and np.all(np.isfinite(self.high))):
            raise OptionError("an area takes finite numbers x_min,x_max,y_min,y_max")
        if np.any(self.low >= self.high):
            text = ", ".join(
                f"{name} {low:g} to {high:g}"
                for name, low, high in zip("xyz", self.low, self.high, strict=False)
            )
            raise OptionError(f"the area {text} is empty")

    def log_density(self, space: StateSpace) -> float:
        """Logarithm of the uniform distribution's density over the region."""
        sides = self.high - self.low
        volume = float(np.prod(sides)) * space.orientation_volume()
        if self.ground is not None:
            volume *= self.ground.area / float(np.prod(sides[:2]))
        return -math.log(volume)

    def contains(self, states: FloatArray) -> BoolArray:
        """Which states ``(M, D)`` lie inside, ``(M,)``."""
        positions = states[:, : len(self.low)]
        inside = np.all((positions >= self.low) & (positions <= self.high), axis=1)
        if self.ground is not None:
            inside &= self.ground.contains(positions[:, :2])
        return np.asarray(inside)

    def sample(self, space: StateSpace, count: int, rng: np.random.Generator) -> FloatArray:
        """Draws states ``(count, D)`` uniformly, in any orientation.

        Args:
            space: what a state is.
            count: how many.
            rng: source of the draws.
        """
        states = space.uniform(self.low, self.high, count, rng)
        if self.ground is not None:
            states[:, :2] = self.ground.sample(count, rng)
        return states


def region_of_area(area: ArrayLike) -> Region:
    """The region of an area ``(4,)`` x_min, x_max, y_min, y_max on the floor.

    Raises:
        OptionError: not four finite numbers, or an area that is empty.
    """
    values = np.asarray(area, dtype=np.float64)
    if values.shape != (4,):
        raise OptionError("an area takes four finite numbers x_min,x_max,y_min,y_max")
    return Region(values[[0, 2]], values[[1, 3]])


def uniform_belief(
    space: StateSpace, region: Region, count: int, rng: np.random.Generator
) -> Belief:
    """Equally weighted particles, uniform over a region and all orientations.

    Args:
        space: what a state is.
        region: where particles may be.
        count: number of particles.
        rng: source of the draws.

    Raises:
        OptionError: fewer than one particle.
    """
    _check_count(count)
    return Belief(region.sample(space, count, rng), equal_log_weights(count))


def gaussian_belief(
    space: StateSpace,
    state: ArrayLike,
    position_sigma: float,
    heading_sigma: float,
    count: int,
    rng: np.random.Generator,
) -> Belief:
    """Equally weighted particles around a state.

    Args:
        space: what a state is.
        state: ``(D,)`` the centre.
        position_sigma: standard deviation along each axis, metres.
        heading_sigma: standard deviation of each angle, radians.
        count: number of particles.
        rng: source of the draws.

    Raises:
        OptionError: values that are not finite, negative deviations, or fewer than one particle.
    """
    centre = np.asarray(state, dtype=np.float64)
    if centre.shape != (space.dimension,) or not np.all(np.isfinite(centre)):
        raise OptionError(f"a start pose takes {space.dimension} finite numbers")
    for name, sigma in (("position_sigma", position_sigma), ("heading_sigma", heading_sigma)):
        if not (np.isfinite(sigma) and sigma >= 0.0):
            raise OptionError(f"{name} = {sigma:g} is not a standard deviation (0 or more)")
    _check_count(count)
    spread = sigmas_of(space, position_sigma, heading_sigma)
    offsets = spread * rng.standard_normal((count, space.dimension))
    return Belief(space.moved(centre, offsets), equal_log_weights(count))


def _check_count(count: int) -> None:
    if count < 1:
        raise OptionError(f"{count} particles; at least 1 is needed")


def equal_log_weights(count: int) -> FloatArray:
    """``(count,)`` log-weights of particles that all weigh the same."""
    return np.full(count, -np.log(count))


def radical_inverses(count: int, base: int) -> FloatArray:
    """The van der Corput sequence ``(count,)`` in [0, 1): digits of 0, 1, 2 ... mirrored."""
    rest, result = np.arange(count), np.zeros(count)
    worth = 1.0 / base
    while rest.any():
        result += worth * (rest % base)
        rest, worth = rest // base, worth / base
    return result
