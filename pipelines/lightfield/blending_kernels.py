"""Unstructured-lumigraph weights, fast: the same tiles as ``blending``, compiled into cells.

A tile is a cell in the sense of ``net_kernels``: three views, each with a weight that is linear in
the pixel, so that the renderer need not know which rule made it.
"""

import numpy as np

from pipelines.artifacts.array_types import BoolArray, FloatArray, IntArray
from pipelines.lightfield.blending import (
    LAST_VIEW_FACTOR,
    RESOLUTION_PENALTY,
    SMALLEST_PENALTY,
    TILE_COLUMNS,
    TILE_ROWS,
    VIEWS_PER_TILE,
)
from pipelines.lightfield.compiled import compiled


@compiled
def _penalty(
    centres: FloatArray,
    view: int,
    pose: FloatArray,
    px: float,
    py: float,
    pz: float,
) -> float:
    """Penalty of a view at the surface point (px, py, pz)."""
    vx, vy, vz = px - pose[0, 3], py - pose[1, 3], pz - pose[2, 3]
    rx, ry, rz = px - centres[view, 0], py - centres[view, 1], pz - centres[view, 2]
    virtual = np.sqrt(vx * vx + vy * vy + vz * vz)
    recorded = np.sqrt(rx * rx + ry * ry + rz * rz)
    cosine = (vx * rx + vy * ry + vz * rz) / (virtual * recorded)
    angle = np.sqrt(max(2.0 - 2.0 * cosine, 0.0))
    return float(angle + RESOLUTION_PENALTY * max(recorded / virtual - 1.0, 0.0))


@compiled
def _shares(penalty: FloatArray, count: int, limit: float, weights: FloatArray) -> None:
    """Writes weights with sum 1 that are large at small penalties and zero at the limit."""
    total = 0.0
    for i in range(count):
        weights[i] = max(1.0 - penalty[i] / limit, 0.0) / max(penalty[i], SMALLEST_PENALTY)
        total += weights[i]
    for i in range(count):
        weights[i] = weights[i] / total if total > 0.0 else 1.0 / count


@compiled
def _best_views(
    x: float,
    y: float,
    point: FloatArray,
    pose: FloatArray,
    usable: BoolArray,
    centres: FloatArray,
    mappings: FloatArray,
    level_size: IntArray,
    best: IntArray,
    penalty: FloatArray,
) -> int:
    """Writes the views with the smallest penalties at a pixel, one more than are used.

    Returns:
        How many were found, at most ``VIEWS_PER_TILE + 1``.
    """
    found = 0
    for view in range(len(centres)):
        if not usable[view]:
            continue
        depth = mappings[view, 2, 0] * x + mappings[view, 2, 1] * y + mappings[view, 2, 2]
        if depth <= 0.0:
            continue
        u = (mappings[view, 0, 0] * x + mappings[view, 0, 1] * y + mappings[view, 0, 2]) / depth
        v = (mappings[view, 1, 0] * x + mappings[view, 1, 1] * y + mappings[view, 1, 2]) / depth
        if not (
            -0.5 <= u <= level_size[view, 0, 0] - 0.5 and -0.5 <= v <= level_size[view, 0, 1] - 0.5
        ):
            continue
        own = _penalty(centres, view, pose, point[0], point[1], point[2])
        if found <= VIEWS_PER_TILE:
            slot = found
            found += 1
        elif own < penalty[VIEWS_PER_TILE]:
            slot = VIEWS_PER_TILE
        else:
            continue
        while slot > 0 and penalty[slot - 1] > own:
            penalty[slot] = penalty[slot - 1]
            best[slot] = best[slot - 1]
            slot -= 1
        penalty[slot] = own
        best[slot] = view
    return found


@compiled
def _surface_point(x: float, y: float, points: FloatArray, point: FloatArray) -> bool:
    """Writes the surface point (3,) that a virtual pixel shows; False where it shows none."""
    scale = points[3, 0] * x + points[3, 1] * y + points[3, 2]
    if scale <= 0.0:
        return False
    for i in range(3):
        point[i] = (points[i, 0] * x + points[i, 1] * y + points[i, 2]) / scale
    return True


