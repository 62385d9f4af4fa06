"""What one image can decide between places, and what only several images together can.

Within a place, a view fits or does not, and an image says where the robot stands to a centimetre.
Between places it says less than the sum over its pixels suggests: three doors look alike, a person
hides what would tell them apart, and such errors are common to all pixels of an image. So an
image's evidence for a place as a whole is compressed,

    c log(1 + evidence / c),

as if how often a wrong place fits by chance fell with a power of the evidence, not exponentially
(the heavy-tailed counterpart of an exponential, as Student's distribution is of the normal one).
Several images of which each speaks for a place add up; no single one decides against all others.
"""

import math
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import StageError
from pipelines.localize.belief import log_sum
from pipelines.localize.state_space import StateSpace

# Natural units of evidence beyond which it is compressed.
COMPRESSED = 4.0
# States of one place: metres and radians to the nearest hypothesis; and between hypotheses.
PLACE_POSITION, PLACE_ANGLE = 0.6, math.radians(20.0)
JOINED_POSITION, JOINED_ANGLE = 0.3, math.radians(12.0)


def compressed(evidence: FloatArray | float) -> FloatArray:
    """Evidence for places as wholes, compressed; odd, and the identity near 0."""
    size = np.abs(evidence)
    return np.asarray(np.sign(evidence) * COMPRESSED * np.log1p(size / COMPRESSED))


def places_of(space: StateSpace, hypotheses: FloatArray) -> IntArray:
    """Which place each of the hypotheses ``(K, D)`` belongs to, ``(K,)``, numbered from 1."""
    if len(hypotheses) == 0:
        return np.zeros(0, dtype=np.int64)
    metres, radians = _distances(space, hypotheses, hypotheses)
    joined = (metres <= JOINED_POSITION) & (radians <= JOINED_ANGLE)
    # Neighbours of neighbours: chains twice as long with every product.
    while not np.array_equal(longer := joined @ joined, joined):
        joined = longer
    # The first hypothesis of a place stands for it.
    return np.unique(np.argmax(joined, axis=1), return_inverse=True)[1].astype(np.int64) + 1


def place_labels(
    space: StateSpace, states: FloatArray, hypotheses: FloatArray, places: IntArray
) -> IntArray:
    """Which place each of the states ``(M, D)`` belongs to, ``(M,)``.

    Args:
        space: what a state is.
        states: ``(M, D)`` of the particles.
        hypotheses: ``(K, D)``.
        places: ``(K,)`` number of the place of each hypothesis, from 1.

    Returns:
        Numbers of places; 0 for states near none of the hypotheses.
    """
    if len(hypotheses) == 0:
        return np.zeros(len(states), dtype=np.int64)
    metres, radians = _distances(space, states, hypotheses)
    relative = np.maximum(metres / PLACE_POSITION, radians / PLACE_ANGLE)
    nearest = np.argmin(relative, axis=1)
    is_near = relative[np.arange(len(states)), nearest] <= 1.0
    return np.where(is_near, places[nearest], 0)


def log_priors(space: StateSpace, log_densities: FloatArray, places: IntArray) -> FloatArray:
    """Logarithm of the prior probability ``(P + 1,)`` of each place, by its number.

    The prior's density at the place's likeliest hypothesis times the volume of a place, at most 1.
    (A sum over particles would depend on whether one happened to be drawn there.) Number 0, near
    no hypothesis, has 1.

    Args:
        space: what a state is.
        log_densities: ``(K,)`` of the prior at the hypotheses.
        places: ``(K,)`` number of the place of each hypothesis, from 1.
    """
    volume = math.pi * PLACE_POSITION**2 * 2.0 * PLACE_ANGLE
    if space.angles == 3:
        volume = (4.0 / 3.0 * math.pi) ** 2 * (PLACE_POSITION * PLACE_ANGLE) ** 3
    result = np.zeros(int(places.max(initial=0)) + 1)
    for place in range(1, len(result)):
        largest = float(log_densities[places == place].max())
        result[place] = min(0.0, largest + math.log(volume))
    return result


def _distances(
    space: StateSpace, states: FloatArray, others: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Metres and radians ``(M, K)`` between states."""
    p = space.positions
    metres = np.linalg.norm(states[:, None, :p] - others[None, :, :p], axis=2)
    return metres, space.pair_angles(states, others)


@dataclass(frozen=True)
class PlaceWeighting:
    """What an image makes of weighted particles.

    Attributes:
        log_weights: ``(M,)`` posterior weights, not normalised.
        marginal: compressed evidence of the image for the map, averaged over the prior of the
            places (of all particles, where none is in any): where a pose sees nothing of the map,
            being there is as good as being outside.
        largest: compressed evidence for the place that the image fits best.
    """

    log_weights: FloatArray
    marginal: float
    largest: float


def weighted_by_place(
    log_prior: FloatArray, evidence: FloatArray, labels: IntArray, log_place_priors: FloatArray
) -> PlaceWeighting:
    """Posterior weights with an image's evidence compressed between places.

    Within a place weights are prior times evidence. Their sum over the prior of the place is the
    evidence for the place as a whole, and is compressed. Particles near no hypothesis are on the
    slopes of the best place, or see nothing: they are worth as much less as that one.

    Args:
        log_prior: ``(M,)`` weights of the particles before the image, which add up to 1 on average
            over the particles that might have been drawn.
        evidence: ``(M,)`` of the image at the particles.
        labels: ``(M,)`` number of the place of each particle; 0: near no hypothesis.
        log_place_priors: ``(P + 1,)`` logarithm of the prior probability of each place, by its
            number.

    Raises:
        StageError: evidence that is NaN or +inf: the comparison is broken.
    """
    broken = int(np.count_nonzero(np.isnan(evidence) | np.isposinf(evidence)))
    if broken:
        raise StageError(f"{broken} of {len(evidence)} log-likelihoods are NaN or +inf")
    exact = log_prior + evidence
    loss = np.zeros(len(exact))
    largest, loss_of_best = -math.inf, 0.0
    numbers = np.unique(labels[labels > 0]) if np.any(labels > 0) else np.zeros(1, np.int64)
    for place in numbers:
        own = labels == place
        sum_ = float(log_sum(exact[own])) - float(log_place_priors[place])
        if not math.isfinite(sum_):
            continue
        kept = float(compressed(sum_))
        loss[own] = sum_ - kept
        if kept > largest:
            largest, loss_of_best = kept, sum_ - kept
    if numbers[0] > 0:
        loss[labels == 0] = loss_of_best
    seen = np.isin(labels, numbers)
    marginal = float(compressed(float(log_sum(exact[seen]))))
    return PlaceWeighting(exact - loss, marginal, largest)
