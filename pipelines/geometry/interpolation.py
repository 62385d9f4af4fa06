"""Poses between those of a trajectory: a camera and odometry rarely tick together.

Between two poses the position goes along a straight line and the rotation along the shortest arc on
the sphere (Shoemake 1985), both evenly in time. How far off that is depends on how far apart the
two are: a robot that turns by 1 rad/s at 1 m/s leaves the chord of 0.2 s by 5 mm.
"""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arguments import checked_number
from pipelines.artifacts.arrays import BoolArray, FloatArray, checked_array
from pipelines.geometry.pose import pose_from_quaternion
from pipelines.geometry.trajectory import Trajectory

# Seconds between the two poses around a moment at most.
MAX_GAP = 0.2
# Half a frame at 25 Hz, the tolerance of the TUM benchmark's tools: a pose so near in time to an
# image counts as the pose of this image, whatever comes before and after.
PAIRING_TOLERANCE = 0.02
# Seconds by which gaps may be longer, since times since 1970 are rounded to a quarter of it.
_ROUNDING = 1e-6
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
    first, second = before[between], after[between]
    share = (timestamps[between] - times[first]) / gaps[between]
    poses[between] = _between(trajectory.poses[first], trajectory.poses[second], share)
    return PosesInTime(poses, is_known, offsets)


def _between(first: FloatArray, second: FloatArray, share: FloatArray) -> FloatArray:
    """Poses ``(N, 4, 4)`` at the shares ``(N,)`` of the ways from the first to the second."""
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
