"""How a stage says how far it is, without knowing whether anybody watches."""

from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

T = TypeVar("T")


class Progress(Protocol):
    """Wraps an iterable; a front end shows a bar while the items are consumed."""

    def __call__(
        self, items: Iterable[T], description: str, total: int | None = None
    ) -> Iterator[T]:
        """Yields ``items`` unchanged; ``total`` is their number where ``len`` does not tell."""
        ...


def no_progress(items: Iterable[T], description: str, total: int | None = None) -> Iterator[T]:
    """The ``Progress`` that shows nothing."""
    yield from items
