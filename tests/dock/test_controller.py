"""The controllers as pure kinematics: they reach the pose from anywhere, within their limits."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.clearance import Clearance
from pipelines.dock.controller import diff_movement_along, diff_movement_to, nearing, omni_movement
from pipelines.dock.planar_motion import behind, distance_between, is_near, moved, yaw_between
from pipelines.dock.robot import Movement
from pipelines.dock.safety import Safety
from pipelines.dock.settings import DockSettings
from tests.report_samples import facing_wall, wall_scene

GOAL = np.array([-1.15, -1.65, math.pi / 2.0])
OMNI, DIFF = DockSettings(drive="omni"), DockSettings(drive="diff")
STAGING = behind(GOAL, OMNI.staging_distance)
AREA = (-4.9, 2.8, -5.6, -0.5)
EXACT = np.zeros((3, 3))
starts = st.tuples(st.floats(-3.0, 2.0), st.floats(-5.0, -2.5), st.floats(-math.pi, math.pi)).map(
    np.array
)


def in_area(state: FloatArray) -> bool:
    return bool(AREA[0] < state[0] < AREA[1] and AREA[2] < state[1] < AREA[3])


def check_limits(movement: Movement, chosen: DockSettings) -> None:
    assert movement.distance <= chosen.largest_step + 1e-9
    assert abs(movement.turn) <= chosen.largest_turn + 1e-9


@settings(max_examples=60, deadline=None)
@given(starts)
def test_an_omni_drive_gets_to_a_pose_from_anywhere(start: FloatArray) -> None:
    state = start
    for _ in range(40):
        step = nearing(distance_between(state, STAGING), OMNI)
        movement = omni_movement(state, STAGING, step, OMNI.largest_turn)
        check_limits(movement, OMNI)
        state = moved(state, movement)
    assert is_near(state, STAGING, 1e-6, 1e-6)


@settings(max_examples=60, deadline=None)
@given(starts)
def test_a_differential_drive_gets_to_the_goal_from_anywhere(start: FloatArray) -> None:
    state, steps = start, 0
    while not is_near(state, STAGING, 0.1, 0.1):
        movement = diff_movement_to(state, STAGING, DIFF, in_area, lambda _: True)
        check_limits(movement, DIFF)
        # No sideways movement but that of an arc: the chord's direction is half of its yaw.
        assert math.isclose(
            movement.left, movement.forward * math.tan(movement.turn / 2.0), abs_tol=1e-9
        )
        before, state, steps = state, moved(state, movement), steps + 1
        assert in_area(state) or not in_area(before)
        assert steps < 40
    while not is_near(state, GOAL, DIFF.position_tolerance, DIFF.heading_tolerance):
        movement = diff_movement_along(state, GOAL, DIFF)
        check_limits(movement, DIFF)
        assert np.any(movement.vector() != 0.0)
        state, steps = moved(state, movement), steps + 1
        assert steps < 60


@settings(max_examples=30, deadline=None)
@given(st.floats(-3.0, 2.0), st.floats(-5.0, -2.5))
def test_a_differential_drive_keeps_the_goal_in_view_once_it_faces_it(x: float, y: float) -> None:
    state = np.array([x, y, GOAL[2]])
    for _ in range(30):
        movement = diff_movement_to(state, STAGING, DIFF, in_area, lambda _: True)
        state = moved(state, movement)
        assert abs(yaw_between(state, GOAL)) < math.radians(50.0)


def test_where_the_scene_leaves_the_view_the_drive_rotates_less() -> None:
    start = np.array([1.6, -4.3, GOAL[2]])

    def sees(state: FloatArray) -> bool:
        # Nothing of the scene is to be seen to the right of the goal's heading by 15 degrees.
        return yaw_between(GOAL, state) > math.radians(-15.0)

    state = start
    for _ in range(60):
        state = moved(state, diff_movement_to(state, STAGING, DIFF, in_area, sees))
        assert yaw_between(GOAL, state) > math.radians(-25.0)
    assert is_near(state, STAGING, 0.1, 0.1)


@pytest.mark.parametrize("lost_views", [0, 1, 3, 9])
def test_a_drive_that_lost_its_view_rotates_less_and_still_arrives(lost_views: int) -> None:
    state, target = np.array([0.6, 0.2, GOAL[2]]), np.array([0.0, 0.0, GOAL[2]])
    widest = 0.0
    for _ in range(150):
        movement = diff_movement_to(state, target, DIFF, lambda _: True, lambda _: True, lost_views)
        state = moved(state, movement)
        widest = max(widest, abs(yaw_between(state, target)))
        if is_near(state, target, 0.1, 0.1):
            break
    assert is_near(state, target, 0.1, 0.1)
    share = (1.0, 0.75, 0.5, 0.3)[min(lost_views, 3)]
    assert widest == pytest.approx(share * math.radians(40.0), abs=math.radians(3.0))


def test_steps_become_smaller_towards_the_goal() -> None:
    state, steps = behind(GOAL, 0.8), []
    while distance_between(state, GOAL) > 0.05:
        movement = diff_movement_along(state, GOAL, DIFF)
        steps.append(movement.distance)
        state = moved(state, movement)
    assert steps == sorted(steps, reverse=True)
    assert steps[-1] < 0.5 * steps[0]


# --- safety -------------------------------------------------------------------------------------


def wall_safety(least_distance: float = 0.5) -> Safety:
    return Safety((-3.0, 3.0, -3.0, 0.0), Clearance(wall_scene(), 1.0), least_distance)


@settings(max_examples=100, deadline=None)
@given(
    st.floats(-2.9, 2.9), st.floats(-2.9, -0.7), st.floats(-3.0, 3.0), st.floats(0.0, 0.05),
    st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-3.0, 3.0)),
)  # fmt: skip
def test_no_restricted_movement_leaves_the_area_or_nears_the_wall(
    x: float, y: float, heading: float, sigma: float, wanted: tuple[float, float, float]
) -> None:
    safety, state = wall_safety(), np.array([x, y, heading])
    covariance = np.diag([sigma**2, sigma**2, 0.0])
    allowed = safety.restricted(state, covariance, Movement(*wanted))
    then = moved(state, allowed)
    assert safety.outside_by(then) == 0.0
    # The wall is the plane y = 0, so that -y is the distance from it.
    assert -then[1] >= min(0.5 + min(2.0 * sigma, 0.15), -state[1]) - 1e-9
    if allowed.distance > 0.0:
        np.testing.assert_allclose(allowed.turn * wanted[0], allowed.forward * wanted[2], atol=1e-9)


def test_a_movement_that_is_safe_is_not_changed() -> None:
    movement = Movement(0.3, 0.1, 0.2)
    assert wall_safety().restricted(facing_wall(0.0, 2.0), EXACT, movement) == movement


def test_a_robot_too_near_to_the_wall_may_still_leave_it() -> None:
    back = Movement(forward=-0.2)
    assert wall_safety().restricted(facing_wall(0.0, 0.3), EXACT, back) == back
    assert wall_safety().restricted(facing_wall(0.0, 0.3), EXACT, Movement(0.1)).distance == 0.0


# --- a doorway ----------------------------------------------------------------------------------

PILLARS = (np.array([-0.6, -2.0]), np.array([0.6, -2.0]))
PILLAR_RADIUS, ROBOT_RADIUS = 0.15, 0.3


@pytest.mark.parametrize("drive", ["omni", "diff"])
def test_a_robot_of_60_cm_passes_between_pillars_90_cm_apart(drive: str) -> None:
    # The estimate errs by 2 cm and 0.7 degrees, independently in every step.
    rng = np.random.default_rng(4)
    chosen = DockSettings(drive=drive, staging_distance=1.6)
    goal = np.array([0.0, -1.0, math.pi / 2.0])
    staging = behind(goal, chosen.staging_distance)
    for _ in range(10):
        state = np.array([rng.uniform(-0.8, 0.8), rng.uniform(-4.0, -3.2), rng.uniform(1.0, 2.0)])
        staged = False
        for _ in range(60):
            believed = state + rng.normal(0.0, [0.02, 0.02, 0.012])
            staged = staged or is_near(believed, staging, 0.1, 0.1)
            target = goal if staged else staging
            if drive == "omni":
                ahead = distance_between(believed, target)
                movement = omni_movement(
                    believed, target, nearing(ahead, chosen), chosen.largest_turn
                )
            elif staged:
                movement = diff_movement_along(believed, goal, chosen)
            else:
                movement = diff_movement_to(
                    believed, staging, chosen, lambda _: True, lambda _: True
                )
            for share in np.linspace(0.1, 1.0, 10):
                place = moved(state, movement.scaled(float(share)))[:2]
                gap = min(float(np.linalg.norm(place - pillar)) for pillar in PILLARS)
                assert gap > PILLAR_RADIUS + ROBOT_RADIUS
            state = moved(state, movement)
        assert state[1] > -1.2
