"""Which views a pixel is blended from: the choice of rule, and the second rule, readable.

``DELAUNAY`` is the paper's net (module ``net``). ``UNSTRUCTURED`` follows Buehler, Bosse, McMillan,
Gortler, Cohen (2001), "Unstructured lumigraph rendering": at a surface point the views are ranked
by a penalty for the angle between their ray and the virtual one and for a coarser resolution; the k
best share the weight, which falls to zero where the next one takes over. As there, weights are
evaluated on a coarse grid and interpolated: here on tiles of the virtual image, linear inside each.
"""

from enum import IntEnum

import numpy as np

from pipelines.artifacts.array_types import FloatArray, IntArray
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane
from pipelines.lightfield.net import PixelWeights, sees
from pipelines.lightfield.views import Views


class Blending(IntEnum):
    """The blending rules."""

    DELAUNAY = 0
    UNSTRUCTURED = 1


TILE_COLUMNS = 8
TILE_ROWS = 6
VIEWS_PER_TILE = 3
# Cost of a view at twice the distance, in radians of viewing angle.
RESOLUTION_PENALTY = 0.05
# Penalties below this, in radians, all count as the same ray.
SMALLEST_PENALTY = 1e-4
# Where no further view takes over, weights fall as if one with this multiple of the worst did.
LAST_VIEW_FACTOR = 2.0


def unstructured_weights(
    views: Views,
    plane: Plane,
    maps: FloatArray,
    facing: FloatArray,
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
) -> PixelWeights:
    """Unstructured-lumigraph weights at each pixel of a virtual image.

    Args:
        views: the light field's photos.
        plane: the scene's surface.
        maps: ``(N, 3, 3)`` mappings from virtual pixels into the views.
        facing: ``(3,)`` coefficients, negative at pixels that show the surface.
        world_from_camera: ``(4, 4)`` virtual camera.
        intrinsics: of the virtual camera.

    Returns:
        Views and weights; all three weights are zero in a tile whose centre no view shows.
    """
    shape = (intrinsics.height, intrinsics.width, 3)
    chosen, weights = np.zeros(shape, dtype=np.int64), np.zeros(shape)
    tile_column = np.arange(intrinsics.width) * TILE_COLUMNS // intrinsics.width
    tile_row = np.arange(intrinsics.height) * TILE_ROWS // intrinsics.height
    for row in range(TILE_ROWS):
        for column in range(TILE_COLUMNS):
            own = np.ix_(tile_row == row, tile_column == column)
            left = -0.5 + intrinsics.width * column / TILE_COLUMNS
            top = -0.5 + intrinsics.height * row / TILE_ROWS
            size = intrinsics.width / TILE_COLUMNS, intrinsics.height / TILE_ROWS
            best, corner_weights = _tile(
                views, plane, maps, facing, world_from_camera, intrinsics, (left, top), size
            )
            if len(best) == 0:
                continue
            rows, columns = np.meshgrid(
                np.flatnonzero(tile_row == row),
                np.flatnonzero(tile_column == column),
                indexing="ij",
            )
            u = (columns - left) / size[0] - 0.5
            v = (rows - top) / size[1] - 0.5
            # The plane that fits the four corner values best: mean and the two mean slopes.
            mean = corner_weights.mean(axis=0)
            slope_u = corner_weights[[1, 3]].mean(axis=0) - corner_weights[[0, 2]].mean(axis=0)
            slope_v = corner_weights[[2, 3]].mean(axis=0) - corner_weights[[0, 1]].mean(axis=0)
            linear = mean + u[..., None] * slope_u + v[..., None] * slope_v
            padding = VIEWS_PER_TILE - len(best)
            weights[own] = np.pad(np.maximum(linear, 0.0), ((0, 0), (0, 0), (0, padding)))
            chosen[own] = np.pad(best, (0, padding), constant_values=best[-1])
    return PixelWeights(chosen, weights)


def _tile(
    views: Views,
    plane: Plane,
    maps: FloatArray,
    facing: FloatArray,
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
    origin: tuple[float, float],
    size: tuple[float, float],
) -> tuple[IntArray, FloatArray]:
    """The best views at a tile's centre, ``(k,)``, and their weights at its corners, ``(4, k)``."""
    centre = np.array([origin[0] + size[0] / 2, origin[1] + size[1] / 2, 1.0])
    if centre @ facing >= 0.0:
        return np.empty(0, dtype=np.int64), np.empty((4, 0))
    seen = sees(maps @ centre, views.level_size[:, 0, 0], views.level_size[:, 0, 1])
    seen &= plane.signed_distance(views.centres) > 0.0
    candidates = np.flatnonzero(seen).astype(np.int64)
    penalty = _penalties(views, plane, centre, world_from_camera, intrinsics)[candidates]
    order = np.argsort(penalty, kind="stable")
    best = candidates[order[:VIEWS_PER_TILE]]
    if len(best) == 0:
        return best, np.empty((4, 0))
    if len(order) > VIEWS_PER_TILE:
        limit = penalty[order[VIEWS_PER_TILE]]
    else:
        limit = LAST_VIEW_FACTOR * penalty[order[-1]]
    limit = max(limit, LAST_VIEW_FACTOR * SMALLEST_PENALTY)
    at_centre = _shares(penalty[order[:VIEWS_PER_TILE]], limit)
    corner_weights = np.tile(at_centre, (4, 1))
    for number in range(4):
        corner = np.array(
            [origin[0] + size[0] * (number % 2), origin[1] + size[1] * (number // 2), 1.0]
        )
        if corner @ facing < 0.0:
            there = _penalties(views, plane, corner, world_from_camera, intrinsics)[best]
            if np.any(there < limit):
                corner_weights[number] = _shares(there, limit)
    return best, corner_weights


def _penalties(
    views: Views,
    plane: Plane,
    pixel: FloatArray,
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
) -> FloatArray:
    """Penalty ``(N,)`` of each view at the surface point that a virtual pixel shows."""
    centre = world_from_camera[:3, 3]
    ray = world_from_camera[:3, :3] @ np.linalg.inv(intrinsics.matrix()) @ pixel
    point = centre - ray * float(plane.signed_distance(centre)) / (plane.normal @ ray)
    virtual, recorded = point - centre, point - views.centres
    virtual_distance = np.linalg.norm(virtual)
    distance = np.linalg.norm(recorded, axis=1)
    cosine = recorded @ virtual / (distance * virtual_distance)
    # The chord 2 sin(angle / 2): the angle where it is small, without an inverse cosine.
    angle = np.sqrt(np.maximum(2.0 - 2.0 * cosine, 0.0))
    coarser = np.maximum(distance / virtual_distance - 1.0, 0.0)
    return np.asarray(angle + RESOLUTION_PENALTY * coarser)


def _shares(penalty: FloatArray, limit: float) -> FloatArray:
    """Weights with sum 1 that are large at small penalties and zero at the limit."""
    weights = np.maximum(1.0 - penalty / limit, 0.0) / np.maximum(penalty, SMALLEST_PENALTY)
    total = weights.sum()
    if total <= 0.0:
        return np.full(len(penalty), 1.0 / len(penalty))
    return np.asarray(weights / total)
