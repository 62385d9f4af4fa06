"""Unstructured-lumigraph weights, fast: the same tiles as ``blending``, compiled into cells.

A tile is a cell in the sense of ``net_kernels``: some views, each with a weight that is bilinear in
the pixel, so that the renderer need not know which rule made it.
"""

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray, Int32Array, IntArray
from pipelines.lightfield.blending import (
    FEWEST_TILES,
    MOST_TILES,
    TILE_SIDE,
    VIEWS_PER_CORNER,
    VIEWS_PER_TILE,
)
from pipelines.lightfield.compiled import compiled, compiled_leaf
from pipelines.lightfield.ranking_kernels import (
    POINTS,
    RANKING_SCRATCH,
    RANKS,
    order_of_groups,
    rank_views,
    set_points,
    set_shares,
)
from pipelines.lightfield.view_index import ViewIndex
from pipelines.lightfield.views import ViewArrays


@compiled_leaf
def tile_count(size: int) -> int:
    """How many tiles there are across (or down) an image of so many pixels."""
    return min(max(size // TILE_SIDE, FEWEST_TILES), MOST_TILES)


@compiled
def tile_borders(size: int) -> IntArray:
    """Pixel columns (or rows) on which the tiles' corners lie; see ``blending.tile_borders``."""
    tiles = tile_count(size)
    borders = np.empty(tiles + 1, np.int64)
    for i in range(tiles + 1):
        borders[i] = min(i * size // tiles, size - 1)
    return borders


@compiled
def order_by_tile(
    width: int, height: int, columns: Float32Array, rows: Float32Array, starts: IntArray
) -> None:
    """Writes the pixels of an image tile by tile.

    Args:
        width: of the image, and
        height: of it.
        columns: (H W,) and
        rows: (H W,) receive the pixels' places.
        starts: (c + 1,) receives where each tile begins, and the end.
    """
    across, down = tile_borders(width), tile_borders(height)
    count, cell = 0, 0
    for i in range(len(down) - 1):
        last_row = down[i + 1] if i + 2 < len(down) else height
        for j in range(len(across) - 1):
            last_column = across[j + 1] if j + 2 < len(across) else width
            starts[cell] = count
            cell += 1
            for y in range(down[i], last_row):
                for x in range(across[j], last_column):
                    columns[count], rows[count] = x, y
                    count += 1
    starts[cell] = count


@compiled_leaf
def _set_pixel(
    x: int, y: int, surface: Float32Array, width: int, pixels: Float32Array, lane: int
) -> None:
    """Writes place and inverse depth of a pixel as one of those of ``set_points``."""
    pixels[lane], pixels[POINTS + lane] = x, y
    pixels[2 * POINTS + lane] = surface[y * width + x]


@compiled
def build_tiles(
    pose: FloatArray,
    rays: FloatArray,
    surface: Float32Array,
    width: int,
    views: ViewArrays,
    index: ViewIndex,
    has_depth: bool,
    slots: IntArray,
    cell_views: IntArray,
    cell_weights: FloatArray,
    cell_origins: FloatArray,
) -> None:
    """Cells of the unstructured-lumigraph rule.

    Args:
        pose: (4, 4) world_from_camera of the virtual camera.
        rays: (3, 3) virtual pixels to world directions.
        surface: (H W,) virtual inverse depth; 0: none.
        width: of the virtual image.
        views: the light field.
        index: of the views that may take part.
        has_depth: whether depth maps may hide the surface.
        slots: (2, N) overwritten.
        cell_views: (c, VIEWS_PER_TILE) receives view indices, -1 behind the last.
        cell_weights: (c, VIEWS_PER_TILE, 4) receives coefficients of x, y, 1, x y, relative to
        cell_origins: (c, 2), which receives columns and rows.
    """
    columns, rows = tile_borders(width), tile_borders(len(surface) // width)
    across = len(columns)
    corners = across * len(rows)
    padded = (corners + POINTS - 1) // POINTS * POINTS
    corner_views = np.empty((VIEWS_PER_CORNER, padded), np.int32)
    corner_weights = np.empty((VIEWS_PER_CORNER, padded), np.float32)
    scratch = np.empty(RANKING_SCRATCH, np.float32)
    best = np.empty(RANKS * POINTS, np.int32)
    pixels = np.empty(3 * POINTS, np.float32)
    for lane in range(POINTS):
        # The middle of the image stands for all of it.
        _set_pixel(width // 2, len(surface) // width // 2, surface, width, pixels, lane)
    set_points(pose, rays, index.origin, pixels, scratch)
    order = order_of_groups(index.spheres, scratch)
    for first in range(0, corners, POINTS):
        for lane in range(POINTS):
            # The last corner stands for those that are not there.
            corner = min(first + lane, corners - 1)
            x, y = columns[corner % across], rows[corner // across]
            _set_pixel(x, y, surface, width, pixels, lane)
        set_points(pose, rays, index.origin, pixels, scratch)
        rank_views(views, index, order, has_depth, scratch, best)
        set_shares(scratch, best, first, corner_views, corner_weights)
    at_corner = np.empty((VIEWS_PER_TILE, 4))
    slots[0] = -1
    for i in range(len(rows) - 1):
        for j in range(across - 1):
            cell = i * (across - 1) + j
            cell_origins[cell, 0], cell_origins[cell, 1] = columns[j], rows[i]
            _join_corners(
                corner_views,
                corner_weights,
                i * across + j,
                across,
                max(columns[j + 1] - columns[j], 1),
                max(rows[i + 1] - rows[i], 1),
                cell,
                slots,
                at_corner,
                cell_views,
                cell_weights,
            )


@compiled_leaf
def _join_corners(
    corner_views: Int32Array,
    corner_weights: Float32Array,
    upper_left: int,
    across: int,
    width: int,
    height: int,
    cell: int,
    slots: IntArray,
    at_corner: FloatArray,
    cell_views: IntArray,
    cell_weights: FloatArray,
) -> None:
    """Writes the views of a tile's corners and the bilinear functions of their weights.

    Args:
        corner_views: (VIEWS_PER_CORNER, C), corner_weights: likewise.
        corner_weights: see there.
        upper_left: index of the tile's first corner.
        across: corners in a row.
        width: of the tile.
        height: of the tile.
        cell: its number.
        slots: (2, N) the last cell that a view was in, and its slot there; changed.
        at_corner: (VIEWS_PER_TILE, 4) overwritten.
        cell_views: see ``build_tiles``.
        cell_weights: see ``build_tiles``.
    """
    count = 0
    step_x, step_y = 1.0 / width, 1.0 / height
    for number in range(4):
        corner = upper_left + number // 2 * across + number % 2
        for rank in range(VIEWS_PER_CORNER):
            view = corner_views[rank, corner]
            if view < 0:
                break
            if slots[0, view] != cell:
                slots[0, view], slots[1, view] = cell, count
                cell_views[cell, count] = view
                for other in range(4):
                    at_corner[count, other] = 0.0
                count += 1
            at_corner[slots[1, view], number] = corner_weights[rank, corner]
    if count < VIEWS_PER_TILE:
        cell_views[cell, count] = -1
    for slot in range(count):
        a, b, c, d = at_corner[slot, 0], at_corner[slot, 1], at_corner[slot, 2], at_corner[slot, 3]
        # a (1-s)(1-t) + b s (1-t) + c (1-s) t + d s t with s = x / width, t = y / height.
        cell_weights[cell, slot, 0] = (b - a) * step_x
        cell_weights[cell, slot, 1] = (c - a) * step_y
        cell_weights[cell, slot, 2] = a
        cell_weights[cell, slot, 3] = (a - b - c + d) * step_x * step_y
