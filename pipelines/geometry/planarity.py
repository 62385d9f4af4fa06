"""Checks whether poses can be those of a robot on a floor: it turns about z, at one height.

Each pose turns the body's axes into the world's. For a robot on a level floor one direction of the
body (its own up) always is one direction of the world (up): ``world_up = R_i @ body_up`` for every
rotation R_i. Both need not be z exactly. A sensor may be mounted at a tilt (body_up is not z), the
world may have been levelled badly at the start (world_up is not z), and both do no harm to a state
of x, y and heading. What cannot be is that no such pair of directions exists, or that it is far
from z. What the poses show beyond the pair is the wobble, and what the heights show is the climb.

Two levels. A contradiction is what no robot on a floor can show; it is refused. What is suspicious
may have a harmless cause; it is reported in a note. The limits:

* Wobble (95 % of the poses lie within): suspicious above 8 degrees, a contradiction above 15. The
  attitude of a wheeled robot with an inertial sensor is noisy by 1 to 3 degrees in roll and pitch.
  Noise of 3 degrees in both stays within 7.3 for 95 % of the poses (Rayleigh's distribution), so
  that it is not mentioned. The heading read from a pose that leans by 15 degrees is wrong by 1
  degree at most, since roll and pitch act on it in second order only.
* Constant lean: suspicious above 10 degrees, a contradiction above 45. It leaves increments as they
  are, so only a frame that is nearer to another one (a camera's, z down) is refused.
* Climb, between the lowest and the highest pose: suspicious above 10 cm and 0.5 % of the path (a
  street that falls by 0.7 degrees has 1.2 %), a contradiction above 30 cm and 10 %. An attitude
  that is wrong by 3 degrees makes a level path climb by 5 %, and one by 5 degrees 9 %, so a smaller
  share does not prove that the ground is not level. Ramps in buildings, up to 8 %, are only
  mentioned for the same reason.
"""

import math
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError
from pipelines.geometry.pose import pose_from_quaternion, quaternion_of

# Radians: wobble and constant lean that are noted, and that are refused.
NOTED_WOBBLE, REFUSED_WOBBLE = math.radians(8.0), math.radians(15.0)
NOTED_LEAN, REFUSED_LEAN = math.radians(10.0), math.radians(45.0)
# Metres and share of the path; both have to be exceeded.
NOTED_CLIMB, NOTED_SLOPE = 0.1, 0.005
REFUSED_CLIMB, REFUSED_SLOPE = 0.3, 0.1
# Share of the climb within which poses are as low as the lowest, or as high as the highest.
SAME_HEIGHT = 0.01
# Percentile of the wobble that counts, so that one bump is no uneven ground.
COUNTED_PERCENTILE = 95.0
# Least difference of the singular values: rotations of about 5 degrees determine their axis.
TELLING_ROTATIONS = 0.004
# Rotated so far about its y axis, radians, a robot would lie on its back; a camera looks elsewhere.
NO_PITCH = math.radians(60.0)
# A robot rarely moves along its own z; a camera that looks ahead nearly always does.
CAMERA_FORWARD_SHARE, SURE_FORWARD_SHARE = 0.7, 0.9
# Metres a second that no robot drives, but one whose millimetres are taken for metres.
FASTEST = 30.0
_NEAR_AXIS = math.cos(math.radians(45.0))
_Z = np.array([0.0, 0.0, 1.0])

TURNS_ABOUT_Y = "turns about its y axis"
HOW_TO_LEAVE_THE_FLOOR = "give --degrees-of-freedom 6 where the ground is not level"


class Cause(Enum):
    """Why poses are not those of a robot's base on a floor."""

    W_FIRST = "quaternions with w first"
    CAMERA = "poses of a camera"
    Z_DOWN = "z points down"
    UNEVEN = "leans or climbs"


@dataclass(frozen=True)
class Planarity:
    """How far poses are from those of a robot on a floor.

    Attributes:
        largest_lean: largest angle of the body's z axis against the world's z axis, radians.
        constant_lean: angle against z of the best pair body_up and world_up, radians.
        wobble: angle from this pair within which 95 % of the poses lie, radians.
        climb: difference between the lowest and the highest pose, metres.
        climb_path: the shortest path between poses that are as low and as high, metres.
    """

    largest_lean: float
    constant_lean: float
    wobble: float
    climb: float
    climb_path: float

    @property
    def climbs(self) -> bool:
        """Whether the change of height is worth mentioning."""
        return self.climb > max(NOTED_CLIMB, NOTED_SLOPE * self.climb_path)

    @property
    def leans(self) -> bool:
        """Whether the tilt is worth mentioning."""
        return self.wobble > NOTED_WOBBLE or self.constant_lean > NOTED_LEAN

    @property
    def is_suspicious(self) -> bool:
        """Whether a note is due."""
        return self.leans or self.climbs

    @property
    def is_contradiction(self) -> bool:
        """Whether no robot on a floor can have these poses."""
        return (
            self.wobble > REFUSED_WOBBLE
            or self.constant_lean > REFUSED_LEAN
            or self.climb > max(REFUSED_CLIMB, REFUSED_SLOPE * self.climb_path)
        )

    def text(self) -> str:
        """Lean and climb, where worth mentioning, for people."""
        parts = []
        if self.leans:
            parts.append(f"leans by up to {math.degrees(self.largest_lean):.0f} degrees")
        if self.climbs:
            parts.append(f"changes its height by {self.climb:.2f} m over {self.climb_path:.1f} m")
        return " and ".join(parts)


