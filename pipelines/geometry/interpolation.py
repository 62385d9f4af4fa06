"""Poses between those of a trajectory: a camera and odometry rarely tick together.

Between two poses the position goes along a straight line and the rotation along the shortest arc on
the sphere (Shoemake 1985), both evenly in time. How far off that is depends on how far apart the
two are: a robot that turns by 1 rad/s at 1 m/s leaves the chord of 0.2 s by 5 mm.

A robot may also stop, start or turn back between two poses, at once as seen at their rate. Where it
moved straight and evenly on both sides, and the two lines meet in between, it follows them to where
they meet: the chord would cut the corner, by centimetres at 1 m/s and 30 Hz.
"""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arguments import checked_number
from pipelines.artifacts.arrays import BoolArray, FloatArray, IntArray, checked_array
from pipelines.geometry.pose import pose_from_quaternion
from pipelines.geometry.trajectory import Trajectory

# Seconds between the two poses around a moment at most.
MAX_GAP = 0.2
# Half a frame at 25 Hz, the tolerance of the TUM benchmark's tools: a pose so near in time to an
# image counts as the pose of this image, whatever comes before and after.
PAIRING_TOLERANCE = 0.02
# Seconds by which gaps may be longer, since times since 1970 are rounded to a quarter of it.
_ROUNDING = 1e-6
# Metres, four times what the chord of a corner is at least off; and the share of the change of
# speed by which the motion on both sides may be uneven, or the lines miss each other.
CUT_CORNER, EVEN = 0.004, 0.02
# Half angles, radians, below which an arc is as straight as a chord.
_STRAIGHT = 1e-9


@dataclass(frozen=True)
class PosesInTime:
    """Poses at given moments.

    Attributes:
        poses: ``(M, 4, 4)`` world_from_body; NaN where none is known.
        is_known: ``(M,)``.
        offsets: ``(M,)`` seconds to the nearest pose of the trajectory; infinite where it is empty.
    """

    poses: FloatArray
    is_known: BoolArray
    offsets: FloatArray


def poses_at_times(
    trajectory: Trajectory,
    timestamps: FloatArray,
    max_gap: float = MAX_GAP,
    tolerance: float = PAIRING_TOLERANCE,
) -> PosesInTime:
    """The poses of a trajectory at other moments than its own, interpolated.

    A moment has a pose where the poses before and after it are at most ``max_gap`` apart, or where
    one of all poses is at most ``tolerance`` away. Before the first pose and behind the last one
    that is this pose. At the very time of a pose the result is this pose, to the bit.

    Args:
        trajectory: the poses, at any rate.
        timestamps: ``(M,)`` seconds, in any order.
        max_gap: seconds between two poses at most.
        tolerance: seconds between a moment and a pose that is near enough by itself.

    Raises:
        OptionError: no array of this shape, or a number that is negative.
    """
    timestamps = checked_array(timestamps, "timestamps", (None,))
    checked_number(max_gap, "the longest gap", 0.0)
    checked_number(tolerance, "tolerance", 0.0)
    count, times = len(timestamps), trajectory.timestamps
    poses = np.full((count, 4, 4), np.nan)
    if len(trajectory) == 0:
        return PosesInTime(poses, np.zeros(count, dtype=np.bool_), np.full(count, np.inf))
    after = np.clip(np.searchsorted(times, timestamps), 0, len(times) - 1)
    before = np.where(times[after] > timestamps, np.maximum(after - 1, 0), after)
    offsets = np.minimum(np.abs(times[before] - timestamps), np.abs(times[after] - timestamps))
    inside = (times[0] <= timestamps) & (timestamps <= times[-1])
    gaps = times[after] - times[before]
    is_known = (inside & (gaps <= max_gap + _ROUNDING)) | (offsets <= tolerance)
    between = is_known & (gaps > 0.0)
    exact = is_known & ~between
    poses[exact] = trajectory.poses[after[exact]]
    first = before[between]
    share = (timestamps[between] - times[first]) / gaps[between]
    start, end, share = _around_corners(trajectory, first, share, max_gap + _ROUNDING)
    poses[between] = poses_between(trajectory.poses[start], trajectory.poses[end], share)
    return PosesInTime(poses, is_known, offsets)


