"""Route planning: the way over a road map on which a robot of this size gets through.

The recorded places say where one can go; the scene's surface says how much room there is. A place
that was recorded beside the middle of a doorway is first moved to where there is room for a robot
(retraction, as in the medial-axis road maps of Wilmarth, Amato, Stiller 1999), and a link is closed
where the straight line between its places comes too near to the surface or leaves the free ground.
Of the ways that are left the cheapest is taken, where a narrow link costs more than its length.
"""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.collision_check import CollisionCheck
from pipelines.dock.road_map import RoadMap, cheapest_way

# Room from which on more of it is no better, metres. A link without any costs so many times its
# length.
ENOUGH_ROOM, NARROW_COST = 0.25, 3.0
# Places are moved by this at most, in steps of this, metres, in so many directions.
FARTHEST_MOVE, MOVE, DIRECTIONS = 0.3, 0.03, 12


@dataclass(frozen=True)
class DrivableRoads:
    """A road map for a robot of one size.

    Attributes:
        road_map: with N places, moved to where there is room, and E links.
        room: ``(E,)`` metres that each link leaves; negative: it cannot be driven.
        step: length of the longest link, metres: places nearer than this are next to each other.
    """

    road_map: RoadMap
    room: FloatArray
    step: float


def drivable_roads(road_map: RoadMap, check: CollisionCheck) -> DrivableRoads:
    """Moves the places of a road map to where there is room, and measures what its links leave.

    Args:
        road_map: as recorded.
        check: the bounds, without blockages.
    """
    first, last = road_map.ends
    step = float(np.linalg.norm(last - first, axis=1).max(initial=0.0))
    moved = RoadMap(retracted(road_map.positions, check), road_map.links)
    return DrivableRoads(moved, check.room_along(*moved.ends), step)


def retracted(places: FloatArray, check: CollisionCheck) -> FloatArray:
    """Places ``(N, 2)`` moved uphill in room until there is ``ENOUGH_ROOM``, or no more nearby."""
    angles = np.arange(DIRECTIONS) * 2.0 * np.pi / DIRECTIONS
    steps = MOVE * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    now, room = places.copy(), check.room(places)
    for _ in range(round(FARTHEST_MOVE / MOVE)):
        narrow = np.flatnonzero(room < ENOUGH_ROOM)
        around = now[narrow, None] + steps
        rooms = check.room(around.reshape(-1, 2)).reshape(len(narrow), DIRECTIONS)
        best = np.argmax(rooms, axis=1)
        row = np.arange(len(narrow))
        better = rooms[row, best] > room[narrow]
        if not better.any():
            break
        now[narrow[better]] = around[row, best][better]
        room[narrow[better]] = rooms[row, best][better]
    return now


def planned_route(
    roads: DrivableRoads, check: CollisionCheck, start: FloatArray, end: FloatArray
) -> FloatArray | None:
    """The way from where the robot is to where it is to go.

    The robot drives to the road map and leaves it by straight lines to and from places within a
    step, or where there are none so near, the nearest that can be reached.

    Args:
        roads: that it may use.
        check: the bounds, with what was found to be blocked.
        start: ``(2,)`` metres.
        end: ``(2,)`` metres.

    Returns:
        Waypoints ``(W, 2)``, the start left out, the end last; None: there is no way.
    """
    places = roads.road_map.positions
    first, last = roads.road_map.ends
    room = np.where(check.is_blocked(first, last), -np.inf, roads.room)
    costs = _costs(np.linalg.norm(last - first, axis=1), room)
    entering, leaving = (_connections(place, roads, check) for place in (start, end))
    way = cheapest_way(roads.road_map, costs, entering, leaving)
    return None if way is None else np.concatenate([places[way], end[None]])


def _connections(place: FloatArray, roads: DrivableRoads, check: CollisionCheck) -> FloatArray:
    """Cost ``(N,)`` of the straight lines between a place ``(2,)`` and those of the road map."""
    places = roads.road_map.positions
    lengths = np.linalg.norm(places - place, axis=1)
    room = check.room_leaving(place, places)
    reachable = np.where(room >= 0.0, lengths, np.inf)
    near = reachable <= max(roads.step, float(reachable.min(initial=np.inf)))
    return np.where(near, _costs(lengths, room), np.inf)


def _costs(lengths: FloatArray, room: FloatArray) -> FloatArray:
    """Costs of lines from their lengths and the room they leave; infinite without room."""
    narrow = np.clip(1.0 - room / ENOUGH_ROOM, 0.0, 1.0)
    return np.where(room >= 0.0, lengths * (1.0 + (NARROW_COST - 1.0) * narrow), np.inf)
