"""Unstructured-lumigraph weights, fast: the same tiles as ``blending``, compiled into cells.

A tile is a cell in the sense of ``net_kernels``: some views, each with a weight that is bilinear in
the pixel, so that the renderer need not know which rule made it.
"""

import numpy as np

from pipelines.artifacts.array_types import BoolArray, Float32Array, FloatArray, IntArray
from pipelines.lightfield.blending import (
    BORDER_PENALTY,
    BORDER_SHARE,
    FEWEST_TILES,
    MOST_TILES,
    OCCLUSION_FACTOR,
    RESOLUTION_PENALTY,
    SMALLEST_MARGIN,
    SMALLEST_PENALTY,
    TILE_SIDE,
    VIEWS_PER_CORNER,
    VIEWS_PER_TILE,
)
from pipelines.lightfield.compiled import compiled, compiled_leaf
from pipelines.lightfield.views import ViewArrays


@compiled_leaf
def tile_count(size: int) -> int:
    """How many tiles there are across (or down) an image of so many pixels."""
    return min(max(size // TILE_SIDE, FEWEST_TILES), MOST_TILES)


@compiled_leaf
def is_occluded(
    inverse_depth: Float32Array,
    depth_start: IntArray,
    depth_size: IntArray,
    level_size: IntArray,
    view: int,
    u: float,
    v: float,
    own: float,
) -> bool:
    """Whether a view sees something nearer in the direction of a surface point.

    Args:
        inverse_depth: depth maps of all views; see ``ViewArrays``, as for the next three.
        depth_start: where each begins.
        depth_size: width and height of each.
        level_size: of the photos.
        view: which.
        u: column of the point in the view's finest level, inside the image.
        v: its row.
        own: the point's inverse depth in the view.
    """
    width, height = depth_size[view, 0], depth_size[view, 1]
    if width == 0:
        return False
    column = min(int((u + 0.5) * (width / level_size[view, 0, 0])), width - 1)
    row = min(int((v + 0.5) * (height / level_size[view, 0, 1])), height - 1)
    seen = np.float64(inverse_depth[depth_start[view] + row * width + column])
    return bool(seen > OCCLUSION_FACTOR * own)


@compiled_leaf
def _penalty(
    centres: FloatArray, view: int, pose: FloatArray, px: float, py: float, pz: float
) -> float:
    """Penalty of a view for showing the surface point (px, py, pz)."""
    vx, vy, vz = px - pose[0, 3], py - pose[1, 3], pz - pose[2, 3]
    rx, ry, rz = px - centres[view, 0], py - centres[view, 1], pz - centres[view, 2]
    virtual = np.sqrt(vx * vx + vy * vy + vz * vz)
    recorded = np.sqrt(rx * rx + ry * ry + rz * rz)
    cosine = (vx * rx + vy * ry + vz * rz) / (virtual * recorded)
    angle = np.sqrt(max(2.0 - 2.0 * cosine, 0.0))
    return float(angle + RESOLUTION_PENALTY * max(recorded / virtual - 1.0, 0.0))


@compiled_leaf
def _border_penalty(width: int, height: int, u: float, v: float) -> float:
    """Penalty of an image for showing a point in column u, row v, near its border."""
    margin = min(u + 0.5, width - 0.5 - u, v + 0.5, height - 0.5 - v)
    strip = BORDER_SHARE * min(width, height)
    if margin >= strip:
        return 0.0
    return float(BORDER_PENALTY * (strip / max(margin, SMALLEST_MARGIN * strip) - 1.0))


@compiled_leaf
def _best_views(
    x: int,
    y: int,
    inverse_depth: float,
    pose: FloatArray,
    rays: FloatArray,
    views: ViewArrays,
    usable: BoolArray,
    maps: FloatArray,
    shifts: FloatArray,
    best: IntArray,
    penalty: FloatArray,
) -> int:
    """Writes the views with the smallest penalties at a pixel, one more than are used.

    Returns:
        How many were found, at most ``VIEWS_PER_CORNER + 1``.
    """
    px = pose[0, 3] + (rays[0, 0] * x + rays[0, 1] * y + rays[0, 2]) / inverse_depth
    py = pose[1, 3] + (rays[1, 0] * x + rays[1, 1] * y + rays[1, 2]) / inverse_depth
    pz = pose[2, 3] + (rays[2, 0] * x + rays[2, 1] * y + rays[2, 2]) / inverse_depth
    found = 0
    centres, level_size = views.centres, views.level_size
    inverse_depths, depth_start, depth_size = (
        views.inverse_depth,
        views.depth_start,
        views.depth_size,
    )
    for view in range(len(centres)):
        if not usable[view]:
            continue
        depth = (
            maps[view, 2, 0] * x
            + maps[view, 2, 1] * y
            + maps[view, 2, 2]
            + shifts[view, 2] * inverse_depth
        )
        if depth <= 0.0:
            continue
        u = (
            maps[view, 0, 0] * x
            + maps[view, 0, 1] * y
            + maps[view, 0, 2]
            + shifts[view, 0] * inverse_depth
        ) / depth
        if not -0.5 <= u <= level_size[view, 0, 0] - 0.5:
            continue
        v = (
            maps[view, 1, 0] * x
            + maps[view, 1, 1] * y
            + maps[view, 1, 2]
            + shifts[view, 1] * inverse_depth
        ) / depth
        if not -0.5 <= v <= level_size[view, 0, 1] - 0.5:
            continue
        if is_occluded(
            inverse_depths, depth_start, depth_size, level_size, view, u, v, inverse_depth / depth
        ):
            continue
        own = _penalty(centres, view, pose, px, py, pz)
        own += _border_penalty(level_size[view, 0, 0], level_size[view, 0, 1], u, v)
        if found <= VIEWS_PER_CORNER:
            slot = found
            found += 1
        elif own < penalty[VIEWS_PER_CORNER]:
            slot = VIEWS_PER_CORNER
        else:
            continue
        while slot > 0 and penalty[slot - 1] > own:
            penalty[slot] = penalty[slot - 1]
            best[slot] = best[slot - 1]
            slot -= 1
        penalty[slot] = own
        best[slot] = view
    return found


@compiled_leaf
def _shares(penalty: FloatArray, found: int, weights: FloatArray) -> int:
    """Writes weights with sum 1 that fall to zero where the next view takes over; their number."""
    count = min(found, VIEWS_PER_CORNER)
    limit = np.inf
    if found > VIEWS_PER_CORNER:
        limit = max(penalty[VIEWS_PER_CORNER], 2.0 * SMALLEST_PENALTY)
    total = 0.0
    for i in range(count):
        weights[i] = max(1.0 - penalty[i] / limit, 0.0) / max(penalty[i], SMALLEST_PENALTY)
        total += weights[i]
    for i in range(count):
        weights[i] = weights[i] / total if total > 0.0 else 1.0 / count
    return count


@compiled
def build_tiles(
    pose: FloatArray,
    rays: FloatArray,
    surface: FloatArray,
    views: ViewArrays,
    usable: BoolArray,
    maps: FloatArray,
    shifts: FloatArray,
    cell_views: IntArray,
    cell_weights: FloatArray,
    label: IntArray,
) -> int:
    """Cells of the unstructured-lumigraph rule.

    Args:
        pose: (4, 4) world_from_camera of the virtual camera.
        rays: (3, 3) virtual pixels to world directions.
        surface: (H, W) virtual inverse depth; 0: none.
        views: the light field.
        usable: (N,) views that may take part.
        maps: (N, 3, 3), shifts: (N, 3): virtual pixel p at inverse depth d is at map p + shift d.
        cell_views: (c, VIEWS_PER_TILE) receives view indices, -1 behind the last.
        cell_weights: (c, VIEWS_PER_TILE, 4) receives coefficients of x, y, 1, x y.
        label: (H, W) receives each pixel's cell.

    Returns:
        The number of cells.
    """
    height, width = label.shape
    tile_columns, tile_rows = tile_count(width), tile_count(height)
    columns, rows = np.empty(tile_columns + 1, np.int64), np.empty(tile_rows + 1, np.int64)
    for j in range(tile_columns + 1):
        columns[j] = min(j * width // tile_columns, width - 1)
    for i in range(tile_rows + 1):
        rows[i] = min(i * height // tile_rows, height - 1)
    corner_views = np.empty((tile_rows + 1, tile_columns + 1, VIEWS_PER_CORNER + 1), np.int64)
    corner_weights = np.empty((tile_rows + 1, tile_columns + 1, VIEWS_PER_CORNER))
    corner_count = np.zeros((tile_rows + 1, tile_columns + 1), np.int64)
    penalty = np.empty(VIEWS_PER_CORNER + 1)
    for i in range(tile_rows + 1):
        for j in range(tile_columns + 1):
            inverse_depth = surface[rows[i], columns[j]]
            if inverse_depth <= 0.0:
                continue
            found = _best_views(
                columns[j],
                rows[i],
                inverse_depth,
                pose,
                rays,
                views,
                usable,
                maps,
                shifts,
                corner_views[i, j],
                penalty,
            )
            if found > 0:
                corner_count[i, j] = _shares(penalty, found, corner_weights[i, j])
    for i in range(tile_rows):
        for j in range(tile_columns):
            cell = i * tile_columns + j
            _join_corners(
                corner_views[i : i + 2, j : j + 2],
                corner_weights[i : i + 2, j : j + 2],
                corner_count[i : i + 2, j : j + 2],
                columns[j : j + 2],
                rows[i : i + 2],
                cell_views[cell],
                cell_weights[cell],
            )
            last_row = rows[i + 1] if i + 1 < tile_rows else height
            last_column = columns[j + 1] if j + 1 < tile_columns else width
            for y in range(rows[i], last_row):
                for x in range(columns[j], last_column):
                    label[y, x] = cell
    return tile_rows * tile_columns


@compiled
def _join_corners(
    corner_views: IntArray,
    corner_weights: FloatArray,
    corner_count: IntArray,
    columns: IntArray,
    rows: IntArray,
    cell_views: IntArray,
    cell_weights: FloatArray,
) -> None:
    """Writes the views of a tile's corners and the bilinear functions of their weights."""
    at_corner = np.zeros((VIEWS_PER_TILE, 4))
    cell_views[:] = -1
    count = 0
    for corner in range(4):
        i, j = corner // 2, corner % 2
        for k in range(corner_count[i, j]):
            slot = 0
            while slot < count and cell_views[slot] != corner_views[i, j, k]:
                slot += 1
            if slot == count:
                cell_views[slot] = corner_views[i, j, k]
                count += 1
            at_corner[slot, corner] = corner_weights[i, j, k]
    width, height = max(columns[1] - columns[0], 1), max(rows[1] - rows[0], 1)
    left, top = columns[0] / width, rows[0] / height
    for slot in range(count):
        a, b, c, d = at_corner[slot, 0], at_corner[slot, 1], at_corner[slot, 2], at_corner[slot, 3]
        # a (1-s)(1-t) + b s (1-t) + c (1-s) t + d s t with s = x / width - left, t likewise.
        cross = a - b - c + d
        cell_weights[slot, 0] = (b - a - cross * top) / width
        cell_weights[slot, 1] = (c - a - cross * left) / height
        cell_weights[slot, 2] = a - (b - a) * left - (c - a) * top + cross * left * top
        cell_weights[slot, 3] = cross / (width * height)
