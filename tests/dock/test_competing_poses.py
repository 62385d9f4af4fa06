"""Images and odometry decide together between poses that fit nearly as well."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.agreement import aligned_fix, confirmed
from pipelines.dock.competing_poses import Rivals
from pipelines.dock.fine_alignment import Candidate
from pipelines.dock.planar_motion import moved
from pipelines.dock.pose_estimate import Fix
from pipelines.dock.robot import STANDSTILL, Movement

SIGMAS = np.array([0.005, 0.005, math.radians(0.15)])
START = np.array([0.3, -2.0, math.pi / 2.0])
# A step aside and a turn back: what looks almost the same two metres in front of a wall.
ASIDE = np.array([0.08, 0.0, math.atan(0.08 / 2.0)])
FAR = np.array([0.1, 0.0, 0.0])
MAP = np.diag(np.array([0.015, 0.015, math.radians(0.4)]) ** 2)


def candidate(state: FloatArray, fit: float) -> Candidate:
    return Candidate(state, np.diag(SIGMAS**2), fit)


def pair(right: float, wrong: float, state: FloatArray, offset: FloatArray) -> list[Candidate]:
    both = [candidate(state, right), candidate(state + offset, wrong)]
    return sorted(both, key=lambda each: -each.fit)


def test_one_image_in_which_two_poses_fit_alike_decides_nothing() -> None:
    choice = Rivals()(pair(0.035, 0.034, START, ASIDE), STANDSTILL)
    assert choice is not None
    assert 0.5 < choice.probability < 0.75


def test_standing_still_does_not_make_it_surer() -> None:
    rivals, choice = Rivals(), None
    for _ in range(6):
        choice = rivals(pair(0.035, 0.033, START, ASIDE), STANDSTILL)
    assert choice is not None
    assert choice.probability < 0.9


def test_the_pose_that_moves_as_the_wheels_do_wins_whatever_fits_better() -> None:
    rng = np.random.default_rng(0)
    rivals, state, choice = Rivals(), START, None
    # At first the wrong one fits better; then it appears now here, now there.
    for number in range(6):
        offset = ASIDE if number == 0 else ASIDE * rng.uniform(-1.5, 1.5)
        right, wrong = (0.033, 0.035) if number == 0 else (0.035, 0.034)
        choice = rivals(
            pair(right, wrong, state, offset), Movement(0.1, 0.05) if number else STANDSTILL
        )
        assert choice is not None
        if number < 5:
            state = moved(state, Movement(0.1, 0.05))
    assert choice is not None
    np.testing.assert_allclose(choice.rival.candidate.state, state)
    assert choice.probability > 0.95
    assert choice.rival.surprise < 1.0


def test_fits_of_one_place_are_no_rivals() -> None:
    near = np.array([0.01, 0.0, math.radians(0.3)])
    choice = Rivals()(pair(0.035, 0.035, START, near), STANDSTILL)
    assert choice is not None
    assert choice.probability == pytest.approx(1.0)


def test_without_an_image_nothing_is_carried_on() -> None:
    rivals = Rivals()
    rivals([candidate(START, 0.03)], STANDSTILL)
    assert len(rivals.expected(STANDSTILL)) == 1
    assert rivals([], STANDSTILL) is None
    assert rivals.expected(STANDSTILL) == []


def filters_fix(state: FloatArray, confidence: float = 1.0, sure: bool = True) -> Fix:
    covariance = np.diag(np.array([0.02, 0.02, math.radians(0.6)]) ** 2)
    modes = np.array([[*state, 1.0]])
    return Fix(state, covariance, modes, True, sure, False, confidence=confidence)


def doubt(
    states: list[FloatArray], measured: Movement, fix: Fix, rival: FloatArray | None = None
) -> str:
    """What speaks against the last of some fits, with the movements between them."""
    rivals, choice = Rivals(), None
    for number, state in enumerate(states):
        found = [candidate(state, 0.035)]
        found += [] if rival is None else [candidate(state + rival, 0.0345)]
        choice = rivals(found, measured if number else STANDSTILL)
    return aligned_fix(fix, choice, MAP).doubt


def test_a_fix_is_confirmed_when_filter_alignment_and_odometry_agree() -> None:
    step = Movement(0.1, 0.0, 0.0)
    there = moved(START, step)
    assert doubt([START, there], step, filters_fix(there)) == ""
    # One image alone has not been held against odometry.
    assert "otherwise than odometry" in doubt([START], step, filters_fix(START))
    astray = there + FAR
    assert "otherwise than odometry" in doubt([START, astray], step, filters_fix(astray))
    assert "filter disagree" in doubt([START, there], step, filters_fix(there + 3.0 * FAR))
    assert "confidence is 0.60" in doubt([START, there], step, filters_fix(there, 0.6))
    assert "confidence" in doubt([START, there], step, filters_fix(there, sure=False))
    assert "another pose nearby" in doubt([START, there], step, filters_fix(there), ASIDE)
    assert "could not be aligned" in aligned_fix(filters_fix(there), None, MAP).doubt


def test_the_filter_is_overruled_by_little_and_by_surer_images_only() -> None:
    step, rivals = Movement(0.1, 0.0, 0.0), Rivals()
    there = moved(START, step)
    rivals([candidate(START, 0.03)], STANDSTILL)
    choice = rivals([candidate(there, 0.03)], step)
    assert choice is not None
    seen = aligned_fix(filters_fix(there + FAR), choice, MAP)
    assert seen.is_disputed
    assert seen.doubt == ""
    less_sure = aligned_fix(filters_fix(there + FAR), replace(choice, probability=0.96), MAP)
    assert "another pose" in less_sure.doubt
    assert aligned_fix(filters_fix(there), replace(choice, probability=0.96), MAP).doubt == ""


def test_a_smoothed_fix_that_left_its_image_is_doubted() -> None:
    rivals = Rivals()
    rivals([candidate(START, 0.03)], STANDSTILL)
    seen = aligned_fix(filters_fix(START), rivals([candidate(START, 0.03)], STANDSTILL), MAP)
    assert seen.doubt == ""
    assert confirmed(seen, seen).doubt == ""
    away = replace(seen, state=START + FAR)
    assert confirmed(seen, away).doubt == "the image and those before it disagree"
