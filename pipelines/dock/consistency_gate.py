"""Consistency gates: an estimate is acted on only while independent sources agree with it.

Three sources say where the robot is. The filter weighs the whole posterior with small images. The
alignment compares the photos at full resolution. Odometry ties consecutive images together.

**Gate for docking** (``gated_estimate``, ``gated_by_image``). Near the goal the alignment is the
most accurate source. Its pose is accepted when the filter tracks with enough confidence, when the
normalised innovation against the filter and against odometry is small, and when no competing pose
fits nearly as well. Under other lamps than the map's, the filter's small images err by a decimetre
along the direction in which a wall hardly changes, while full resolution does not. The filter may
therefore be overruled, within ``OVERRULING_POSITION`` and ``OVERRULING_HEADING`` and by images that
rule out competing poses more surely.

**Gate for driving** (``violates_odometry``, ``ConsistencyGate``). In a scene with repeated content
a belief can settle on a wrong place and follow reflections from step to step. At the right place,
estimates move as odometry says to a few centimetres, whatever odometry's scale. At a wrong place
they jump. A belief with several such jumps is abandoned.
"""

import math
from collections import deque
from dataclasses import replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.competing_poses import SelectedPose
from pipelines.dock.fine_alignment import Candidate
from pipelines.dock.planar_motion import is_near, movement_between, normalised_innovation
from pipelines.dock.pose_estimate import PoseEstimate
from pipelines.dock.robot import Movement
from pipelines.localize.settings import LocalizerSettings

# A normalised innovation above this is inconsistent: the 99 % quantile of the chi-square
# distribution with three degrees of freedom.
LARGEST_INNOVATION = 11.3
# Probabilities that the filter's estimate is right, and that the aligned pose is none of its
# competitors: at least these.
LEAST_CONFIDENCE, LEAST_PROBABILITY = 0.75, 0.95
# To overrule the filter, competing poses have to be ruled out more surely; and it is overruled by
# no more than this, metres and radians.
OVERRULING_PROBABILITY = 0.97
OVERRULING_POSITION, OVERRULING_HEADING = 0.2, math.radians(6.0)

# The motions by estimate and by odometry may differ by this: metres plus a share of the distance;
# radians, radians a metre, and a share of the rotation.
POSITION, POSITION_SHARE = 0.08, 0.2
HEADING, HEADING_A_METRE, HEADING_SHARE = math.radians(4.0), math.radians(12.0), 0.05
# The belief is abandoned after this many violations in a window of movements. One may be slip.
MOST_VIOLATIONS, WINDOW = 3, 6


def map_covariance(settings: LocalizerSettings) -> FloatArray:
    """Covariance ``(3, 3)`` of the map's error by a filter's settings, metres and radians."""
    sigmas = [settings.map_position_sigma] * 2 + [settings.map_heading_sigma]
    return np.diag(np.square(sigmas))


def gated_estimate(
    estimate: PoseEstimate, selected: SelectedPose | None, map_error: FloatArray
) -> PoseEstimate:
    """The estimate at the aligned pose where there is one, and why it is rejected if it is.

    Args:
        estimate: by the filter.
        selected: the best of the poses that alignment found; None where it found none.
        map_error: ``(3, 3)`` covariance of the map's error.
    """
    if selected is None:
        return replace(estimate, rejection="the image could not be aligned")
    candidate = selected.pose.candidate
    contradicts_filter = _contradicts_filter(estimate, candidate)
    return replace(
        estimate,
        state=candidate.state,
        covariance=candidate.covariance + map_error,
        is_refined=True,
        is_aligned=True,
        rejection=_rejection(estimate, selected, contradicts_filter),
        overrules_filter=contradicts_filter,
    )


def _contradicts_filter(estimate: PoseEstimate, candidate: Candidate) -> bool:
    """Whether an aligned pose lies outside of the filter's covariance."""
    total = estimate.covariance + candidate.covariance
    innovation = normalised_innovation(candidate.state, estimate.state, total)
    return innovation > LARGEST_INNOVATION


def _rejection(estimate: PoseEstimate, selected: SelectedPose, contradicts_filter: bool) -> str:
    """Why an aligned pose is rejected; empty where it is accepted."""
    if not estimate.is_localized or estimate.confidence < LEAST_CONFIDENCE:
        return f"the filter's confidence is {estimate.confidence:.2f}"
    least = LEAST_PROBABILITY
    if contradicts_filter:
        state = selected.pose.candidate.state
        if not is_near(state, estimate.state, OVERRULING_POSITION, OVERRULING_HEADING):
            return "the finest alignment and the filter disagree"
        least = OVERRULING_PROBABILITY
    if selected.probability < least:
        return "another pose nearby fits the images nearly as well"
    if not selected.pose.innovation <= LARGEST_INNOVATION:
        return "the images moved otherwise than odometry"
    return ""


def gated_by_image(own: PoseEstimate, smoothed: PoseEstimate) -> PoseEstimate:
    """The smoothed estimate, rejected where the image's own estimate contradicts it.

    Args:
        own: by this image alone.
        smoothed: by this image and those before it.
    """
    if own.rejection or not own.is_aligned:
        return smoothed
    if normalised_innovation(own.state, smoothed.state, own.covariance) > LARGEST_INNOVATION:
        return replace(smoothed, rejection="the image and those before it disagree")
    return smoothed


def violates_odometry(measured: Movement, before: PoseEstimate, after: PoseEstimate) -> bool:
    """Whether two estimates lie farther apart, or nearer, than odometry allows.

    Args:
        measured: the movement between the two by odometry.
        before: by the image before the movement.
        after: by the image after it.
    """
    if not (before.is_localized and after.is_localized):
        return False
    estimated = movement_between(before.state, after.state)
    apart = math.hypot(estimated.forward - measured.forward, estimated.left - measured.left)
    rotated = abs(math.remainder(estimated.turn - measured.turn, 2.0 * math.pi))
    far = POSITION + POSITION_SHARE * measured.distance
    wide = HEADING + HEADING_A_METRE * measured.distance + HEADING_SHARE * abs(measured.turn)
    return apart > far or rotated > wide


class ConsistencyGate:
    """Counts violations of odometry among the last movements."""

    def __init__(self) -> None:
        self._last: deque[bool] = deque(maxlen=WINDOW)

    def __call__(self, is_violated: bool) -> bool:
        """Whether the belief is to be abandoned; the count then starts from zero.

        Args:
            is_violated: whether the last movement violated odometry.
        """
        self._last.append(is_violated)
        is_abandoned = sum(self._last) >= MOST_VIOLATIONS
        if is_abandoned:
            self._last.clear()
        return is_abandoned
