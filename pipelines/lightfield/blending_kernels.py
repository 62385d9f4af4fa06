"""Unstructured-lumigraph weights, fast: the same tiles as ``blending``, compiled into cells.

A tile is a cell in the sense of ``net_kernels``: some views, each with a weight that is bilinear in
the pixel, so that the renderer need not know which rule made it.
"""

from typing import NamedTuple

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray, Int32Array, IntArray
from pipelines.lightfield.aligned_memory import aligned
from pipelines.lightfield.blending import (
    MOST_RANKED,
    VIEWS_PER_CORNER,
    VIEWS_PER_TILE,
    outlook_positions,
    tile_borders,
)
from pipelines.lightfield.compiled import compiled_leaf
from pipelines.lightfield.lane_intrinsics import either
from pipelines.lightfield.outlook_kernels import look_out
from pipelines.lightfield.ranking_kernels import (
    POINTS,
    RANKING_SCRATCH,
    RANKS,
    ZERO,
    gather_depths,
    rank_views,
    set_points,
    set_shares,
)
from pipelines.lightfield.record_type import compiled_record
from pipelines.lightfield.view_index import ViewIndex
from pipelines.lightfield.views import ViewArrays


@compiled_record
class Tiling(NamedTuple):
    """The tiles of images of one size, and memory for choosing their views.

    C points are ranked: those of the outlook, then the tiles' corners row by row, then the last of
    them again until a batch is full.

    Attributes:
        across: columns on which corners lie, and
        down: rows.
        columns: ``(C,)`` of the points' pixels, and
        rows: likewise, and
        pixels: ``(C,)`` int32 their indices.
        views: ``(VIEWS_PER_CORNER * C,)`` int32 the best at each point; -1: none. A batch of points
            after the other, and in each rank by rank.
        weights: ``(VIEWS_PER_CORNER * C,)`` their weights.
        ranking: ``(RANKING_SCRATCH,)`` see ``ranking_kernels``.
        best: ``(RANKS * POINTS,)`` int32.
        bounds: ``(G * POINTS,)`` of the penalties of groups of views.
        all_rows: ``(N,)`` int32 0, 1, 2, ...: rows of the views in the index, and
        few_rows: ``(POINTS,)`` int32 of those that the outlook leaves.
        slots: ``(N, 2)`` the last tile that a view was in, counted from 1, and its slot there.
        joined: ``(1,)`` how many tiles there have been.
        at_corner: ``(4 * VIEWS_PER_TILE,)`` weights of a tile's views at its corners, one corner
            after the other.
    """

    across: IntArray
    down: IntArray
    columns: Float32Array
    rows: Float32Array
    pixels: Int32Array
    views: Int32Array
    weights: Float32Array
    ranking: Float32Array
    best: Int32Array
    bounds: Float32Array
    all_rows: Int32Array
    few_rows: Int32Array
    slots: IntArray
    joined: IntArray
    at_corner: Float32Array


def tiling_for(width: int, height: int, view_count: int, group_count: int) -> Tiling:
    """Makes a tiling for images of one size and a light field of so many views and groups."""
    places = _places(width, height)
    points = len(places[-1])
    return Tiling(
        *places,
        aligned(VIEWS_PER_CORNER * points, np.int32),
        aligned(VIEWS_PER_CORNER * points, np.float32),
        aligned(RANKING_SCRATCH, np.float32),
        aligned(RANKS * POINTS, np.int32),
        aligned(group_count * POINTS, np.float32),
        np.arange(view_count, dtype=np.int32),
        np.empty(POINTS, np.int32),
        np.zeros((view_count, 2), np.int64),
        np.zeros(1, np.int64),
        np.zeros(4 * VIEWS_PER_TILE, np.float32),
    )


def _places(
    width: int, height: int
) -> tuple[IntArray, IntArray, Float32Array, Float32Array, Int32Array]:
    """Where the points that are ranked lie, and what else a tiling has of images of one size.

    Returns:
        Its columns and rows of corners; columns, rows and pixels of the points, ``(C,)``.
    """
    across, down = tile_borders(width), tile_borders(height)
    corner_rows, corner_columns = np.meshgrid(down, across, indexing="ij")
    outlook_rows, outlook_columns = np.meshgrid(
        outlook_positions(height), outlook_positions(width), indexing="ij"
    )
    # The last corner stands for those that are not there.
    filled = (0, -corner_rows.size % POINTS)
    columns, rows = (
        np.concatenate([outlook.reshape(-1), np.pad(corners.reshape(-1), filled, mode="edge")])
        for outlook, corners in ((outlook_columns, corner_columns), (outlook_rows, corner_rows))
    )
    pixels = (rows * width + columns).astype(np.int32)
    return across, down, columns.astype(np.float32), rows.astype(np.float32), pixels


@compiled_leaf
def set_labels(across: IntArray, down: IntArray, labels: IntArray) -> None:
    """Writes the tile in which each pixel (H, W) lies, given the columns and rows of corners."""
    height, width = labels.shape
    for i in range(len(down) - 1):
        last_row = down[i + 1] if i + 2 < len(down) else height
        for j in range(len(across) - 1):
            last_column = across[j + 1] if j + 2 < len(across) else width
            for y in range(down[i], last_row):
                for x in range(across[j], last_column):
                    labels[y, x] = i * (len(across) - 1) + j


