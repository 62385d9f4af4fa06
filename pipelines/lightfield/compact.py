"""Compact storage: a scene's photos and depth maps as small as its uses allow.

Localization samples photos of 320 pixels a side and docking ones of 640. Docking needs these
pixels more than their quality: with sharper colours in 320 or 480 pixels it ends farther from the
goal. So photos are undistorted, as all renderers use them, area-averaged to the size of docking
and stored as WebP of low quality; depth maps are reduced to the size of localization, quantised
more coarsely, and predicted within themselves (``depth_storage.differences_of``). What that costs
is measured in ``docs/rendering.md``.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from pipelines.artifacts.processes import in_threads
from pipelines.artifacts.stages import Progress, no_progress
from pipelines.dataset.webp import decode_webp, encode_webp
from pipelines.geometry.camera import Camera, Intrinsics, Undistorter
from pipelines.lightfield.depth_storage import COMPACT_LEVELS, as_stored
from pipelines.lightfield.scene import Compaction, Scene, SceneDepth
from pipelines.lightfield.scene_file import identified
from pipelines.lightfield.views import shrink, shrunk_depth, shrunk_size

STORAGES = ("full", "compact")
# Longer side of photos and of depth maps, pixels.
PHOTO_SIDE, DEPTH_SIDE = 640, 320
# Of WebP, 0 to 100.
QUALITY = 40


class _Photo(NamedTuple):
    """A photo as it is stored, and the mean squared difference of its pixels that this makes."""

    data: bytes
    error: float


def compact_scene(scene: Scene, progress: Progress = no_progress) -> Scene:
    """The same light field with photos and depth maps in compact storage.

    Args:
        scene: with photos and depth maps as recorded or computed.
        progress: told how far the work is.

    Returns:
        A scene of pinhole cameras; its ``compaction`` says what was lost.

    Raises:
        InputError: a photo cannot be decoded.
        StageError: Pillow was built without WebP.
    """
    undistorters = [Undistorter(camera) for camera in scene.cameras]

    def one(index: int) -> _Photo:
        undistorter = undistorters[int(scene.camera_index[index])]
        small, _ = shrink(undistorter(scene.image(index)), undistorter.intrinsics, PHOTO_SIDE)
        data = encode_webp(small, QUALITY)
        decoded = decode_webp(data, scene.image_names[index])
        return _Photo(data, float(np.mean((decoded.astype(np.float64) - small) ** 2)))

    photos = list(progress(in_threads(one, range(len(scene))), "compact photos", len(scene)))
    depth = tuple(map(_compact_depth, scene.depth))
    cameras = tuple(_pinhole_camera(undistorter.intrinsics) for undistorter in undistorters)
    images = tuple(photo.data for photo in photos)
    compact = replace(
        scene,
        encoded_images=images,
        cameras=cameras,
        depth=depth,
        compaction=Compaction(
            recorded_bytes=sum(map(len, scene.encoded_images)),
            photo_psnr=_psnr([photo.error for photo in photos]),
            depth_error=_depth_error(scene.depth, depth),
        ),
    )
    return identified(compact)


def _pinhole_camera(intrinsics: Intrinsics) -> Camera:
    size = shrunk_size(intrinsics.width, intrinsics.height, PHOTO_SIDE)
    small = intrinsics.resized(*size)
    return Camera("PINHOLE", *size, (small.fx, small.fy, small.cx, small.cy))


def _compact_depth(depth: SceneDepth) -> SceneDepth:
    inverse = shrunk_depth(depth.inverse_depth, DEPTH_SIDE)
    size = (inverse.shape[1], inverse.shape[0])
    # The same pixels as of the depth itself.
    confident = cv2.resize(depth.confident.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    return as_stored(inverse, np.asarray(confident, dtype=np.bool_), COMPACT_LEVELS)


def _depth_error(full: Sequence[SceneDepth], compact: Sequence[SceneDepth]) -> float | None:
    """Median over all known pixels of the relative error of depth that quantisation makes."""
    errors = []
    for before, after in zip(full, compact, strict=True):
        expected = shrunk_depth(before.inverse_depth, DEPTH_SIDE)
        known = expected > 0.0
        errors.append(np.abs(after.inverse_depth[known] / expected[known] - 1.0))
    return float(np.median(np.concatenate(errors))) if errors else None


def _psnr(squared_errors: Sequence[float]) -> float:
    """Decibels of the mean over all photos of the mean squared error."""
    return 10.0 * math.log10(255.0**2 / max(float(np.mean(squared_errors)), 1e-9))
