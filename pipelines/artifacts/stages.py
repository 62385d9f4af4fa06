"""What a stage reports to its caller: progress while it works, and then its outcome."""

from collections.abc import Iterable, Iterator
from typing import Any, Protocol, TypeVar

T = TypeVar("T")


class Progress(Protocol):
    """Wraps an iterable; a front end shows a bar while the items are consumed."""

    def __call__(
        self, items: Iterable[T], description: str, total: int | None = None
    ) -> Iterator[T]:
        """Yields ``items`` unchanged; ``total`` is their number where ``len`` does not tell."""
        ...


def no_progress(items: Iterable[T], description: str, total: int | None = None) -> Iterator[T]:
    """The ``Progress`` that shows nothing.

    Args:
        items: what is gone through.
        description: what a bar would say; not used.
        total: number of the items where ``len`` does not tell; not used.

    Yields:
        The items, unchanged.
    """
    yield from items


class Summary(Protocol):
    """The outcome of a stage."""

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people; the first row holds the column headings."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types, for programs; SI units unless the key says otherwise."""
        ...
