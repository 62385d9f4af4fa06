"""sensor_msgs/Image and CompressedImage: their pixels, and the image file that keeps them.

Sizes are checked before anything is decoded: what a message says of itself is not believed.
OpenCV names a Bayer pattern after the pixels of the second row, ROS after those of the first.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipelines.artifacts.arrays import ImageArray
from pipelines.artifacts.errors import InputError, quoted, reason_of
from pipelines.dataset.images import (
    MAX_IMAGE_BYTES,
    MAX_PIXELS,
    ImageHeader,
    decode_image,
    encode_png,
    image_header,
)

# What CompressedImage.format says of depth images.
_DEPTH_TRANSPORT = "compressedDepth"


@dataclass(frozen=True)
class Encoding:
    """How the pixels of an Image are laid out.

    Attributes:
        dtype: of a sample, without its byte order.
        channels: samples of a pixel; of NV12 and NV21 those of the plane of luminance.
        code: OpenCV's conversion to RGB; None: it is RGB or grey already.
        extra_rows: rows below the image, as a share of its height: the chrominance.
    """

    dtype: str
    channels: int
    code: int | None = None
    extra_rows: float = 0.0


def _encodings() -> dict[str, Encoding]:
    known = {
        "mono8": Encoding("u1", 1),
        "mono16": Encoding("u2", 1),
        "8UC1": Encoding("u1", 1),
        # cv_bridge takes colours without a name for BGR.
        "8UC3": Encoding("u1", 3, cv2.COLOR_BGR2RGB),
        "8UC4": Encoding("u1", 4, cv2.COLOR_BGRA2RGB),
        "uyvy": Encoding("u1", 2, cv2.COLOR_YUV2RGB_UYVY),
        "yuv422": Encoding("u1", 2, cv2.COLOR_YUV2RGB_UYVY),
        "yuyv": Encoding("u1", 2, cv2.COLOR_YUV2RGB_YUYV),
        "yuv422_yuy2": Encoding("u1", 2, cv2.COLOR_YUV2RGB_YUYV),
        "nv12": Encoding("u1", 1, cv2.COLOR_YUV2RGB_NV12, 0.5),
        "nv21": Encoding("u1", 1, cv2.COLOR_YUV2RGB_NV21, 0.5),
    }
    bayer = {
        "rggb": cv2.COLOR_BayerBG2RGB,
        "bggr": cv2.COLOR_BayerRG2RGB,
        "gbrg": cv2.COLOR_BayerGR2RGB,
        "grbg": cv2.COLOR_BayerGB2RGB,
    }
    for bits, dtype in ((8, "u1"), (16, "u2")):
        known[f"rgb{bits}"] = Encoding(dtype, 3)
        known[f"bgr{bits}"] = Encoding(dtype, 3, cv2.COLOR_BGR2RGB)
        known[f"rgba{bits}"] = Encoding(dtype, 4, cv2.COLOR_RGBA2RGB)
        known[f"bgra{bits}"] = Encoding(dtype, 4, cv2.COLOR_BGRA2RGB)
        for pattern, code in bayer.items():
            known[f"bayer_{pattern}{bits}"] = Encoding(dtype, 1, code)
    return known


ENCODINGS = _encodings()
# Distances, not brightness.
DEPTH_ENCODINGS = ("16UC1", "32FC1")
# Pixels: OpenCV leaves the border of smaller Bayer patterns undefined.
SMALLEST_MOSAIC = 4


@dataclass(frozen=True)
class StoredImage:
    """An image as a file of a data set: its content, and what its header says."""

    data: bytes
    header: ImageHeader

    @property
    def suffix(self) -> str:
        """Of the file: ``.jpg`` or ``.png``."""
        return ".jpg" if self.header.format == "JPEG" else ".png"


def is_compressed(message: Any) -> bool:
    """Whether a message is a CompressedImage."""
    return hasattr(message, "format")


def is_depth_image(message: Any) -> bool:
    """Whether an Image or CompressedImage holds distances."""
    if is_compressed(message):
        return _DEPTH_TRANSPORT in str(message.format)
    return str(message.encoding) in DEPTH_ENCODINGS


def message_size(message: Any, name: Path | str) -> tuple[int, int]:
    """Width and height of an Image or CompressedImage, pixels; nothing is decoded.

    Args:
        message: of ROS 1 or 2.
        name: its source, for the error.

    Raises:
        InputError: neither JPEG nor PNG, damaged, or more pixels than any camera has.
    """
    if is_compressed(message):
        header = image_header(_compressed_bytes(message, name), name)
        return header.width, header.height
    return _checked_size(message, name)


def image_of_message(message: Any, name: Path | str) -> ImageArray:
    """Decodes an Image or CompressedImage.

    Args:
        message: of ROS 1 or 2.
        name: its source, for the error.

    Returns:
        ``(height, width, 3)`` RGB; of 16 bits the upper 8.

    Raises:
        InputError: an encoding that lfnav does not know, a message shorter than its image, or a
            damaged image.
    """
    if is_compressed(message):
        data = _compressed_bytes(message, name)
        mosaic = _mosaic(message)
        if mosaic is None:
            return decode_image(data, name)
        return _demosaiced(decode_image(data, name)[:, :, 0], mosaic, name)
    pixels = _pixels(message, name)
    return np.repeat(pixels[:, :, None], 3, axis=2) if pixels.ndim == 2 else pixels


def stored_image(message: Any, name: Path | str) -> StoredImage:
    """The image file that keeps an Image or CompressedImage.

    JPEG and PNG are kept to the byte, once they were seen to be whole. What is not encoded becomes
    a PNG, which is grey where the image is.

    Args:
        message: of ROS 1 or 2.
        name: its source, for the error.

    Raises:
        InputError: as for ``image_of_message``.
    """
    if is_compressed(message) and _mosaic(message) is None:
        data = _compressed_bytes(message, name)
        header = image_header(data, name)
        decode_image(data, name)
        return StoredImage(data, header)
    pixels = image_of_message(message, name) if is_compressed(message) else _pixels(message, name)
    height, width = pixels.shape[:2]
    return StoredImage(encode_png(pixels), ImageHeader("PNG", width, height))


def _checked_size(message: Any, name: Path | str) -> tuple[int, int]:
    width, height = int(message.width), int(message.height)
    if not 0 < width * height <= MAX_PIXELS:
        raise InputError(
            name, f"has {width}x{height} pixels; from 1 to {MAX_PIXELS} in all are allowed"
        )
    return width, height


def _pixels(message: Any, name: Path | str) -> ImageArray:
    """``(height, width, 3)`` RGB or ``(height, width)`` grey, 8 bits."""
    width, height = _checked_size(message, name)
    encoding = _encoding(str(message.encoding), name)
    samples = _samples(message, encoding, width, height, name)
    if samples.dtype.itemsize == 2 and encoding.code is None:
        return _upper_bits(samples)
    if encoding.code is None:
        return np.ascontiguousarray(samples, dtype=np.uint8)
    if encoding.channels == 1 and not encoding.extra_rows:
        return _demosaiced(samples, encoding, name)
    return _converted(samples, encoding.code, name)


def _encoding(text: str, name: Path | str) -> Encoding:
    if text in DEPTH_ENCODINGS:
        raise InputError(name, f"encoding {quoted(text)} is that of depth, not of a camera image")
    if text not in ENCODINGS:
        known = ", ".join(key for key in ENCODINGS if not key.startswith("8U"))
        raise InputError(name, f"encoding {quoted(text)} is not known", f"known are {known}")
    return ENCODINGS[text]


def _samples(
    message: Any, encoding: Encoding, width: int, height: int, name: Path | str
) -> NDArray[Any]:
    """``(rows, width[, channels])`` in the processor's byte order; rows may have a padding."""
    dtype = np.dtype(encoding.dtype)
    rows = height + int(height * encoding.extra_rows)
    used, step = width * encoding.channels * dtype.itemsize, int(message.step)
    data = np.frombuffer(memoryview(message.data), dtype=np.uint8)
    if encoding.code is not None and encoding.channels == 2 and width % 2:
        raise InputError(
            name, f"is {width} pixels wide, and {message.encoding} takes them in pairs"
        )
    if encoding.extra_rows and (width % 2 or height % 2):
        raise InputError(name, f"has {width}x{height} pixels, and {message.encoding} even numbers")
    if step < used:
        raise InputError(
            name,
            f"has rows of {step} bytes, too short for {width} pixels of {message.encoding}",
        )
    # The padding of the last row may be missing.
    if len(data) < step * (rows - 1) + used:
        raise InputError(
            name,
            f"has {len(data)} bytes, too few for {width}x{height} pixels of {message.encoding}",
        )
    lines = np.lib.stride_tricks.as_strided(data, (rows, used), (step, 1), writeable=False)
    samples = np.ascontiguousarray(lines).view(dtype)
    if dtype.itemsize > 1 and bool(message.is_bigendian) != (sys.byteorder == "big"):
        samples = samples.byteswap()
    if encoding.channels == 1:
        return samples
    return samples.reshape(rows, width, encoding.channels)


