"""Which surface points a view does not show, since its depth map has something nearer, compiled.

Depth maps are too large for the processor's near memory. The nearest values in squares of them
(``ViewArrays.blocks``) are not, and leave only points near the edges of things to be looked up.
That pays where points are scattered; those of a chunk that is blended lie near each other.
"""

import numpy as np

from pipelines.artifacts.array_types import Float32Array, Int32Array, IntArray
from pipelines.lightfield.blending import OCCLUSION_FACTOR
from pipelines.lightfield.compiled import compiled_leaf, compiled_loop
from pipelines.lightfield.texel_intrinsic import LANES, gather_lanes
from pipelines.lightfield.views import BLOCK_SIDE, ViewArrays

HIDDEN = np.float32(OCCLUSION_FACTOR)
HALF, ONE, ZERO = np.float32(0.5), np.float32(1.0), np.float32(0.0)
BLOCKS = np.float32(1.0 / BLOCK_SIDE)


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


@compiled_loop
def _set_places(
    scratch: Float32Array,
    column: np.uintp,
    row: np.uintp,
    scale_x: np.float32,
    scale_y: np.float32,
    width: np.float32,
    height: np.float32,
    share: np.float32,
    across: np.int32,
    places: Int32Array,
    count: np.uintp,
) -> None:
    """Writes where in a view's depth map, or among its blocks, points are looked up.

    Args:
        scratch: see ``find_hidden``, as for the next two.
        column: see there.
        row: see there.
        scale_x: how many of the depth map's columns one of the view's is, and
        scale_y: of its rows.
        width: of the depth map, and
        height: likewise.
        share: one over the side of a block.
        across: blocks in a row.
        places: receives the places.
        count: of the points.
    """
    for i in range(count):
        x = min((scratch[column + i] + HALF) * scale_x, width - ONE) * share
        y = min((scratch[row + i] + HALF) * scale_y, height - ONE) * share
        # Products of 32 bits stay that; sums of two numbers of 32 bits would take 64.
        places[i] = np.int32(np.int32(y) * across) + np.int32(x)


@compiled_loop
def _compare(
    scratch: Float32Array, nearness: np.uintp, seen: np.uintp, count: np.uintp
) -> np.float32:
    """Puts 1 in the place of what is seen where it hides the point, else 0; returns the sum."""
    total = ZERO
    for i in range(count):
        hides = ONE if scratch[seen + i] > HIDDEN * scratch[nearness + i] else ZERO
        scratch[seen + i] = hides
        total += hides
    return total


@compiled_leaf
def find_hidden(
    views: ViewArrays,
    view: int,
    by_blocks: bool,
    scratch: Float32Array,
    column: np.uintp,
    row: np.uintp,
    nearness: np.uintp,
    seen: np.uintp,
    places: Int32Array,
    count: int,
) -> bool:
    """Finds points before which a view has something nearer.

    Args:
        views: the light field.
        view: which.
        by_blocks: whether to look for something nearer anywhere in their blocks: then some may be
            found that are not hidden, but none is missed.
        scratch: with the points and the result.
        column: where the row with columns in the view's finest level begins, inside the image; and
        row: the row with rows; and
        nearness: that with the points' inverse depths in the view; and
        seen: that which receives 1 for points that are hidden, else 0.
        places: (count,) int32, overwritten.
        count: of the points, a multiple of ``LANES``.

    Returns:
        Whether any is.
    """
    width, height = views.depth_size[view, 0], views.depth_size[view, 1]
    if width == 0:
        return False
    table, start = views.inverse_depth, views.depth_start[view]
    share, across = ONE, width
    if by_blocks:
        table, start = views.blocks, views.block_start[view]
        share, across = BLOCKS, (width + BLOCK_SIDE - 1) // BLOCK_SIDE
    _set_places(
        scratch,
        column,
        row,
        np.float32(width / views.level_size[view, 0, 0]),
        np.float32(height / views.level_size[view, 0, 1]),
        np.float32(width),
        np.float32(height),
        share,
        np.int32(across),
        places,
        np.uintp(count),
    )
    for first in range(0, count, LANES):
        gather_lanes(table, start, places, first, scratch, seen + np.uintp(first))
    return bool(_compare(scratch, nearness, seen, np.uintp(count)) > ZERO)
