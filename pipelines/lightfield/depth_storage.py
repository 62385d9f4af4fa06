"""Depth maps in a scene file: inverse depth in levels, and where it is confident.

In full storage the levels are stored as they are, in compact storage, in fewer levels, what a plane
through a pixel's neighbours does not predict.
"""

import math
from enum import Enum

import h5py
import numpy as np
from numpy.typing import NDArray

from pipelines.artifacts.arrays import BoolArray, Float32Array
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.safe_hdf5 import SafeFile, write_array
from pipelines.lightfield.scene import SceneDepth

# Inverse depth is stored in at most so many levels.
FULL_LEVELS, COMPACT_LEVELS = 65535, 1023


class Depths(Enum):
    """What is read of depth maps: ``VALUES`` of them are said to be confident nowhere."""

    NONE = "none"
    VALUES = "values"
    ALL = "all"


def quantised(
    inverse_depth: Float32Array, most: int = FULL_LEVELS
) -> tuple[NDArray[np.uint16], float]:
    """Inverse depth in levels of at most ``most``, and the factor that makes 1 / metres of them.

    The factor is a power of two: what was read is written again as the same bytes.
    """
    scale = 2.0 ** math.ceil(math.log2(max(float(inverse_depth.max()), 1e-9) / most))
    return np.rint(inverse_depth / scale).astype(np.uint16), scale


def as_stored(
    inverse_depth: Float32Array, confident: BoolArray, most: int = FULL_LEVELS
) -> SceneDepth:
    """A depth map rounded to what the file keeps of it, in levels of at most ``most``."""
    levels, scale = quantised(inverse_depth, most)
    return SceneDepth((levels * scale).astype(np.float32), confident)


def write_depth(file: h5py.File, group: str, depth: SceneDepth, is_full: bool) -> None:
    """Writes a depth map.

    Args:
        file: the scene's.
        group: of the view.
        depth: of at most so many levels as are stored.
        is_full: whether storage is full, and not compact.
    """
    levels, scale = quantised(depth.inverse_depth, FULL_LEVELS if is_full else COMPACT_LEVELS)
    if is_full:
        write_array(file, f"{group}/inverse", levels, compress=True)
    else:
        write_array(file, f"{group}/differences", differences_of(levels), compress=True)
    write_array(file, f"{group}/scale", np.float64(scale))
    if is_full:
        write_array(file, f"{group}/confident", depth.confident, compress=True)
    else:
        write_array(file, f"{group}/confident_bits", np.packbits(depth.confident), compress=True)


def read_depth(file: SafeFile, group: str, is_full: bool, depths: Depths) -> SceneDepth:
    """Reads a depth map.

    Args:
        file: the scene's.
        group: of the view.
        is_full: whether storage is full, and not compact.
        depths: ``VALUES`` or ``ALL``.

    Raises:
        InputError: damaged, of another type than is written, or without any depth.
    """
    stored = "inverse" if is_full else "differences"
    levels = file.read_array(f"{group}/{stored}", dtype_kind="u", shape=(None, None))
    if not is_full:
        if levels.dtype != np.uint16:
            raise InputError(file.path, f"{group}/{stored} has type {levels.dtype}, not uint16")
        levels = levels_of(levels)
    scale = float(file.read_array(f"{group}/scale", dtype_kind="f", shape=()))
    if not (np.isfinite(scale) and scale > 0.0) or levels.size == 0 or not levels.any():
        raise InputError(file.path, f"{group} holds no depth")
    confident: BoolArray = np.broadcast_to(np.False_, levels.shape)
    if depths is Depths.ALL:
        confident = _confident(file, group, is_full, levels.shape)
    if levels.dtype == np.uint16 and float(np.float32(scale)) == scale:
        # Of so few bits the product rounds to the same, in a third of the time.
        return SceneDepth(levels * np.float32(scale), confident)
    return SceneDepth((levels * scale).astype(np.float32), confident)


def _confident(file: SafeFile, group: str, is_full: bool, shape: tuple[int, ...]) -> BoolArray:
    """Where a depth map of a shape ``(h, w)`` is confident."""
    if is_full:
        return file.read_array(f"{group}/confident", dtype_kind="b", shape=shape)
    count = math.prod(shape)
    bits = file.read_array(f"{group}/confident_bits", dtype_kind="u", shape=(-(-count // 8),))
    if bits.dtype != np.uint8:
        raise InputError(file.path, f"{group}/confident_bits has type {bits.dtype}, not uint8")
    return np.unpackbits(bits, count=count).reshape(shape).astype(np.bool_)


def differences_of(levels: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """What a plane through the pixels on the left, above and diagonally above fails to predict.

    On surfaces that are flat in space inverse depth is linear in the image, so that nearly all
    that is left is small. Signs alternate (0, -1, 1, -2, ...) so that small numbers have small
    bytes; arithmetic is modulo 2^16 and loses nothing.

    Args:
        levels: ``(h, w)``.

    Returns:
        ``(h, w)``; ``levels_of`` turns it back.
    """
    zero = np.uint16(0)
    signed = np.diff(np.diff(levels, axis=0, prepend=zero), axis=1, prepend=zero).view(np.int16)
    return ((signed << 1) ^ (signed >> 15)).view(np.uint16)


def levels_of(differences: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """The levels ``(h, w)`` of which ``differences_of`` made these."""
    wrapped = (differences >> 1) ^ (np.uint16(0) - (differences & 1))
    return np.cumsum(np.cumsum(wrapped, axis=1, dtype=np.uint16), axis=0, dtype=np.uint16)
