"""Arguments that a program hands over, checked before they are used; arrays: ``arrays``.

Types say to a type checker what a function takes; not every caller has one. What is of another type
is an ``OptionError`` that names the argument, and not a traceback from somewhere inside.
"""

import dataclasses
import functools
import math
import os
from collections.abc import Hashable, Iterable
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, TypeAlias, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from pipelines.artifacts.errors import OptionError, quoted

PathLike: TypeAlias = str | os.PathLike[str]
Kind = TypeVar("Kind")


def checked_path(value: object, name: str) -> Path:
    """A file or folder; whether it exists is not looked at.

    Args:
        value: a text or a path.
        name: what the message calls it.

    Raises:
        OptionError: neither of these, empty, or with a zero byte in it.
    """
    if not isinstance(value, str | os.PathLike):
        raise OptionError(f"{name} is {_type_name(value)}, not a path")
    text = os.fspath(value)
    if not isinstance(text, str) or not text or "\0" in text:
        raise OptionError(f"{name} {quoted(text)} is not a path")
    return Path(text)


def checked_instance(value: object, name: str, kind: type[Kind]) -> Kind:
    """An object of a class.

    Args:
        value: what the caller handed over.
        name: what the message calls it.
        kind: the class.

    Raises:
        OptionError: of another class.
    """
    if not isinstance(value, kind):
        raise OptionError(f"{name} is {_type_name(value)}, not {_article(kind.__name__)}")
    return value


def checked_choice(value: object, name: str, known: Iterable[str]) -> str:
    """One of a few words.

    Args:
        value: what the caller handed over.
        name: what the message calls it.
        known: the words.

    Raises:
        OptionError: none of them.
    """
    words = tuple(known)
    if not isinstance(value, str) or value not in words:
        raise OptionError(f"{name} {quoted(value)} is none of {', '.join(words)}")
    return value


def checked_index(value: object, name: str, count: int) -> int:
    """The number of one of so many things, from 0.

    Args:
        value: what the caller handed over.
        name: what the message calls the things, in the plural.
        count: how many there are.

    Raises:
        OptionError: no whole number, negative, or ``count`` or more.
    """
    if not _is_of(value, int):
        raise OptionError(f"{quoted(value)} is not the number of one of the {name}")
    number = int(cast("int", value))
    if not 0 <= number < count:
        raise OptionError(f"there is no number {number} among {count} {name}, counted from 0")
    return number


def checked_number(
    value: object, name: str, low: float = -math.inf, high: float = math.inf, *, whole: bool = False
) -> None:
    """Refuses what is no number of a range; NaN is in none, infinity in those without an end.

    Args:
        value: what the caller handed over.
        name: what the message calls it.
        low: the least that is allowed.
        high: the most that is allowed.
        whole: whether it has to be a whole number.

    Raises:
        OptionError: no number (or, with ``whole``, no whole one), or outside of the range.
    """
    if not _is_of(value, int if whole else float):
        raise OptionError(f"{name} {quoted(value)} is not a {'whole ' if whole else ''}number")
    number = float(cast("float", value))
    if low <= number <= high:
        return
    shown = f"{value}" if whole else f"{number:g}"
    if math.isinf(high) and number < low:
        raise OptionError(f"{name} {shown} is {'negative' if low == 0 else f'less than {low:g}'}")
    raise OptionError(f"{name} {shown} is not between {low:g} and {high:g}")


def check_fields(made: object) -> None:
    """Refuses a dataclass whose values are not of the types that its fields are declared with.

    Ranges are left to the class. Known are numbers, truth values, texts, paths, tuples of these,
    and other classes.

    Args:
        made: the dataclass, in its ``__post_init__``.

    Raises:
        OptionError: a value of another type; its field is named.
    """
    for name, wanted in _declared(cast("Hashable", type(made))).items():
        value = getattr(made, name)
        if not _is_of(value, wanted):
            raise OptionError(f"{name} {quoted(value)} is not {_words(wanted)}")


@functools.cache
def _declared(kind: Any) -> dict[str, Any]:
    """Field -> its type."""
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def _is_of(value: object, wanted: Any) -> bool:
    """Whether a value is of a declared type. Numbers are finite in 64 bits, or NaN or infinity."""
    parts = get_args(wanted)
    if get_origin(wanted) in (Union, UnionType):
        return any(_is_of(value, part) for part in parts)
    if get_origin(wanted) is tuple:
        if not isinstance(value, tuple):
            return False
        each = [parts[0]] * len(value) if parts[-1] is ... else list(parts)
        return len(value) == len(each) and all(map(_is_of, value, each))
    if wanted in (int, float):
        if isinstance(value, bool) or not isinstance(value, Integral if wanted is int else Real):
            return False
        return not isinstance(value, Integral) or abs(int(value)) < 2**63
    return isinstance(value, NoneType if wanted is None else wanted)


def _words(wanted: Any) -> str:
    """What a declared type is called in a message."""
    if get_origin(wanted) in (Union, UnionType):
        return " or ".join(_words(part) for part in get_args(wanted) if part is not NoneType)
    if get_origin(wanted) is tuple:
        parts = get_args(wanted)
        count = "" if parts[-1] is ... else f"{len(parts)} "
        return f"a tuple of {count}numbers"
    names = {int: "a whole number", float: "a number", str: "a text", bool: "True or False"}
    return names.get(wanted) or _article(wanted.__name__)


def _type_name(value: object) -> str:
    return "None" if value is None else _article(type(value).__name__)


def _article(name: str) -> str:
    return f"{'an' if name[:1] in 'AEIOUaeiou' else 'a'} {name}"
