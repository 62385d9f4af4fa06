"""The one base exception. Its text is the single line that a user of the command line reads."""

from pathlib import Path


class LfnavError(Exception):
    """Something that the caller can mend: bad input, a failed stage, an unwritable place.

    The message is one line that says what is wrong, in which file, and what to do.
    """


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
        super().__init__(f"{path}: {reason}" + (f"; {remedy}" if remedy else ""))


class OptionError(LfnavError):
    """A value given by the caller (an option, a setting) is impossible."""


class StageError(LfnavError):
    """A stage ran on valid input and could not deliver a result that can be trusted."""
