"""Which movements are allowed: inside the area, away from the surface, whatever is not known."""

import math
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.dock.clearance import Clearance
from pipelines.dock.planar_motion import moved, position_sigma
from pipelines.dock.robot import STANDSTILL, Movement

# What is not known of the position counts so many standard deviations.
SIGMAS = 2.0
# But never more than this, metres: a robot that is nowhere sure could never move again.
LARGEST_ALLOWANCE = 0.15
# The path of a movement is looked at in so many places, and shortened in such steps.
PLACES_ON_PATH = 5
SHARES = (1.0, 0.75, 0.5, 0.25, 0.1)
# Shortened to less than this a movement is none, metres.
SHORTEST = 0.01


@dataclass(frozen=True)
class Safety:
    """The bounds of all movements.

    Attributes:
        area: ``(4,)`` x_min, x_max, y_min, y_max, metres.
        clearance: from the scene's surface.
        least_distance: metres from it.
    """

    area: tuple[float, float, float, float]
    clearance: Clearance
    least_distance: float

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
        """Metres by which a state ``(3,)`` lies outside of the area; 0 inside."""
        x_min, x_max, y_min, y_max = self.area
        x, y = float(state[0]), float(state[1])
        return math.hypot(max(x_min - x, 0.0, x - x_max), max(y_min - y, 0.0, y - y_max))

    def is_allowed(self, state: FloatArray, allowance: float = 0.0) -> bool:
        """Whether the robot may stand at a state ``(3,)``, ``allowance`` metres left aside."""
        return (
            self.outside_by(state) == 0.0
            and self.clearance.distance(state) >= self.least_distance + allowance
        )

    def restricted(self, state: FloatArray, covariance: FloatArray, movement: Movement) -> Movement:
        """The movement, shortened so far that it is allowed; a turn on the spot always is.

        Args:
            state: ``(3,)`` where the robot is taken to be.
            covariance: ``(3, 3)`` of that.
            movement: what is wanted.
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
        near = self.clearance.distance(state)
        outside = self.outside_by(state)
        for share in np.linspace(0.0, 1.0, PLACES_ON_PATH + 1)[1:]:
            place = moved(state, movement.scaled(float(share)))
            distance = self.clearance.distance(place)
            # Where the robot is already too near or outside, it may still leave.
            if distance < self.least_distance + allowance and distance < near:
                return False
            if self.outside_by(place) > outside:
                return False
        return True
