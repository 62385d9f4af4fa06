"""Which surface points a view does not show, since its depth map has something nearer, compiled.

Depth maps are too large for the processor's near memory. The nearest values in squares of them
(``ViewArrays.blocks``) are not, and leave only points near the edges of things to be looked up.
"""

import numpy as np

from pipelines.artifacts.array_types import Float32Array, IntArray
from pipelines.lightfield.blending import OCCLUSION_FACTOR
from pipelines.lightfield.compiled import compiled_leaf, compiled_part
from pipelines.lightfield.texel_intrinsic import LANES, find_hidden_lanes
from pipelines.lightfield.views import BLOCK_SIDE

HIDDEN = np.float32(OCCLUSION_FACTOR)
# Values of one depth map that the near memory holds, beside the photo.
SMALL_MAP = 1 << 15


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


@compiled_part
def find_hidden(
    blocks: Float32Array,
    block_start: int,
    inverse_depth: Float32Array,
    depth_start: int,
    width: int,
    height: int,
    full_width: int,
    full_height: int,
    most: int,
    scratch: Float32Array,
    column: np.uintp,
    row: np.uintp,
    nearness: np.uintp,
    hidden: np.uintp,
    count: int,
) -> bool:
    """Finds points before which a view has something nearer.

    Args:
        blocks: the nearest of the blocks of all depth maps; see ``ViewArrays``.
        block_start: where the view's begin.
        inverse_depth: all depth maps.
        depth_start: where the view's begins.
        width: of it; 0: there is none.
        height: of it.
        full_width: of the view, on the level that columns and rows are of, and
        full_height: likewise.
        most: in depth maps of no more values than this points are looked up at once, in others
            among the blocks first.
        scratch: with the points and the result.
        column: where the row with columns in the view begins, inside the image; and
        row: the row with rows; and
        nearness: that with the points' inverse depths in the view; and
        hidden: that which receives 1 for points that are hidden, else 0.
        count: of the points, a multiple of ``LANES``.

    Returns:
        Whether any is.
    """
    if width == 0:
        return False
    table, start, side = blocks, block_start, BLOCK_SIDE
    if width * height <= most:
        table, start, side = inverse_depth, depth_start, 1
    while True:
        across, share = np.int32((width + side - 1) // side), 1.0 / side
        scale_x, scale_y = share * width / full_width, share * height / full_height
        last_x, last_y = share * (width - 1), share * (height - 1)
        is_any = False
        for number in range(0, count, LANES):
            first = np.uintp(number)
            is_any |= find_hidden_lanes(
                table,
                start,
                across,
                np.float32(scale_x),
                np.float32(scale_y),
                np.float32(last_x),
                np.float32(last_y),
                HIDDEN,
                scratch,
                column + first,
                row + first,
                nearness + first,
                hidden + first,
            )
        if side == 1 or not is_any:
            return is_any
        table, start, side = inverse_depth, depth_start, 1
