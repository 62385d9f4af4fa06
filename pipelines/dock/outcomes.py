"""How a docking can end: each outcome with its name and its exit code."""

from dataclasses import dataclass
from enum import Enum


class Ending(Enum):
    """The outcomes. The value is the exit code; 1 and 2 are errors and wrong usage."""

    DOCKED = 0
    LOST = 10
    BLOCKED = 11
    OUT_OF_AREA = 12
    TIMED_OUT = 13
    ROBOT_FAILED = 14
    VIEW_BLOCKED = 15
    INTERRUPTED = 130

    @property
    def word(self) -> str:
        """For people and files: ``out of area``."""
        return self.name.lower().replace("_", " ")


@dataclass(frozen=True)
class Outcome:
    """How it ended.

    Attributes:
        ending: which way.
        reason: one line that says why.
    """

    ending: Ending
    reason: str
