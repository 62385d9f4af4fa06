"""``rgb.txt`` and ``depth.txt``: a time and the name of an image a line."""

import logging
import math
import re
from pathlib import Path, PurePosixPath

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, quoted
from pipelines.artifacts.file_content import is_file, read_text_file
from pipelines.geometry.pose_columns import cells_of, is_comment, is_header, unit_of_first_column
from pipelines.geometry.time_units import UNIT_NAMES, in_seconds, unit_of_times

MAX_LIST_BYTES = 64 * 1024**2

_log = logging.getLogger(__name__)


def read_image_list(root: Path, list_name: str) -> tuple[FloatArray, tuple[str, ...]]:
    """Reads ``rgb.txt`` or ``depth.txt``.

    A line is ``timestamp filename``, with a blank, a tab or a comma between. Times are seconds; the
    header may name another unit, and times that cannot be seconds are converted. An image may be
    named several times: a robot stands, or an image is shown again.

    Args:
        root: the data set.
        list_name: the file in it.

    Returns:
        Timestamps ``(N,)`` in seconds, and names of files that exist.

    Raises:
        InputError: unreadable, a line that is none of these, names that lead out of the folder or
            to nothing, or time that does not increase; the line is named.
    """
    path = root / list_name
    times: list[float] = []
    names: list[str] = []
    unit: float | None = None
    there: set[str] = set()
    for number, line in enumerate(read_text_file(path, MAX_LIST_BYTES).splitlines(), start=1):
        content = line.strip()
        if not content:
            continue
        if is_comment(content) or (not names and _is_names(content)):
            unit = unit or unit_of_first_column(content)
            continue
        try:
            time, name = _parse_entry(content)
        except ValueError as error:
            raise InputError(path, f"line {number}: {error}") from error
        if times and time <= times[-1]:
            raise InputError(
                path,
                f"line {number}: time {time:.6f} does not come after {times[-1]:.6f}",
                "sort the images by time and keep one for each",
            )
        if name not in there and not is_file(root / name):
            raise InputError(path, f"line {number}: {quoted(name)} is not there")
        there.add(name)
        times.append(time)
        names.append(name)
    if not names:
        raise InputError(path, "names no image")
    recorded = np.array(times, dtype=np.float64)
    if unit is None:
        unit = unit_of_times(recorded)
        if unit != 1.0:
            _log.warning("%s: times are taken for %s", path, UNIT_NAMES[unit])
    return in_seconds(recorded, unit), tuple(names)


def _is_names(line: str) -> bool:
    """Whether a line names the columns, and holds no entry."""
    return is_header(line) and re.match("time|stamp|t$", cells_of(line)[0].lower()) is not None


def _parse_entry(content: str) -> tuple[float, str]:
    """Timestamp and normalised file name; ValueError says what is wrong with them."""
    parts = re.split(r"\s*[,;]\s*|\s+", content, maxsplit=1)
    if len(parts) != 2:
        raise ValueError("not of the form: timestamp filename")
    try:
        time = float(parts[0])
    except ValueError:
        raise ValueError(f"{quoted(parts[0])} is not a timestamp") from None
    if not math.isfinite(time):
        raise ValueError(f"the timestamp {time} is not finite")
    name = PurePosixPath(parts[1])
    if not parts[1].isprintable():
        raise ValueError(f"{quoted(parts[1])} is not a file name")
    if name.is_absolute() or ".." in name.parts:
        raise ValueError(f"{quoted(parts[1])} leads out of the data set's folder")
    return time, str(name)
