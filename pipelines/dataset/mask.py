"""A mask: which pixels of a camera show the scene.

A robot's bumper, the bars beside a narrow picture, or the rim of a fisheye lens are in every image.
``mask.png`` says where, in COLMAP's convention: 0 where a pixel is not to be used.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from pipelines.artifacts.arrays import BoolArray, ImageArray
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.provenance import sha256_of_bytes
from pipelines.dataset.images import decode_grey, encode_png, image_header, read_image_bytes

MASK_FILE = "mask.png"
# A camera of which less remains tells no place from another; such a mask is a mistake.
SMALLEST_USED_SHARE = 0.05
# A pixel of a reduced image is used when the mask leaves more than this share of it.
FULLY_USED = 0.99


@dataclass(frozen=True)
class Mask:
    """A mask as it was read.

    Attributes:
        path: its file.
        used: ``(H, W)``, True where the camera's image, as recorded, is to be used.
        sha256: of the file.
    """

    path: Path
    used: BoolArray
    sha256: str

    @property
    def left_out(self) -> float:
        """Share of the image that is not used, 0 to 1."""
        return 1.0 - float(self.used.mean())

    @property
    def text(self) -> str:
        """How much it leaves out, for people."""
        return f"{100.0 * self.left_out:.0f} % of the image left out"

    def encoded(self) -> bytes:
        """A PNG of it: 0 where not used, else 255."""
        grey: ImageArray = np.where(self.used, np.uint8(255), np.uint8(0))
        return encode_png(grey)


def read_mask(path: Path, size: tuple[int, int], whose: str) -> Mask:
    """Reads and checks a mask.

    Args:
        path: of the file.
        size: width and height that it must have, pixels.
        whose: what has this size, for the error, with its verb: ``"camera.toml says"``.

    Raises:
        InputError: it is missing, no PNG in 8-bit grey, damaged, of another size, or leaves less
            than ``SMALLEST_USED_SHARE`` of the image.
    """
    data = read_image_bytes(path)
    header = image_header(data, path)
    if header.format != "PNG":
        raise InputError(path, f"is a {header.format}, not a PNG", "masks are 8-bit grey PNGs")
    if (header.width, header.height) != size:
        raise InputError(
            path,
            f"is {header.width}x{header.height} pixels, {whose} {size[0]}x{size[1]}",
            "a mask has a pixel for each of the recorded image",
        )
    used = np.asarray(decode_grey(data, path) != 0)
    share = float(used.mean())
    if share < SMALLEST_USED_SHARE:
        left = "no pixel" if share == 0.0 else f"{share:.1%} of the pixels"
        raise InputError(
            path,
            f"leaves {left} to be used, less than {SMALLEST_USED_SHARE:.0%}",
            "0 means not to be used, anything else used",
        )
    return Mask(path, used, sha256_of_bytes(data))


def used_in_small(used: BoolArray | None, width: int, height: int) -> BoolArray:
    """Which pixels of a reduced image are used, ``(height, width)``.

    Args:
        used: ``(H, W)``, True where the image is used; None: everywhere.
        width: of the reduced image, pixels.
        height: of the reduced image, pixels.
    """
    if used is None:
        return np.ones((height, width), dtype=np.bool_)
    size = (width, height)
    shares = cv2.resize(used.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return np.asarray(shares > FULLY_USED, dtype=np.bool_)
