"""The fix that a robot acts on, and whether everything that is known agrees with it.

Three things say where the robot is: the filter, which weighs the whole posterior in small pictures;
the alignment with the photos at full resolution; and odometry, which ties images together. Near the
goal the alignment is the finest. It is confirmed when the filter follows one place with enough
confidence, when the alignment lies within the filter's covariance, when it moved as the wheels did,
and when no other pose fits nearly as well.

Under light from elsewhere small pictures err along the direction in which a wall hardly changes, by
a decimetre, while the large ones do not. Then the fix is disputed: it takes surer images, from both
sides of the goal, to overrule the filter, and never by more than ``FARTHEST``.
"""

import math
from dataclasses import replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.competing_poses import Choice
from pipelines.dock.fine_alignment import Candidate
from pipelines.dock.planar_motion import distance_between, turn_between
from pipelines.dock.pose_estimate import Fix
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import PLANAR

# Two things disagree beyond this squared distance in standard deviations: of three numbers that are
# normally distributed one in a hundred times (the chi-square distribution).
LARGEST_SURPRISE = 11.3
# The filter's estimate has to be right, and the pose to be none of its rivals, with at least these
# probabilities.
LEAST_CONFIDENCE, LEAST_PROBABILITY = 0.75, 0.95
# To overrule the filter the rivals have to be ruled out more surely; it is overruled by so many
# metres and radians at most.
OVERRULING_PROBABILITY, FARTHEST, WIDEST = 0.97, 0.2, math.radians(6.0)


def map_covariance(settings: LocalizerSettings) -> FloatArray:
    """``(3, 3)`` of the error of the map, as a filter's settings say; metres and radians."""
    sigmas = [settings.map_position_sigma] * 2 + [settings.map_heading_sigma]
    return np.diag(np.square(sigmas))


def aligned_fix(fix: Fix, choice: Choice | None, map_error: FloatArray) -> Fix:
    """The filter's fix, at the aligned pose where there is one, and what speaks against that.

    Args:
        fix: of the filter.
        choice: among the poses that alignment found; None where it found none.
        map_error: ``(3, 3)`` covariance of the map's error.
    """
    if choice is None:
        return replace(fix, doubt="the image could not be aligned")
    candidate = choice.rival.candidate
    is_disputed = _disagrees(fix, candidate)
    return replace(
        fix,
        state=candidate.state,
        covariance=candidate.covariance + map_error,
        is_refined=True,
        is_aligned=True,
        doubt=_doubt(fix, choice, is_disputed),
        is_disputed=is_disputed,
    )


def _disagrees(fix: Fix, candidate: Candidate) -> bool:
    """Whether a pose lies outside of the filter's covariance."""
    difference = PLANAR.difference(candidate.state, fix.state)
    total = fix.covariance + candidate.covariance
    return float(difference @ np.linalg.solve(total, difference)) > LARGEST_SURPRISE


def _doubt(fix: Fix, choice: Choice, is_disputed: bool) -> str:
    """Why a pose is not confirmed; empty where it is."""
    if not fix.is_sure or fix.confidence < LEAST_CONFIDENCE:
        return f"the filter's confidence is {fix.confidence:.2f}"
    least = LEAST_PROBABILITY
    if is_disputed:
        state = choice.rival.candidate.state
        is_far = distance_between(state, fix.state) > FARTHEST
        if is_far or abs(turn_between(state, fix.state)) > WIDEST:
            return "the finest alignment and the filter disagree"
        least = OVERRULING_PROBABILITY
    if choice.probability < least:
        return "another pose nearby fits the images nearly as well"
    if not choice.rival.surprise <= LARGEST_SURPRISE:
        return "the images moved otherwise than odometry"
    return ""


def confirmed(seen: Fix, smoothed: Fix) -> Fix:
    """A smoothed fix, with a doubt where it is not where the image alone says.

    Args:
        seen: by the image alone.
        smoothed: in the light of those before.
    """
    if seen.doubt or not seen.is_aligned:
        return smoothed
    difference = PLANAR.difference(seen.state, smoothed.state)
    if float(difference @ np.linalg.solve(seen.covariance, difference)) > LARGEST_SURPRISE:
        return replace(smoothed, doubt="the image and those before it disagree")
    return smoothed
