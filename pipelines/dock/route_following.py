"""Route following: which waypoint to drive to next, from where the robot is now.

Waypoints are passed over where a straight line leads farther along the route: one that stays near
recorded places and leaves as much room as the route itself, or enough. What a depth map does not
show, a pane of glass, stands between recorded places that are not linked; so the route is not left
for a line that only looks free.
"""

import numpy as np
import scipy.spatial

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.collision_check import SPACING, CollisionCheck

# A waypoint is reached within this, metres.
REACHED = 0.1
# Straight lines lead so far ahead at most, metres, and leave this room unless the route has less.
LOOK_AHEAD, ENOUGH_ROOM = 2.0, 0.2
# A straight line stays within this of recorded places, metres.
NEAR_RECORDED = 0.6
# The robot faces the first waypoint that is at least so far away, metres.
FACED = 0.5


def remaining_route(
    route: FloatArray,
    place: FloatArray,
    check: CollisionCheck,
    recorded: scipy.spatial.KDTree,
) -> FloatArray | None:
    """What is left of a route: the robot drives straight to its first waypoint.

    Args:
        route: ``(W, 2)`` waypoints that were left before, metres.
        place: ``(2,)`` where the robot is.
        check: the bounds, with what was found to be blocked.
        recorded: the places of the road map.

    Returns:
        ``(V, 2)`` with 0 < V <= W; None where not even the next waypoint can be reached.
    """
    while len(route) > 1 and np.linalg.norm(route[0] - place) < REACHED:
        route = route[1:]
    ahead = route[np.cumsum(_lengths(place, route)) <= LOOK_AHEAD]
    ahead = route[:1] if len(ahead) == 0 else ahead
    direct = check.room_leaving(place, ahead)
    if direct[0] < 0.0:
        return None
    legs = check.room_along(ahead[:-1], ahead[1:])
    along = np.minimum.accumulate(np.concatenate([direct[:1], legs]))
    wanted = np.minimum(along, ENOUGH_ROOM)
    for index in range(len(ahead) - 1, 0, -1):
        if direct[index] >= max(wanted[index], 0.0) and is_recorded(place, ahead[index], recorded):
            return route[index:]
    return route


def is_recorded(first: FloatArray, last: FloatArray, recorded: scipy.spatial.KDTree) -> bool:
    """Whether the line between two places ``(2,)`` stays near recorded places."""
    count = max(2, int(np.ceil(np.linalg.norm(last - first) / SPACING)))
    places = first + np.linspace(0.0, 1.0, count)[:, None] * (last - first)
    distances, _ = recorded.query(places)
    return bool(np.all(distances <= NEAR_RECORDED))


def faced_waypoint(route: FloatArray, place: FloatArray) -> FloatArray:
    """The waypoint ``(2,)`` that a robot at a place ``(2,)`` looks at while it drives."""
    far = np.flatnonzero(np.linalg.norm(route - place, axis=1) >= FACED)
    return np.asarray(route[far[0]] if len(far) else route[-1])


def _lengths(place: FloatArray, route: FloatArray) -> FloatArray:
    """Lengths ``(W,)`` of the legs from a place over a route's waypoints."""
    return np.asarray(np.linalg.norm(np.diff(route, axis=0, prepend=place[None]), axis=1))
