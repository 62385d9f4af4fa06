"""Depth maps of many views in little memory, while they are compared with each other.

Hundreds of views are fused in rounds, each from the maps that the round before has made. In the
levels in which a scene file keeps depth they take less than half of the memory; the error, less
than 1 / 65535 of a view's nearest depth, is far below that of the depth.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

from pipelines.artifacts.arrays import BoolArray
from pipelines.geometry.camera import Intrinsics
from pipelines.lightfield.depth_storage import quantised
from pipelines.lightfield.stereo_depth import DepthMap


@dataclass(frozen=True)
class _Packed:
    """One view: levels ``(H, W)``, the factor that makes 1 / metres of them, bits of confidence."""

    levels: NDArray[np.uint16]
    scale: float
    confident: NDArray[np.uint8]
    intrinsics: Intrinsics


class PackedDepthMaps(Sequence[DepthMap]):
    """Depth maps of N views, in order, unpacked each time that one is asked for.

    Args:
        maps: taken one after the other, none of them kept as it is.
    """

    def __init__(self, maps: Iterable[DepthMap] = ()) -> None:
        self._packed = [_pack(depth) for depth in maps]

    def __len__(self) -> int:
        return len(self._packed)

    @overload
    def __getitem__(self, index: int) -> DepthMap: ...

    @overload
    def __getitem__(self, index: slice) -> "PackedDepthMaps": ...

    def __getitem__(self, index: int | slice) -> "DepthMap | PackedDepthMaps":
        if isinstance(index, slice):
            return PackedDepthMaps(self[i] for i in range(*index.indices(len(self))))
        return _unpack(self._packed[index])


def _pack(depth: DepthMap) -> _Packed:
    levels, scale = quantised(depth.inverse_depth)
    return _Packed(levels, scale, np.packbits(depth.confident), depth.intrinsics)


def _unpack(packed: _Packed) -> DepthMap:
    shape = packed.levels.shape
    bits = np.unpackbits(packed.confident, count=packed.levels.size)
    confident: BoolArray = bits.view(np.bool_).reshape(shape)
    # Exact: the factor is a power of two.
    inverse_depth = packed.levels * np.float32(packed.scale)
    return DepthMap(inverse_depth, confident, packed.intrinsics)