def planarity_of(poses: FloatArray) -> Planarity:
    """Measures lean and climb of ``world_from_body``, ``(N, 4, 4)``, N at least 1.

    Poses that are all equal, or that never turn, are as planar as their constant lean is small.
    """
    rotations, positions = poses[:, :3, :3], poses[:, :3, 3]
    # Either the world is level and the body is mounted at a tilt, or the other way round.
    pairs = [(_unit(rotations[:, 2, :].mean(axis=0)), _Z), (_Z, _unit(rotations[:, :, 2].mean(0)))]
    body_up, world_up = min(pairs, key=lambda pair: _wobble(rotations, *pair))
    if _wobble(rotations, body_up, world_up) > NOTED_WOBBLE:
        # Both at once: odometry that began at the identity of a sensor at a tilt.
        body_axis, world_axis, _ = _turning_axis(rotations)
        sign = 1.0 if body_axis[2] >= 0.0 else -1.0
        if sign * body_axis[2] > _NEAR_AXIS and sign * world_axis[2] > _NEAR_AXIS:
            body_up, world_up = sign * body_axis, sign * world_axis
    return Planarity(
        largest_lean=float(_angle(rotations[:, 2, 2]).max()),
        constant_lean=float(_angle(np.array([body_up[2], world_up[2]])).max()),
        wobble=_wobble(rotations, body_up, world_up),
        climb=float(np.ptp(positions[:, 2])),
        climb_path=_climb_path(positions),
    )


def _climb_path(positions: FloatArray) -> float:
    """The shortest path (metres) along ``(N, 3)`` from the bottom to the top or back."""
    heights = positions[:, 2]
    band = SAME_HEIGHT * float(np.ptp(heights))
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    lowest, highest = way[heights <= heights.min() + band], way[heights >= heights.max() - band]
    after = np.minimum(np.searchsorted(highest, lowest), len(highest) - 1)
    before = np.maximum(after - 1, 0)
    distances = np.minimum(np.abs(highest[after] - lowest), np.abs(highest[before] - lowest))
    return float(distances.min())


def cause_of(poses: FloatArray) -> Cause:
    """The likeliest reason why ``world_from_body``, ``(N, 4, 4)``, is not a robot's on a floor."""
    signs = _camera_signs(poses)
    if signs.are_sure:
        return Cause.CAMERA
    other = planarity_of(_read_with_w_first(poses))
    # Not leaning at all: a camera that never turns may lean little when its numbers are moved on.
    if not (other.leans or other.is_contradiction):
        return Cause.W_FIRST
    if signs.first is not None:
        return Cause.CAMERA
    if float(np.median(poses[:, 2, 2])) < -_NEAR_AXIS:
        return Cause.Z_DOWN
    return Cause.UNEVEN


def camera_sign_of(poses: FloatArray) -> str | None:
    """What about poses ``(N, 4, 4)`` is a camera's (y down, z forward) and no robot's; or None."""
    return _camera_signs(poses).first


@dataclass(frozen=True)
class _CameraSigns:
    """What about poses is a camera's (y down, z forward) and no robot's.

    Attributes:
        turns_about_y: whether it rotates about its y axis.
        is_y_down: its y axis points down in the world.
        ahead: share of the way that goes along its z axis, 0 to 1.
    """

    turns_about_y: bool
    is_y_down: bool
    ahead: float

    @property
    def first(self) -> str | None:
        """The surest of them in words; None where there is none."""
        if self.turns_about_y:
            return TURNS_ABOUT_Y
        if self.is_y_down:
            return "has its y axis down"
        return "moves along its z axis" if self.ahead > CAMERA_FORWARD_SHARE else None

    @property
    def are_sure(self) -> bool:
        """Whether they outweigh that quaternions with w first would fit a robot too.

        Of robots whose quaternions have w first, one in twenty seems to have its y axis down, but
        none of those moves along its z axis as a camera does.
        """
        return self.turns_about_y or (self.is_y_down and self.ahead > SURE_FORWARD_SHARE)


