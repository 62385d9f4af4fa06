"""Which of several poses that fit an image nearly as well: images and odometry decide together.

Each pose at which an image fits (``alignment.Candidate``) is a hypothesis. From image to image it
is carried on by odometry, and what it scores in each adds up: how well the image fits there, and
how near the best fit lies to where odometry says. The right one fits all images and moves as the
wheels do; a wrong one fits some (tracking of multiple hypotheses, Reid 1979). Images from one and
the same place say the same thing, and count once.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.covered_view import Anchor
from pipelines.dock.fine_alignment import Candidate
from pipelines.dock.planar_motion import distance_between, turn_between
from pipelines.dock.robot import Movement
from pipelines.localize.state_space import PLANAR

# A fit that is better by a share raises the log-probability by so many times its logarithm.
SHARPNESS = 20.0
# Hypotheses that odometry does not lead to begin so much lower, in natural units.
NEW = 6.0
# Farther than this (squared, in standard deviations) from where odometry says is another one.
LARGEST_SURPRISE = 20.0
# So many are kept. Older images are forgotten by this factor.
MOST, MEMORY = 4, 0.9
# What two images' fits err by although both are right: metres and radians.
FIT_POSITION, FIT_HEADING = 0.005, math.radians(0.15)
# Poses so near to each other are one: metres and radians.
SAME_POSITION, SAME_HEADING = 0.03, math.radians(1.0)
# Movements from which an image is new: metres and radians.
NEW_POSITION, NEW_TURN = 0.1, 0.1


@dataclass(frozen=True)
class Rival:
    """A pose that may be the right one.

    Attributes:
        candidate: of the last image.
        score: log-probability, up to a common constant.
        surprise: how far from where odometry said the last image put it, squared, in standard
            deviations; infinite for one that has just begun.
    """

    candidate: Candidate
    score: float
    surprise: float = math.inf


@dataclass(frozen=True)
class Choice:
    """The best of the rivals.

    Attributes:
        rival: it.
        probability: that it is right, and not one of those that lie elsewhere.
    """

    rival: Rival
    probability: float


class Rivals:
    """Follows hypotheses from image to image."""

    def __init__(self) -> None:
        self._rivals: list[Rival] = []

    def expected(self, measured: Movement) -> list[FloatArray]:
        """Where the rivals ``(3,)`` are after a movement, the best first."""
        return [_predicted(rival, measured).state for rival in self._rivals]

    def forget(self) -> None:
        """Begins anew."""
        self._rivals = []

    def __call__(self, candidates: Sequence[Candidate], measured: Movement) -> Choice | None:
        """The best pose in the light of all images so far; None without candidates.

        Args:
            candidates: of this image, the best first.
            measured: the movement since the image before, as odometry says.
        """
        if not candidates:
            self.forget()
            return None
        worth = _novelty(measured) if self._rivals else 1.0
        found = [self._continued(each, candidates[0].fit, worth, measured) for each in candidates]
        found.sort(key=lambda rival: -rival.score)
        distinct: list[Rival] = []
        for rival in found:
            if not any(_are_same(rival, other) for other in distinct):
                distinct.append(rival)
        total = float(scipy.special.logsumexp([rival.score for rival in distinct]))
        self._rivals = [_with_score(rival, rival.score - total) for rival in distinct[:MOST]]
        best = self._rivals[0]
        return Choice(best, math.exp(best.score))

    def _continued(
        self, candidate: Candidate, best_fit: float, worth: float, measured: Movement
    ) -> Rival:
        """A candidate as the continuation of whichever rival leads to it best."""
        fit = worth * SHARPNESS * math.log(candidate.fit / best_fit)
        options = [Rival(candidate, fit - (NEW if self._rivals else 0.0))]
        for rival in self._rivals:
            surprise = surprise_of(rival.candidate, candidate, measured)
            if surprise <= LARGEST_SURPRISE:
                score = MEMORY * rival.score + fit - 0.5 * surprise
                options.append(Rival(candidate, score, surprise))
        return max(options, key=lambda option: option.score)


def _novelty(measured: Movement) -> float:
    """How much an image is worth, 0 to 1, from the movement since the last one."""
    return min(1.0, math.hypot(measured.distance / NEW_POSITION, measured.turn / NEW_TURN))


def surprise_of(before: Candidate, after: Candidate, measured: Movement) -> float:
    """How far apart two fits and odometry are: squared, in standard deviations."""
    own = np.diag([FIT_POSITION**2, FIT_POSITION**2, FIT_HEADING**2])
    predicted = Anchor(before.state, before.covariance + own).after(measured)
    difference = PLANAR.difference(after.state, predicted.state)
    total = predicted.covariance + after.covariance + own
    return float(difference @ np.linalg.solve(total, difference))


def _predicted(rival: Rival, measured: Movement) -> Anchor:
    return Anchor(rival.candidate.state, rival.candidate.covariance).after(measured)


def _are_same(first: Rival, second: Rival) -> bool:
    one, other = first.candidate.state, second.candidate.state
    return (
        distance_between(one, other) <= SAME_POSITION
        and abs(turn_between(one, other)) <= SAME_HEADING
    )


def _with_score(rival: Rival, score: float) -> Rival:
    return Rival(rival.candidate, score, rival.surprise)
