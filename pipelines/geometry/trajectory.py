"""Timed poses: the TUM text format, association by time, increments.

The TUM format is a line ``timestamp tx ty tz qx qy qz qw`` a pose, ``#`` starting a comment; see
the TUM RGB-D benchmark (Sturm et al. 2012).
"""

import logging
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipelines.artifacts.arguments import PathLike, checked_number, checked_path
from pipelines.artifacts.arrays import FloatArray, IntArray, checked_array
from pipelines.artifacts.errors import InputError, quoted
from pipelines.artifacts.file_content import read_text_file
from pipelines.geometry.pose import inverse, pose_from_quaternion, quaternion_of
from pipelines.geometry.pose_columns import (
    TUM_COLUMNS,
    PoseColumns,
    cells_of,
    columns_named_by,
    is_comment,
    is_header,
)
from pipelines.geometry.time_units import UNIT_NAMES, in_seconds, unit_of_times

# A quaternion written with six decimals is a unit to about 1e-6; this allows for two decimals.
QUATERNION_TOLERANCE = 0.02
MAX_TRAJECTORY_BYTES = 256 * 1024 * 1024
# Places that are named where lines hold no pose.
SHOWN_RUNS = 5

_log = logging.getLogger(__name__)


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
    """Reads a trajectory in the TUM format (Sturm et al. 2012), or one whose header says how.

    A line that names the columns, comment or not, decides on their order and units: EuRoC's
    ``data.csv`` is read as it is. Values stand between blanks, commas, semicolons or tabs. Times
    that cannot be seconds are converted. A line without a pose (NaN, a quaternion of zeros) is a
    gap: nothing is known there.

    Args:
        path: a text file; a line ``timestamp tx ty tz qx qy qz qw`` a pose: seconds, metres, a unit
            quaternion.

    Raises:
        OptionError: ``path`` is no path.
        InputError: unreadable, not eight numbers a line, quaternions that are not of unit length,
            time that does not increase, or no pose at all; the line is named.
    """
    path = checked_path(path, "the trajectory's path")
    columns = TUM_COLUMNS
    rows: list[list[float]] = []
    numbers: list[int] = []
    gaps: list[int] = []
    last = -math.inf
    for number, line in enumerate(read_text_file(path, MAX_TRAJECTORY_BYTES).splitlines(), start=1):
        content = line.strip()
        is_first = not rows and not gaps
        if is_comment(content) or (is_first and is_header(content)):
            columns = (columns_named_by(content) if is_first else None) or columns
            continue
        cells = cells_of(content.split("#", 1)[0])
        if not cells:
            continue
        row = _parse_row(path, number, cells, columns)
        if _holds_no_pose(row):
            gaps.append(number)
            continue
        if row[0] <= last:
            raise InputError(
                path,
                f"line {number}: time {row[0]:.6f} does not come after {last:.6f}",
                "sort the poses by time and keep one for each",
            )
        last = row[0]
        rows.append(row)
        numbers.append(number)
    if not rows:
        raise InputError(path, "holds no pose" + (f" in {len(gaps)} lines" if gaps else ""))
    if gaps:
        _log.warning("%s: without a pose, and so a gap: %s", path, _lines_text(gaps))
    table = np.array(rows)
    _check_lengths(path, table, numbers)
    unit = columns.seconds
    if unit is None:
        unit = unit_of_times(table[:, 0])
        if unit != 1.0:
            _log.warning("%s: times are taken for %s", path, UNIT_NAMES[unit])
    quaternions = table[:, 4:8] / np.linalg.norm(table[:, 4:8], axis=1, keepdims=True)
    return Trajectory(
        in_seconds(table[:, 0], unit),
        pose_from_quaternion(table[:, 1:4] * columns.metres, quaternions),
    )


def _parse_row(path: Path, number: int, cells: list[str], columns: PoseColumns) -> list[float]:
    """Time, position and quaternion (scalar last) of a line, as they stand there."""
    while len(cells) > columns.count and not cells[-1]:
        cells = cells[:-1]
    if len(cells) != columns.count:
        remedy = "write: timestamp tx ty tz qx qy qz qw"
        if columns == TUM_COLUMNS and len(cells) in (12, 16):
            remedy = f"these may be matrices without times; {remedy}"
        elif columns == TUM_COLUMNS and len(cells) > columns.count:
            remedy = f"or begin with a line that names the columns; {remedy}"
        raise InputError(
            path, f"line {number}: {len(cells)} values instead of {columns.count}", remedy
        )
    values = []
    for column in (columns.time, *columns.position, *columns.quaternion):
        try:
            values.append(float(cells[column] or "nan"))
        except ValueError:
            reason = f"line {number}: {quoted(cells[column])} is not a number"
            raise InputError(path, reason) from None
    return values


def _holds_no_pose(row: list[float]) -> bool:
    """Whether a program wrote the line though it knew no pose: not finite, or no rotation."""
    return not all(map(math.isfinite, row)) or not any(row[4:8])


def _lines_text(numbers: list[int]) -> str:
    """Numbers of lines, those in a row as from-to, the first few of them."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    shown = [f"{first}" if first == last else f"{first} to {last}" for first, last in runs]
    more = f" and {len(shown) - SHOWN_RUNS} more places" if len(shown) > SHOWN_RUNS else ""
    return f"line{'s' * (len(numbers) > 1)} {', '.join(shown[:SHOWN_RUNS])}{more}"


def _check_lengths(path: Path, table: FloatArray, numbers: list[int]) -> None:
    """Refuses quaternions that are no units; names another order in which they would be."""
    off = np.abs(np.linalg.norm(table[:, 4:8], axis=1) - 1.0) > QUATERNION_TOLERANCE
    if not np.any(off):
        return
    first = int(np.argmax(off))
    remedy = "the order is tx ty tz qx qy qz qw"
    others = np.abs(np.linalg.norm(table[:, 1:5], axis=1) - 1.0) <= QUATERNION_TOLERANCE
    if len(table) > 1 and np.all(others):
        remedy = f"{remedy}; here the first four after the time have length 1"
    raise InputError(
        path,
        f"line {numbers[first]}: the quaternion has length "
        f"{float(np.linalg.norm(table[first, 4:8])):.4f} instead of 1",
        remedy,
    )


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
