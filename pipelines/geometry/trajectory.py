"""Timed poses: the TUM text format, association by time, increments.

The TUM format is a line ``timestamp tx ty tz qx qy qz qw`` a pose, ``#`` starting a comment; see
the TUM RGB-D benchmark (Sturm et al. 2012).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipelines.artifacts.arguments import PathLike, checked_number, checked_path
from pipelines.artifacts.arrays import FloatArray, IntArray, checked_array
from pipelines.artifacts.errors import InputError, reason_of
from pipelines.artifacts.file_content import read_text_file
from pipelines.geometry.pose import inverse, pose_from_quaternion, quaternion_of

# A quaternion written with six decimals is a unit to about 1e-6; this allows for two decimals.
QUATERNION_TOLERANCE = 0.02
MAX_TRAJECTORY_BYTES = 256 * 1024 * 1024


@dataclass(frozen=True)
class Trajectory:
    """Poses over time.

    Attributes:
        timestamps: ``(N,)`` seconds, strictly increasing.
        poses: ``(N, 4, 4)`` world_from_body, metres.

    Raises:
        OptionError: other shapes, or numbers that are not finite.
    """

    timestamps: FloatArray
    poses: FloatArray

    def __post_init__(self) -> None:
        times = checked_array(self.timestamps, "timestamps", (None,))
        checked_array(self.poses, "poses", (len(times), 4, 4))

    def __len__(self) -> int:
        return len(self.timestamps)

    def nearest(self, timestamps: FloatArray, tolerance: float) -> IntArray:
        """The poses nearest in time to others' times.

        Args:
            timestamps: ``(M,)`` seconds.
            tolerance: seconds between a time and its pose at most.

        Returns:
            ``(M,)`` indices; -1 where no pose lies within the tolerance.

        Raises:
            OptionError: no array of this shape, or a tolerance that is negative.
        """
        timestamps = checked_array(timestamps, "timestamps", (None,))
        checked_number(tolerance, "tolerance", 0.0)
        if len(self) == 0:
            return np.full(len(timestamps), -1, dtype=np.int64)
        right = np.clip(np.searchsorted(self.timestamps, timestamps), 1, max(1, len(self) - 1))
        right = np.minimum(right, len(self) - 1)
        left = np.maximum(right - 1, 0)
        left_is_nearer = np.abs(self.timestamps[left] - timestamps) <= np.abs(
            self.timestamps[right] - timestamps
        )
        nearest = np.where(left_is_nearer, left, right)
        within = np.abs(self.timestamps[nearest] - timestamps) <= tolerance
        return np.where(within, nearest, -1).astype(np.int64)

    def increments(self) -> FloatArray:
        """``(N - 1, 4, 4)`` body_from_next_body: the motion from each pose to the next."""
        return np.asarray(inverse(self.poses[:-1]) @ self.poses[1:], dtype=np.float64)


def read_tum(path: PathLike) -> Trajectory:
    """Reads a trajectory in the TUM format (Sturm et al. 2012).

    Args:
        path: a text file; a line ``timestamp tx ty tz qx qy qz qw`` a pose: seconds, metres, a unit
            quaternion.

    Raises:
        OptionError: ``path`` is no path.
        InputError: unreadable, not eight numbers a line, values that are not finite, quaternions
            that are not of unit length, or time that does not increase; the line is named.
    """
    path = checked_path(path, "the trajectory's path")
    lines = read_text_file(path, MAX_TRAJECTORY_BYTES).splitlines()
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        content = line.split("#", 1)[0].replace(",", " ").split()
        if not content:
            continue
        rows.append(_parse_row(path, number, content))
        if len(rows) > 1 and rows[-1][0] <= rows[-2][0]:
            raise InputError(
                path,
                f"line {number}: time {rows[-1][0]:.6f} does not come after {rows[-2][0]:.6f}",
                "sort the poses by time and keep one for each",
            )
    if not rows:
        raise InputError(path, "holds no pose")
    table = np.array(rows)
    quaternions = table[:, 4:8] / np.linalg.norm(table[:, 4:8], axis=1, keepdims=True)
    return Trajectory(table[:, 0], pose_from_quaternion(table[:, 1:4], quaternions))


def _parse_row(path: Path, number: int, content: list[str]) -> list[float]:
    if len(content) != 8:
        raise InputError(
            path,
            f"line {number}: {len(content)} values instead of 8",
            "write: timestamp tx ty tz qx qy qz qw",
        )
    try:
        values = [float(value) for value in content]
    except ValueError as error:
        raise InputError(path, f"line {number}: not a number ({reason_of(error)})") from error
    if not np.all(np.isfinite(values)):
        raise InputError(path, f"line {number}: a value is not finite (nan or inf)")
    length = float(np.linalg.norm(values[4:8]))
    if abs(length - 1.0) > QUATERNION_TOLERANCE:
        raise InputError(
            path,
            f"line {number}: the quaternion has length {length:.4f} instead of 1",
            "the order is qx qy qz qw",
        )
    return values


def format_tum(trajectory: Trajectory) -> str:
    """The trajectory as TUM text, with a comment line that names the columns."""
    quaternions = quaternion_of(trajectory.poses)
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    for time, pose, quaternion in zip(
        trajectory.timestamps, trajectory.poses, quaternions, strict=True
    ):
        values = " ".join(f"{value:.9f}" for value in (*pose[:3, 3], *quaternion))
        lines.append(f"{time:.9f} {values}")
    return "\n".join(lines) + "\n"
