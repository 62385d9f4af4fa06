"""From where the robot is to its next movement, for two kinds of drive.

``omni`` goes straight to its target with the target's heading, so that its camera looks where it
will have to look in the end. ``diff`` turns on the spot and drives arcs of constant curvature,
``left = forward tan(turn / 2)``. It keeps its heading within ``WIDEST_VIEW`` of the goal's even
when the target lies sideways: a camera that looks along the wall tells nothing. It then reaches
the target by tacking, as a car does that is parked: back on one diagonal, forward on the other.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.planar_motion import distance_between, movement_between, turn_between
from pipelines.dock.robot import STANDSTILL, Movement
from pipelines.dock.settings import DockSettings

# The drive keeps its heading within this of the goal's.
WIDEST_VIEW = math.radians(40.0)
VIEW_SHARES = (1.0, 0.75, 0.5, 0.3)
# An omni drive that is turned away by more than this turns before it drives.
TURN_FIRST = math.radians(60.0)
# Course errors up to this are steered away in an arc; beyond, the robot turns on the spot.
LARGEST_STEERING = math.radians(8.0)
# A diagonal counts as taken when the heading is as near to it as this.
ON_DIAGONAL = math.radians(15.0)
# The arc towards a line aims so far ahead, metres.
LOOK_AHEAD = 0.35
# Shorter movements are not worth an image.
SHORTEST = 0.002
# Nearer than this to the target, a course is no longer a meaningful direction.
NEAR = 0.05


def limited(movement: Movement, step: float, turn: float) -> Movement:
    """The same path, no farther than ``step`` metres and ``turn`` radians."""
    share = min(
        1.0,
        step / max(movement.distance, 1e-12),
        turn / max(abs(movement.turn), 1e-12),
    )
    return movement.scaled(share)


def omni_movement(state: FloatArray, target: FloatArray, step: float, turn: float) -> Movement:
    """The next movement of a drive that can go anywhere.

    Args:
        state: ``(3,)`` where the robot is.
        target: ``(3,)`` where it is to go.
        step: metres at most.
        turn: radians at most.
    """
    whole = movement_between(state, target)
    if abs(whole.turn) > TURN_FIRST:
        return Movement(turn=math.copysign(min(turn, abs(whole.turn)), whole.turn))
    # Turning and driving have limits of their own, and each part gets as far as it can.
    driven = limited(Movement(whole.forward, whole.left), step, math.inf)
    return Movement(driven.forward, driven.left, float(np.clip(whole.turn, -turn, turn)))


def diff_movement_to(
    state: FloatArray,
    target: FloatArray,
    settings: DockSettings,
    is_allowed: Callable[[FloatArray], bool],
    sees: Callable[[FloatArray], bool],
    lost_views: int = 0,
) -> Movement:
    """The next movement of a differential drive towards a pose, with the goal mostly in view.

    Args:
        state: ``(3,)`` where the robot is.
        target: ``(3,)`` where it is to go; its heading is where the goal is seen.
        settings: limits of one movement.
        is_allowed: whether the robot may stand at a state.
        sees: whether its camera sees enough of the scene there.
        lost_views: how often it turned aside and then did not know where it was: each time it dares
            less.
    """
    shares = VIEW_SHARES[min(lost_views, len(VIEW_SHARES) - 1) :]
    step = settings.largest_step
    heading = -turn_between(state, target)
    remaining = movement_between(np.array([state[0], state[1], target[2]]), target)
    ahead, left = remaining.forward, remaining.left
    if remaining.distance < NEAR:
        return _turn(-heading, settings)
    direction = 1.0 if ahead >= 0.0 else -1.0
    course = math.atan2(direction * left, direction * ahead)
    if abs(course) <= shares[0] * WIDEST_VIEW:
        return _drive(heading, course, direction * min(step, remaining.distance), settings)
    forwards, backwards = (
        _widest_seen(state, target, math.copysign(1.0, sign * left), sees, shares)
        for sign in (1, -1)
    )
    if forwards == backwards == 0.0:
        # Nothing is to be seen on either side: as little aside as still leads there.
        forwards = math.copysign(VIEW_SHARES[-1] * WIDEST_VIEW, left)
        backwards = -forwards
    forward_leg = _drive(heading, forwards, step, settings)
    may_drive_on = ahead > NEAR and forwards != 0.0
    if abs(heading - forwards) < ON_DIAGONAL and may_drive_on:
        return forward_leg
    displacement = (-step * math.cos(backwards), -step * math.sin(backwards))
    behind = np.array([*_displaced(state, target, *displacement), target[2] + backwards])
    if may_drive_on and not (is_allowed(behind) and backwards != 0.0):
        return forward_leg
    return _drive(heading, backwards, -step, settings)


def _widest_seen(
    state: FloatArray,
    target: FloatArray,
    sign: float,
    sees: Callable[[FloatArray], bool],
    shares: Sequence[float],
) -> float:
    """The course on one side of the target's heading, as wide as the scene stays in view."""
    for share in shares:
        course = sign * share * WIDEST_VIEW
        if sees(np.array([state[0], state[1], target[2] + course])):
            return course
    return 0.0


