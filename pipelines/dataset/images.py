"""JPEG and PNG: headers before pixels, strict decoding, nothing larger than a real camera makes.

A PNG of a megabyte can unfold to gigabytes, and a truncated JPEG is half grey where decoders are
lenient; so sizes are checked before anything is decoded, and what is damaged is refused.
"""

import io
import stat
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from pipelines.artifacts.arrays import ImageArray
from pipelines.artifacts.errors import InputError, reason_of

MAX_PIXELS = 100_000_000
MAX_IMAGE_BYTES = 256 * 1024**2
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
# What Pillow calls the formats; MPO is a JPEG with further pictures behind it, as phones write.
_FORMATS = {"JPEG": "JPEG", "MPO": "JPEG", "PNG": "PNG"}
_GREY_16_BIT = ("I;16", "I;16B", "I;16L", "I;16N", "I")
# Pillow's modes, for people.
_MODE_TEXTS = {
    "1": "1-bit black and white",
    "LA": "grey with transparency",
    "P": "a palette of colours",
    "RGB": "in colour",
    "RGBA": "in colour or grey with transparency",
}
# What Pillow raises over damaged files.
DECODING_ERRORS = (
    OSError,
    SyntaxError,
    ValueError,
    TypeError,
    IndexError,
    KeyError,
    EOFError,
    OverflowError,
    struct.error,
    zlib.error,
    Image.DecompressionBombError,
)


@dataclass(frozen=True)
class ImageHeader:
    """What an image file says of itself: ``"JPEG"`` or ``"PNG"``, width and height in pixels."""

    format: str
    width: int
    height: int


def image_header(data: bytes, name: Path | str) -> ImageHeader:
    """The header of an encoded image; no pixel is decoded.

    Args:
        data: the content of an image file.
        name: what to call it in an error.

    Raises:
        InputError: neither JPEG nor PNG, damaged, or more than ``MAX_PIXELS``.
    """
    with _opened(io.BytesIO(data), name) as image:
        return _header_of(image)


def read_image_header(path: Path) -> ImageHeader:
    """The header of an image file, of which only the beginning is read.

    Raises:
        InputError: unreadable, neither JPEG nor PNG, damaged, or more than ``MAX_PIXELS``.
    """
    _check_file(path)
    try:
        with path.open("rb") as file, _opened(file, path) as image:
            return _header_of(image)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror or error})") from error


def decode_image(data: bytes, name: Path | str) -> ImageArray:
    """Decodes a JPEG or PNG.

    Grey images become RGB, 16-bit ones keep their upper 8 bits, transparency is dropped, CMYK is
    converted. The orientation in EXIF data is ignored, as COLMAP does.

    Args:
        data: the content of an image file.
        name: what to call it in an error.

    Returns:
        ``(H, W, 3)`` RGB.

    Raises:
        InputError: neither JPEG nor PNG, more than ``MAX_PIXELS``, truncated or damaged.
    """
    image = _decoded(data, name)
    if image.mode in _GREY_16_BIT:
        # Pillow would clip at 255 where the other decoders scale.
        grey = (np.asarray(image).astype(np.int64) >> 8).clip(0, 255).astype(np.uint8)
        return np.repeat(grey[:, :, None], 3, axis=2)
    try:
        if image.mode == "P":
            image = image.convert("RGBA")
        # Pillow would convert what is RGB already into a copy.
        return np.array(image if image.mode == "RGB" else image.convert("RGB"), dtype=np.uint8)
    except Exception as error:  # a pixel beyond the palette, for one: whatever Pillow raises
        reason = f"is a damaged or truncated image ({reason_of(error)})"
        raise InputError(name, reason) from error


def decode_depth(data: bytes, name: Path | str) -> NDArray[np.uint16]:
    """Decodes a depth image, a 16-bit grey PNG.

    Args:
        data: the content of the file.
        name: what to call it in an error.

    Returns:
        ``(H, W)``, 0 where the depth is unknown; divided by the data set's scale it is metres.

    Raises:
        InputError: no image, more than ``MAX_PIXELS``, damaged, or not 16-bit grey.
    """
    image = _decoded(data, name)
    if image.mode not in _GREY_16_BIT:
        raise InputError(name, f"is no depth image: mode {image.mode} instead of 16-bit grey")
    return np.asarray(image).astype(np.uint16)


