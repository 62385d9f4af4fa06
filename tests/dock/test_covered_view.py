"""Waiting for a covered view: where the robot is meanwhile, and how it looks again."""

import math

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.clearance import Clearance
from pipelines.dock.covered_view import (
    ASIDE,
    ASIDE_TURN,
    LOOKS,
    LOOKS_ASIDE,
    Anchor,
    Wait,
    next_look,
)
from pipelines.dock.planar_motion import moved
from pipelines.dock.pose_estimate import Fix
from pipelines.dock.robot import STANDSTILL, Movement
from pipelines.dock.safety import Safety
from tests.report_samples import facing_wall, wall_scene

EXACT = np.zeros((3, 3))
AREA = (-3.0, 3.0, -3.0, 0.0)


def movements(
    state: FloatArray, drive: str, area: tuple[float, float, float, float] = AREA, turned: float = 0
) -> list[Movement]:
    """All looks of a robot whose view stays covered."""
    safety = Safety(area, Clearance(wall_scene(), 1.0), 0.5)
    anchor, wait, found = Anchor(state, EXACT), Wait(turned=turned), list[Movement]()
    while (look := next_look(wait, anchor, drive, safety)) is not None:
        movement, wait = look
        found.append(movement)
        anchor = anchor.after(movement)
    return found


def test_an_omni_drive_waits_then_looks_past_on_both_sides() -> None:
    found = movements(facing_wall(0.0, 2.0), "omni")
    expected = [STANDSTILL] * LOOKS
    for side in (1.0, -2.0):
        expected += [Movement(left=side * ASIDE), *[STANDSTILL] * (LOOKS_ASIDE - 1)]
    assert found == expected


def test_a_differential_drive_turns_instead() -> None:
    found = movements(facing_wall(0.0, 2.0), "diff")
    turns = [movement.turn for movement in found if movement != STANDSTILL]
    assert turns == pytest.approx([ASIDE_TURN, -2.0 * ASIDE_TURN])
    assert all(movement.distance == 0.0 for movement in found)


def test_where_no_step_is_allowed_it_turns() -> None:
    x, distance = 0.0, 2.0
    area = (x - 0.01, x + 0.01, -distance - 0.01, -distance + 0.01)
    found = movements(facing_wall(x, distance), "omni", area)
    assert sum(movement.distance for movement in found) < 0.05
    assert max(abs(movement.turn) for movement in found) == pytest.approx(ASIDE_TURN)


@pytest.mark.parametrize("drive", ["omni", "diff"])
def test_a_view_lost_by_a_turn_is_looked_for_where_it_was(drive: str) -> None:
    found = movements(facing_wall(0.0, 2.0), drive, turned=0.5)
    asides = [movement for movement in found if movement != STANDSTILL]
    assert asides[0] == Movement(turn=-0.5)
    assert len(asides) == 2
    assert abs(asides[1].left) <= ASIDE
    assert abs(asides[1].turn) <= ASIDE_TURN


def test_the_anchor_follows_the_wheels_and_becomes_less_sure() -> None:
    start = facing_wall(0.0, 2.0)
    anchor = Anchor(start, np.diag([1e-4, 1e-4, 1e-5]))
    assert anchor.after(STANDSTILL) is anchor
    then = anchor.after(Movement(0.2, 0.1, 0.3))
    np.testing.assert_allclose(then.state, moved(start, Movement(0.2, 0.1, 0.3)))
    assert np.all(np.linalg.eigvalsh(then.covariance - anchor.covariance) > -1e-6)
    assert np.trace(then.covariance) > np.trace(anchor.covariance)


def fix(state: FloatArray, *offset: float) -> Fix:
    state = state + np.array(offset)
    return Fix(state, EXACT, np.array([[*state, 1.0]]), True, True, False)


def test_a_view_that_becomes_clear_elsewhere_does_not_agree() -> None:
    start = facing_wall(0.0, 2.0)
    anchor = Anchor(start, EXACT)
    assert anchor.agrees(fix(start, 0.05, -0.05, math.radians(2.0)))
    assert not anchor.agrees(fix(start, 0.15, 0.0, 0.0))
    assert not anchor.agrees(fix(start, 0.0, 0.0, math.radians(6.0)))
    # After a long way by the wheels alone it may be a little elsewhere.
    driven = anchor.after(Movement(1.0))
    assert driven.agrees(fix(driven.state, 0.25, 0.0, 0.0))
