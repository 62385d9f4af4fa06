"""Poses on the floor: motion between them, their distance, and the covariance of their error.

A state is an array ``(3,)``: x and y in metres, heading in radians.
"""

import math

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.robot import Movement
from pipelines.localize.state_space import PLANAR


def movement_between(before: FloatArray, after: FloatArray) -> Movement:
    """The movement from one state ``(3,)`` to another, in the frame of the first."""
    forward, left, turn = PLANAR.increment(PLANAR.poses(before), PLANAR.poses(after)).tolist()
    return Movement(forward, left, turn)


def moved(state: FloatArray, movement: Movement) -> FloatArray:
    """The state ``(3,)`` after a movement."""
    return PLANAR.composed(state, movement.vector())


def behind(goal: FloatArray, distance: float) -> FloatArray:
    """The state ``(3,)`` that many metres straight behind a goal, with the goal's heading."""
    return moved(goal, Movement(forward=-distance))


def distance_between(first: FloatArray, second: FloatArray) -> float:
    """Distance of two states ``(3,)`` on the floor, metres."""
    return math.hypot(float(first[0] - second[0]), float(first[1] - second[1]))


def yaw_between(first: FloatArray, second: FloatArray) -> float:
    """Yaw from the heading of one state ``(3,)`` to another's, radians in (−π, π]."""
    return float(PLANAR.difference(second, first)[2])


def is_near(state: FloatArray, target: FloatArray, metres: float, radians: float) -> bool:
    """Whether a state ``(3,)`` lies within this distance and this yaw of a target ``(3,)``."""
    return distance_between(state, target) <= metres and abs(yaw_between(state, target)) <= radians


def position_sigma(covariance: FloatArray) -> float:
    """Standard deviation (metres) of the position along its least certain direction.

    Args:
        covariance: ``(3, 3)`` of a state's error.
    """
    return math.sqrt(max(0.0, float(np.linalg.eigvalsh(covariance[:2, :2])[-1])))


def heading_sigma(covariance: FloatArray) -> float:
    """Standard deviation (radians) of the heading, from a state's covariance ``(3, 3)``."""
    return math.sqrt(max(0.0, float(covariance[2, 2])))


def normalised_innovation(state: FloatArray, expected: FloatArray, covariance: FloatArray) -> float:
    """Squared Mahalanobis distance of a state from where it was expected.

    Args:
        state: ``(3,)``.
        expected: ``(3,)``.
        covariance: ``(3, 3)`` of their difference, metres and radians.
    """
    difference = PLANAR.difference(state, expected)
    return float(difference @ np.linalg.solve(covariance, difference))


def propagated_covariance(
    covariance: FloatArray,
    before: FloatArray,
    after: FloatArray,
    position_noise: float,
    heading_noise: float,
) -> FloatArray:
    """Covariance ``(3, 3)`` of a state's error after a movement measured by odometry.

    Args:
        covariance: ``(3, 3)`` before the movement.
        before: state ``(3,)`` before the movement.
        after: state ``(3,)`` after it, by odometry.
        position_noise: standard deviation that the movement adds along x and along y, metres.
        heading_noise: standard deviation that it adds to the heading, radians.
    """
    jacobian = np.eye(3)
    jacobian[0, 2] = -(after[1] - before[1])
    jacobian[1, 2] = after[0] - before[0]
    noise = np.diag([position_noise**2, position_noise**2, heading_noise**2])
    return np.asarray(jacobian @ covariance @ jacobian.T + noise)
