"""A covered view: the viewpoints that the robot tries, and its dead-reckoned pose meanwhile."""

import math

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.clearance import Clearance
from pipelines.dock.covered_view import (
    IMAGES_BESIDE,
    SIDE_YAW,
    SIDESTEP,
    WAITING_IMAGES,
    ViewWait,
    next_viewpoint,
)
from pipelines.dock.dead_reckoning import DeadReckonedPose
from pipelines.dock.planar_motion import moved
from pipelines.dock.pose_estimate import PoseEstimate
from pipelines.dock.robot import STANDSTILL, Movement
from pipelines.dock.safety import Safety
from tests.report_samples import facing_wall, wall_scene

EXACT = np.zeros((3, 3))
AREA = (-3.0, 3.0, -3.0, 0.0)


def movements(
    state: FloatArray,
    drive: str,
    area: tuple[float, float, float, float] = AREA,
    rotated: float = 0,
) -> list[Movement]:
    """All movements of a robot whose view stays covered."""
    safety = Safety(area, Clearance(wall_scene(), 1.0), 0.5)
    pose, wait, found = DeadReckonedPose(state, EXACT), ViewWait(rotated=rotated), list[Movement]()
    while (viewpoint := next_viewpoint(wait, pose, drive, safety)) is not None:
        movement, wait = viewpoint
        found.append(movement)
        pose = pose.after(movement)
    return found


def test_an_omni_drive_waits_then_looks_from_both_sides() -> None:
    found = movements(facing_wall(0.0, 2.0), "omni")
    expected = [STANDSTILL] * WAITING_IMAGES
    for side in (1.0, -2.0):
        expected += [Movement(left=side * SIDESTEP), *[STANDSTILL] * (IMAGES_BESIDE - 1)]
    assert found == expected


def test_a_differential_drive_rotates_instead() -> None:
    found = movements(facing_wall(0.0, 2.0), "diff")
    yaws = [movement.turn for movement in found if movement != STANDSTILL]
    assert yaws == pytest.approx([SIDE_YAW, -2.0 * SIDE_YAW])
    assert all(movement.distance == 0.0 for movement in found)


def test_where_no_step_is_allowed_it_rotates() -> None:
    x, distance = 0.0, 2.0
    area = (x - 0.01, x + 0.01, -distance - 0.01, -distance + 0.01)
    found = movements(facing_wall(x, distance), "omni", area)
    assert sum(movement.distance for movement in found) < 0.05
    assert max(abs(movement.turn) for movement in found) == pytest.approx(SIDE_YAW)


@pytest.mark.parametrize("drive", ["omni", "diff"])
def test_a_view_lost_by_a_rotation_is_regained_by_rotating_back(drive: str) -> None:
    found = movements(facing_wall(0.0, 2.0), drive, rotated=0.5)
    sidesteps = [movement for movement in found if movement != STANDSTILL]
    assert sidesteps[0] == Movement(turn=-0.5)
    assert len(sidesteps) == 2
    assert abs(sidesteps[1].left) <= SIDESTEP
    assert abs(sidesteps[1].turn) <= SIDE_YAW


def test_dead_reckoning_follows_odometry_and_becomes_less_certain() -> None:
    start = facing_wall(0.0, 2.0)
    pose = DeadReckonedPose(start, np.diag([1e-4, 1e-4, 1e-5]))
    assert pose.after(STANDSTILL) is pose
    then = pose.after(Movement(0.2, 0.1, 0.3))
    np.testing.assert_allclose(then.state, moved(start, Movement(0.2, 0.1, 0.3)))
    assert np.all(np.linalg.eigvalsh(then.covariance - pose.covariance) > -1e-6)
    assert np.trace(then.covariance) > np.trace(pose.covariance)


def estimate(state: FloatArray, *offset: float) -> PoseEstimate:
    state = state + np.array(offset)
    return PoseEstimate(state, EXACT, np.array([[*state, 1.0]]), True, True, False)


def test_an_estimate_elsewhere_does_not_agree() -> None:
    start = facing_wall(0.0, 2.0)
    pose = DeadReckonedPose(start, EXACT)
    assert pose.agrees_with(estimate(start, 0.05, -0.05, math.radians(2.0)))
    assert not pose.agrees_with(estimate(start, 0.15, 0.0, 0.0))
    assert not pose.agrees_with(estimate(start, 0.0, 0.0, math.radians(6.0)))
    # After a long way by odometry alone a larger difference agrees_with.
    driven = pose.after(Movement(1.0))
    assert driven.agrees_with(estimate(driven.state, 0.25, 0.0, 0.0))
