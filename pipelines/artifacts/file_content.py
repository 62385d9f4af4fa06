"""The content of files that are not trusted, with a limit to what is read."""

import codecs
from pathlib import Path

from pipelines.artifacts.errors import InputError


def is_file(path: Path) -> bool:
    """Whether ``path`` is an existing regular file; names that no file can have are none."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, for example
        return False


def read_file(path: Path, limit: int) -> bytes:
    """The whole content of a regular file of at most ``limit`` bytes.

    Raises:
        InputError: it is missing, no regular file (a device never ends), too large or unreadable.
    """
    try:
        if not path.exists():
            raise InputError(path, "does not exist")
        if not path.is_file():
            raise InputError(path, "is not a file")
        size = path.stat().st_size
        if size > limit:
            raise InputError(path, f"has {size} bytes; at most {limit} are read")
        return path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(path, f"cannot be read ({reason})") from error


def read_text_file(path: Path, limit: int) -> str:
    """The content of a text file of at most ``limit`` bytes: UTF-8, or what its mark says.

    Raises:
        InputError: missing, no regular file, too large, unreadable, or no text.
    """
    return decoded_text(read_file(path, limit), path)


def decoded_text(data: bytes, path: Path) -> str:
    """Bytes of a file as text; a byte order mark is skipped, and says UTF-16 where it is one.

    Raises:
        InputError: no text in this encoding.
    """
    is_wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    name = "UTF-16" if is_wide else "UTF-8"
    try:
        return data.decode("utf-16" if is_wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(path, f"is no text in {name} (byte {error.start})") from error
