"""Held-out photos, each with a light field that does not hold it."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray
from pipelines.artifacts.errors import InputError
from pipelines.dataset.dataset import CAMERA_FILE, GROUNDTRUTH_FILE, Dataset
from pipelines.dataset.pairing import pair_images
from pipelines.geometry.camera import Intrinsics, Undistorter
from pipelines.geometry.interpolation import MAX_GAP
from pipelines.geometry.trajectory import read_tum
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.views import Views, without_view

# Recording positions that leave a plane (or a line) by less than this share of their extent lie in
# it; those nearer to the border of their hull lie on it.
FLATNESS = 0.02

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class HeldOut:
    """A photo that a light field does not hold, where it was taken, and the light field.

    Attributes:
        image: ``(H, W, 3)`` RGB, undistorted.
        intrinsics: of its camera.
        world_from_camera: ``(4, 4)``.
        views: the light field.
    """

    image: ImageArray
    intrinsics: Intrinsics
    world_from_camera: FloatArray
    views: Views


def views_one_by_one(scene: Scene, views: Views, chosen: Sequence[int]) -> Iterator[HeldOut]:
    """The chosen views of a scene, each with the light field of all others."""
    for index in chosen:
        yield HeldOut(
            np.ascontiguousarray(views.level(index, 0)),
            views.intrinsics[index],
            scene.world_from_camera[index],
            without_view(views, index),
        )


def posed_photos(
    dataset: Dataset, poses: Path | None, max_gap: float = MAX_GAP
) -> tuple[Dataset, FloatArray]:
    """The photos of a data set that have a pose in a TUM file or in its ground truth.

    Args:
        dataset: the photos.
        poses: the file; None: the ground truth.
        max_gap: seconds between the two poses around a photo at most.

    Returns:
        Those photos, and world_from_camera of each, ``(N, 4, 4)``.

    Raises:
        InputError: the data set has no camera, or no poses at its photos.
    """
    if dataset.camera is None:
        raise InputError(dataset.root / CAMERA_FILE, "is missing: the photos' camera must be known")
    source = dataset.root / GROUNDTRUTH_FILE if poses is None else poses
    missing = "is missing: poses are needed to render at"
    trajectory = dataset.true_poses(missing, "--poses") if poses is None else read_tum(poses)
    found = pair_images(dataset, trajectory, source, max_gap)
    for note in found.notes:
        _log.warning("%s", note)
    photos = dataset.part(found.image_index.tolist())
    return photos, found.world_from_body @ dataset.body_from_camera


def photos_of_dataset(
    dataset: Dataset, camera_poses: FloatArray, views: Views
) -> Iterator[HeldOut]:
    """The photos of a data set, each with the light field.

    Args:
        dataset: the photos, as ``posed_photos`` returns them.
        camera_poses: ``(N, 4, 4)`` world_from_camera.
        views: the light field.

    Raises:
        InputError: the data set has no camera, or a photo cannot be read.
    """
    if dataset.camera is None:
        raise InputError(dataset.root / CAMERA_FILE, "is missing: the photos' camera must be known")
    undistorter = Undistorter(dataset.camera)
    for index, pose in enumerate(camera_poses):
        image = undistorter(dataset.read_image(index))
        yield HeldOut(image, undistorter.intrinsics, pose, views)


def lie_amid_others(centres: FloatArray) -> BoolArray:
    """Which recording positions lie amid the others: ``(N,)``, inside the hull of all.

    The hull is taken in the line, plane or space over which the positions spread. A light field has
    to invent what lies outside of it.
    """
    offsets = centres - centres.mean(axis=0)
    _, _, axes = np.linalg.svd(offsets, full_matrices=True)
    places = offsets @ axes.T
    extent = np.ptp(places, axis=0)
    if extent[0] == 0.0:
        return np.zeros(len(centres), dtype=bool)
    places = places[:, extent > FLATNESS * extent[0]]
    margin = FLATNESS * extent[0]
    if places.shape[1] == 1:
        line = places[:, 0]
        return np.asarray((line > line.min() + margin) & (line < line.max() - margin))
    try:
        facets = scipy.spatial.ConvexHull(places).equations
    except scipy.spatial.QhullError:
        return np.zeros(len(centres), dtype=bool)
    outside = places @ facets[:, :-1].T + facets[:, -1]
    return np.asarray(outside.max(axis=1) < -margin)
