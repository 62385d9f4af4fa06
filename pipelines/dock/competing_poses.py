"""Several poses that fit an image nearly as well: images and odometry decide together.

Each pose at which an image fits (``fine_alignment.Candidate``) is a hypothesis. Odometry carries it
on from image to image. Its log-probability adds up how well each image fits there, and the
normalised innovation of the fit against odometry. The right hypothesis fits all images and moves as
odometry does; a wrong one fits some (multiple-hypothesis tracking, Reid 1979). Images taken from
one place have the same errors and count once.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.dead_reckoning import DeadReckonedPose
from pipelines.dock.fine_alignment import Candidate
from pipelines.dock.planar_motion import is_near, normalised_innovation
from pipelines.dock.robot import Movement

# Log-probability that a fit contributes: this, times the logarithm of its ratio to the best fit.
INVERSE_TEMPERATURE = 20.0
# A hypothesis that continues none of the previous image starts this much lower, natural units.
NEW_HYPOTHESIS_PENALTY = 6.0
# A candidate continues a hypothesis up to this normalised innovation.
LARGEST_INNOVATION = 20.0
# Number of hypotheses kept, and the factor by which older images are forgotten.
MOST_HYPOTHESES, FORGETTING = 4, 0.9
# Standard deviations of a correct fit beside its own covariance: metres and radians.
FIT_POSITION, FIT_HEADING = 0.005, math.radians(0.15)
# Poses as near to each other as this are one: metres and radians.
SAME_POSITION, SAME_HEADING = 0.03, math.radians(1.0)
# Movements from which an image is independent of the previous one: metres and radians.
INDEPENDENT_DISTANCE, INDEPENDENT_YAW = 0.1, 0.1


@dataclass(frozen=True)
class CompetingPose:
    """A hypothesis of where the robot is.

    Attributes:
        candidate: its fit in the last image.
        log_probability: up to a constant that all hypotheses share.
        innovation: normalised innovation of the last image against odometry; infinite for a
            hypothesis that the last image started.
    """

    candidate: Candidate
    log_probability: float
    innovation: float = math.inf


@dataclass(frozen=True)
class SelectedPose:
    """The most probable of the competing poses.

    Attributes:
        pose: the hypothesis.
        probability: that it is right, and none of those that lie elsewhere.
    """

    pose: CompetingPose
    probability: float


class CompetingPoses:
    """Tracks hypotheses from image to image."""

    def __init__(self) -> None:
        self._poses: list[CompetingPose] = []

    def expected(self, measured: Movement) -> list[FloatArray]:
        """States ``(3,)`` of the hypotheses after a movement, the most probable first."""
        return [
            DeadReckonedPose(pose.candidate.state, pose.candidate.covariance).after(measured).state
            for pose in self._poses
        ]

    def __call__(self, candidates: Sequence[Candidate], measured: Movement) -> SelectedPose | None:
        """The most probable pose by all images so far; None, and a reset, without candidates.

        Args:
            candidates: poses at which this image fits, the best first.
            measured: movement since the previous image by odometry.
        """
        if not candidates:
            self._poses = []
            return None
        novelty = _novelty(measured) if self._poses else 1.0
        found = [self._continued(each, candidates[0].fit, novelty, measured) for each in candidates]
        found.sort(key=lambda pose: -pose.log_probability)
        distinct: list[CompetingPose] = []
        for pose in found:
            if not any(_are_same(pose, other) for other in distinct):
                distinct.append(pose)
        total = float(scipy.special.logsumexp([pose.log_probability for pose in distinct]))
        self._poses = [
            replace(pose, log_probability=pose.log_probability - total)
            for pose in distinct[:MOST_HYPOTHESES]
        ]
        best = self._poses[0]
        return SelectedPose(best, math.exp(best.log_probability))

    def _continued(
        self, candidate: Candidate, best_fit: float, novelty: float, measured: Movement
    ) -> CompetingPose:
        """A candidate as the continuation of the hypothesis that makes it most probable."""
        fit = novelty * INVERSE_TEMPERATURE * math.log(candidate.fit / best_fit)
        options = [CompetingPose(candidate, fit - (NEW_HYPOTHESIS_PENALTY if self._poses else 0.0))]
        for pose in self._poses:
            innovation = _innovation(pose.candidate, candidate, measured)
            if innovation <= LARGEST_INNOVATION:
                log_probability = FORGETTING * pose.log_probability + fit - 0.5 * innovation
                options.append(CompetingPose(candidate, log_probability, innovation))
        return max(options, key=lambda option: option.log_probability)


def _novelty(measured: Movement) -> float:
    """How much an image counts, 0 to 1, by the movement since the previous one."""
    return min(
        1.0, math.hypot(measured.distance / INDEPENDENT_DISTANCE, measured.turn / INDEPENDENT_YAW)
    )


def _innovation(before: Candidate, after: Candidate, measured: Movement) -> float:
    """Normalised innovation of a fit against the previous image's fit and odometry."""
    own = np.diag([FIT_POSITION**2, FIT_POSITION**2, FIT_HEADING**2])
    predicted = DeadReckonedPose(before.state, before.covariance + own).after(measured)
    total = predicted.covariance + after.covariance + own
    return normalised_innovation(after.state, predicted.state, total)


def _are_same(first: CompetingPose, second: CompetingPose) -> bool:
    """Whether two hypotheses are one pose."""
    one, other = first.candidate.state, second.candidate.state
    return is_near(one, other, SAME_POSITION, SAME_HEADING)
