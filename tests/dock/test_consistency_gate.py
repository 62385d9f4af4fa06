"""A belief that does not move as the wheels do is given up."""

import math

import numpy as np
import pytest

from pipelines.dock.consistency_gate import MOST, WINDOW, Doubt, contradicts
from pipelines.dock.planar_motion import moved
from pipelines.dock.pose_estimate import Fix
from pipelines.dock.robot import Movement

START = np.array([0.5, -2.0, 1.2])


def fix(state: np.ndarray, sure: bool = True) -> Fix:
    return Fix(state, np.eye(3), np.array([[*state, 1.0]]), True, sure, False)


@pytest.mark.parametrize("scale", [0.85, 1.0, 1.15])
def test_odometry_of_another_scale_is_no_contradiction(scale: float) -> None:
    true = Movement(0.4, 0.1, 0.3)
    measured = Movement(scale * 0.4, scale * 0.1, 0.3 + math.radians(9.0) * true.distance)
    assert not contradicts(measured, fix(START), fix(moved(START, true)))


@pytest.mark.parametrize("jump", [Movement(0.0, 0.2), Movement(-0.25), Movement(turn=0.15)])
def test_a_jump_is_one(jump: Movement) -> None:
    measured = Movement(0.1, 0.0, 0.02)
    after = moved(moved(START, measured), jump)
    assert contradicts(measured, fix(START), fix(after))
    # Who does not know where it is contradicts nothing.
    assert not contradicts(measured, fix(START, sure=False), fix(after))
    assert not contradicts(measured, fix(START), fix(after, sure=False))


def test_a_turn_past_the_back_is_no_jump() -> None:
    before = np.array([0.0, 0.0, math.pi - 0.1])
    measured = Movement(turn=0.2)
    assert not contradicts(measured, fix(before), fix(moved(before, measured)))


def test_a_few_contradictions_in_a_row_of_movements_are_too_many() -> None:
    doubt = Doubt()
    pattern = [True, False, False, True, False, True]
    assert [doubt(value) for value in pattern] == [False] * 5 + [True]
    # Then it begins anew; rare ones, as slip makes them, are forgiven for ever.
    rare = ([True] + [False] * (WINDOW // (MOST - 1))) * 10
    assert not any(doubt(value) for value in rare)
