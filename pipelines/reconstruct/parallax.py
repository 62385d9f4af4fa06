"""Which pairs of images differ by a rotation alone.

A camera that rotates on the spot sees no depth, yet structure from motion makes a model of it, with
tiny reprojection errors and, where the focal length is estimated too, with some parallax that does
not exist. So the matches themselves are tested, before any model: does a rotation explain them?
"""

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import StageError, reason_of
from pipelines.geometry.camera import Camera
from pipelines.reconstruct.colmap_model import PIXEL_CENTRE_SHIFT

# A pair is explained when this share of its matches lies within so many pixels.
EXPLAINED_SHARE, EXPLAINED_PIXELS = 0.8, 2.0
# Tried where the camera is unknown: focal length / longer side of the image.
FOCAL_RATIOS = np.geomspace(0.4, 3.0, 12)
MAX_PAIRS, MAX_MATCHES = 200, 400
TRIMMINGS = 4
# COLMAP's number of a pair is first * this + second.
PAIR_BASE = 2147483647


def rotation_only_share(database: Path, camera: Camera | None, size: tuple[int, int]) -> float:
    """Share of the matching pairs that a pure rotation explains.

    Args:
        database: COLMAP's, after matching.
        camera: None where unknown: then any of ``FOCAL_RATIOS`` may explain a pair.
        size: width and height of the images.

    Returns:
        0 to 1; over evenly chosen pairs where there are very many; 0 where none matches.

    Raises:
        StageError: the database cannot be read.
    """
    try:
        with closing(sqlite3.connect(f"{database.as_uri()}?mode=ro", uri=True)) as connection:
            keypoints = {
                int(number): np.frombuffer(data, "<f4").reshape(rows, columns)[:, :2].astype(float)
                for number, rows, columns, data in connection.execute(
                    "SELECT image_id, rows, cols, data FROM keypoints WHERE rows > 0"
                )
            }
            query = "SELECT pair_id, data FROM two_view_geometries WHERE rows > 0 ORDER BY pair_id"
            pairs = connection.execute(query).fetchall()
    except sqlite3.Error as error:
        raise StageError(
            f"the database of structure from motion is unreadable: {reason_of(error)}"
        ) from error
    chosen = pairs[:: -(-len(pairs) // MAX_PAIRS)] if pairs else []
    explained = 0
    for pair, data in chosen:
        matches = np.frombuffer(data, "<u4").reshape(-1, 2)
        matches = matches[:: -(-len(matches) // MAX_MATCHES)]
        first = keypoints[pair // PAIR_BASE][matches[:, 0]] - PIXEL_CENTRE_SHIFT
        second = keypoints[pair % PAIR_BASE][matches[:, 1]] - PIXEL_CENTRE_SHIFT
        explained += _is_rotation(first, second, camera, size)
    return explained / max(1, len(chosen))


def _is_rotation(
    first: FloatArray, second: FloatArray, camera: Camera | None, size: tuple[int, int]
) -> bool:
    if camera is not None:
        focal = camera.intrinsics.fx
        errors = _rotation_errors(_known_rays(first, camera), _known_rays(second, camera))
        return _explained(focal * errors)
    centre = np.array([(side - 1) / 2.0 for side in size])
    for focal in FOCAL_RATIOS * max(size):
        errors = _rotation_errors(_rays((first - centre) / focal), _rays((second - centre) / focal))
        if _explained(focal * errors):
            return True
    return False


def _explained(pixel_errors: FloatArray) -> bool:
    return bool(np.quantile(pixel_errors, EXPLAINED_SHARE) < EXPLAINED_PIXELS)


def _known_rays(pixels: FloatArray, camera: Camera) -> FloatArray:
    """Unit rays ``(N, 3)`` of pixels ``(N, 2)``, distortion removed."""
    rays = camera.rays(pixels)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _rays(flat: FloatArray) -> FloatArray:
    """Unit rays ``(N, 3)`` through points ``(N, 2)`` at depth one."""
    rays = np.column_stack([flat, np.ones(len(flat))])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _rotation_errors(first: FloatArray, second: FloatArray) -> FloatArray:
    """Residual angles (radians, ``(N,)``) of the best rotation of rays, fitted without outliers."""
    kept = np.ones(len(first), dtype=np.bool_)
    errors = np.zeros(len(first))
    for _ in range(TRIMMINGS):
        left, _, right = np.linalg.svd(second[kept].T @ first[kept])
        signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
        rotated = first @ ((left * signs) @ right).T
        errors = np.linalg.norm(rotated - second, axis=1)
        kept = errors <= np.quantile(errors, EXPLAINED_SHARE)
    return errors