@compiled
def build_tiles(
    pose: FloatArray,
    points: FloatArray,
    usable: BoolArray,
    centres: FloatArray,
    mappings: FloatArray,
    level_size: IntArray,
    cell_views: IntArray,
    cell_weights: FloatArray,
    label: IntArray,
) -> int:
    """Cells of the unstructured-lumigraph rule.

    Args:
        pose: (4, 4) world_from_camera of the virtual camera.
        points: (4, 3) from virtual pixels to homogeneous surface points.
        usable: (N,) views that may take part.
        centres: (N, 3) recording centres.
        mappings: (N, 3, 3) from virtual pixels into the views.
        level_size: (N, L, 2).
        cell_views: (c, 3) receives view indices, c >= TILE_ROWS * TILE_COLUMNS.
        cell_weights: (c, 3, 3) receives weight coefficients.
        label: (H, W) receives each pixel's cell.

    Returns:
        The number of cells.
    """
    height, width = label.shape
    for y in range(height):
        for x in range(width):
            label[y, x] = (y * TILE_ROWS // height) * TILE_COLUMNS + x * TILE_COLUMNS // width
    tile_width, tile_height = width / TILE_COLUMNS, height / TILE_ROWS
    best = np.empty(VIEWS_PER_TILE + 1, dtype=np.int64)
    penalty = np.empty(VIEWS_PER_TILE + 1)
    there = np.empty(VIEWS_PER_TILE + 1)
    point = np.empty(3)
    weights = np.empty((4, VIEWS_PER_TILE))
    for row in range(TILE_ROWS):
        for column in range(TILE_COLUMNS):
            cell = row * TILE_COLUMNS + column
            cell_weights[cell] = 0.0
            cell_views[cell] = 0
            left, top = -0.5 + tile_width * column, -0.5 + tile_height * row
            centre_x, centre_y = left + tile_width / 2, top + tile_height / 2
            if not _surface_point(centre_x, centre_y, points, point):
                continue
            found = _best_views(
                centre_x,
                centre_y,
                point,
                pose,
                usable,
                centres,
                mappings,
                level_size,
                best,
                penalty,
            )
            if found == 0:
                continue
            count = min(found, VIEWS_PER_TILE)
            if found > VIEWS_PER_TILE:
                limit = penalty[VIEWS_PER_TILE]
            else:
                limit = LAST_VIEW_FACTOR * penalty[found - 1]
            limit = max(limit, LAST_VIEW_FACTOR * SMALLEST_PENALTY)
            for corner in range(4):
                x, y = left + tile_width * (corner % 2), top + tile_height * (corner // 2)
                _shares(penalty, count, limit, weights[corner])
                if not _surface_point(x, y, points, point):
                    continue
                smallest = np.inf
                for i in range(count):
                    there[i] = _penalty(centres, best[i], pose, point[0], point[1], point[2])
                    smallest = min(smallest, there[i])
                if smallest < limit:
                    _shares(there, count, limit, weights[corner])
            _linear_weights(weights, count, left, top, tile_width, tile_height, cell_weights[cell])
            for i in range(3):
                cell_views[cell, i] = best[min(i, count - 1)]
    return TILE_ROWS * TILE_COLUMNS


@compiled
def _linear_weights(
    weights: FloatArray,
    count: int,
    left: float,
    top: float,
    width: float,
    height: float,
    coefficients: FloatArray,
) -> None:
    """Writes the coefficients (3, 3) of the planes that fit the corner weights (4, k) best."""
    for i in range(count):
        mean = (weights[0, i] + weights[1, i] + weights[2, i] + weights[3, i]) / 4.0
        across = (weights[1, i] + weights[3, i] - weights[0, i] - weights[2, i]) / (2.0 * width)
        down = (weights[2, i] + weights[3, i] - weights[0, i] - weights[1, i]) / (2.0 * height)
        coefficients[i, 0], coefficients[i, 1] = across, down
        coefficients[i, 2] = mean - across * (left + width / 2) - down * (top + height / 2)
