"""The density of a mixture of normal distributions, compiled: one pass over all pairs."""

import numpy as np

from pipelines.artifacts.array_types import FloatArray
from pipelines.lightfield.compiled import compiled


@compiled
def log_mixture_density(
    positions: FloatArray,
    centres: FloatArray,
    angles: FloatArray,
    log_weights: FloatArray,
    position_sigma: float,
    angle_sigma: float,
    exponents: FloatArray,
    result: FloatArray,
) -> None:
    """Logarithm of a sum of isotropic normal distributions, but for their common factor.

    Args:
        positions: (M, P) where, metres.
        centres: (N, P) of the distributions.
        angles: (M, N) between the orientations of both, radians.
        log_weights: (N,) of the distributions; -inf is a weight of 0.
        position_sigma: metres.
        angle_sigma: radians.
        exponents: (N,) overwritten.
        result: (M,) receives the logarithms; -inf where all weights are 0.
    """
    position_scale, angle_scale = 0.5 / position_sigma**2, 0.5 / angle_sigma**2
    for row in range(len(positions)):
        largest = -np.inf
        for column in range(len(centres)):
            squared = 0.0
            for i in range(positions.shape[1]):
                squared += (positions[row, i] - centres[column, i]) ** 2
            own = log_weights[column] - position_scale * squared
            own -= angle_scale * angles[row, column] ** 2
            exponents[column] = own
            largest = max(largest, own)
        if largest == -np.inf:
            result[row] = largest
            continue
        total = 0.0
        for column in range(len(centres)):
            # Terms that are lost in rounding need no exponential.
            if exponents[column] > largest - 40.0:
                total += np.exp(exponents[column] - largest)
        result[row] = largest + np.log(total)
