"""Which column of a table of poses is which, by the line that names them.

Programs write poses in many orders: TUM has the quaternion's w last, EuRoC first, others put the
quaternion before the position. Where a header names the columns, it decides.
"""

import re
from dataclasses import dataclass

COMMENT_MARKS = ("#", "%", "//")
# Seconds a unit of time, by the names that headers give them.
TIME_UNITS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millis", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "usec", "micros", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanosecond", "nanoseconds"), 1e-9),
}
_LENGTHS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0}
_POSITION = {"p", "t", "pos", "position", "trans", "translation", "location", "xyz"}
_QUATERNION = {"q", "quat", "quaternion", "orientation", "rot", "rotation"}
# What stands beside a pose and has axes too.
_OTHERS = {
    *("v", "vel", "velocity", "twist", "linear", "angular", "w", "omega", "a", "acc", "accel"),
    *("acceleration", "b", "bias", "g", "gyro", "cov", "covariance", "sigma", "std", "euler"),
}
_TIME = {"time", "timestamp", "timestamps", "stamp", "secs", "sec"}


@dataclass(frozen=True)
class PoseColumns:
    """The columns of a table of poses.

    Attributes:
        time: column of the time.
        position: columns of x, y, z.
        quaternion: columns of x, y, z, w.
        count: columns that the header names.
        seconds: how many a unit of time has; None where the header does not say.
        metres: how many a unit of length has.
    """

    time: int
    position: tuple[int, int, int]
    quaternion: tuple[int, int, int, int]
    count: int
    seconds: float | None = None
    metres: float = 1.0


TUM_COLUMNS = PoseColumns(0, (1, 2, 3), (4, 5, 6, 7), 8)


def cells_of(line: str) -> list[str]:
    """The cells of a line of numbers, between commas, semicolons or blanks; an empty one: none."""
    content = line.strip()
    return re.split(r"\s*[,;]\s*|\s+", content) if content else []


def columns_named_by(line: str) -> PoseColumns | None:
    """The columns that a header names; None where the line names no whole pose.

    Args:
        line: a line of the file, with or without its comment mark.
    """
    content = _names_in(line)
    mark = next((mark for mark in ",;\t" if mark in content), None)
    cells = content.rstrip(",; ").split(mark)
    found: dict[str, int] = {}
    for number, cell in enumerate(cells):
        kind = _kind_of(cell)
        if kind is not None:
            found.setdefault(kind, number)
    if not all(key in found for key in ("time", "px", "py", "pz", "qx", "qy", "qz", "qw")):
        return None
    return PoseColumns(
        time=found["time"],
        position=(found["px"], found["py"], found["pz"]),
        quaternion=(found["qx"], found["qy"], found["qz"], found["qw"]),
        count=len(cells),
        seconds=seconds_a_unit(cells[found["time"]]),
        metres=_LENGTHS.get(_unit_of(cells[found["px"]]), 1.0),
    )


def unit_of_first_column(line: str) -> float | None:
    """Seconds in the unit of time that a header names for its first column; None: it does not."""
    name = re.split(r"[,;\s]", _names_in(line))[0]
    return seconds_a_unit(name) if _kind_of(name) == "time" else None


def seconds_a_unit(name: str) -> float | None:
    """Seconds in the unit that the name of a column of times ends with; None: no unit."""
    words = _words(name)
    return TIME_UNITS.get(_unit_of(name)) or (TIME_UNITS.get(words[-1]) if words else None)


def _names_in(line: str) -> str:
    """A header without its comment mark, and without blanks between a name and its unit."""
    return re.sub(r"\s+([\[(])", r"\1", line.strip().lstrip("#%/").strip())


def _unit_of(cell: str) -> str:
    match = re.search(r"[\[(]\s*([a-z]*)\s*[\])]", cell.lower())
    return "" if match is None else match[1]


def _words(cell: str) -> list[str]:
    """The words of a name without its unit: ``p_RS_R_x [m]`` is p, rs, r, x."""
    return re.findall(r"[a-z]+", re.sub(r"[\[(].*", "", cell.lower()))


def _kind_of(cell: str) -> str | None:
    """``time``, ``px`` to ``pz``, ``qx`` to ``qw``; None: anything else."""
    words = _words(cell)
    if not words:
        return None
    if _TIME.intersection(words) or words in (["t"], ["timestampns"], ["timens"]):
        return "time"
    # p x, t x, px, tx, x; q x, qx.
    last = words[-1]
    compact = re.fullmatch(r"(p|t|q|pos|quat)?([wxyz])", last)
    if compact is None:
        return None
    before = {*words[:-1], *([compact[1]] if compact[1] else [])}
    if before & _QUATERNION:
        return f"q{compact[2]}"
    if before & _OTHERS or compact[2] == "w":
        return None
    is_position = bool(before & _POSITION) or len(words) == 1
    return f"p{compact[2]}" if is_position else None


def is_comment(line: str) -> bool:
    """Whether a line, stripped, is a comment."""
    return line.startswith(COMMENT_MARKS)


def is_header(line: str) -> bool:
    """Whether a line of several words holds no number, as one of names does."""
    cells = cells_of(line)
    return len(cells) > 1 and not any(
        re.match(r"[-+]?(nan$|inf|\.?[0-9])", cell.lower()) for cell in cells
    )
