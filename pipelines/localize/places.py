"""What one image can decide between places, and what only several images together can.

Within a place, a view fits or does not, and an image says where the robot stands to a centimetre.
Between places it says less than the sum over its pixels makes believe: three doors look alike, a
person hides what would tell them apart, and such errors are common to all pixels of an image. So an
image's evidence for a place as a whole is compressed,

    c log(1 + evidence / c),

as if how often a wrong place fits by chance fell with a power of the evidence, not exponentially
(the heavy-tailed counterpart of an exponential, as Student's distribution is of the normal one).
Several images of which each speaks for a place add up; no single one decides against all others.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.special import logsumexp

from pipelines.artifacts.array_types import FloatArray, IntArray
from pipelines.artifacts.errors import StageError
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


def labelled(space: StateSpace, states: FloatArray, hypotheses: FloatArray) -> IntArray:
    """Which place each of the states ``(M, D)`` belongs to, ``(M,)``.

    Args:
        space: what a state is.
        states: of the particles.
        hypotheses: ``(K, D)``; those near each other are one place.

    Returns:
        Numbers from 1; 0 for states near none of the hypotheses.
    """
    if len(hypotheses) == 0:
        return np.zeros(len(states), dtype=np.int64)
    between, turned = _distances(space, hypotheses, hypotheses)
    joined = (between <= JOINED_POSITION) & (turned <= JOINED_ANGLE)
    _, place = connected_components(coo_array(joined), directed=False)
    distance, angle = _distances(space, states, hypotheses)
    relative = np.maximum(distance / PLACE_POSITION, angle / PLACE_ANGLE)
    nearest = np.argmin(relative, axis=1)
    is_near = relative[np.arange(len(states)), nearest] <= 1.0
    return np.where(is_near, place[nearest].astype(np.int64) + 1, 0)


def _distances(
    space: StateSpace, states: FloatArray, others: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Metres and radians ``(M, K)`` between states."""
    p = space.positions
    metres = np.linalg.norm(states[:, None, :p] - others[None, :, :p], axis=2)
    return metres, space.pair_angles(states, others)


@dataclass(frozen=True)
class Weighed:
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


def weighed(log_prior: FloatArray, evidence: FloatArray, labels: IntArray) -> Weighed:
    """Posterior weights with an image's evidence compressed between places.

    Within a place weights are prior times evidence. The place as a whole is worth less by how much
    its evidence, the posterior's mean there, loses by being compressed. Particles in no place are
    on the slopes of the best one, or see nothing: they are worth as much less as that one.

    Args:
        log_prior: ``(M,)`` weights of the particles before the image, which add up to 1 on average
            over the particles that might have been drawn.
        evidence: ``(M,)`` of the image at the particles.
        labels: ``(M,)`` see ``labelled``.

    Raises:
        StageError: evidence that is NaN or +inf: the comparison is broken.
    """
    broken = int(np.count_nonzero(np.isnan(evidence) | np.isposinf(evidence)))
    if broken:
        raise StageError(f"{broken} of {len(evidence)} log-likelihoods are NaN or +inf")
    exact = log_prior + evidence
    if not np.any(labels > 0):
        labels = labels + 1
    loss = np.zeros(len(exact))
    largest, loss_of_best = -math.inf, 0.0
    for place in np.unique(labels[labels > 0]):
        own = (labels == place) & np.isfinite(exact)
        if not own.any():
            continue
        shares = np.exp(exact[own] - logsumexp(exact[own]))
        mean = float(shares @ evidence[own])
        kept = float(compressed(mean))
        loss[own] = mean - kept
        if kept > largest:
            largest, loss_of_best = kept, mean - kept
    loss[labels == 0] = loss_of_best
    log_weights = exact - loss
    marginal = float(compressed(float(logsumexp(exact[labels > 0]))))
    return Weighed(log_weights, marginal, largest)
