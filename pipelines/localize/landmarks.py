"""Landmarks: world coordinates of the features of a scene's photos.

Three sources: the points that structure from motion triangulated; the scene's depth maps; or, where
the scene is a plane, that plane. A feature at a depth edge, where pixels mix two surfaces, is no
landmark. One whose depth no neighbouring view confirms is: many of them are right, and which, the
agreement on a pose tells better. In a real room of 94 photos one feature in ten lies where all
pixels around are confirmed: 52 of 93 images had a pose by these, and have one by all, none wrong.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import scipy

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray, IntArray
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.provenance import sha256_of_bytes
from pipelines.geometry.camera import Intrinsics, Undistorter
from pipelines.geometry.plane import Plane
from pipelines.geometry.pose import inverse, rotation_angle
from pipelines.lightfield.scene import Scene, SceneDepth
from pipelines.reconstruct.reconstruction import Reconstruction

# A feature is an observation of a point when they are at most so many pixels apart.
SAME_PIXELS = 2.0
# Depths around a feature differ by at most this share; more is a depth edge.
EDGE_SHARE = 0.05
# A ray that meets the plane at a smaller angle than this (its sine) is too oblique to locate a
# feature.
SMALLEST_INCIDENCE = 0.1
# A scene and the reconstruction that it was made from agree better than this, metres and radians.
SAME_POSITION, SAME_ANGLE = 1e-3, 1e-3


@dataclass(frozen=True)
class Landmarks:
    """The landmarks among a photo's features.

    Attributes:
        rows: ``(L,)`` indices of the features.
        points: ``(L, 3)`` their world coordinates.
    """

    rows: IntArray
    points: FloatArray


class LandmarkSource:
    """Finds the landmarks of a scene's photos.

    Args:
        scene: the light field.
        reconstruction: whose points are used; None: those of the scene's own surface.
        reconstruction_path: how errors name it.

    Raises:
        InputError: a reconstruction that has no points, or is not that of the scene.
    """

    def __init__(
        self, scene: Scene, reconstruction: Reconstruction | None, reconstruction_path: str = ""
    ) -> None:
        self._scene = scene
        self._reconstruction = reconstruction
        self._pinholes = [Undistorter(camera).intrinsics for camera in scene.cameras]
        self._images: tuple[int | None, ...] = ()
        if reconstruction is not None:
            self._images = _images_of_views(scene, reconstruction, reconstruction_path)

    def landmarks(self, view: int, pixels: FloatArray) -> Landmarks:
        """The landmarks among a photo's features.

        Args:
            view: which photo.
            pixels: ``(F, 2)`` of the features in the photo as recorded.
        """
        scene = self._scene
        if self._reconstruction is not None:
            return _triangulated(self._reconstruction, self._images[view], pixels)
        pose = scene.world_from_camera[view]
        rays = scene.camera_of(view).rays(pixels)
        if scene.depth:
            pinhole = self._pinholes[int(scene.camera_index[view])]
            inverse_depth = depth_at(scene.depth[view], pinhole, rays)
        else:
            inverse_depth = plane_depth_at(scene.plane, pose, rays)
        rows = np.flatnonzero(inverse_depth > 0.0)
        local = rays[rows] / inverse_depth[rows, None]
        return Landmarks(rows, local @ pose[:3, :3].T + pose[:3, 3])


def depth_at(depth: SceneDepth, pinhole: Intrinsics, rays: FloatArray) -> FloatArray:
    """Inverse depths ``(F,)`` of a depth map along rays; 0 where it is not known.

    Between pixels the inverse depth is interpolated, which is exact on planes. All pixels around
    have to be known, confident or not, and close to each other in depth.

    Args:
        depth: of the undistorted photo, at any size.
        pinhole: intrinsics of the undistorted photo.
        rays: ``(F, 3)`` camera coordinates, z = 1.
    """
    height, width = depth.inverse_depth.shape
    grid = pinhole.resized(width, height)
    columns = (grid.fx * rays[:, 0] + grid.cx).astype(np.float32)
    rows = (grid.fy * rays[:, 1] + grid.cy).astype(np.float32)
    values = depth.inverse_depth.astype(np.float32)
    sampled = _sampled(values, columns, rows, cv2.INTER_LINEAR)
    usable = _sampled(_is_smooth(values).astype(np.float32), columns, rows, cv2.INTER_LINEAR)
    # Where one of the four pixels around is not smooth, the mean falls below 1.
    return np.where(usable > 1.0 - 1e-3, sampled, 0.0).astype(np.float64)


def _sampled(
    values: Float32Array, columns: Float32Array, rows: Float32Array, interpolation: int
) -> Float32Array:
    """Values ``(F,)`` of an array, interpolated at columns and rows; 0 outside of it."""
    if len(columns) == 0:
        return np.empty(0, dtype=np.float32)
    found = cv2.remap(values, columns[:, None], rows[:, None], interpolation, borderValue=0.0)
    return np.asarray(found, dtype=np.float32)[:, 0]


def _is_smooth(inverse_depth: Float32Array) -> BoolArray:
    """Which pixels ``(h, w)`` are known, as all their neighbours are, and at no depth edge."""
    kernel = np.ones((3, 3), np.uint8)
    # The borders do not count: by default they count as the opposite extremes.
    lowest = cv2.erode(inverse_depth, kernel)
    highest = cv2.dilate(inverse_depth, kernel)
    known = (lowest > 0.0) & (inverse_depth > 0.0)
    return np.asarray(known & (highest <= (1.0 + EDGE_SHARE) * lowest), dtype=np.bool_)


def plane_depth_at(plane: Plane, world_from_camera: FloatArray, rays: FloatArray) -> FloatArray:
    """Inverse depths ``(F,)`` at which rays ``(F, 3)`` meet a plane; 0 where they do not."""
    directions = rays @ world_from_camera[:3, :3].T
    approach = -(directions @ plane.normal)
    height = float(plane.signed_distance(world_from_camera[:3, 3]))
    if height <= 0.0:
        return np.zeros(len(rays))
    is_met = approach > SMALLEST_INCIDENCE * np.linalg.norm(directions, axis=1)
    return np.where(is_met, approach / height, 0.0)


def _triangulated(
    reconstruction: Reconstruction, image: int | None, pixels: FloatArray
) -> Landmarks:
    """The landmarks of features that lie where a point was observed."""
    seen = np.empty(0, dtype=np.int64)
    if image is not None:
        seen = np.flatnonzero(reconstruction.observations[:, 1] == image)
    if len(seen) == 0 or len(pixels) == 0:
        return Landmarks(np.empty(0, dtype=np.int64), np.empty((0, 3)))
    distances, nearest = scipy.spatial.cKDTree(reconstruction.observed_pixels[seen]).query(pixels)
    rows = np.flatnonzero(distances <= SAME_PIXELS)
    points = reconstruction.observations[seen[np.asarray(nearest)[rows]], 0]
    return Landmarks(rows, reconstruction.points[points])


def _images_of_views(
    scene: Scene, reconstruction: Reconstruction, path: str
) -> tuple[int | None, ...]:
    """Which image of the reconstruction each of the scene's photos is.

    Raises:
        InputError: no points, or another map.
    """
    if len(reconstruction.points) == 0:
        raise InputError(
            path,
            "holds no points; only structure from motion makes some",
            "leave out --reconstruction to use the scene's own surface",
        )
    if scene.compaction is not None:
        raise InputError(
            path,
            "has its points in the recorded photos, which a scene in compact storage does not hold",
            "make the scene with --storage full, or leave out --reconstruction",
        )
    by_hash = {digest: index for index, digest in enumerate(reconstruction.image_hashes)}
    images = tuple(by_hash.get(sha256_of_bytes(photo)) for photo in scene.encoded_images)
    pairs = [(view, image) for view, image in enumerate(images) if image is not None]
    if not pairs:
        raise InputError(path, "shares no photo with the scene", "give the one it was made from")
    views, found = np.array(pairs).T
    apart = inverse(scene.world_from_camera[views]) @ reconstruction.world_from_camera[found]
    is_same = np.linalg.norm(apart[:, :3, 3], axis=1) <= SAME_POSITION
    if not np.all(is_same & (rotation_angle(apart) <= SAME_ANGLE)):
        raise InputError(
            path,
            "has other poses of its photos than the scene",
            "give the reconstruction that the scene was made from",
        )
    return images
