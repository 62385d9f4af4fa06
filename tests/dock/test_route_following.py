"""Following routes in two rooms: noisy movements, noisy estimates, doors that turn out closed."""

import itertools
import math

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.navigation import Navigator, Travel
from pipelines.dock.planar_motion import moved
from pipelines.dock.robot import Movement
from pipelines.dock.robots.noise import MotionNoise, SimulatedMotion
from pipelines.dock.settings import DockSettings
from tests.route_samples import EAST, WEST, Rooms

RADIUS = 0.25
STAGING = np.array([*EAST, 1.0])
START = np.array([*WEST, 2.0])
# Standard deviations of estimates: metres and radians.
SIGMAS = (0.02, 0.02, math.radians(1.0))


def navigator(
    rooms: Rooms, drive: str = "omni", radius: float = RADIUS
) -> tuple[Navigator, DockSettings]:
    settings = DockSettings(drive=drive, robot_radius=radius)
    safety = rooms.safety(settings.distance_kept)
    return Navigator(rooms.road_map, safety, STAGING, settings), settings


def driven(rooms: Rooms, drive: str, seed: int, carried: int = -1) -> list[FloatArray]:
    """True states from the start to where the straight line to staging begins.

    Args:
        rooms: where.
        drive: kind of drive.
        seed: of all noise.
        carried: the robot is carried back to its start after so many movements.
    """
    guide, settings = navigator(rooms, drive)
    safety = rooms.safety(settings.distance_kept)
    rng = np.random.default_rng(seed)
    motion = SimulatedMotion(START, MotionNoise(), rng)
    travel, states = Travel(), [motion.state]
    for step in range(80):
        if step == carried:
            motion.state = START
        estimate = motion.state + rng.normal(0.0, SIGMAS)
        travel = guide.next(travel, estimate, step == carried)
        if guide.has_arrived(travel):
            return states
        assert travel.route is not None
        command = guide.movement(travel, estimate)
        assert command.distance <= settings.largest_step + 1e-9
        assert abs(command.turn) <= settings.largest_turn + 1e-9
        covariance = np.diag(np.square(SIGMAS))
        motion.move(safety.restricted(estimate, covariance, command))
        states.append(motion.state)
    raise AssertionError("80 steps were not enough")


@pytest.mark.parametrize("drive", ["omni", "diff"])
def test_the_robot_gets_through_the_door_and_touches_nothing(drive: str) -> None:
    rooms = Rooms([(0.0, 0.9)])
    for seed in range(20):
        states = driven(rooms, drive, seed)
        assert states[-1][0] > 0.0
        assert len(states) < 40
        for before, after in itertools.pairwise(states):
            for share in np.linspace(0.0, 1.0, 9):
                place = before[:2] + share * (after - before)[:2]
                assert rooms.wall_distance(place) > RADIUS


def test_it_plans_anew_where_it_was_carried_to() -> None:
    rooms = Rooms([(0.0, 0.9)])
    for seed in range(3):
        states = driven(rooms, "omni", seed, carried=9)
        assert states[8][0] > -1.0
        assert states[-1][0] > 0.0


def test_a_route_is_needed_only_where_the_wall_is_in_between() -> None:
    guide, _ = navigator(Rooms([(0.0, 0.9)]))
    assert guide.is_needed(START)
    assert not guide.is_needed(np.array([1.0, -1.0, 0.0]))
    assert not guide.is_needed(np.array([2.0, 0.5, 0.0]))


def test_a_blocked_door_means_the_other_door_and_then_no_way() -> None:
    rooms = Rooms([(-1.0, 0.9), (1.0, 0.9)])
    guide, _ = navigator(rooms)
    for y in (-1.0, 1.0):
        before_door = np.array([-0.4, y, 0.0])
        travel = guide.next(Travel(), before_door, False)
        assert travel.route is not None
        blocked = guide.blocked(travel, before_door)
        assert blocked.is_stuck
        # To tell a door from wheels that do not turn.
        assert guide.movement(blocked, before_door).turn > 0.0
        around = guide.next(blocked, before_door, False)
        assert around.route is not None
        crossing = np.argmax(around.route[:, 0] > 0.0)
        assert around.route[crossing, 1] * y < 0.0
        # From before the other one, which is closed too.
        other = np.array([-0.4, -y, 0.0])
        both = guide.blocked(guide.next(around, other, True), other)
        nowhere = guide.next(both, other, False)
        assert nowhere.route is None
        assert nowhere.failures == 1
        assert "does not show" in guide.objection(nowhere)


@pytest.mark.parametrize(("radius", "words"), [(0.5, "0.55 m from"), (0.0, "--robot-radius")])
def test_no_way_for_a_robot_that_is_too_wide_says_why(radius: float, words: str) -> None:
    guide, _ = navigator(Rooms([(0.0, 0.9)]), radius=radius)
    assert guide.is_needed(START)
    travel = guide.next(guide.next(Travel(), START, False), START, False)
    assert travel.failures == 2
    assert guide.movement(travel, START) == Movement()
    assert words in guide.objection(travel)


def test_being_stuck_ends_with_a_movement_that_happened() -> None:
    stuck = Travel(is_stuck=True)
    assert stuck.after(Movement(), False).is_stuck
    assert stuck.after(Movement(turn=0.2), True).is_stuck
    assert not stuck.after(Movement(forward=0.2), False).is_stuck
    assert not stuck.after(Movement(turn=0.2), False).is_stuck


def test_the_robot_looks_where_it_drives() -> None:
    guide, settings = navigator(Rooms([(0.0, 0.9)]))
    state = START
    for _ in range(12):
        travel = guide.next(Travel(), state, False)
        state = moved(state, guide.movement(travel, state))
    assert travel.route is not None
    ahead = travel.route[0] - state[:2]
    course = math.remainder(math.atan2(ahead[1], ahead[0]) - float(state[2]), 2.0 * math.pi)
    assert abs(course) < settings.largest_turn
