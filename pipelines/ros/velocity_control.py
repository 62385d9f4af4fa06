"""Velocities that carry a robot to a pose and bring it to a stop there, within its limits.

The way from one pose of the plane to another is taken along the arc of one constant velocity
(forward, left, turn), as a screw motion: for a differential drive, whose movements are arcs, left
is zero all along. At every moment the rest of the way is taken anew from odometry, so that slip and
delay do not add up.
"""

import math
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.state_space import PLANAR

# Where the rest of the way is shorter, the robot has arrived: metres, radians.
ARRIVED_POSITION, ARRIVED_ANGLE = 0.002, math.radians(0.15)


@dataclass(frozen=True)
class Velocity:
    """Metres a second forward and left, radians a second counter-clockwise."""

    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0


@dataclass(frozen=True)
class VelocityLimits:
    """Largest speeds and accelerations: metres, radians, seconds."""

    speed: float
    turn_speed: float
    acceleration: float
    turn_acceleration: float


STOPPED = Velocity()


def screw_of(displacement: FloatArray) -> FloatArray:
    """The velocity ``(3,)`` that makes a displacement ``(3,)`` in one second."""
    forward, left, turn = displacement.tolist()
    half = 0.5 * turn
    # half / tan(half), which is 1 for no rotation.
    stretch = half / math.tan(half) if abs(half) > 1e-9 else 1.0
    return np.array(
        [stretch * forward + half * left, stretch * left - half * forward, turn], dtype=np.float64
    )


def rest_of_way(state: FloatArray, target: FloatArray) -> FloatArray:
    """The displacement ``(3,)`` from a state to a target, in the robot's frame."""
    return PLANAR.increment(PLANAR.poses(state), PLANAR.poses(target))


class VelocityControl:
    """Brings a robot to one target.

    Args:
        target: ``(3,)`` in odometry's frame.
        limits: of the robot.
        holonomic: whether it drives sideways; else what is left of the way sideways stays.
    """

    def __init__(
        self, target: FloatArray, limits: VelocityLimits, *, holonomic: bool = True
    ) -> None:
        self._target, self._limits = target, limits
        self._directions = np.array([1.0, float(holonomic), 1.0])
        self._speed = self._turn_speed = 0.0

    def has_arrived(self, state: FloatArray) -> bool:
        """Whether the rest of the way, along which the robot can go, is as good as none."""
        forward, left, turn = self._screw(state).tolist()
        return math.hypot(forward, left) < ARRIVED_POSITION and abs(turn) < ARRIVED_ANGLE

    def velocity(self, state: FloatArray, seconds: float) -> Velocity:
        """The velocity to be driven next.

        Args:
            state: ``(3,)`` by odometry.
            seconds: since the velocity before.
        """
        limits = self._limits
        screw = self._screw(state)
        distance, angle = math.hypot(screw[0], screw[1]), abs(float(screw[2]))
        speed = _ramped(self._speed, distance, limits.speed, limits.acceleration, seconds)
        turn_speed = _ramped(
            self._turn_speed, angle, limits.turn_speed, limits.turn_acceleration, seconds
        )
        left = max(distance / speed, angle / turn_speed)
        self._speed, self._turn_speed = distance / left, angle / left
        forward, sideways, turn = (screw / left).tolist()
        return Velocity(forward, sideways, turn)

    def _screw(self, state: FloatArray) -> FloatArray:
        return np.asarray(screw_of(rest_of_way(state, self._target)) * self._directions)


def _ramped(before: float, rest: float, most: float, acceleration: float, seconds: float) -> float:
    """A speed no higher than what the robot reaches by now, and can still brake from."""
    braking = math.sqrt(2.0 * acceleration * rest)
    return max(min(most, before + acceleration * seconds, braking), 1e-3)


def longest_time(displacement: FloatArray, limits: VelocityLimits) -> float:
    """Seconds within which a displacement ``(3,)`` is driven, ramps included."""
    screw = screw_of(displacement)
    distance, angle = math.hypot(screw[0], screw[1]), abs(float(screw[2]))
    driving = distance / limits.speed + limits.speed / limits.acceleration
    turning = angle / limits.turn_speed + limits.turn_speed / limits.turn_acceleration
    return driving + turning
