"""``areas.toml``: the areas of a world as rectangles with names, and the doorways between them.

```
[[area]]
name = "kitchen"
xmin = 6.12
xmax = 11.10
ymin = 1.20
ymax = 5.98

[[doorway]]                        # optional
areas = ["kitchen", "corridor"]
x = 8.20
y = 6.04
width = 0.95
```

Metres in world coordinates. Where the file has doorways, no path leads from one area to another
but through one of them.
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipelines.artifacts.errors import InputError, quoted
from pipelines.artifacts.toml_file import read_toml, type_name

# A name becomes that of a file, on any system: Windows keeps some for devices.
MAX_NAME = 64
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
_DEVICES = re.compile(r"(?i)con|prn|aux|nul|com[0-9]|lpt[0-9]")
_AREA_KEYS = ("name", "xmin", "xmax", "ymin", "ymax")
_DOORWAY_KEYS = ("areas", "x", "y", "width")


@dataclass(frozen=True)
class Rectangle:
    """An area as it was drawn.

    Attributes:
        name: letters, digits, ``_`` and ``-``.
        bounds: x_min, x_max, y_min, y_max, metres.
    """

    name: str
    bounds: tuple[float, float, float, float]


@dataclass(frozen=True)
class Doorway:
    """Where one area can be left for another.

    Attributes:
        areas: their names.
        x: of its middle, metres.
        y: likewise.
        width: metres.
    """

    areas: tuple[str, str]
    x: float
    y: float
    width: float


@dataclass(frozen=True)
class AreaFile:
    """The content of an ``areas.toml``.

    Attributes:
        path: the file, for errors.
        rectangles: at least one.
        doorways: may be empty: then nothing is known of them.
    """

    path: Path
    rectangles: tuple[Rectangle, ...]
    doorways: tuple[Doorway, ...]


def read_area_file(path: Path) -> AreaFile:
    """Reads and checks an ``areas.toml``.

    Raises:
        InputError: unreadable, not TOML, a key missing, unknown or of the wrong type, no area, a
            name that is no file name or is there twice, a rectangle that encloses nothing, a
            doorway between areas that there are not.
    """
    table = read_toml(path)
    for key in table:
        if key not in ("area", "doorway"):
            raise InputError(path, f"unknown key {quoted(key)}", "known are area, doorway")
    rectangles = [_rectangle(path, row, place) for row, place in _rows(path, table, "area")]
    if not rectangles:
        raise InputError(path, "holds no area", "write [[area]] and its keys below")
    seen: dict[str, str] = {}
    for rectangle in rectangles:
        # Some file systems hold no two names that differ in case alone.
        folded = rectangle.name.casefold()
        if folded in seen:
            raise InputError(path, f"two areas are called {quoted(rectangle.name)}")
        seen[folded] = rectangle.name
    names = {rectangle.name for rectangle in rectangles}
    doorways = [_doorway(path, row, place, names) for row, place in _rows(path, table, "doorway")]
    return AreaFile(path, tuple(rectangles), tuple(doorways))


def is_area_name(name: str) -> bool:
    """Whether an area may be called so: the name becomes that of a file."""
    fits = len(name) <= MAX_NAME and _NAME.fullmatch(name) is not None
    return fits and _DEVICES.fullmatch(name) is None


def _rows(path: Path, table: dict[str, Any], key: str) -> list[tuple[dict[str, Any], str]]:
    """The tables of an array, and what errors call each."""
    rows = table.get(key, [])
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(path, f"{key} is not a list of tables", f"write [[{key}]]")
    return [(row, f"{key} {number}") for number, row in enumerate(rows, 1)]


def _rectangle(path: Path, row: dict[str, Any], place: str) -> Rectangle:
    _check_keys(path, row, place, _AREA_KEYS)
    name = row["name"]
    if not isinstance(name, str) or not is_area_name(name):
        raise InputError(
            path,
            f"{place}: name {quoted(name)} cannot be that of a file",
            f"use at most {MAX_NAME} letters, digits, _ and -",
        )
    low_x, high_x, low_y, high_y = (_number(path, row, place, key) for key in _AREA_KEYS[1:])
    for axis, low, high in (("x", low_x, high_x), ("y", low_y, high_y)):
        if low >= high:
            raise InputError(
                path, f"area {quoted(name)}: {axis}min {low:g} is not below {axis}max {high:g}"
            )
    return Rectangle(name, (low_x, high_x, low_y, high_y))


def _doorway(path: Path, row: dict[str, Any], place: str, names: set[str]) -> Doorway:
    _check_keys(path, row, place, _DOORWAY_KEYS)
    areas = row["areas"]
    if not isinstance(areas, list) or len(areas) != 2 or not all(isinstance(a, str) for a in areas):
        raise InputError(path, f"{place}: areas is not a list of two names")
    for name in areas:
        if name not in names:
            raise InputError(path, f"{place}: there is no area {quoted(name)}")
    if areas[0] == areas[1]:
        raise InputError(path, f"{place} leads from {quoted(areas[0])} to itself")
    x, y, width = (_number(path, row, place, key) for key in _DOORWAY_KEYS[1:])
    if width <= 0.0:
        raise InputError(path, f"{place}: width {width:g} is not positive")
    return Doorway((areas[0], areas[1]), x, y, width)


def _check_keys(path: Path, row: dict[str, Any], place: str, known: tuple[str, ...]) -> None:
    for key in row:
        # A misspelt key would otherwise be ignored in silence.
        if key not in known:
            raise InputError(
                path, f"{place}: unknown key {quoted(key)}", f"known are {', '.join(known)}"
            )
    for key in known:
        if key not in row:
            raise InputError(path, f"{place}: {key} is missing")


def _number(path: Path, row: dict[str, Any], place: str, key: str) -> float:
    value = row[key]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(path, f"{place}: {key} is {type_name(value)}, not a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(path, f"{place}: {key} is not finite")
    return number
