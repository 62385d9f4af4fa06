"""Kinds of values that settings have: how each is read from TOML and from a text, and written."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from types import NoneType
from typing import Any, get_args

# A unit. Values are radians in Python.
DEGREES = "degrees"


@dataclass(frozen=True)
class Kind:
    """A kind of value.

    Attributes:
        expected: in words.
        form: what stands for a value in the help of a command.
        read: from TOML's types; raises ValueError, TypeError or OverflowError for another kind.
        write: as TOML's types.
        parse: from a text at the command line to TOML's types; raises ValueError.
        choices: all values there are; empty: too many to name.
        expected_text: what is expected at the command line, in words; "": as in a file.
    """

    expected: str
    form: str
    read: Callable[[Any], Any]
    write: Callable[[Any], Any]
    parse: Callable[[str], Any]
    choices: tuple[str, ...] = ()
    expected_text: str = ""


def degrees_of(radians: float) -> float:
    """The shortest number of degrees that is read back as these radians.

    Where rounding leaves none, the nearest is taken, which is read back one bit beside.
    """
    exact = math.degrees(radians)
    candidates = (float(f"{exact:.{digits}g}") for digits in range(1, 18))
    beside = (math.nextafter(exact, end) for end in (-math.inf, math.inf))
    for candidate in (*candidates, *beside):
        if math.radians(candidate) == radians:
            return candidate
    return exact


def _whole(value: object) -> int:
    # In Python a bool is an int as well.
    if type(value) is not int:
        raise TypeError
    return value


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError
    return float(value)


def _flag(value: object) -> bool:
    if not isinstance(value, bool):
        raise TypeError
    return value


def _flag_of(text: str) -> bool:
    if text not in {"true", "false"}:
        raise ValueError
    return text == "true"


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _numbers(value: object, counts: tuple[int, ...]) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) not in counts:
        raise TypeError
    return tuple(_number(item) for item in value)


def _numbers_of(text: str) -> list[float]:
    return [float(part) for part in text.split(",")]


def _positions(state: Sequence[float]) -> int:
    return 2 if len(state) == 3 else 3


def _pose(value: object) -> tuple[float, ...]:
    """Metres and degrees become metres and radians."""
    numbers = _numbers(value, (3, 6))
    count = _positions(numbers)
    return (*numbers[:count], *map(math.radians, numbers[count:]))


def _pose_text(state: tuple[float, ...]) -> list[float]:
    count = _positions(state)
    return [*map(float, state[:count]), *map(degrees_of, state[count:])]


WHOLE = Kind("a whole number", "INTEGER", _whole, int, int)
NUMBER = Kind("a number", "NUMBER", _number, float, float)
FLAG = Kind("true or false", "", _flag, bool, _flag_of)
TEXT = Kind("a text", "TEXT", _text, str, str)
ANGLE = replace(NUMBER, read=lambda value: math.radians(_number(value)), write=degrees_of)
AREA = Kind(
    "a list of four numbers",
    "XMIN,XMAX,YMIN,YMAX",
    lambda value: _numbers(value, (4,)),
    lambda area: list(map(float, area)),
    _numbers_of,
    expected_text="of the form XMIN,XMAX,YMIN,YMAX",
)
POSE = Kind(
    "a list of three or six numbers",
    "X,Y,DEG or X,Y,Z,RX,RY,RZ",
    _pose,
    _pose_text,
    _numbers_of,
    expected_text="of the form X,Y,DEG or X,Y,Z,RX,RY,RZ",
)


def one_of(choices: Sequence[str | int]) -> Kind:
    """One of some texts or whole numbers."""

    def read(value: object) -> Any:
        if isinstance(value, bool) or value not in choices:
            raise ValueError
        return value

    names = tuple(map(str, choices))
    return Kind(
        f"one of {', '.join(names)}",
        f"[{'|'.join(names)}]",
        read,
        lambda value: value,
        type(choices[0]),
        names,
        f"one of {', '.join(map(repr, names))}",
    )


def member_of(members: type[Enum]) -> Kind:
    """A member of an enumeration, by its name in lower case."""
    by_name = {member.name.lower(): member for member in members}
    kind = one_of(tuple(by_name))
    return replace(
        kind,
        read=lambda value: by_name[kind.read(value)],
        write=lambda member: str(members(member).name.lower()),
    )


def or_word(kind: Kind, word: str) -> Kind:
    """A kind of value, or a word that stands for None, which TOML lacks."""
    return replace(
        kind,
        expected=f'{kind.expected} or "{word}"',
        expected_text=f"{kind.expected_text or kind.expected} or {word!r}",
        form=f"{kind.form} or {word}",
        read=lambda value: None if value == word else kind.read(value),
        write=lambda value: word if value is None else kind.write(value),
    )


def kind_of_type(hint: Any, unit: str) -> Kind:
    """The kind of values of a type: truth values, numbers, texts, members of an enumeration.

    Args:
        hint: the type, or one with None.
        unit: ``DEGREES`` makes radians of numbers.

    Raises:
        TypeError: a type that no setting has.
    """
    (kind, *others) = [item for item in get_args(hint) or (hint,) if item is not NoneType]
    if not others and isinstance(kind, type):
        if issubclass(kind, Enum):
            return member_of(kind)
        if kind is bool:
            return FLAG
        if kind is int:
            return WHOLE
        if kind is str:
            return TEXT
        if kind is float:
            return ANGLE if unit == DEGREES else NUMBER
    raise TypeError(f"no setting has the type {hint}")
