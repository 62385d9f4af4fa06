"""Room in memory for views that come and go: places of one size in buffers that are made once.

Views of areas that are opened and closed lie in the same buffers, so that a renderer of those that
are there is made without copying a pixel, and memory neither grows nor falls apart.
"""

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import Float32Array, ImageArray
from pipelines.artifacts.errors import StageError
from pipelines.geometry.camera import Intrinsics
from pipelines.lightfield.views import (
    POOL_SIDE,
    ViewArrays,
    Views,
    pyramid_texels,
    texels_beyond,
)

# What ``ViewArrays`` holds of a view but its pixels and where these are.
_NUMBERS = ("projection", "rays", "centres", "axes", "focal", "level_size", "depth_size")


@dataclass(frozen=True)
class _Placed:
    """A view that has a place.

    Attributes:
        place: its number.
        numbers: name -> that part of ``ViewArrays``, of this view.
        levels: first texel of each level, from the place's first.
        intrinsics: of level 0.
        typical_inverse_depth: median of its depth map's known values, 1 / metres; NaN: none.
    """

    place: int
    numbers: dict[str, np.ndarray]
    levels: np.ndarray
    intrinsics: Intrinsics
    typical_inverse_depth: float


class ViewArena:
    """Places for views of at most so many pixels a side.

    The operating system gives memory to a place when something is first put there.

    Args:
        places: how many views there may be at once.
        side: the most pixels of a photo's and of a depth map's longer side.
        channels: how many kinds of pixels each view has: colours and others made of them.
    """

    def __init__(self, places: int, side: int, channels: int) -> None:
        # Of no photo of this side are there more than of a square one.
        self._texels_a_place = pyramid_texels(side, side)
        self._depths_a_place = side * side
        self._pooled_a_place = (-(-side // POOL_SIDE)) ** 2
        texels = places * self._texels_a_place + texels_beyond(side)
        # Zeros and not empty arrays: those are given out page by page.
        self._texels: list[ImageArray] = [
            np.zeros((texels, 4), dtype=np.uint8) for _ in range(channels)
        ]
        self._depths: Float32Array = np.zeros(places * self._depths_a_place, dtype=np.float32)
        self._pooled: Float32Array = np.zeros(places * self._pooled_a_place, dtype=np.float32)
        self._placed: dict[Hashable, _Placed] = {}
        self._free = list(range(places - 1, -1, -1))

    def __contains__(self, key: Hashable) -> bool:
        return key in self._placed

    @property
    def free(self) -> int:
        """How many places are free."""
        return len(self._free)

    @property
    def keys(self) -> tuple[Hashable, ...]:
        """The views that have a place."""
        return tuple(self._placed)

    def drop(self, key: Hashable) -> None:
        """Frees the place of a view; it must not be in a renderer that is used any more."""
        self._free.append(self._placed.pop(key).place)

    def put(self, key: Hashable, channels: Sequence[Views], view: int) -> None:
        """Copies a view to a free place.

        Args:
            key: names it from now on.
            channels: light fields that hold the view in each of the kinds of pixels.
            view: its number there.

        Raises:
            StageError: no place is free.
        """
        if not self._free:
            raise StageError("no place is free for a view")
        place = self._free.pop()
        for texels, views in zip(self._texels, channels, strict=True):
            self._copy_texels(texels, place, views.arrays, view)
        arrays = channels[0].arrays
        levels = self._level_offsets(arrays, view)
        width, height = (int(side) for side in arrays.depth_size[view])
        count, start = width * height, int(arrays.depth_start[view])
        first = place * self._depths_a_place
        self._depths[first : first + count] = arrays.inverse_depth[start : start + count]
        count = -(-width // POOL_SIDE) * -(-height // POOL_SIDE)
        start, first = int(arrays.pooled_start[view]), place * self._pooled_a_place
        self._pooled[first : first + count] = arrays.pooled_depth[start : start + count]
        numbers = {name: getattr(arrays, name)[view].copy() for name in _NUMBERS}
        depth = channels[0].depth_map(view)
        known = depth[(depth > 0.0) & (depth < np.inf)]
        typical = float(np.median(known)) if len(known) else math.nan
        self._placed[key] = _Placed(place, numbers, levels, channels[0].intrinsics[view], typical)

    def typical_inverse_depth(self, keys: Sequence[Hashable]) -> float:
        """Median over some of the views of their depth maps' medians, 1 / metres; 0 without any."""
        typical = np.array([self._placed[key].typical_inverse_depth for key in keys])
        known = typical[np.isfinite(typical)]
        return float(np.median(known)) if len(known) else 0.0

    def views(self, keys: Sequence[Hashable], channel: int) -> Views:
        """The light field of some of the views, in their order.

        Args:
            keys: which; at least one.
            channel: the kind of pixels.
        """
        placed = [self._placed[key] for key in keys]
        places = np.array([one.place for one in placed], dtype=np.int64)
        most = max(len(one.levels) for one in placed)
        numbers = {
            name: np.ascontiguousarray(
                np.stack([_repeated(one.numbers[name], most, name) for one in placed])
            )
            for name in _NUMBERS
        }
        levels = np.stack([_repeated(one.levels, most, "level_size") for one in placed])
        has_depth = bool(numbers["depth_size"].any())
        empty = np.zeros(0, dtype=np.float32)
        return Views(
            ViewArrays(
                texels=self._texels[channel],
                level_start=levels + (places * self._texels_a_place)[:, None],
                inverse_depth=self._depths if has_depth else empty,
                depth_start=places * (self._depths_a_place if has_depth else 0),
                pooled_depth=self._pooled if has_depth else empty,
                pooled_start=places * (self._pooled_a_place if has_depth else 0),
                **numbers,
            ),
            tuple(one.intrinsics for one in placed),
        )

    def _copy_texels(self, texels: ImageArray, place: int, arrays: ViewArrays, view: int) -> None:
        """Copies all levels of a view, one after the other as they are."""
        start, count = _extent(arrays, view)
        first = place * self._texels_a_place
        texels[first : first + count] = arrays.texels[start : start + count]

    def _level_offsets(self, arrays: ViewArrays, view: int) -> np.ndarray:
        return np.asarray(arrays.level_start[view] - arrays.level_start[view, 0])


def _extent(arrays: ViewArrays, view: int) -> tuple[int, int]:
    """First texel of a view, and how many all of its levels have."""
    start = int(arrays.level_start[view, 0])
    width, height = (int(side) for side in arrays.level_size[view, -1])
    return start, int(arrays.level_start[view, -1]) + width * height - start


def _repeated(numbers: np.ndarray, most: int, name: str) -> np.ndarray:
    """Levels of a view that has fewer than others: the last one repeated."""
    if name != "level_size" or len(numbers) == most:
        return numbers
    return np.concatenate([numbers, np.repeat(numbers[-1:], most - len(numbers), axis=0)])