def diff_movement_along(state: FloatArray, goal: FloatArray, settings: DockSettings) -> Movement:
    """The next movement of a differential drive that stands behind a goal and is to drive into it.

    Args:
        state: ``(3,)`` where the robot is.
        goal: ``(3,)``.
        settings: limits of one movement.
    """
    heading = -turn_between(state, goal)
    remaining = movement_between(np.array([state[0], state[1], goal[2]]), goal)
    ahead, left = remaining.forward, remaining.left
    if ahead < max(settings.position_tolerance, abs(left)):
        # Too near for steering: what is left is turning, and a little to and fro.
        if abs(heading) > settings.heading_tolerance:
            return _turn(-heading, settings)
        return Movement(forward=ahead) if abs(ahead) > SHORTEST else STANDSTILL
    # Half of the way at most, so that steps become smaller as the goal comes nearer.
    step = min(settings.largest_step, max(0.5 * ahead, min(ahead, NEAR)))
    course = math.atan2(left, min(ahead, max(LOOK_AHEAD, step)))
    return _drive(heading, course, step, settings)


def nearing(distance: float, settings: DockSettings) -> float:
    """How far the next step may go, metres, so that steps become smaller near the target."""
    return min(settings.largest_step, max(0.5 * distance, NEAR))


def is_near(state: FloatArray, target: FloatArray, metres: float, radians: float) -> bool:
    """Whether a state is as near to a target as that."""
    return distance_between(state, target) <= metres and abs(turn_between(state, target)) <= radians


def _drive(heading: float, course: float, distance: float, settings: DockSettings) -> Movement:
    """Drives ``distance`` (negative: backwards) in an arc whose chord lies on ``course``.

    Args:
        heading: radians from the goal's heading.
        course: likewise, of the robot's x axis in the middle of the arc.
        distance: metres.
        settings: limits of one movement.
    """
    error = math.remainder(course - heading, 2.0 * math.pi)
    if abs(error) > LARGEST_STEERING:
        return _turn(error, settings)
    return Movement(
        forward=distance * math.cos(error), left=distance * math.sin(error), turn=2.0 * error
    )


def _turn(angle: float, settings: DockSettings) -> Movement:
    angle = math.remainder(angle, 2.0 * math.pi)
    return Movement(turn=math.copysign(min(abs(angle), settings.largest_turn), angle))


def _displaced(
    state: FloatArray, target: FloatArray, forward: float, left: float
) -> tuple[float, float]:
    """``state`` displaced along and across the target's heading."""
    cosine, sine = math.cos(float(target[2])), math.sin(float(target[2]))
    return (
        float(state[0]) + forward * cosine - left * sine,
        float(state[1]) + forward * sine + left * cosine,
    )
