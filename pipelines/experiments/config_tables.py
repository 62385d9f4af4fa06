"""Checked reading of tables, lists and seeds in the TOML files of sweeps and studies."""

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipelines.artifacts.errors import InputError, OptionError, quoted
from pipelines.artifacts.toml_file import type_name

MAX_RUNS = 100_000


def parse_seeds(text: str) -> tuple[int, ...]:
    """``"0-19"`` is 0 to 19, both included; ``"3,4,8"`` are those three.

    Raises:
        ValueError: anything else.
    """
    span = re.fullmatch(r"\s*(\d{1,18})\s*-\s*(\d{1,18})\s*", text)
    if span is None:
        return tuple(int(part) for part in text.split(",") if _is_seed(part))
    first, last = int(span[1]), int(span[2])
    if not 0 <= last - first < MAX_RUNS:
        raise ValueError(f"from {first} to {last} are not 1 to {MAX_RUNS} seeds")
    return tuple(range(first, last + 1))


def _is_seed(text: str) -> bool:
    if not re.fullmatch(r"\s*\d{1,18}\s*", text):
        raise ValueError(f"{quoted(text.strip())} is no seed")
    return True


def named_seeds(text: str) -> tuple[int, ...]:
    """Seeds from the command line: ``"0-19"`` or ``"3,4,8"``, each once.

    Raises:
        OptionError: the text is neither.
    """
    try:
        return tuple(dict.fromkeys(parse_seeds(text)))
    except ValueError as error:
        raise OptionError(f"seeds {quoted(text)}: {error}; give 0-19 or 3,4,8") from error


def read_seeds(path: Path, place: str, table: Mapping[str, Any]) -> tuple[int, ...]:
    """The ``seeds`` of a table: ``"0-19"``, or a list of whole numbers.

    Raises:
        InputError: there are none, or something else.
    """
    value = table.get("seeds")
    if value is None:
        raise InputError(path, f"{place} seeds is missing", 'write seeds = "0-19", for example')
    if isinstance(value, str):
        try:
            seeds = list(parse_seeds(value))
        except ValueError as error:
            raise InputError(path, f"{place} seeds: {error}", 'write "0-19" or a list') from error
    else:
        seeds = checked_list(path, f"{place} seeds", value)
        if not all(type(seed) is int and 0 <= seed < 2**63 for seed in seeds):
            raise InputError(path, f"{place} seeds are not whole numbers from 0 on")
    refuse_duplicates(path, f"{place} seeds", seeds)
    return tuple(seeds)


def absolute_path(folder: Path, name: str) -> Path:
    """The absolute path of a name relative to a folder."""
    return (folder / name).absolute()


def checked_table(path: Path, value: Any, place: str, known: tuple[str, ...]) -> Mapping[str, Any]:
    """A TOML table, checked.

    Args:
        path: the file, for the error.
        value: of the table.
        place: its place in the file, for the error.
        known: keys that it may have.

    Raises:
        InputError: the value is no table, or the table has unknown keys.
    """
    if not isinstance(value, dict):
        raise InputError(path, f"{place} is {type_name(value)}, expected a table")
    for key in value:
        if key not in known:
            reason = f"unknown key {quoted(key)} in {place}"
            raise InputError(path, reason, f"known are {', '.join(known)}")
    return value


def checked_list(path: Path, place: str, value: Any) -> list[Any]:
    """A list that is not empty; a single value stands for a list of one.

    Args:
        path: the file, for the error.
        place: its place in the file, for the error.
        value: of the list.

    Raises:
        InputError: the list is empty.
    """
    values = value if isinstance(value, list) else [value]
    if not values:
        raise InputError(path, f"{place} is empty")
    return values


def refuse_duplicates(path: Path, place: str, values: list[Any]) -> None:
    """Refuses duplicates in a list.

    Args:
        path: the file, for the error.
        place: the list's place in the file, for the error.
        values: of the list.

    Raises:
        InputError: a value is in the list more than once.
    """
    value, count = Counter(values).most_common(1)[0]
    if count > 1:
        text = getattr(value, "name", str(value)).lower()
        raise InputError(path, f"{place}: {text} is there twice")
