"""Confidence: the probability that an estimate is within 0.1 m and 3 degrees of the truth.

An estimate can be in the wrong place, or too far from the truth within the right one. So the
confidence is a product: the probability of the place, against all other places and against not
seeing the map at all, times the share of the estimate's normal distribution within the bounds.
"""

import functools
import math
from statistics import NormalDist

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.localize.belief import radical_inverses
from pipelines.localize.state_space import state_space_of_dimension

# What "right" means: metres and radians.
POSITION_BOUND, ANGLE_BOUND = 0.1, math.radians(3.0)
# A normal distribution is represented by so many points of a Halton sequence.
POINTS = 512
BASES = (2, 3, 5, 7, 11, 13)


def confidence(probability: float, covariance: FloatArray) -> float:
    """How probably an estimate is right.

    Args:
        probability: of the body being in the place of the estimate, 0 to 1.
        covariance: ``(D, D)`` of the estimate's error there, metres and radians.

    Raises:
        OptionError: a probability outside of 0 to 1, or a covariance that is not finite.
    """
    if not 0.0 <= probability <= 1.0:
        raise OptionError(f"probability {probability:g} lies outside 0 to 1")
    if not np.all(np.isfinite(covariance)):
        raise OptionError("the covariance is not finite")
    return probability * share_within(covariance)


def share_within(covariance: FloatArray) -> float:
    """Share of a normal distribution with this covariance ``(D, D)`` within the bounds."""
    positions = state_space_of_dimension(len(covariance)).positions
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    factor = vectors * np.sqrt(np.maximum(values, 0.0))
    errors = _normal_points(len(covariance)) @ factor.T
    metres = np.linalg.norm(errors[:, :positions], axis=1)
    radians = np.linalg.norm(errors[:, positions:], axis=1)
    return float(np.mean((metres <= POSITION_BOUND) & (radians <= ANGLE_BOUND)))


@functools.cache
def _normal_points(dimension: int) -> FloatArray:
    """``(POINTS, dimension)`` low-discrepancy points of a normal distribution; read-only."""
    # The sequence's first number is 0, which no normal distribution has.
    columns = [radical_inverses(POINTS + 1, base)[1:] for base in BASES[:dimension]]
    quantile = NormalDist().inv_cdf
    points = np.stack(columns, axis=1)
    return np.array([quantile(share) for share in points.flat]).reshape(points.shape)
