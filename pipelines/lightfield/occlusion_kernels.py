"""Which surface points a view does not show, since its depth map has something nearer, compiled.

Depth maps are too large for the processor's near memory. The nearest values in squares of them
(``ViewArrays.blocks``) are not, and leave only points near the edges of things to be looked up.
"""

import numpy as np

from pipelines.artifacts.array_types import Float32Array, IntArray
from pipelines.lightfield.blending import OCCLUSION_FACTOR
from pipelines.lightfield.compiled import compiled_leaf, compiled_part
from pipelines.lightfield.lane_intrinsics import find_hidden_lanes, set_lanes
from pipelines.lightfield.sampling_kernels import COLUMN, LOWER, NEARNESS, ROW, UPPER
from pipelines.lightfield.vector_code import LANES
from pipelines.lightfield.views import BLOCK_SIDE

HIDDEN, SHARE = np.float32(OCCLUSION_FACTOR), np.float32(1.0 / BLOCK_SIDE)
ONE, ZERO = np.float32(1.0), np.float32(0.0)
EVERY_LANE = (1 << LANES) - 1


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
def leave_out_hidden(
    blocks: Float32Array,
    block_start: int,
    inverse_depth: Float32Array,
    depth_start: int,
    width: int,
    height: int,
    full_width: int,
    full_height: int,
    scratch: Float32Array,
    count: int,
) -> None:
    """Sets the weights of a chunk's points to 0 before which a view has something nearer.

    Args:
        blocks: see ``hidden_lanes``, as for the next seven.
        block_start: see there.
        inverse_depth: see there.
        depth_start: see there.
        width: see there.
        height: see there.
        full_width: see there.
        full_height: see there.
        scratch: of the chunk, whose samples are placed; changed.
        count: of the points, a multiple of ``LANES``.
    """
    if width == 0:
        return
    for number in range(0, count, LANES):
        first = np.uintp(number)
        lanes = hidden_lanes(
            EVERY_LANE,
            blocks,
            block_start,
            inverse_depth,
            depth_start,
            width,
            height,
            full_width,
            full_height,
            scratch,
            (COLUMN + first, ROW + first, NEARNESS + first),
        )
        if lanes:
            set_lanes(lanes, scratch, UPPER + first, ZERO)
            set_lanes(lanes, scratch, LOWER + first, ZERO)


@compiled_leaf
def hidden_lanes(
    lanes: int,
    blocks: Float32Array,
    block_start: int,
    inverse_depth: Float32Array,
    depth_start: int,
    width: int,
    height: int,
    full_width: int,
    full_height: int,
    scratch: Float32Array,
    places: tuple[np.uintp, np.uintp, np.uintp],
) -> int:
    """Which of ``LANES`` points a view does not show, since it has something nearer before them.

    Args:
        lanes: a bit for each point, 1 where that is asked.
        blocks: the nearest of the blocks of all depth maps; see ``ViewArrays``.
        block_start: where the view's begin.
        inverse_depth: all depth maps.
        depth_start: where the view's begins.
        width: of it, more than 0.
        height: of it.
        full_width: of the view, on the level that columns and rows are of, and
        full_height: likewise.
        scratch: with the points.
        places: where in it the points' columns, rows and inverse depths in the view begin.

    Returns:
        A bit for each point, 1 where it is hidden.
    """
    across, down = np.float32(width), np.float32(height)
    scale_x, scale_y = across / np.float32(full_width), down / np.float32(full_height)
    lanes = find_hidden_lanes(
        lanes,
        blocks,
        block_start,
        np.int32((width + BLOCK_SIDE - 1) // BLOCK_SIDE),
        SHARE * scale_x,
        SHARE * scale_y,
        SHARE * (across - ONE),
        SHARE * (down - ONE),
        HIDDEN,
        scratch,
        places,
    )
    if lanes == 0:
        return lanes
    return find_hidden_lanes(
        lanes,
        inverse_depth,
        depth_start,
        np.int32(width),
        scale_x,
        scale_y,
        across - ONE,
        down - ONE,
        HIDDEN,
        scratch,
        places,
    )
