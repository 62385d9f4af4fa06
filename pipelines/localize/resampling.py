"""Resampling: drawing particles in proportion to their weights.

All schemes are unbiased (particle i is drawn ``count * weight_i`` times on average) and differ in
their variance. Each sorts ``count`` points of [0, 1) into the cumulative weights; only the way the
points are spread differs (Douc, Cappe and Moulines 2005):

- ``multinomial``: independent points; the paper's Condensation.
- ``stratified``: one independent point in each of ``count`` equal intervals.
- ``systematic``: the same offset in each interval; least work, lowest variance in practice.
- ``residual``: floor(count * weight) copies for certain, the rest multinomial.
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import OptionError, StageError, quoted

Scheme: TypeAlias = Callable[[FloatArray, int, np.random.Generator], IntArray]


def resample(log_weights: ArrayLike, count: int, scheme: str, rng: np.random.Generator) -> IntArray:
    """Indices of the particles that survive, some of them several times.

    Args:
        log_weights: ``(M,)`` of any common offset; -inf is never drawn.
        count: how many to draw; need not be M.
        scheme: a key of ``SCHEMES``.
        rng: source of the draws.

    Returns:
        ``(count,)`` indices in [0, M).

    Raises:
        OptionError: an unknown scheme, or fewer than one particle to draw.
        StageError: no particle has weight, or a weight is NaN or +inf.
    """
    if scheme not in SCHEMES:
        raise OptionError(
            f"unknown resampling scheme {quoted(scheme)}; known are {', '.join(SCHEMES)}"
        )
    if count < 1:
        raise OptionError(f"{count} particles; at least 1 is needed")
    values = np.asarray(log_weights, dtype=np.float64)
    if len(values) == 0 or np.any(np.isnan(values) | np.isposinf(values)):
        raise StageError("cannot resample: no particles, or log-weights that are NaN or +inf")
    largest = float(np.max(values))
    if np.isneginf(largest):
        raise StageError("cannot resample: no particle has any weight")
    return SCHEMES[scheme](np.exp(values - largest), count, rng)


def _select(weights: FloatArray, points: FloatArray) -> IntArray:
    """Index of the particle whose share of the cumulative weight holds each point of [0, 1]."""
    cumulative = np.cumsum(weights)
    # Points are stretched to the sum as it was computed, so that it does not have to be exactly 1.
    # side="right" skips particles of zero weight: theirs is an empty half-open interval.
    indices = np.searchsorted(cumulative, points * cumulative[-1], side="right")
    # A point that rounds up to the very end belongs to the last particle that has weight.
    last = int(np.flatnonzero(weights)[-1])
    return np.asarray(np.minimum(indices, last), dtype=np.int64)


def _multinomial(weights: FloatArray, count: int, rng: np.random.Generator) -> IntArray:
    return _select(weights, rng.random(count))


def _stratified(weights: FloatArray, count: int, rng: np.random.Generator) -> IntArray:
    return _select(weights, (np.arange(count) + rng.random(count)) / count)


def _systematic(weights: FloatArray, count: int, rng: np.random.Generator) -> IntArray:
    return _select(weights, (np.arange(count) + rng.random()) / count)


def _residual(weights: FloatArray, count: int, rng: np.random.Generator) -> IntArray:
    expected = count * (weights / np.sum(weights))
    copies = np.floor(expected).astype(np.int64)
    certain = np.repeat(np.arange(len(weights), dtype=np.int64), copies)
    missing = count - len(certain)
    if missing <= 0:
        return certain[:count]
    return np.concatenate([certain, _select(expected - copies, rng.random(missing))])


SCHEMES: dict[str, Scheme] = {
    "multinomial": _multinomial,
    "systematic": _systematic,
    "stratified": _stratified,
    "residual": _residual,
}
