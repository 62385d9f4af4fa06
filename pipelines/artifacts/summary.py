"""What a stage hands back to be shown: one object from which table and JSON are both made."""

from typing import Any, Protocol


class Summary(Protocol):
    """The outcome of a stage."""

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people; the first row holds the column headings."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """The same for programs: plain JSON types, SI units unless the key says otherwise."""
        ...
