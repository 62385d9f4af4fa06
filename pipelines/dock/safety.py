"""Safety bounds: movements stay in the area and away from the surface, uncertainty included."""

import math
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.dock.clearance import Clearance
from pipelines.dock.planar_motion import moved, position_sigma
from pipelines.dock.robot import STANDSTILL, Movement
from pipelines.lightfield.free_ground import FreeGround

# Uncertainty of the position counts with this many standard deviations.
SIGMAS = 2.0
# It counts with this at most, metres: a robot that is uncertain everywhere could never move again.
LARGEST_ALLOWANCE = 0.15
# The path of a movement is checked at this many places, and shortened to these shares.
PLACES_ON_PATH = 5
SHARES = (1.0, 0.75, 0.5, 0.25, 0.1)
# A movement shortened to less than this is not made, metres.
SHORTEST = 0.01


@dataclass(frozen=True)
class Safety:
    """The bounds of all movements.

    Attributes:
        area: x_min, x_max, y_min, y_max that the robot must not leave, metres.
        clearance: measures distances from the scene's surface.
        least_distance: distance to keep from the surface, metres.
        ground: the free ground, which it must not leave either; None: all of the area.
    """

    area: tuple[float, float, float, float]
    clearance: Clearance
    least_distance: float
    ground: FreeGround | None = None

    def check_goal(self, goal: FloatArray) -> None:
        """Makes sure that a goal ``(3,)`` is a place where the robot can be.

        Raises:
            OptionError: outside of the area, inside the surface, or too near to it.
        """
        place = f"the goal {goal[0]:.2f},{goal[1]:.2f}"
        if self.outside_by(goal) > 0.0:
            x_min, x_max, y_min, y_max = self.area
            raise OptionError(
                f"{place} lies outside of the allowed area, x {x_min:.2f} to {x_max:.2f} m, "
                f"y {y_min:.2f} to {y_max:.2f} m"
                + ("" if self.ground is None else ", or of its free ground")
            )
        if self.clearance.is_inside(goal):
            raise OptionError(f"{place} lies inside the scene's surface or behind it")
        distance = self.clearance.distance(goal)
        if distance < self.least_distance:
            raise OptionError(
                f"{place} is {distance:.2f} m from the scene's surface, nearer than the least "
                f"distance {self.least_distance:.2f} m; choose another goal or --least-distance"
            )

    def outside_by(self, state: FloatArray) -> float:
        """Metres by which a state ``(3,)`` lies outside of the area or free ground; 0 inside."""
        x_min, x_max, y_min, y_max = self.area
        x, y = float(state[0]), float(state[1])
        outside = math.hypot(max(x_min - x, 0.0, x - x_max), max(y_min - y, 0.0, y - y_max))
        return outside if self.ground is None else max(outside, self.ground.distance(state[:2]))

    def is_allowed(self, state: FloatArray, allowance: float = 0.0) -> bool:
        """Whether the robot may stand at a state.

        Args:
            state: ``(3,)``.
            allowance: metres to keep from the surface beyond the least distance.
        """
        return (
            self.outside_by(state) == 0.0
            and self.clearance.distance(state) >= self.least_distance + allowance
        )

    def restricted(self, state: FloatArray, covariance: FloatArray, movement: Movement) -> Movement:
        """A movement shortened until it is allowed; a rotation on the spot always is.

        Args:
            state: ``(3,)`` estimated pose of the robot.
            covariance: ``(3, 3)`` of the estimate's error, metres and radians.
            movement: the movement wanted.
        """
        if movement.distance == 0.0:
            return movement
        allowance = min(SIGMAS * position_sigma(covariance), LARGEST_ALLOWANCE)
        for share in SHARES:
            shorter = movement.scaled(share)
            if shorter.distance < min(SHORTEST, movement.distance):
                break
            if self._is_path_allowed(state, shorter, allowance):
                return shorter
        return STANDSTILL

    def _is_path_allowed(self, state: FloatArray, movement: Movement, allowance: float) -> bool:
        """Whether a movement from a state ``(3,)`` stays in bounds, or leads back into them."""
        near = self.clearance.distance(state)
        outside = self.outside_by(state)
        for share in np.linspace(0.0, 1.0, PLACES_ON_PATH + 1)[1:]:
            place = moved(state, movement.scaled(float(share)))
            distance = self.clearance.distance(place)
            # A robot that is already too near or outside may still move away.
            if distance < self.least_distance + allowance and distance < near:
                return False
            if self.outside_by(place) > outside:
                return False
        return True
