"""The content of files that are not trusted, with a limit to what is read."""

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
    """The content of a UTF-8 text file of at most ``limit`` bytes.

    Raises:
        InputError: missing, no regular file, too large, unreadable, or not UTF-8.
    """
    try:
        return read_file(path, limit).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(path, f"is no text in UTF-8 (byte {error.start})") from error