def _converted(samples: NDArray[Any], code: int, name: Path | str) -> ImageArray:
    try:
        rgb = np.asarray(cv2.cvtColor(samples, code))
    except cv2.error as error:
        raise InputError(name, f"cannot be converted ({reason_of(str(error.err))})") from error
    return np.asarray(rgb, dtype=np.uint8) if rgb.dtype == np.uint8 else _upper_bits(rgb)


def _demosaiced(samples: NDArray[Any], encoding: Encoding, name: Path | str) -> ImageArray:
    """``(H, W, 3)`` RGB of a Bayer pattern ``(H, W)``."""
    height, width = samples.shape
    if min(height, width) < SMALLEST_MOSAIC or encoding.code is None:
        raise InputError(name, f"has {width}x{height} pixels, too few for a Bayer pattern")
    return _converted(samples, encoding.code, name)


def _upper_bits(samples: NDArray[Any]) -> ImageArray:
    return np.asarray(samples >> 8, dtype=np.uint8)


def _compressed_bytes(message: Any, name: Path | str) -> bytes:
    data = memoryview(message.data)
    if data.nbytes > MAX_IMAGE_BYTES:
        raise InputError(name, f"is larger than {MAX_IMAGE_BYTES // 1024**2} MiB")
    if is_depth_image(message):
        raise InputError(name, "is a depth image, not one of a camera")
    return data.tobytes()


def _mosaic(message: Any) -> Encoding | None:
    """The Bayer pattern of a compressed image that was not demosaiced before; else None.

    ``bayer_rggb8; png compressed`` is one, ``bayer_rggb8; jpeg compressed bgr8`` is none.
    """
    original, _, how = str(message.format).partition(";")
    compressed_as = how.partition("compressed")[2].strip()
    pattern = compressed_as or original.strip()
    if not how or not pattern.startswith("bayer_"):
        return None
    return ENCODINGS.get(pattern)
