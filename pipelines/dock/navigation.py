"""Navigation: from room to room to the staging pose, where no straight line leads there.

Docking by itself drives straight to its staging pose. Where the surface lies in between, or ground
that is not free, the robot takes a route over recorded places (``route_planning``) with movements
of the same size, and follows it (``route_following``) until a straight line leads to the staging
pose. The route is planned anew when the belief has moved, when the next waypoint cannot be reached
from where the robot is, and when the robot finds its way blocked by something that the map does not
show, such as a closed door: it then takes another way, as long as there is one.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.spatial

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.collision_check import Blockage, CollisionCheck
from pipelines.dock.controller import movement_to_place
from pipelines.dock.road_map import RoadMap
from pipelines.dock.robot import STANDSTILL, Movement
from pipelines.dock.route_following import faced_waypoint, remaining_route
from pipelines.dock.route_planning import drivable_roads, planned_route
from pipelines.dock.safety import Safety
from pipelines.dock.settings import DockSettings

# What blocks the way is taken for a circle of this radius before the robot, metres: a door.
BLOCKAGE_RADIUS = 0.45
# A robot that is stuck rotates by this, radians.
TRIAL = 0.15
# A robot that odometry has moved less than this stands still: metres and radians.
STANDS_POSITION, STANDS_HEADING = 0.03, 0.05


@dataclass(frozen=True)
class Travel:
    """Progress on the way to the staging pose.

    Attributes:
        route: ``(W, 2)`` waypoints that are left; None: there is none.
        blockages: where the robot found its way blocked.
        is_stuck: whether the way was blocked and the robot has not moved since.
        failures: consecutive images from whose place there is no route.
    """

    route: FloatArray | None = None
    blockages: tuple[Blockage, ...] = ()
    is_stuck: bool = False
    failures: int = 0

    def after(self, measured: Movement, is_stalled: bool) -> "Travel":
        """Progress after a movement measured by odometry, or one that did not happen."""
        stands = measured.distance < STANDS_POSITION and abs(measured.turn) < STANDS_HEADING
        return replace(self, is_stuck=self.is_stuck and (stands or is_stalled))


class Navigator:
    """Plans and follows routes to one place.

    Args:
        road_map: places that can be driven.
        safety: bounds of all movements.
        end: ``(3,)`` the staging pose.
        settings: limits of one movement; the robot's radius.
    """

    def __init__(
        self, road_map: RoadMap, safety: Safety, end: FloatArray, settings: DockSettings
    ) -> None:
        self._check = CollisionCheck(safety)
        self._roads = drivable_roads(road_map, self._check)
        self._recorded = scipy.spatial.KDTree(self._roads.road_map.positions)
        self._end = end[:2]
        self._settings = settings

    def is_needed(self, state: FloatArray) -> bool:
        """Whether the straight line from a state ``(3,)`` to the staging pose cannot be driven."""
        return float(self._check.room_leaving(state[:2], self._end[None])[0]) < 0.0

    def next(self, travel: Travel, state: FloatArray, has_moved: bool) -> Travel:
        """Progress from a new estimate.

        Args:
            travel: so far.
            state: ``(3,)`` where the robot is.
            has_moved: whether the belief lies elsewhere than odometry says.

        Returns:
            Progress with what is left of the route, or without a route where there is none.
        """
        check = self._check.with_blockages(travel.blockages)
        route = None if has_moved else travel.route
        if route is not None:
            route = remaining_route(route, state[:2], check, self._recorded)
        if route is None:
            planned = planned_route(self._roads, check, state[:2], self._end)
            if planned is not None:
                route = remaining_route(planned, state[:2], check, self._recorded)
        failures = 0 if route is not None else travel.failures + 1
        return replace(travel, route=route, failures=failures)

    def has_arrived(self, travel: Travel) -> bool:
        """Whether nothing of the route is left but the straight line to the staging pose."""
        return travel.route is not None and len(travel.route) == 1

    def objection(self, travel: Travel) -> str:
        """Why there is no route, for people."""
        if any(not blockage.is_on_map for blockage in travel.blockages):
            return "something that the map does not show blocks the way, and there is no other"
        if travel.blockages:
            return "the way is too narrow for the robot and for what it knows of its position"
        least = self._settings.distance_kept
        hint = "" if self._settings.robot_radius > 0.0 else "; doorways need --robot-radius"
        return (
            f"no recorded path leads to the staging pose that stays {least:.2f} m from the surface "
            f"and on free ground{hint}"
        )

    def movement(self, travel: Travel, state: FloatArray) -> Movement:
        """The next movement from a state ``(3,)``: along the route; none without one.

        A robot that is stuck rotates: if it was a door, that is possible, otherwise it is the
        wheels.
        """
        if travel.is_stuck:
            return Movement(turn=min(TRIAL, self._settings.largest_turn))
        if travel.route is None:
            return STANDSTILL
        faced = faced_waypoint(travel.route, state[:2])
        return movement_to_place(state, travel.route[0], faced, self._settings)

    def blocked(self, travel: Travel, state: FloatArray, *, is_on_map: bool = False) -> Travel:
        """Progress of a robot that could not drive on from a state ``(3,)``.

        Args:
            travel: so far.
            state: where it stands.
            is_on_map: whether the map's surface did not allow it.
        """
        if travel.route is None:
            return travel
        ahead = travel.route[0] - state[:2]
        ahead = ahead / max(float(np.hypot(*ahead)), 1e-9)
        place = state[:2] + (self._settings.robot_radius + BLOCKAGE_RADIUS) * ahead
        blockage = Blockage(place, BLOCKAGE_RADIUS, is_on_map)
        return replace(travel, route=None, blockages=(*travel.blockages, blockage), is_stuck=True)