def decode_grey(data: bytes, name: Path | str) -> ImageArray:
    """Decodes a picture in 8-bit grey, such as a mask; its values are what the file says.

    Args:
        data: the content of the file.
        name: what to call it in an error.

    Returns:
        ``(H, W)``.

    Raises:
        InputError: no image, more than ``MAX_PIXELS``, damaged, or with colours, a palette,
            transparency or another depth.
    """
    with _opened(io.BytesIO(data), name) as image:
        kind = "RGBA" if "transparency" in image.info else str(image.mode)
    if kind != "L":
        found = "16-bit grey" if kind in _GREY_16_BIT else _MODE_TEXTS.get(kind, f"mode {kind}")
        raise InputError(name, f"is {found}, not 8-bit grey", "save it as an 8-bit grey PNG")
    return np.array(_decoded(data, name), dtype=np.uint8)


def read_image_bytes(path: Path) -> bytes:
    """The content of an image file, still encoded.

    Raises:
        InputError: not a file, unreadable, empty, or larger than ``MAX_IMAGE_BYTES``.
    """
    _check_file(path)
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror or error})") from error


def encode_png(image: ImageArray) -> bytes:
    """A PNG of an RGB image ``(H, W, 3)`` or a grey one ``(H, W)``."""
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "PNG")
    return buffer.getvalue()


def encode_jpeg(image: ImageArray, quality: int = 95) -> bytes:
    """A JPEG of an RGB image ``(H, W, 3)`` or a grey one ``(H, W)``; ``quality`` 1 to 95."""
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "JPEG", quality=quality)
    return buffer.getvalue()


def encode_depth(depth: NDArray[np.uint16]) -> bytes:
    """A 16-bit grey PNG of a depth image ``(H, W)``; ``decode_depth`` reads it back."""
    buffer = io.BytesIO()
    Image.fromarray(depth).save(buffer, "PNG")
    return buffer.getvalue()


def _check_file(path: Path) -> None:
    """Regular files of a sane size only: reading a named pipe would wait for ever."""
    try:
        status = path.stat()
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror or error})") from error
    if not stat.S_ISREG(status.st_mode):
        raise InputError(path, "is not a file")
    if status.st_size == 0:
        raise InputError(path, "is empty")
    if status.st_size > MAX_IMAGE_BYTES:
        raise InputError(path, f"is larger than {MAX_IMAGE_BYTES // 1024**2} MiB")


def _opened(file: IO[bytes], name: Path | str) -> Any:
    """Pillow's image with its header read and checked, its pixels not yet decoded."""
    try:
        image = Image.open(file, formats=("JPEG", "PNG"))
    except UnidentifiedImageError as error:
        raise InputError(name, "is neither a JPEG nor a PNG image, or is damaged") from error
    except Image.DecompressionBombError as error:
        raise InputError(name, f"has more than {MAX_PIXELS} pixels") from error
    except DECODING_ERRORS as error:
        raise InputError(name, f"is a damaged image ({reason_of(error)})") from error
    width, height = image.size
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise InputError(
            name, f"has {width}x{height} pixels; from 1 to {MAX_PIXELS} in all are allowed"
        )
    return image


def _header_of(image: Image.Image) -> ImageHeader:
    return ImageHeader(_FORMATS[str(image.format)], image.width, image.height)


def _decoded(data: bytes, name: Path | str) -> Image.Image:
    image: Image.Image = _opened(io.BytesIO(data), name)
    try:
        if image.format == "PNG":
            # Decoding alone does not look at the checksums of the pixel data.
            image.verify()
            image = _opened(io.BytesIO(data), name)
        image.load()
    except DECODING_ERRORS as error:
        raise InputError(name, f"is a damaged or truncated image ({reason_of(error)})") from error
    return image
