"""The one base exception. Its text is the single line that a user of the command line reads.

What such a line says of a file's content was written by a stranger: it may be megabytes long, or
hold escape sequences that make a terminal show something else. So it goes through ``quoted``, and
what another library says of it through ``reason_of``.
"""

from pathlib import Path

QUOTED_CHARACTERS, REASON_CHARACTERS, LONGEST_PATH = 80, 200, 4096
LONGEST_MESSAGE = 2 * LONGEST_PATH


def quoted(text: object) -> str:
    """A text from a file, or a value from a caller, as it may stand in a message.

    Args:
        text: anything; ``str`` makes a text of it.

    Returns:
        One line in quotation marks: what is not printable is escaped as in Python, and of more than
        ``QUOTED_CHARACTERS`` the rest is left out, which an ellipsis says.
    """
    content, is_cut = _escaped(str(text), QUOTED_CHARACTERS, "'\\")
    return f"'{content}'..." if is_cut else f"'{content}'"


def reason_of(error: Exception | str) -> str:
    """What an error of another library says, as it may stand in a message.

    Args:
        error: its text may quote a file's content.

    Returns:
        One line: what is not printable is escaped as in Python, and of more than
        ``REASON_CHARACTERS`` the rest is left out.
    """
    content, is_cut = _escaped(str(error), REASON_CHARACTERS, "")
    return f"{content}..." if is_cut else content


def _escaped(text: str, limit: int, special: str) -> tuple[str, bool]:
    """At most so many characters without control characters; whether something was left out."""
    shown: list[str] = []
    length = 0
    for character in text:
        is_plain = character.isprintable() and character not in special
        part = character if is_plain else _escape(character)
        length += len(part)
        if length > limit:
            return "".join(shown), True
        shown.append(part)
    return "".join(shown), False


def _escape(character: str) -> str:
    return f"\\{character}" if character.isprintable() else repr(character)[1:-1]


class LfnavError(Exception):
    """Something that the caller can mend: bad input, a failed stage, an unwritable place.

    The message is one line that says what is wrong, in which file, and what to do. Whatever it
    quotes, it holds no control characters, and it ends.
    """

    def __init__(self, message: object = "") -> None:
        text = str(message)
        if len(text) > LONGEST_MESSAGE:
            text = f"{text[:LONGEST_MESSAGE]}..."
        shown = [c if c.isprintable() or c.isspace() else _escape(c) for c in text]
        super().__init__("".join(shown))


class InputError(LfnavError):
    """A file or folder that was handed in cannot be used.

    Args:
        path: the offending file or folder.
        reason: what is wrong with it.
        remedy: what to do about it, where that is not obvious from the reason.
    """

    def __init__(self, path: Path | str, reason: str, remedy: str = "") -> None:
        self.path = Path(path)
        self.reason = reason
        self.remedy = remedy
        # A file may be called anything but a slash and the zero byte.
        name, _ = _escaped(str(path), LONGEST_PATH, "")
        super().__init__(f"{name}: {reason}" + (f"; {remedy}" if remedy else ""))


class OptionError(LfnavError):
    """A value given by the caller (an option, a setting) is impossible."""


class StageError(LfnavError):
    """A stage ran on valid input and could not deliver a result that can be trusted."""
