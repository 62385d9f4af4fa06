"""Competing poses, and the consistency gate of docking that follows them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.competing_poses import CompetingPoses
from pipelines.dock.consistency_gate import gated_by_image, gated_estimate
from pipelines.dock.fine_alignment import Candidate
from pipelines.dock.planar_motion import moved
from pipelines.dock.pose_estimate import PoseEstimate
from pipelines.dock.robot import STANDSTILL, Movement

SIGMAS = np.array([0.005, 0.005, math.radians(0.15)])
START = np.array([0.3, -2.0, math.pi / 2.0])
# A step aside and a rotation back, which look almost the same two metres in front of a wall.
ASIDE = np.array([0.08, 0.0, math.atan(0.08 / 2.0)])
FAR = np.array([0.1, 0.0, 0.0])
MAP = np.diag(np.array([0.015, 0.015, math.radians(0.4)]) ** 2)


def candidate(state: FloatArray, fit: float) -> Candidate:
    return Candidate(state, np.diag(SIGMAS**2), fit)


def pair(right: float, wrong: float, state: FloatArray, offset: FloatArray) -> list[Candidate]:
    both = [candidate(state, right), candidate(state + offset, wrong)]
    return sorted(both, key=lambda each: -each.fit)


def test_one_image_in_which_two_poses_fit_alike_decides_nothing() -> None:
    selected = CompetingPoses()(pair(0.035, 0.034, START, ASIDE), STANDSTILL)
    assert selected is not None
    assert 0.5 < selected.probability < 0.75


def test_images_from_one_place_do_not_raise_the_probability() -> None:
    poses, selected = CompetingPoses(), None
    for _ in range(6):
        selected = poses(pair(0.035, 0.033, START, ASIDE), STANDSTILL)
    assert selected is not None
    assert selected.probability < 0.9


def test_the_pose_that_moves_as_odometry_does_wins_over_better_fits() -> None:
    rng = np.random.default_rng(0)
    poses, state, selected = CompetingPoses(), START, None
    # The wrong pose fits better at first; later it jumps about.
    for number in range(6):
        offset = ASIDE if number == 0 else ASIDE * rng.uniform(-1.5, 1.5)
        right, wrong = (0.033, 0.035) if number == 0 else (0.035, 0.034)
        selected = poses(
            pair(right, wrong, state, offset), Movement(0.1, 0.05) if number else STANDSTILL
        )
        assert selected is not None
        if number < 5:
            state = moved(state, Movement(0.1, 0.05))
    assert selected is not None
    np.testing.assert_allclose(selected.pose.candidate.state, state)
    assert selected.probability > 0.95
    assert selected.pose.innovation < 1.0


def test_fits_at_one_place_do_not_compete() -> None:
    near = np.array([0.01, 0.0, math.radians(0.3)])
    selected = CompetingPoses()(pair(0.035, 0.035, START, near), STANDSTILL)
    assert selected is not None
    assert selected.probability == pytest.approx(1.0)


def test_an_image_without_fits_resets_the_poses() -> None:
    poses = CompetingPoses()
    poses([candidate(START, 0.03)], STANDSTILL)
    assert len(poses.expected(STANDSTILL)) == 1
    assert poses([], STANDSTILL) is None
    assert poses.expected(STANDSTILL) == []


def filter_estimate(
    state: FloatArray, confidence: float = 1.0, localized: bool = True
) -> PoseEstimate:
    covariance = np.diag(np.array([0.02, 0.02, math.radians(0.6)]) ** 2)
    modes = np.array([[*state, 1.0]])
    return PoseEstimate(state, covariance, modes, True, localized, False, confidence=confidence)


def rejection(
    states: list[FloatArray],
    measured: Movement,
    estimate: PoseEstimate,
    competitor: FloatArray | None = None,
) -> str:
    """Why the gate rejects the last of some fits, with the same movement before each."""
    poses, selected = CompetingPoses(), None
    for number, state in enumerate(states):
        found = [candidate(state, 0.035)]
        found += [] if competitor is None else [candidate(state + competitor, 0.0345)]
        selected = poses(found, measured if number else STANDSTILL)
    return gated_estimate(estimate, selected, MAP).rejection


def test_an_estimate_is_accepted_when_filter_alignment_and_odometry_agree() -> None:
    step = Movement(0.1, 0.0, 0.0)
    there = moved(START, step)
    assert rejection([START, there], step, filter_estimate(there)) == ""
    # A single image cannot be compared with odometry.
    assert "otherwise than odometry" in rejection([START], step, filter_estimate(START))
    astray = there + FAR
    assert "otherwise than odometry" in rejection([START, astray], step, filter_estimate(astray))
    assert "filter disagree" in rejection([START, there], step, filter_estimate(there + 3.0 * FAR))
    assert "confidence is 0.60" in rejection([START, there], step, filter_estimate(there, 0.6))
    assert "confidence" in rejection([START, there], step, filter_estimate(there, localized=False))
    assert "another pose nearby" in rejection([START, there], step, filter_estimate(there), ASIDE)
    assert "could not be aligned" in gated_estimate(filter_estimate(there), None, MAP).rejection


def test_the_filter_is_overruled_by_little_and_by_decisive_images_only() -> None:
    step, poses = Movement(0.1, 0.0, 0.0), CompetingPoses()
    there = moved(START, step)
    poses([candidate(START, 0.03)], STANDSTILL)
    selected = poses([candidate(there, 0.03)], step)
    assert selected is not None
    own = gated_estimate(filter_estimate(there + FAR), selected, MAP)
    assert own.overrules_filter
    assert own.rejection == ""
    less_probable = gated_estimate(
        filter_estimate(there + FAR), replace(selected, probability=0.96), MAP
    )
    assert "another pose" in less_probable.rejection
    assert (
        gated_estimate(filter_estimate(there), replace(selected, probability=0.96), MAP).rejection
        == ""
    )


def test_a_smoothed_estimate_that_left_its_image_is_rejected() -> None:
    poses = CompetingPoses()
    poses([candidate(START, 0.03)], STANDSTILL)
    own = gated_estimate(filter_estimate(START), poses([candidate(START, 0.03)], STANDSTILL), MAP)
    assert own.rejection == ""
    assert gated_by_image(own, own).rejection == ""
    away = replace(own, state=START + FAR)
    assert gated_by_image(own, away).rejection == "the image and those before it disagree"
