"""Photos: headers before pixels, strict decoding, nothing larger than a real camera makes.

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

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from pipelines.artifacts.arrays import ImageArray
from pipelines.artifacts.errors import InputError, reason_of

MAX_PIXELS = 100_000_000
MAX_IMAGE_BYTES = 256 * 1024**2
# Of a WebP, whose decoder holds several copies of all that it claims as soon as it is opened.
MAX_WEBP_PIXELS = 64_000_000
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp")
# What Pillow calls the formats; MPO is a JPEG with further pictures behind it, as phones write.
_FORMATS = {"JPEG": "JPEG", "MPO": "JPEG", "PNG": "PNG", "TIFF": "TIFF", "WEBP": "WEBP"}
_OPENED = ("JPEG", "PNG", "TIFF", "WEBP")
_GREY_16_BIT = ("I;16", "I;16B", "I;16L", "I;16N", "I")
# Bits that cameras have where 16 are stored.
_BIT_DEPTHS = (8, 10, 12, 14, 16)
# EXIF orientation -> the direction in the image as stored, x right and y down, that is up.
_UP = {3: (0, 1), 4: (0, 1), 5: (-1, 0), 6: (-1, 0), 7: (1, 0), 8: (1, 0)}
_UPRIGHT = (0, -1)
_TURNED = (5, 6, 7, 8)
_WIDTH_TAG, _HEIGHT_TAG, _ORIENTATION_TAG, _SHORT = 0x0100, 0x0101, 0x0112, 3
CONVERT = "convert it to JPEG"
# The brand of a file of HEIC's family -> what it is.
_BRANDS = {b"avif": "AVIF", b"avis": "AVIF", b"crx ": "raw"}
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
    """What an image file says of itself.

    Attributes:
        format: ``"JPEG"``, ``"PNG"``, ``"TIFF"`` or ``"WEBP"``.
        width, height: pixels, as stored.
        up: direction in the image as stored, x right and y down, that its EXIF orientation calls
            up; ``(0, -1)`` where it says nothing.
        bits: stored for each value, 8 or 16.
    """

    format: str
    width: int
    height: int
    up: tuple[int, int] = _UPRIGHT
    bits: int = 8

    @property
    def is_plain(self) -> bool:
        """Whether every program that reads photos reads this one, and sees the same."""
        return self.format in ("JPEG", "PNG") and self.bits == 8


def image_header(data: bytes, name: Path | str) -> ImageHeader:
    """The header of an encoded image; no pixel is decoded.

    Args:
        data: the content of an image file.
        name: what to call it in an error.

    Raises:
        InputError: no format that is read, damaged, or more than ``MAX_PIXELS``.
    """
    with _opened(io.BytesIO(data), name) as image:
        return _header_of(image)


def read_image_header(path: Path) -> ImageHeader:
    """The header of an image file, of which only the beginning is read.

    Raises:
        InputError: unreadable, no format that is read, damaged, or more than ``MAX_PIXELS``.
    """
    _check_file(path)
    try:
        with path.open("rb") as file, _opened(file, path) as image:
            return _header_of(image)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror or error})") from error


def decode_image(data: bytes, name: Path | str) -> ImageArray:
    """Decodes a JPEG, PNG, TIFF or WebP.

    Grey images become RGB, transparency is dropped, CMYK is converted, of several pages the first
    is taken. The orientation in EXIF data turns no pixel, as in COLMAP (``ImageHeader.up``).

    Where 16 bits are stored, the camera is taken for one of 8, 10, 12, 14 or 16 bits: the fewest
    that hold the image's largest value. Of these the upper 8 are kept.

    Args:
        data: the content of an image file.
        name: what to call it in an error.

    Returns:
        ``(H, W, 3)`` RGB.

    Raises:
        InputError: no format that is read, more than ``MAX_PIXELS``, truncated, damaged, or with
            values that are no whole numbers.
    """
    image, bits = _decoded(data, name)
    if image.mode in _GREY_16_BIT:
        # Pillow would clip at 255 where the other decoders scale.
        grey = _in_8_bits(np.asarray(image).astype(np.int64).clip(0, 0xFFFF))
        return np.repeat(grey[:, :, None], 3, axis=2)
    if image.mode == "F":
        raise InputError(name, "holds fractions instead of 8 or 16 bits", "save it as a PNG")
    colours = _colour_16_bit(data, image.size) if bits == 16 else None
    if colours is not None:
        return _in_8_bits(colours)
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
    image, _ = _decoded(data, name)
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
    return np.array(_decoded(data, name)[0], dtype=np.uint8)


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


def _in_8_bits(values: NDArray[np.int64]) -> ImageArray:
    """Values from 0 to 65535 by the rule of ``decode_image``."""
    largest = int(values.max())
    bits = next(bits for bits in _BIT_DEPTHS if largest < 1 << bits)
    return np.asarray(values >> (bits - 8), dtype=np.uint8)


def _colour_16_bit(data: bytes, size: tuple[int, int]) -> NDArray[np.int64] | None:
    """RGB values ``(H, W, 3)`` of a whole image of this width and height; None: cannot be told.

    Pillow keeps the upper 8 bits of these alone.
    """
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint16 or image.shape[1::-1] != size:
        return None
    return None if image.ndim != 3 or image.shape[2] < 3 else image[:, :, 2::-1].astype(np.int64)


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
    start = file.read(30)
    if _webp_pixels(start) > MAX_WEBP_PIXELS:
        raise InputError(name, f"is a WebP of more than {MAX_WEBP_PIXELS} pixels", CONVERT)
    file.seek(0)
    try:
        image = Image.open(file, formats=_OPENED)
    except UnidentifiedImageError as error:
        raise _unidentified(start, name) from error
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


def _webp_pixels(start: bytes) -> int:
    """Pixels that a WebP claims by the first 30 bytes of its file (RFC 9649); 0 of other files."""
    if len(start) < 30 or start[:4] != b"RIFF" or start[8:12] != b"WEBP":
        return 0
    if start[12:16] == b"VP8X":
        width, height = (1 + int.from_bytes(start[at : at + 3], "little") for at in (24, 27))
    elif start[12:16] == b"VP8L":
        sizes = int.from_bytes(start[21:25], "little")
        width, height = 1 + (sizes & 0x3FFF), 1 + (sizes >> 14 & 0x3FFF)
    else:
        width, height = (int.from_bytes(start[at : at + 2], "little") & 0x3FFF for at in (26, 28))
    return width * height


def _unidentified(start: bytes, name: Path | str) -> InputError:
    """The error of a file that is no photo; those that phones and cameras make are named."""
    if start[4:8] == b"ftyp":
        kind = _BRANDS.get(start[8:12], "HEIC")
        return InputError(name, f"is a {kind} image, which is not read", CONVERT)
    return InputError(name, "is neither a JPEG, PNG, TIFF nor WebP image, or is damaged")


def _header_of(image: Any) -> ImageHeader:
    format_name, bits = _FORMATS[str(image.format)], _bits(image)
    if format_name != "TIFF":
        up = _UP.get(_orientation(image), _UPRIGHT)
        return ImageHeader(format_name, image.width, image.height, up, bits)
    # What reads a TIFF turns it as it says; Pillow has done so since version 11.
    stored = image.tag_v2.get(_WIDTH_TAG), image.tag_v2.get(_HEIGHT_TAG)
    width, height = image.size
    if image.tag_v2.get(_ORIENTATION_TAG) in _TURNED and stored == (width, height):
        width, height = height, width
    return ImageHeader(format_name, width, height, bits=bits)


def _bits(image: Any) -> int:
    """Bits that are stored for a value: 16 where the raw mode that Pillow unpacks says so."""
    raw = image.tile[0][3] if image.tile else ""
    raw = raw if isinstance(raw, str) else str(raw[0]) if raw else ""
    return 16 if ";16" in raw or image.mode in _GREY_16_BIT else 8


def _orientation(image: Any) -> int:
    """EXIF orientation, 1 where there is none. Read here, as Pillow warns of damaged EXIF data."""
    content = image.info.get("exif")
    if not isinstance(content, bytes):
        return 1
    content = content.removeprefix(b"Exif\0\0")
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(content[:4])
    if order is None:
        return 1
    try:
        (start,) = struct.unpack_from(f"{order}I", content, 4)
        (count,) = struct.unpack_from(f"{order}H", content, start)
        for row in range(count):
            entry = struct.unpack_from(f"{order}HHIH", content, start + 2 + 12 * row)
            if entry[:3] == (_ORIENTATION_TAG, _SHORT, 1):
                return int(entry[3])
    except struct.error:
        pass
    return 1


def _decoded(data: bytes, name: Path | str) -> tuple[Image.Image, int]:
    """Pillow's image, and how many bits are stored for a value."""
    image: Image.Image = _opened(io.BytesIO(data), name)
    bits = _bits(image)
    try:
        if image.format == "PNG":
            # Decoding alone does not look at the checksums of the pixel data.
            image.verify()
            image = _opened(io.BytesIO(data), name)
        image.load()
        if image.format == "TIFF":
            image = ImageOps.exif_transpose(image)
    except DECODING_ERRORS as error:
        raise InputError(name, f"is a damaged or truncated image ({reason_of(error)})") from error
    return image, bits
