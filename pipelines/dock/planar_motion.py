"""Poses on the floor: what leads from one to another, and how far apart they are."""

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
    """The state ``(3,)`` that many metres straight behind a goal, with its heading."""
    return moved(goal, Movement(forward=-distance))


def distance_between(first: FloatArray, second: FloatArray) -> float:
    """Metres."""
    return math.hypot(float(first[0] - second[0]), float(first[1] - second[1]))


def turn_between(first: FloatArray, second: FloatArray) -> float:
    """Radians from the first heading to the second, by the shorter way."""
    return float(PLANAR.difference(second, first)[2])


def position_sigma(covariance: FloatArray) -> float:
    """Standard deviation (metres) of the position along its least certain direction."""
    return math.sqrt(max(0.0, float(np.linalg.eigvalsh(covariance[:2, :2])[-1])))


def heading_sigma(covariance: FloatArray) -> float:
    """Standard deviation (radians) of the heading."""
    return math.sqrt(max(0.0, float(covariance[2, 2])))
