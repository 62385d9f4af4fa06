"""WebP, of which only the plain kind is read: one lossy picture, nothing beside it.

Scene models store photos in it (``lightfield.compact``). The container is checked here, byte for
byte, before a decoder sees it: decoders allocate the canvas that a file claims, of up to
16383x16383 pixels, when they open it. Photos of a data set may be of any kind of WebP (``images``).
"""

import io
import struct
from pathlib import Path

import numpy as np
from PIL import Image, features

from pipelines.artifacts.arrays import ImageArray
from pipelines.artifacts.errors import InputError, StageError, reason_of
from pipelines.dataset.images import DECODING_ERRORS, MAX_PIXELS, ImageHeader

# Of the file: "RIFF", size of the rest, "WEBP", "VP8 ", size of the frame.
_CONTAINER = struct.Struct("<4sI4s4sI")
# Of the frame (RFC 6386, section 9.1): tag, start code, width and height with a scale each.
_FRAME = struct.Struct("<3s3sHH")
_START_CODE = b"\x9d\x01\x2a"
_KEY_FRAME_BIT, _SIZE_BITS = 1, 0x3FFF
# The slowest search for the smallest file.
_EFFORT = 6


def check_webp() -> None:
    """Checks that Pillow can read and write WebP.

    Raises:
        StageError: it was built without.
    """
    if not features.check("webp"):
        raise StageError(
            "compact scenes need a Pillow with WebP, and this one was built without; "
            "install one of Pillow's own wheels (pip install --force-reinstall pillow)"
        )


def webp_header(data: bytes, name: Path | str) -> ImageHeader:
    """The header of a plain lossy WebP file; no pixel is decoded and nothing allocated.

    Args:
        data: the content of the file.
        name: what to call it in an error.

    Raises:
        InputError: another format; truncated, or with something behind the picture; lossless,
            animated, with transparency or metadata; no pixels, or more than ``MAX_PIXELS``.
    """
    if len(data) < _CONTAINER.size or data[:4] != b"RIFF" or data[8:12] != b"WEBP":
        raise InputError(name, "is no WebP image, or is damaged")
    _, file_size, _, kind, frame_size = _CONTAINER.unpack_from(data)
    if kind != b"VP8 ":
        raise InputError(name, "is a WebP image of another kind than one plain lossy picture")
    # Chunks have even sizes.
    padded = frame_size + frame_size % 2
    if len(data) != _CONTAINER.size + padded or file_size != len(data) - 8:
        raise InputError(name, "is a damaged or truncated WebP image (wrong size)")
    if frame_size < _FRAME.size:
        raise InputError(name, "is a damaged WebP image (no frame)")
    tag, start, width, height = _FRAME.unpack_from(data, _CONTAINER.size)
    if start != _START_CODE or tag[0] & _KEY_FRAME_BIT:
        raise InputError(name, "is a damaged WebP image (no frame)")
    width, height = width & _SIZE_BITS, height & _SIZE_BITS
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise InputError(
            name, f"has {width}x{height} pixels; from 1 to {MAX_PIXELS} in all are allowed"
        )
    return ImageHeader("WEBP", width, height)


def decode_webp(data: bytes, name: Path | str) -> ImageArray:
    """Decodes a plain lossy WebP file.

    Args:
        data: the content of the file.
        name: what to call it in an error.

    Returns:
        ``(H, W, 3)`` RGB.

    Raises:
        InputError: as ``webp_header``, or the picture is damaged.
        StageError: Pillow was built without WebP.
    """
    check_webp()
    header = webp_header(data, name)
    try:
        with Image.open(io.BytesIO(data), formats=("WEBP",)) as image:
            image.load()
            pixels = np.array(image, dtype=np.uint8)
    except DECODING_ERRORS as error:
        raise InputError(name, f"is a damaged WebP image ({reason_of(error)})") from error
    if pixels.shape != (header.height, header.width, 3):
        raise InputError(name, f"is a damaged WebP image (decoded to {pixels.shape})")
    return pixels


def encode_webp(image: ImageArray, quality: int) -> bytes:
    """A plain lossy WebP file of an RGB image ``(H, W, 3)``.

    Args:
        image: at most 16383 pixels a side.
        quality: 0 to 100.

    Raises:
        StageError: Pillow was built without WebP.
    """
    check_webp()
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "WEBP", quality=quality, method=_EFFORT)
    return buffer.getvalue()
