"""Chunks of HDF5 datasets, unpacked here and not by HDF5.

HDF5 unpacks a chunk to whatever size it has, and a gigabyte fits into a megabyte. So each has to be
unpacked with a bound, and to have HDF5 do it once more would take as long again. What is done with
a chunk when it is written is undone: deflate and shuffle, after its checksum was compared.
"""

import itertools
import math
import zlib
from collections.abc import Collection
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

CHECKSUM_BYTES = 4
# What Fletcher's sums are counted by.
_MODULUS = 65_535
# So many words are summed up at once, the first one so many times, the last one once.
_TOGETHER = 1 << 15
_FALLING = np.arange(_TOGETHER, 0, -1, dtype=np.int64)
WRONG_SIZE = "a chunk has the wrong size"


class ChunkError(ValueError):
    """A chunk is missing, or not what it has to be."""


def read_chunks(dataset: h5py.Dataset, filters: Collection[str]) -> NDArray[Any]:
    """Reads a dataset of chunks, each of which has a checksum.

    Args:
        dataset: at least one number, of a type that NumPy has as it is stored.
        filters: of ``shuffle``, ``deflate`` and ``fletcher32`` those that were applied, in this
            order, the last one among them.

    Returns:
        All of it, C-contiguous, in the byte order of the file.

    Raises:
        ChunkError: parts are missing, a chunk is larger than it has to be before or after it is
            unpacked, or its checksum is another one.
        OSError, zlib.error: the file cannot be read, or a chunk is not packed as it says.
    """
    shape, chunk_shape, dtype = dataset.shape, dataset.chunks, dataset.dtype
    steps = [range(0, length, step) for length, step in zip(shape, chunk_shape, strict=True)]
    found: list[Any] = []
    if dataset.id.get_num_chunks() == math.prod(len(step) for step in steps):
        dataset.id.chunk_iter(found.append)
    # HDF5 would read what was never stored as zeros.
    if {tuple(chunk.chunk_offset) for chunk in found} != set(itertools.product(*steps)):
        raise ChunkError("parts of it are missing")
    size = dtype.itemsize * math.prod(chunk_shape)
    largest = size + size // 100 + 4096 if "deflate" in filters else size
    array = np.empty(shape, dtype=dtype)
    for chunk in found:
        if chunk.filter_mask != 0 or not 0 <= chunk.size - CHECKSUM_BYTES <= largest:
            raise ChunkError(WRONG_SIZE)
        _, stored = dataset.id.read_direct_chunk(chunk.chunk_offset)
        values = _unpacked(stored, size, filters, dtype).reshape(chunk_shape)
        place = tuple(
            slice(first, first + step)
            for first, step in zip(chunk.chunk_offset, chunk_shape, strict=True)
        )
        part = array[place]
        # Chunks at the end stick out.
        part[...] = values[tuple(slice(length) for length in part.shape)]
    return array


def _unpacked(
    stored: bytes, size: int, filters: Collection[str], dtype: np.dtype[Any]
) -> NDArray[Any]:
    """The numbers of a chunk of so many bytes, as they follow each other."""
    packed, checksum = stored[:-CHECKSUM_BYTES], stored[-CHECKSUM_BYTES:]
    unpacked = packed
    if "deflate" in filters:
        stream = zlib.decompressobj()
        unpacked = stream.decompress(packed, size + 1)
        if len(unpacked) == size and not stream.eof:
            raise ChunkError("a chunk has no end")
    if len(unpacked) != size:
        raise ChunkError(WRONG_SIZE)
    if fletcher32(packed) != int.from_bytes(checksum, "little"):
        raise ChunkError("a checksum differs")
    if "shuffle" in filters and dtype.itemsize > 1:
        # First bytes of all numbers, second bytes of all, and so on.
        in_rows = np.frombuffer(unpacked, dtype=np.uint8).reshape(dtype.itemsize, -1)
        together = np.empty(in_rows.shape[::-1], dtype=np.uint8)
        # Row by row takes a quarter of the time that copying the transpose does.
        for number, row in enumerate(in_rows):
            together[:, number] = row
        return together.view(dtype).reshape(-1)
    return np.frombuffer(unpacked, dtype=dtype)


def fletcher32(data: bytes) -> int:
    """Fletcher's checksum of 32 bits as HDF5 computes it, of words of two bytes."""
    words = np.frombuffer(data + bytes(len(data) % 2), dtype=">u2")
    total = weighted = 0
    for start in range(0, len(words), _TOGETHER):
        part = words[start : start + _TOGETHER].astype(np.int64)
        # Sum of all sums so far: a word is in its own and in all later ones.
        weighted += total * len(part) + int(part @ _FALLING[-len(part) :])
        total += int(part.sum())
    return _reduced(weighted) << 16 | _reduced(total)


def _reduced(total: int) -> int:
    """A sum modulo 65535, where 65535 stands for multiples of it other than 0."""
    return 0 if total == 0 else (total - 1) % _MODULUS + 1
