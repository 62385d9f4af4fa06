"""Motion controllers: the next movement towards a pose, for two kinds of drive.

``omni`` goes straight to its target with the target's heading, so that its camera looks at the goal
on the way. ``diff`` rotates on the spot and drives arcs of constant curvature,
``left = forward tan(turn / 2)``. It keeps its heading within ``WIDEST_VIEW`` of the goal's even
when the target lies sideways, since a camera that looks along the wall localizes nothing. It then
reaches the target as a car parks: back on one diagonal, forward on the other.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.planar_motion import movement_between, yaw_between
from pipelines.dock.robot import STANDSTILL, Movement
from pipelines.dock.settings import DockSettings

# A differential drive keeps its heading within this of the goal's, or within a share of this where
# the scene would leave the view.
WIDEST_VIEW = math.radians(40.0)
VIEW_SHARES = (1.0, 0.75, 0.5, 0.3)
# An omni drive whose heading is off by more than this rotates before it drives.
ROTATE_FIRST = math.radians(60.0)
# Course errors up to this are corrected in an arc; for larger ones the robot rotates on the spot.
LARGEST_STEERING = math.radians(8.0)
# The robot is on a diagonal when its heading is within this of it.
ON_DIAGONAL = math.radians(15.0)
# The arc towards a line aims so far ahead, metres.
LOOK_AHEAD = 0.35
# Shorter movements are not made, metres.
SHORTEST = 0.002
# Nearer than this to the target the direction to it is not meaningful, metres.
NEAR = 0.05


def limited(movement: Movement, step: float, turn: float) -> Movement:
    """The same arc, no longer than ``step`` metres and ``turn`` radians."""
    share = min(1.0, step / max(movement.distance, 1e-12), turn / max(abs(movement.turn), 1e-12))
    return movement.scaled(share)


def omni_movement(state: FloatArray, target: FloatArray, step: float, turn: float) -> Movement:
    """The next movement of an omnidirectional drive.

    Args:
        state: ``(3,)`` where the robot is.
        target: ``(3,)`` where it is to go.
        step: longest translation, metres.
        turn: largest rotation, radians.
    """
    whole = movement_between(state, target)
    if abs(whole.turn) > ROTATE_FIRST:
        return Movement(turn=math.copysign(min(turn, abs(whole.turn)), whole.turn))
    # Rotation and translation are limited separately: each gets as far as it can.
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
        is_allowed: whether the robot may stand at a state ``(3,)``.
        sees: whether the camera sees enough of the scene at a state ``(3,)``.
        lost_views: rotations after which the robot was not localized; each makes the next rotation
            away from the goal smaller.
    """
    shares = VIEW_SHARES[min(lost_views, len(VIEW_SHARES) - 1) :]
    step = settings.largest_step
    heading = -yaw_between(state, target)
    remaining = movement_between(np.array([state[0], state[1], target[2]]), target)
    ahead, left = remaining.forward, remaining.left
    if remaining.distance < NEAR:
        return _rotation(-heading, settings)
    direction = 1.0 if ahead >= 0.0 else -1.0
    course = math.atan2(direction * left, direction * ahead)
    if abs(course) <= shares[0] * WIDEST_VIEW:
        return _drive(heading, course, direction * min(step, remaining.distance), settings)
    forwards, backwards = (
        _widest_seen(state, target, math.copysign(1.0, sign * left), sees, shares)
        for sign in (1, -1)
    )
    if forwards == backwards == 0.0:
        # The scene is in view on neither side: the narrowest diagonal.
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
    """The widest course on one side of the target's heading that keeps the scene in view.

    Args:
        state: ``(3,)`` where the robot is.
        target: ``(3,)`` where it is to go.
        sign: of the course: +1 left, -1 right.
        sees: whether the camera sees enough of the scene at a state ``(3,)``.
        shares: of ``WIDEST_VIEW``, the courses to try, widest first.

    Returns:
        The course from the target's heading, radians; 0 where none keeps the scene in view.
    """
    for share in shares:
        course = sign * share * WIDEST_VIEW
        if sees(np.array([state[0], state[1], target[2] + course])):
            return course
    return 0.0


def diff_movement_along(state: FloatArray, goal: FloatArray, settings: DockSettings) -> Movement:
    """The next movement of a differential drive from behind a goal along the goal's axis.

    Args:
        state: ``(3,)`` where the robot is.
        goal: ``(3,)`` where it is to go.
        settings: limits of one movement.
    """
    heading = -yaw_between(state, goal)
    remaining = movement_between(np.array([state[0], state[1], goal[2]]), goal)
    ahead, left = remaining.forward, remaining.left
    if ahead < max(settings.position_tolerance, abs(left)):
        # Too near for steering: rotate, then drive straight.
        if abs(heading) > settings.heading_tolerance:
            return _rotation(-heading, settings)
        return Movement(forward=ahead) if abs(ahead) > SHORTEST else STANDSTILL
    # Half of the way at most, so that steps become smaller as the goal comes nearer.
    step = min(settings.largest_step, max(0.5 * ahead, min(ahead, NEAR)))
    course = math.atan2(left, min(ahead, max(LOOK_AHEAD, step)))
    return _drive(heading, course, step, settings)


def movement_to_place(
    state: FloatArray, place: FloatArray, faced: FloatArray, settings: DockSettings
) -> Movement:
    """The next movement straight to a place, the camera ahead, without any heading there.

    Args:
        state: ``(3,)`` where the robot is.
        place: ``(2,)`` where it is to go, metres.
        faced: ``(2,)`` what an omnidirectional drive looks at on the way, metres.
        settings: limits of one movement.
    """
    offset = place - state[:2]
    course = math.atan2(offset[1], offset[0])
    if settings.drive == "diff":
        error = math.remainder(course - float(state[2]), 2.0 * math.pi)
        distance = min(settings.largest_step, float(np.hypot(*offset)))
        return _drive(0.0, error, distance, settings)
    heading = math.atan2(*(faced - state[:2])[::-1])
    target = np.array([*place, heading])
    return omni_movement(state, target, settings.largest_step, settings.largest_turn)


def nearing(distance: float, settings: DockSettings) -> float:
    """Length of the next step (metres) at a distance from the target: shorter near it."""
    return min(settings.largest_step, max(0.5 * distance, NEAR))


def _drive(heading: float, course: float, distance: float, settings: DockSettings) -> Movement:
    """An arc whose chord lies on a course, or a rotation on the spot towards that course.

    Args:
        heading: the robot's, from the goal's heading, radians.
        course: of the chord, from the goal's heading, radians.
        distance: length of the chord, metres; negative: backwards.
        settings: limits of one movement.
    """
    error = math.remainder(course - heading, 2.0 * math.pi)
    if abs(error) > LARGEST_STEERING:
        return _rotation(error, settings)
    return Movement(
        forward=distance * math.cos(error), left=distance * math.sin(error), turn=2.0 * error
    )


def _rotation(angle: float, settings: DockSettings) -> Movement:
    """A rotation on the spot by an angle (radians), as far as the settings let it go."""
    angle = math.remainder(angle, 2.0 * math.pi)
    return Movement(turn=math.copysign(min(abs(angle), settings.largest_turn), angle))


def _displaced(
    state: FloatArray, target: FloatArray, forward: float, left: float
) -> tuple[float, float]:
    """X and y of a state ``(3,)`` displaced along and across a target's heading, metres."""
    cosine, sine = math.cos(float(target[2])), math.sin(float(target[2]))
    return (
        float(state[0]) + forward * cosine - left * sine,
        float(state[1]) + forward * sine + left * cosine,
    )
