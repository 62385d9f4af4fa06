"""Unstructured-lumigraph weights, fast: the same tiles as ``blending``, compiled into cells.

A tile is a cell in the sense of ``net_kernels``: some views, each with a weight that is bilinear in
the pixel, so that the renderer need not know which rule made it.
"""

import functools
from typing import NamedTuple

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray, Int32Array, IntArray
from pipelines.lightfield.blending import (
    MOST_RANKED,
    OUTLOOK_VIEWS,
    VIEWS_PER_CORNER,
    VIEWS_PER_TILE,
    outlook_positions,
    tile_borders,
)
from pipelines.lightfield.compiled import compiled_leaf
from pipelines.lightfield.ranking_kernels import (
    POINTS,
    RANKING_SCRATCH,
    RANKS,
    gather_depths,
    order_groups,
    rank_views,
    set_points,
    set_shares,
)
from pipelines.lightfield.record_type import compiled_record
from pipelines.lightfield.view_index import VIEW_NUMBERS, ViewIndex
from pipelines.lightfield.views import ViewArrays

# Views that many are narrowed down to, at most. The outlook's points are one batch.
MOST_NARROWED = OUTLOOK_VIEWS * POINTS
# Instead of the last tile that a view was in.
NARROWED = -2


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
        views: ``(VIEWS_PER_CORNER, C)`` int32 the best at each point; -1: none.
        weights: ``(VIEWS_PER_CORNER, C)`` their weights.
        ranking: ``(RANKING_SCRATCH,)`` see ``ranking_kernels``.
        best: ``(RANKS * POINTS,)`` int32, likewise.
        deviations: ``(G,)`` of the groups of views, and
        groups: ``(G,)`` in which order they are looked at.
        narrow_order: ``(MOST_NARROWED,)`` int32 and
        narrow_starts: ``(2,)`` and
        narrow_numbers: ``(MOST_NARROWED, VIEW_NUMBERS)``: an index of a few of the views.
        slots: ``(2, N)`` the last tile that a view was in, and its slot there.
        at_corner: ``(VIEWS_PER_TILE, 4)`` weights of a tile's views at its corners.
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
    deviations: FloatArray
    groups: IntArray
    narrow_order: Int32Array
    narrow_starts: IntArray
    narrow_numbers: Float32Array
    slots: IntArray
    at_corner: FloatArray


def tiling_for(width: int, height: int, view_count: int, group_count: int) -> Tiling:
    """Makes a tiling for images of one size and a light field of so many views and groups."""
    places = _places(width, height)
    points = len(places[-1])
    return Tiling(
        *places,
        np.empty((VIEWS_PER_CORNER, points), np.int32),
        np.empty((VIEWS_PER_CORNER, points), np.float32),
        np.empty(RANKING_SCRATCH, np.float32),
        np.empty(RANKS * POINTS, np.int32),
        np.empty(group_count + 1),
        np.zeros(group_count + 1, np.int64),
        np.empty(MOST_NARROWED, np.int32),
        np.zeros(2, np.int64),
        np.empty((MOST_NARROWED, VIEW_NUMBERS), np.float32),
        np.empty((2, view_count), np.int64),
        np.empty((VIEWS_PER_TILE, 4)),
    )


@functools.lru_cache(maxsize=32)
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
def _narrow(index: ViewIndex, space: Tiling) -> int:
    """Makes an index of those views alone that are the best at the points of the outlook.

    Returns:
        Their number.
    """
    count = 0
    space.slots[0] = -1
    for rank in range(OUTLOOK_VIEWS):
        for point in range(POINTS):
            view = space.views[rank, point]
            if view < 0 or space.weights[rank, point] <= 0.0:
                continue
            if space.slots[0, view] != NARROWED:
                space.slots[0, view] = NARROWED
                space.narrow_order[count] = view
                place = index.places[view]
                for i in range(VIEW_NUMBERS):
                    space.narrow_numbers[count, i] = index.numbers[place, i]
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
    numbers, order, starts = index.numbers, index.order, index.starts
    groups, start = len(index.spheres), 0 if len(order) > MOST_RANKED else POINTS
    for first in range(start, len(space.pixels), POINTS):
        gather_depths(surface, space.pixels, np.uintp(first), space.ranking)
        set_points(
            pose, rays, index.origin, space.columns, space.rows, np.uintp(first), space.ranking
        )
        if first == start:
            order_groups(index.spheres, space.ranking, space.deviations, space.groups)
        rank_views(
            views,
            numbers,
            order,
            starts,
            index.spheres,
            space.groups,
            groups,
            has_depth,
            space.ranking,
            space.best,
        )
        set_shares(space.ranking, space.best, first, space.views, space.weights)
        if first == 0:
            space.narrow_starts[1] = _narrow(index, space)
            numbers, order, starts = space.narrow_numbers, space.narrow_order, space.narrow_starts
            groups, space.groups[0] = 1, 0
    space.slots[0] = -1
    across = len(space.across)
    for i in range(len(space.down) - 1):
        for j in range(across - 1):
            _join_corners(
                space.views,
                space.weights,
                POINTS + i * across + j,
                across,
                max(space.across[j + 1] - space.across[j], 1),
                max(space.down[i + 1] - space.down[i], 1),
                i * (across - 1) + j,
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