def _camera_signs(poses: FloatArray) -> _CameraSigns:
    rotations = poses[:, :3, :3]
    steps = np.einsum("nij,ni->nj", rotations[:-1], np.diff(poses[:, :3, 3], axis=0))
    along_x, _, along_z = np.abs(steps).sum(axis=0).tolist()
    turned = float(_angle(np.einsum("nij,ij->n", rotations, rotations[0]) / 2.0 - 0.5).max())
    body_axis, world_axis, gap = _turning_axis(rotations)
    is_y = abs(body_axis[1]) > _NEAR_AXIS
    is_axis = (
        gap > TELLING_ROTATIONS and _wobble(rotations, body_axis, world_axis) <= REFUSED_WOBBLE
    )
    # A robot pitches about its y axis on a ramp, but it moves along x there.
    is_no_pitch = along_z > along_x or turned > NO_PITCH
    way = float(np.linalg.norm(steps, axis=1).sum())
    return _CameraSigns(
        turns_about_y=is_y and is_axis and is_no_pitch,
        is_y_down=bool(_unit(rotations[:, 2, :].mean(axis=0))[1] < -_NEAR_AXIS),
        ahead=along_z / way if way > 0.0 else 0.0,
    )


def check_planar(
    poses: FloatArray, source: Path | str, way_out: str = HOW_TO_LEAVE_THE_FLOOR
) -> str | None:
    """Refuses poses that no robot on a floor can have.

    Args:
        poses: ``(N, 4, 4)`` world_from_base, at least one.
        source: their file, for the error and the note.
        way_out: what to do where the ground really is not level.

    Returns:
        A line on what is suspicious; None where nothing is.

    Raises:
        InputError: the poses contradict a robot on a floor; the likely cause is named.
    """
    found = planarity_of(poses)
    if not found.is_suspicious:
        return None
    if not found.is_contradiction:
        return f"{source}: the robot {found.text()}, a robot on a floor does not; {way_out}"
    cause = cause_of(poses)
    if cause is Cause.W_FIRST:
        raise _w_first_error(found, source)
    if cause is Cause.CAMERA:
        raise InputError(
            source,
            f"seems to be of a camera and not of the robot's base: it {camera_sign_of(poses)}",
            "a base has x forward, y left, z up; give its poses, or --degrees-of-freedom 6 without "
            "[mount] for a camera that moves freely",
        )
    if cause is Cause.Z_DOWN:
        raise InputError(
            source, "its z axis points down", "a robot's base has x forward, y left, z up"
        )
    raise InputError(source, f"is not of a robot on a floor: it {found.text()}", way_out)


def check_quaternion_order(poses: FloatArray, source: Path | str) -> None:
    """Refuses a robot's poses ``(N, 4, 4)`` that have w first, where it may leave the floor too.

    Raises:
        InputError: as read, it cannot be on a floor, and with w first it does not lean.
    """
    found = planarity_of(poses)
    if found.is_contradiction and cause_of(poses) is Cause.W_FIRST:
        raise _w_first_error(found, source)


def note_on_speed(timestamps: FloatArray, positions: FloatArray) -> str | None:
    """Whether positions ``(N, 3)`` at times ``(N,)`` (seconds) look like millimetres, in words."""
    if len(timestamps) < 2:
        return None
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    speed = float(np.sum(steps) / (timestamps[-1] - timestamps[0]))
    if speed < FASTEST:
        return None
    return f"moves by {speed:.0f} m a second: are these millimetres? lfnav reads metres"


def _w_first_error(found: Planarity, source: Path | str) -> InputError:
    return InputError(
        source,
        f"its quaternions look as if w came first (as read, the robot {found.text()})",
        "lfnav reads tx ty tz qx qy qz qw",
    )


def _read_with_w_first(poses: FloatArray) -> FloatArray:
    """The poses had the four numbers of their quaternions been read as w, x, y, z."""
    return pose_from_quaternion(poses[:, :3, 3], np.roll(quaternion_of(poses), -1, axis=-1))


def _turning_axis(rotations: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """The axis in the body and in the world about which ``(N, 3, 3)`` turn, and how clear it is.

    The pair of unit vectors b, w with the largest mean of w . R_i b are the first singular vectors
    of the mean of R_i. The second singular value is as large where nothing turns.
    """
    left, values, right = np.linalg.svd(rotations.mean(axis=0))
    return right[0], left[:, 0], float(values[0] - values[1])


def _wobble(rotations: FloatArray, body_up: FloatArray, world_up: FloatArray) -> float:
    """Angle (radians) between R_i body_up and world_up that few rotations exceed."""
    angles = _angle(rotations @ body_up @ world_up)
    return float(np.percentile(angles, COUNTED_PERCENTILE))


def _angle(cosines: FloatArray) -> FloatArray:
    return np.asarray(np.arccos(np.clip(cosines, -1.0, 1.0)), dtype=np.float64)


def _unit(vector: FloatArray) -> FloatArray:
    """The direction of a mean; z where the directions cancel, and then all is far from it."""
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-9 else _Z
