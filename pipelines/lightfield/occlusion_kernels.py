"""Which surface points a view does not show, since its depth map has something nearer, compiled.

Depth maps are too large for the processor's near memory. The nearest values in squares of them
(``ViewArrays.blocks``) are not, and leave only points near the edges of things to be looked up.
That pays where points are scattered; those of a chunk that is blended lie near each other.
"""

import numpy as np

from pipelines.artifacts.array_types import Float32Array, IntArray
from pipelines.lightfield.blending import OCCLUSION_FACTOR
from pipelines.lightfield.compiled import compiled_leaf
from pipelines.lightfield.texel_intrinsic import LANES, find_hidden_lanes
from pipelines.lightfield.views import BLOCK_SIDE, ViewArrays


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
def find_hidden(
    views: ViewArrays,
    view: int,
    by_blocks: bool,
    scratch: Float32Array,
    column: np.uintp,
    row: np.uintp,
    nearness: np.uintp,
    seen: np.uintp,
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
        count: of the points, a multiple of ``LANES``.

    Returns:
        Whether any is.
    """
    width, height = views.depth_size[view, 0], views.depth_size[view, 1]
    if width == 0:
        return False
    table, start = views.inverse_depth, views.depth_start[view]
    share, across = 1.0, width
    if by_blocks:
        table, start = views.blocks, views.block_start[view]
        share, across = 1.0 / BLOCK_SIDE, (width + BLOCK_SIDE - 1) // BLOCK_SIDE
    coefficients = (
        np.float32(share * width / views.level_size[view, 0, 0]),
        np.float32(share * height / views.level_size[view, 0, 1]),
        np.float32(share * (width - 1)),
        np.float32(share * (height - 1)),
        np.float32(OCCLUSION_FACTOR),
    )
    is_any = False
    for number in range(0, count, LANES):
        first = np.uintp(number)
        is_any |= find_hidden_lanes(
            table,
            start,
            np.int32(across),
            coefficients,
            scratch,
            column + first,
            row + first,
            nearness + first,
            seen + first,
        )
    return is_any
