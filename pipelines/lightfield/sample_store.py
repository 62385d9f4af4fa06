"""Samples of depth maps that are kept from one call to the next."""

from collections.abc import Callable
from typing import Generic, TypeVar

from pipelines.artifacts.array_types import BoolArray

# So many samples are kept at most, three numbers each, of so many kinds: some tens of megabytes.
MOST_SAMPLES, MOST_KINDS = 1 << 20, 4

Samples = TypeVar("Samples")


class SampleStore(Generic[Samples]):
    """Samples of a light field's depth maps, taken when they are asked for first.

    While a camera moves on, its surface is made of the same depth maps again and again. What was
    handed out does not change, so that threads may share a store.

    Args:
        take: takes the samples of some views ``(N,)``, for the virtual camera's focal length and
            the distance between the surface's vertices, both in pixels; returns how many these are,
            too.
    """

    def __init__(self, take: Callable[[BoolArray, float, float], tuple[Samples, int]]) -> None:
        self._take = take
        self._kept: dict[tuple[float, float], tuple[BoolArray, Samples]] = {}

    def __call__(self, is_source: BoolArray, focal: float, spacing: float) -> Samples:
        """Samples of some views at least.

        Args:
            is_source: ``(N,)`` which views.
            focal: of the virtual camera, pixels.
            spacing: of the surface's vertices, virtual pixels.
        """
        kind = (focal, spacing)
        kept = self._kept.get(kind)
        if kept is not None and not (is_source & ~kept[0]).any():
            return kept[1]
        wanted = is_source if kept is None else is_source | kept[0]
        samples, count = self._take(wanted, focal, spacing)
        if count > MOST_SAMPLES and kept is not None:
            wanted = is_source
            samples, count = self._take(wanted, focal, spacing)
        if count <= MOST_SAMPLES:
            self._kept[kind] = wanted, samples
            for oldest in list(self._kept)[:-MOST_KINDS]:
                self._kept.pop(oldest, None)
        return samples