@compiled_leaf
def _narrow(best: Int32Array, rows: Int32Array) -> int:
    """Writes, rising, the rows of the views that are the best at any point of the outlook.

    Returns:
        Their number.
    """
    count = 0
    for point in range(POINTS):
        row, place = best[point], count
        while place > 0 and rows[place - 1] > row:
            place -= 1
        if row < 0 or (place > 0 and rows[place - 1] == row):
            continue
        for later in range(count, place, -1):
            rows[later] = rows[later - 1]
        rows[place] = row
        count += 1
    return count


@compiled_leaf
def build_tiles(
    pose: FloatArray,
    rays: FloatArray,
    surface: Float32Array,
    views: ViewArrays,
    index: ViewIndex,
    has_depth: bool,
    space: Tiling,
    cell_views: IntArray,
    cell_weights: FloatArray,
) -> None:
    """Cells of the unstructured-lumigraph rule.

    Args:
        pose: (4, 4) world_from_camera of the virtual camera.
        rays: (3, 3) virtual pixels to world directions.
        surface: (H W,) virtual inverse depth; 0: none.
        views: the light field.
        index: of the views that may take part.
        has_depth: whether depth maps may hide the surface.
        space: made for images of this size; changed.
        cell_views: (c, VIEWS_PER_TILE) receives view indices, -1 behind the last.
        cell_weights: (c, VIEWS_PER_TILE, 4) receives coefficients of x, y, 1, x y, relative to the
            tiles' upper left corners.
    """
    rows, count = space.all_rows, len(index.order)
    for first in range(0 if count > MOST_RANKED else POINTS, len(space.pixels), POINTS):
        gather_depths(surface, space.pixels, np.uintp(first), space.ranking)
        set_points(
            pose, rays, index.origin, space.columns, space.rows, np.uintp(first), space.ranking
        )
        if first == 0:
            look_out(views, index, has_depth, space.ranking, space.best, space.bounds)
            rows, count = space.few_rows, _narrow(space.best, space.few_rows)
            continue
        rank_views(views, index, rows, count, has_depth, space.ranking, space.best)
        start = np.uintp(first * VIEWS_PER_CORNER)
        set_shares(space.ranking, space.best, start, space.views, space.weights)
    across = len(space.across)
    for i in range(len(space.down) - 1):
        for j in range(across - 1):
            space.joined[0] += 1
            _join_corners(
                space.views,
                space.weights,
                POINTS + i * across + j,
                across,
                max(space.across[j + 1] - space.across[j], 1),
                max(space.down[i + 1] - space.down[i], 1),
                i * (across - 1) + j,
                space.joined[0],
                space.slots,
                space.at_corner,
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
    mark: int,
    slots: IntArray,
    at_corner: Float32Array,
    cell_views: IntArray,
    cell_weights: FloatArray,
) -> None:
    """Writes the views of a tile's corners and the bilinear functions of their weights.

    Args:
        corner_views: see ``Tiling``, and
        corner_weights: likewise.
        upper_left: index of the tile's first corner.
        across: corners in a row.
        width: of the tile.
        height: of the tile.
        cell: its number.
        mark: its number among all of all images.
        slots: see ``Tiling``; changed.
        at_corner: see ``Tiling``; overwritten.
        cell_views: see ``build_tiles``.
        cell_weights: see ``build_tiles``.
    """
    # Unsigned: see ``sampling_kernels``.
    count, tile = np.uintp(0), np.uintp(cell)
    for i in range(4 * VIEWS_PER_TILE):
        at_corner[i] = ZERO
    for number in range(4):
        corner = upper_left + number // 2 * across + number % 2
        first = corner // POINTS * (VIEWS_PER_CORNER * POINTS) + corner % POINTS
        for rank in range(VIEWS_PER_CORNER):
            entry = np.uintp(first + rank * POINTS)
            if corner_views[entry] < 0:
                break
            view = np.uintp(corner_views[entry])
            # No branches: which views come again nobody can foresee.
            is_new = slots[view, 0] != mark
            slot = either(is_new, count, np.uintp(slots[view, 1]))
            count += np.uintp(is_new)
            slots[view, 0], slots[view, 1] = mark, slot
            cell_views[tile, slot] = view
            at_corner[slot + np.uintp(number * VIEWS_PER_TILE)] = corner_weights[entry]
    if count < np.uintp(VIEWS_PER_TILE):
        cell_views[tile, count] = -1
    step_x, step_y = 1.0 / width, 1.0 / height
    for slot in range(count):
        a = np.float64(at_corner[slot])
        b = np.float64(at_corner[slot + np.uintp(VIEWS_PER_TILE)])
        c = np.float64(at_corner[slot + np.uintp(2 * VIEWS_PER_TILE)])
        d = np.float64(at_corner[slot + np.uintp(3 * VIEWS_PER_TILE)])
        # a (1-s)(1-t) + b s (1-t) + c (1-s) t + d s t with s = x / width, t = y / height.
        cell_weights[tile, slot, 0] = (b - a) * step_x
        cell_weights[tile, slot, 1] = (c - a) * step_y
        cell_weights[tile, slot, 2] = a
        cell_weights[tile, slot, 3] = (a - b - c + d) * step_x * step_y