def _around_corners(
    trajectory: Trajectory, first: IntArray, share: FloatArray, max_gap: float
) -> tuple[IntArray, IntArray, FloatArray]:
    """Which two poses to go by, and the shares of the ways between them.

    Args:
        trajectory: the poses.
        first: ``(N,)`` the poses before the moments; the ones after them are the next.
        share: ``(N,)`` where the moments are between the two.
        max_gap: seconds between two poses that belong together.

    Returns:
        ``(N,)`` each: the two around a moment; at a corner the two before it or the two behind it,
        with a share beyond 1 or below 0.
    """
    start, end, share = first.copy(), first + 1, share.copy()
    if len(first) == 0:
        return start, end, share
    # Before the first pose and behind the last one the robot is taken to stand.
    positions = np.pad(trajectory.poses[:, :3, 3], ((2, 2), (0, 0)), mode="edge")
    steps = np.pad(np.diff(trajectory.timestamps), 2, mode="edge")
    rows = np.flatnonzero(np.all(steps[first[:, None] + np.arange(5)] <= max_gap, axis=1))
    at = first[rows] + 2
    speeds = np.diff(positions, axis=0) / steps[:, None]
    before, after = speeds[at - 1], speeds[at + 1]
    change = after - before
    size = np.linalg.norm(change, axis=1)
    uneven = np.linalg.norm(before - speeds[at - 2], axis=1)
    uneven += np.linalg.norm(speeds[at + 2] - after, axis=1)
    # Where the two lines meet: before * t = chord - after * (step - t).
    missing = positions[at + 1] - positions[at] - after * steps[at, None]
    meets = -np.sum(missing * change, axis=1) / np.maximum(size, 1e-9) ** 2
    apart = np.linalg.norm(missing + change * meets[:, None], axis=1)
    is_corner = (
        (size * steps[at] > CUT_CORNER)
        & (uneven <= EVEN * size)
        & (apart <= EVEN * size * steps[at])
        & (meets >= 0.0)
        & (meets <= steps[at])
    )
    moment = share[rows] * steps[at]
    earlier, later = is_corner & (moment <= meets), is_corner & (moment > meets)
    last = len(trajectory) - 1
    own = first[rows]
    start[rows[earlier]], end[rows[earlier]] = np.maximum(own[earlier] - 1, 0), own[earlier]
    share[rows[earlier]] = 1.0 + moment[earlier] / steps[at[earlier] - 1]
    start[rows[later]], end[rows[later]] = own[later] + 1, np.minimum(own[later] + 2, last)
    share[rows[later]] = (moment[later] - steps[at[later]]) / steps[at[later] + 1]
    return start, end, share


def poses_between(first: FloatArray, second: FloatArray, share: FloatArray) -> FloatArray:
    """Poses at shares of the ways from one to another: straight lines, shortest arcs.

    Args:
        first: ``(N, 4, 4)``.
        second: ``(N, 4, 4)``.
        share: ``(N,)``, 0 at the first and 1 at the second; beyond them they go on as they went.
    """
    weight = share[:, None]
    positions = first[:, :3, 3] * (1.0 - weight) + second[:, :3, 3] * weight
    start, end = _quaternions(first[:, :3, :3]), _quaternions(second[:, :3, :3])
    # Two quaternions of opposite sign are one rotation: the shorter arc is taken.
    end = np.where(np.sum(start * end, axis=1, keepdims=True) < 0.0, -end, end)
    apart = np.linalg.norm(end - start, axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(apart, np.linalg.norm(end + start, axis=1, keepdims=True))
    bent = angle > _STRAIGHT
    sine = np.sin(np.where(bent, angle, 1.0))
    start_weight = np.where(bent, np.sin((1.0 - weight) * angle) / sine, 1.0 - weight)
    end_weight = np.where(bent, np.sin(weight * angle) / sine, weight)
    return pose_from_quaternion(positions, start_weight * start + end_weight * end)


def _quaternions(rotations: FloatArray) -> FloatArray:
    """Unit quaternions ``(N, 4)``, scalar last, of ``(N, 3, 3)``.

    Without SciPy, which takes 0.2 s to load. All rows of the symmetric matrix 4 q q^T are multiples
    of q; the longest has the largest element on the diagonal.
    """
    m = np.moveaxis(rotations, 0, -1)
    rows = [
        [
            1.0 + m[0, 0] - m[1, 1] - m[2, 2],
            m[0, 1] + m[1, 0],
            m[0, 2] + m[2, 0],
            m[2, 1] - m[1, 2],
        ],
        [
            m[0, 1] + m[1, 0],
            1.0 - m[0, 0] + m[1, 1] - m[2, 2],
            m[1, 2] + m[2, 1],
            m[0, 2] - m[2, 0],
        ],
        [
            m[0, 2] + m[2, 0],
            m[1, 2] + m[2, 1],
            1.0 - m[0, 0] - m[1, 1] + m[2, 2],
            m[1, 0] - m[0, 1],
        ],
        [
            m[2, 1] - m[1, 2],
            m[0, 2] - m[2, 0],
            m[1, 0] - m[0, 1],
            1.0 + m[0, 0] + m[1, 1] + m[2, 2],
        ],
    ]
    products = np.array(rows)
    longest = np.argmax(np.einsum("iin->in", products), axis=0)
    quaternions = products[longest, :, np.arange(len(rotations))]
    return np.asarray(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))
