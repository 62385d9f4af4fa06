"""Planned routes against brute force, and against the plan of two rooms."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.dock.collision_check import Blockage, CollisionCheck
from pipelines.dock.road_map import RoadMap, cheapest_way
from pipelines.dock.route_planning import drivable_roads, planned_route, retracted
from tests.route_samples import EAST, WEST, Rooms

# --- the graph ----------------------------------------------------------------------------------


def least_cost(
    count: int, links: IntArray, costs: FloatArray, entering: FloatArray, leaving: FloatArray
) -> float:
    """By relaxing all links as often as there are places (Bellman, Ford)."""
    best = entering.copy()
    for _ in range(count):
        for (first, last), cost in zip(links.tolist(), costs.tolist(), strict=True):
            best[last] = min(best[last], best[first] + cost)
            best[first] = min(best[first], best[last] + cost)
    return float(np.min(best + leaving))


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 12), st.floats(0.0, 0.8), st.integers(0, 10**6))
def test_the_cheapest_way_is_that_of_brute_force(count: int, closed: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pairs = np.array([(a, b) for b in range(count) for a in range(b)]).reshape(-1, 2)
    links = pairs[rng.random(len(pairs)) < 0.5]
    costs = rng.uniform(0.1, 1.0, len(links))
    costs[rng.random(len(links)) < closed] = math.inf
    entering, leaving = rng.uniform(0.1, 1.0, (2, count))
    entering[rng.random(count) < 0.6] = math.inf
    leaving[rng.random(count) < 0.6] = math.inf
    way = cheapest_way(RoadMap(np.zeros((count, 2)), links), costs, entering, leaving)
    least = least_cost(count, links, costs, entering, leaving)
    if way is None:
        assert least == math.inf
        return
    cost_of = {tuple(sorted(link)): cost for link, cost in zip(links.tolist(), costs, strict=True)}
    steps = [tuple(sorted(pair)) for pair in zip(way[:-1].tolist(), way[1:].tolist(), strict=True)]
    total = entering[way[0]] + sum(cost_of[step] for step in steps) + leaving[way[-1]]
    assert math.isclose(total, least, rel_tol=1e-9)


# --- two rooms ----------------------------------------------------------------------------------


def route(rooms: Rooms, least: float, *blockages: Blockage) -> FloatArray | None:
    check = CollisionCheck(rooms.safety(least))
    roads = drivable_roads(rooms.road_map, check)
    return planned_route(roads, check.with_blockages(blockages), WEST, EAST)


def places_on(route: FloatArray) -> FloatArray:
    """Places on a route, a centimetre apart."""
    corners = np.vstack([WEST, route])
    return np.concatenate(
        [
            first + np.linspace(0.0, 1.0, 100)[:, None] * (last - first)
            for first, last in itertools.pairwise(corners)
        ]
    )


@settings(max_examples=25, deadline=None)
@given(st.floats(0.5, 1.4), st.floats(0.2, 0.6), st.floats(-0.8, 0.8))
def test_a_doorway_is_passed_where_the_robot_fits_and_nowhere_else(
    width: float, least: float, middle: float
) -> None:
    rooms = Rooms([(middle, width)])
    found = route(rooms, least)
    if width < 2.0 * least - 0.05:
        assert found is None
    elif width > 2.0 * least + 0.1:
        assert found is not None
    if found is not None:
        np.testing.assert_array_equal(found[-1], EAST)
        # Obstacle points and the places that are checked have their spacing.
        assert min(map(rooms.wall_distance, places_on(found))) > least - 0.03


def test_the_middle_of_a_doorway_is_found_although_nobody_photographed_from_there() -> None:
    rooms = Rooms([(0.0, 0.9)])
    found = route(rooms, 0.4)
    assert found is not None
    crossing = [place for place in places_on(found) if abs(place[0]) < 0.02]
    assert max(abs(place[1]) for place in crossing) < 0.05


def test_a_closed_door_leaves_the_other_one_and_two_leave_none() -> None:
    rooms = Rooms([(-1.0, 0.9), (1.0, 0.9)])
    open_way = route(rooms, 0.35)
    assert open_way is not None
    assert np.all(open_way[:, 1] < 0.0)
    south, north = Blockage(np.array([0.0, -1.0]), 0.45), Blockage(np.array([0.0, 1.0]), 0.45)
    around = route(rooms, 0.35, south)
    assert around is not None
    crossing = [place[1] for place in places_on(around) if abs(place[0]) < 0.02]
    assert min(crossing) > 0.5
    assert route(rooms, 0.35, south, north) is None


def test_places_that_no_recorded_path_links_are_not_connected_by_free_ground() -> None:
    # A pane of glass: no depth map shows it, and nobody walked through it.
    rooms = Rooms([(0.0, 3.9)])
    links = rooms.road_map.links
    x = rooms.road_map.positions[links][:, :, 0]
    rooms.road_map = RoadMap(rooms.road_map.positions, links[x[:, 0] * x[:, 1] > 0.0])
    assert route(rooms, 0.3) is None


def test_a_robot_that_stands_too_near_to_a_wall_may_drive_away() -> None:
    rooms = Rooms([(0.0, 0.9)])
    check = CollisionCheck(rooms.safety(0.4))
    roads = drivable_roads(rooms.road_map, check)
    assert planned_route(roads, check, np.array([-2.0, -1.8]), EAST) is not None


# --- collisions ---------------------------------------------------------------------------------


def test_room_along_lines_is_that_of_all_their_places() -> None:
    rooms = Rooms([(0.3, 0.9)])
    check = CollisionCheck(rooms.safety(0.2), [Blockage(np.array([2.0, 0.0]), 0.5)])
    rng = np.random.default_rng(3)
    first, last = rng.uniform([-3.9, -1.9], [3.9, 1.9], (2, 50, 2))
    room = check.room_along(first, last)
    blocked = check.is_blocked(first, last)
    for index in range(50):
        places = first[index] + np.linspace(0.0, 1.0, 400)[:, None] * (last - first)[index]
        apart = np.linalg.norm(places - [2.0, 0.0], axis=1).min()
        if abs(apart - 0.5) > 0.01:
            assert blocked[index] == (apart < 0.5)
            assert np.isinf(room[index]) == (apart < 0.5)
        if apart > 0.51:
            least = min(map(rooms.wall_distance, places)) - 0.2
            assert room[index] == pytest.approx(least, abs=0.04) or rooms.crosses_wall(
                first[index], last[index]
            )


def test_places_are_moved_to_where_there_is_room_and_not_far() -> None:
    rooms = Rooms([(0.0, 0.9)])
    check = CollisionCheck(rooms.safety(0.3))
    before = rooms.road_map.positions
    after = retracted(before, check)
    assert np.all(check.room(after) >= check.room(before))
    assert np.linalg.norm(after - before, axis=1).max() <= 0.3 + 1e-9
    assert np.all(check.room(after)[np.abs(before[:, 0]) < 0.3] > 0.14)
