"""A limit to what ``rosbags`` decompresses: a chunk of a megabyte can unfold to gigabytes.

``rosbags`` believes the sizes in a bag. While a bag is open its tables of decompressors hold those
of this module, which stop where more comes out than a chunk may have.
"""

import bz2
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace, TracebackType
from typing import Any, BinaryIO

from pipelines.dataset.images import MAX_IMAGE_BYTES

# A chunk is closed with the message that fills it, and a message may be an image.
MAX_CHUNK_BYTES = MAX_IMAGE_BYTES + 64 * 1024**2
# What stays free on the disk when a compressed file of a bag is unpacked there.
FREE_DISK_BYTES = 1024**3


@contextmanager
def limited_decompression() -> Iterator[None]:
    """Within the block ``rosbags`` raises ``ValueError`` over what unfolds to too much."""
    import lz4.frame
    from rosbags.rosbag1 import reader as rosbag1
    from rosbags.rosbag2 import reader as rosbag2
    from rosbags.rosbag2 import storage_mcap

    storage: Any = storage_mcap
    zstd = storage.zstd
    bz2_limited = _limited(bz2.BZ2Decompressor)
    lz4_limited = _limited(lz4.frame.LZ4FrameDecompressor)
    zstd_limited = _limited(zstd.ZstdDecompressor)
    chunks, mcap_chunks = dict(rosbag1.decompressors), dict(storage_mcap.DECOMPRESSORS)
    rosbag1.decompressors.update(bz2=bz2_limited, lz4=lz4_limited)
    storage_mcap.DECOMPRESSORS.update(lz4=lz4_limited, zstd=zstd_limited)
    module: Any = rosbag2
    module.zstd = SimpleNamespace(
        decompress=zstd_limited, open=lambda file, _: _UnpackedFile(zstd.open(file, "rb"))
    )
    try:
        yield
    finally:
        rosbag1.decompressors.update(chunks)
        storage_mcap.DECOMPRESSORS.update(mcap_chunks)
        module.zstd = zstd


def _limited(new_decompressor: Callable[[], Any]) -> Callable[..., bytes]:
    """A function that decompresses one or more streams, to so many bytes in all at most."""

    def decompress(data: bytes, size: int = MAX_CHUNK_BYTES) -> bytes:
        limit = min(size, MAX_CHUNK_BYTES)
        parts: list[bytes] = []
        left = limit
        while data:
            decompressor = new_decompressor()
            parts.append(decompressor.decompress(data, left + 1))
            left -= len(parts[-1])
            if left < 0:
                raise ValueError(f"compressed data unfolds to more than {limit} bytes")
            if not decompressor.eof:
                raise ValueError("compressed data is cut off")
            data = decompressor.unused_data or b""
        return parts[0] if len(parts) == 1 else b"".join(parts)

    return decompress


class _UnpackedFile:
    """A compressed file of a bag that is unpacked to disk, which it may not fill."""

    def __init__(self, file: BinaryIO) -> None:
        self.file = file
        self.left = shutil.disk_usage(tempfile.gettempdir()).free - FREE_DISK_BYTES

    def read(self, size: int) -> bytes:
        """The next bytes, as ``shutil.copyfileobj`` asks for them."""
        data = self.file.read(size)
        self.left -= len(data)
        if self.left < 0:
            raise ValueError(f"unpacked into {tempfile.gettempdir()} it would fill the disk")
        return data

    def __enter__(self) -> "_UnpackedFile":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.file.close()
