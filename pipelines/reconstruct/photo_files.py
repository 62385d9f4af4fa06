"""The files of photos as structure from motion takes them: of one camera, as COLMAP reads them.

Portrait and landscape photos of one camera are two cameras with one focal length to whatever comes
after. To COLMAP they are one: photos that lie across the first are turned by a quarter before, and
the model is turned back. Which way does not matter where the principal point is the image centre.
"""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dataset.images import (
    ImageHeader,
    decode_image,
    encode_png,
    read_image_bytes,
    read_image_header,
)
from pipelines.geometry.camera import CAMERA_MODELS, Camera
from pipelines.reconstruct.colmap_model import ColmapModel

# From the camera of a turned photo to that of the photo as it is: x is -y there, y is x.
QUARTER = np.array([[0.0, -1.0, 0, 0], [1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]])


def place_photo(source: Path, folder: Path, name: str, size: tuple[int, int]) -> tuple[str, bool]:
    """Puts a photo into a folder: a link, or an 8-bit PNG where it has to be turned or converted.

    Args:
        source: the photo.
        folder: existing.
        name: of its file there, without suffix.
        size: width and height that it has to have, if need be turned.

    Returns:
        The name with its suffix, and whether the photo was turned.

    Raises:
        InputError: the photo cannot be read.
    """
    header = read_image_header(source)
    is_turned = (header.width, header.height) != size
    if header.is_plain and not is_turned:
        # By what it is, whatever it is called: COLMAP goes by the suffix.
        name += _suffix(header, source)
        (folder / name).symlink_to(source.resolve())
        return name, False
    image = decode_image(read_image_bytes(source), source)
    name += ".png"
    (folder / name).write_bytes(encode_png(np.rot90(image) if is_turned else image))
    return name, is_turned


def _suffix(header: ImageHeader, source: Path) -> str:
    suffix = source.suffix.lower()
    allowed = (".jpg", ".jpeg") if header.format == "JPEG" else (".png",)
    return suffix if suffix in allowed else allowed[0]


def turned_back(model: ColmapModel, turned: Collection[str]) -> ColmapModel:
    """A model in which photos that were turned are again as they are, with a camera of their own.

    Args:
        model: of one camera without tangential distortion.
        turned: names of the photos that ``place_photo`` turned.
    """
    if not any(image.name in turned for image in model.images):
        return model
    ((number, camera),) = model.cameras.items()
    own = number + 1
    images = tuple(
        replace(
            image,
            camera=own,
            camera_from_world=QUARTER @ image.camera_from_world,
            keypoints=_turned_pixels(image.keypoints, camera.height),
        )
        if image.name in turned
        else image
        for image in model.images
    )
    used = {image.camera for image in images}
    cameras = {number: camera, own: _turned_camera(camera)}
    return replace(model, cameras={n: cameras[n] for n in sorted(used)}, images=images)


def _turned_pixels(pixels: FloatArray, height: int) -> FloatArray:
    """Pixels ``(K, 2)`` of a turned photo of so many rows in the photo as it is."""
    return np.column_stack([height - 1.0 - pixels[:, 1], pixels[:, 0]])


def _turned_camera(camera: Camera) -> Camera:
    named = dict(zip(CAMERA_MODELS[camera.model], camera.params, strict=True))
    named["cx"], named["cy"] = camera.height - 1.0 - named["cy"], named["cx"]
    return Camera(camera.model, camera.height, camera.width, tuple(named.values()))
