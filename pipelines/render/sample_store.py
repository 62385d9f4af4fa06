"""A cache of depth-map samples, from one call to the next."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.lightfield.views import ViewArrays
from pipelines.render.surface import PIXEL_PARTS, sample_steps

# The most samples that are kept, of twelve bytes each; in large light fields one for so many
# depths, which take four bytes each.
MOST_SAMPLES, DEPTHS_A_SAMPLE = 1 << 22, 8

Samples = TypeVar("Samples")


@dataclass(frozen=True)
class _Kept(Generic[Samples]):
    """Samples of some views, and which these are.

    Attributes:
        is_source: ``(N,)`` which views.
        samples: of their depth maps.
        count: an upper bound of the number of samples.
    """

    is_source: BoolArray
    samples: Samples
    count: int


class SampleStore(Generic[Samples]):
    """Samples of a light field's depth maps, taken when they are first needed.

    While a camera moves on, its surface is made of the same depth maps again and again. Samples
    that were returned do not change, so that threads may share a store.

    Args:
        views: the light field.
        take: takes the samples of some views. Its arguments: ``(N,)`` which views, and ``(N,)``
            steps from one sample to the next in pixels of the depth maps.
        join: makes one of samples of some views and those of others, of the same steps.
    """

    def __init__(
        self,
        views: ViewArrays,
        take: Callable[[BoolArray, FloatArray], Samples],
        join: Callable[[Samples, Samples], Samples],
    ) -> None:
        self._views, self._take, self._join = views, take, join
        self._most = max(MOST_SAMPLES, int(views.depth_size.prod(axis=1).sum()) // DEPTHS_A_SAMPLE)
        self._kept: dict[tuple[float, float], _Kept[Samples]] = {}

    def __call__(self, is_source: BoolArray, focal: float, spacing: float) -> Samples:
        """Samples of some views at least.

        Args:
            is_source: ``(N,)`` which views.
            focal: focal length of the virtual camera, pixels.
            spacing: of the depth grid, virtual pixels.
        """
        kind = (focal, spacing)
        kept = self._kept.get(kind)
        if kept is not None and not (is_source & ~kept.is_source).any():
            return kept.samples
        steps = sample_steps(self._views, focal, spacing)
        counts = (-(-PIXEL_PARTS * self._views.depth_size // steps[:, None])).prod(axis=1)
        wanted = is_source if kept is None else is_source | kept.is_source
        if kept is None or counts[wanted].sum() > self._most:
            wanted = is_source
            found = self._take(wanted, steps / PIXEL_PARTS)
        else:
            # A camera that moves on meets a new view now and then: only that one is sampled.
            found = self._take(is_source & ~kept.is_source, steps / PIXEL_PARTS)
            found = self._join(kept.samples, found)
        self._keep(kind, _Kept(wanted, found, int(counts[wanted].sum())))
        return found

    def _keep(self, kind: tuple[float, float], found: _Kept[Samples]) -> None:
        """Keeps samples, and of older ones the latest that fit into the limit with them."""
        if found.count > self._most:
            return
        kept, left = {kind: found}, self._most - found.count
        for other, older in reversed(self._kept.items()):
            if other != kind and older.count <= left:
                kept[other] = older
                left -= older.count
        self._kept = dict(reversed(kept.items()))
