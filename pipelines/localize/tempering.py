"""Tempering: a likelihood that is flattened until enough particles survive it."""

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import StageError
from pipelines.localize.belief import effective_sample_size, normalise_log_weights


def tempered(
    log_weights: FloatArray, log_likelihoods: FloatArray, smallest_share: float
) -> tuple[FloatArray, float]:
    """Adds log-likelihoods to log-weights, flattened as far as needed to keep particles alive.

    A likelihood that is sharper than the particles are dense leaves one of them with all the
    weight, the nearest by chance. Raised to a power below 1 it selects more slowly and more surely
    (annealed weights, Deutscher and Reid 2005).

    Args:
        log_weights: ``(M,)`` normalised prior weights.
        log_likelihoods: ``(M,)``; -inf is allowed.
        smallest_share: of M that the effective sample size shall keep; 0 leaves the likelihood as
            it is.

    Returns:
        Normalised log-weights ``(M,)`` and the power in (0, 1]. Where the image rules out all
        particles alike, the prior weights remain.

    Raises:
        StageError: log-likelihoods that are NaN or +inf: the comparison is broken.
    """
    broken = int(np.count_nonzero(np.isnan(log_likelihoods) | np.isposinf(log_likelihoods)))
    if broken:
        raise StageError(f"{broken} of {len(log_likelihoods)} log-likelihoods are NaN or +inf")
    largest = np.max(log_likelihoods)
    if np.isneginf(largest):
        return log_weights, 1.0
    relative = log_likelihoods - largest

    def posterior(power: float) -> FloatArray:
        return normalise_log_weights(log_weights + power * relative)[0]

    wanted = smallest_share * len(log_weights)
    # The prior's own spread is the most that any power can keep.
    wanted = min(wanted, 0.5 * effective_sample_size(log_weights))
    if effective_sample_size(posterior(1.0)) >= wanted:
        return posterior(1.0), 1.0
    low, high = 1e-9, 1.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        if effective_sample_size(posterior(middle)) >= wanted:
            low = middle
        else:
            high = middle
    return posterior(low), low
