"""Reading and writing TOML: configuration that people write by hand and get back from programs."""

import json
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipelines.artifacts.errors import InputError, reason_of
from pipelines.artifacts.file_content import read_text_file

MAX_TOML_BYTES = 1024**2

# What a value is called in an error, by its type in Python.
_NAMES = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a text",
    list: "a list",
    dict: "a table",
}


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file of at most a megabyte.

    Raises:
        InputError: unreadable, too large, or not TOML.
    """
    text = read_text_file(path, MAX_TOML_BYTES)
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(path, f"is not TOML ({reason_of(error)})") from error


def type_name(value: object) -> str:
    """What a value read from TOML is, in words."""
    return _NAMES.get(type(value), "a date or time")


def format_value(value: str | bool | int | float | Sequence[Any]) -> str:
    """A value as TOML; ``read_toml`` reads the same value back."""
    if isinstance(value, str):
        # JSON escapes what TOML wants escaped, in a way that TOML understands; and DEL.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    return f"[{', '.join(format_value(item) for item in value)}]"
