"""A photo by itself: its pixels the right way up, and the camera that took it.

Phones store a picture as the sensor lay and say in the EXIF data how it was held; and they say the
focal length, as that of a 35-mm camera with the same view. Both are read here, and nothing else.
"""

import io
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image

from pipelines.artifacts.arrays import ImageArray
from pipelines.artifacts.errors import InputError
from pipelines.dataset.camera_file import read_camera_file
from pipelines.dataset.images import DECODING_ERRORS, decode_image, encode_png, read_image_bytes
from pipelines.geometry.camera import Camera

# The diagonal of a frame of 35-mm film, 36 x 24 mm, by which equivalent focal lengths are stated.
FILM_DIAGONAL = math.hypot(36.0, 24.0)
# Millimetres: shorter and longer ones are no lens but a wrong entry.
SHORTEST_FOCAL, LONGEST_FOCAL = 5.0, 2000.0

# EXIF's orientation -> what puts an image the right way up; of all others it is already.
UPRIGHT: Mapping[int, Callable[[ImageArray], ImageArray]] = {
    2: np.fliplr,
    3: lambda image: np.rot90(image, 2),
    4: np.flipud,
    5: lambda image: np.swapaxes(image, 0, 1),
    6: lambda image: np.rot90(image, -1),
    7: lambda image: np.rot90(np.swapaxes(image, 0, 1), 2),
    8: lambda image: np.rot90(image, 1),
}


@dataclass(frozen=True)
class SinglePhoto:
    """A photo and its camera.

    Attributes:
        name: of the file.
        image: ``(height, width, 3)`` RGB, the right way up.
        encoded: a JPEG or PNG of ``image``: the file itself where it was stored so.
        camera: of ``image``.
        camera_source: where the camera is from, for people.
        is_rough: whether the focal length is good to some percent only.
    """

    name: str
    image: ImageArray
    encoded: bytes
    camera: Camera
    camera_source: str
    is_rough: bool = False


def read_photo(path: Path, camera_file: Path | None, known: Sequence[Camera]) -> SinglePhoto:
    """Reads a photo and finds its camera.

    Args:
        path: JPEG or PNG.
        camera_file: a ``camera.toml`` of the photo the right way up; None: the camera is that of
            the photo's EXIF data, else the only one of ``known`` with images of this size.
        known: cameras that are likely, such as the map's.

    Raises:
        InputError: a file cannot be read, the camera has images of another size, or nothing says
            which camera it was.
    """
    data = read_image_bytes(path)
    image = decode_image(data, path)
    exif = _exif(data)
    turned = UPRIGHT.get(exif.get(ExifTags.Base.Orientation, 1))
    if turned is not None:
        image = np.ascontiguousarray(turned(image))
        data = encode_png(image)
    height, width = image.shape[:2]
    if camera_file is not None:
        camera, source = read_camera_file(camera_file).camera, camera_file.name
        if (camera.width, camera.height) != (width, height):
            raise InputError(
                camera_file,
                f"is of images of {camera.width}x{camera.height} pixels, and {path.name} has "
                f"{width}x{height} the right way up",
            )
        return SinglePhoto(path.name, image, data, camera, source)
    focal = focal_length(exif, width, height)
    alike = list({c for c in known if (c.width, c.height) == (width, height)})
    if len(alike) == 1 and (focal is None or _is_about(alike[0].intrinsics.fx, focal)):
        return SinglePhoto(path.name, image, data, alike[0], "the map's, of the same size")
    if focal is None:
        raise InputError(
            path,
            "does not say its focal length, and the map was taken by other cameras",
            "give its camera.toml with --camera",
        )
    camera = Camera(
        "SIMPLE_PINHOLE", width, height, (focal, (width - 1.0) / 2.0, (height - 1.0) / 2.0)
    )
    return SinglePhoto(path.name, image, data, camera, "EXIF data", is_rough=True)


def focal_length(exif: Image.Exif, width: int, height: int) -> float | None:
    """The focal length in pixels that EXIF data state; None where they state none that can be.

    Args:
        exif: of the photo.
        width, height: of it, pixels.
    """
    value = exif.get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.FocalLengthIn35mmFilm)
    try:
        millimetres = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    if not SHORTEST_FOCAL <= millimetres <= LONGEST_FOCAL:
        return None
    return millimetres / FILM_DIAGONAL * math.hypot(width, height)


def _is_about(focal: float, stated: float) -> bool:
    """Whether a calibrated focal length is the stated one, which is rounded to millimetres."""
    return abs(focal / stated - 1.0) < 0.1


def _exif(data: bytes) -> Image.Exif:
    """EXIF data of a picture; empty where there are none, or none that can be read."""
    try:
        # Pillow warns of what it cannot read.
        with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(data)) as image:
            exif = image.getexif()
            exif.get_ifd(ExifTags.IFD.Exif)
            return exif
    except DECODING_ERRORS:
        return Image.Exif()
