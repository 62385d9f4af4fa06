"""A JSON object from a file that is not trusted: every value is asked for with its type."""

import json
import math
from pathlib import Path
from typing import Any, TypeVar

from pipelines.artifacts.errors import InputError, quoted, reason_of
from pipelines.artifacts.file_content import read_text_file

Value = TypeVar("Value")


class JsonFields:
    """Typed access to a JSON object; what has another type is an error that names the key."""

    def __init__(self, path: Path, value: object, prefix: str = "") -> None:
        if not isinstance(value, dict):
            raise InputError(path, f"{prefix.rstrip('.') or 'the content'} is not a JSON object")
        self.path, self.prefix = path, prefix
        self.values: dict[str, Any] = value

    def get(self, key: str, kind: type[Value]) -> Value:
        """The value of a key, which has to be of type ``kind``."""
        value = self.values.get(key)
        # In Python a bool is an int as well.
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            found = "is missing" if key not in self.values else f"is a {type(value).__name__}"
            raise InputError(self.path, f"{self.prefix}{key} {found}, expected {kind.__name__}")
        return value

    def number(self, key: str) -> float:
        """The finite number of a key."""
        value = self.values.get(key)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(self.path, f"{self.prefix}{key} is not a number")
        if abs(value) > 1e300 or not math.isfinite(value):
            raise InputError(self.path, f"{self.prefix}{key} is out of range")
        return float(value)

    def choice(self, key: str, known: tuple[str, ...]) -> str:
        """The text of a key, which has to be one of ``known``."""
        value = self.get(key, str)
        if value not in known:
            reason = f"{self.prefix}{key} {quoted(value)} is unknown"
            raise InputError(self.path, reason, f"known are {', '.join(known)}")
        return value


def read_json_object(path: Path, limit: int) -> JsonFields:
    """Reads a file of at most ``limit`` bytes.

    Raises:
        InputError: unreadable, too large, not JSON, NaN or infinity in it, or not an object.
    """

    def refuse_constant(name: str) -> object:
        raise ValueError(f"{name} is no JSON number")

    text = read_text_file(path, limit)
    try:
        value = json.loads(text, parse_constant=refuse_constant)
    except (ValueError, RecursionError) as error:
        raise InputError(path, f"is not valid JSON ({reason_of(error)})") from error
    return JsonFields(path, value)
