"""A belief that does not move as odometry does is abandoned."""

import math

import numpy as np
import pytest

from pipelines.dock.consistency_gate import (
    MOST_VIOLATIONS,
    WINDOW,
    ConsistencyGate,
    violates_odometry,
)
from pipelines.dock.planar_motion import moved
from pipelines.dock.pose_estimate import PoseEstimate
from pipelines.dock.robot import Movement

START = np.array([0.5, -2.0, 1.2])


def estimate(state: np.ndarray, localized: bool = True) -> PoseEstimate:
    return PoseEstimate(state, np.eye(3), np.array([[*state, 1.0]]), True, localized, False)


@pytest.mark.parametrize("scale", [0.85, 1.0, 1.15])
def test_odometry_of_another_scale_is_no_violation(scale: float) -> None:
    true = Movement(0.4, 0.1, 0.3)
    measured = Movement(scale * 0.4, scale * 0.1, 0.3 + math.radians(9.0) * true.distance)
    assert not violates_odometry(measured, estimate(START), estimate(moved(START, true)))


@pytest.mark.parametrize("jump", [Movement(0.0, 0.2), Movement(-0.25), Movement(turn=0.15)])
def test_a_jump_is_a_violation(jump: Movement) -> None:
    measured = Movement(0.1, 0.0, 0.02)
    after = moved(moved(START, measured), jump)
    assert violates_odometry(measured, estimate(START), estimate(after))
    # Without two localized estimates there is nothing to compare.
    assert not violates_odometry(measured, estimate(START, localized=False), estimate(after))
    assert not violates_odometry(measured, estimate(START), estimate(after, localized=False))


def test_a_rotation_across_plus_minus_pi_is_no_violation() -> None:
    before = np.array([0.0, 0.0, math.pi - 0.1])
    measured = Movement(turn=0.2)
    assert not violates_odometry(measured, estimate(before), estimate(moved(before, measured)))


def test_a_belief_with_several_violations_is_abandoned() -> None:
    gate = ConsistencyGate()
    pattern = [True, False, False, True, False, True]
    assert [gate(value) for value in pattern] == [False] * 5 + [True]
    # The count starts from zero then; rare violations, as by slip, are tolerated.
    rare = ([True] + [False] * (WINDOW // (MOST_VIOLATIONS - 1))) * 10
    assert not any(gate(value) for value in rare)
