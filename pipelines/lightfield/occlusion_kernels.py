"""Which surface points a view does not show, since its depth map has something nearer, compiled.

Depth maps are too large for the processor's near memory. The nearest values in squares of them
(``ViewArrays.blocks``) are not, and leave only points near the edges of things to be looked up.
"""

import numpy as np

from pipelines.artifacts.array_types import Float32Array
from pipelines.lightfield.blending import OCCLUSION_FACTOR
from pipelines.lightfield.compiled import compiled_leaf, compiled_part
from pipelines.lightfield.lane_intrinsics import find_hidden_lanes, set_lanes
from pipelines.lightfield.sampling_kernels import COLUMN, LOWER, NEARNESS, ROW, UPPER
from pipelines.lightfield.vector_code import LANES
from pipelines.lightfield.views import BLOCK_SIDE, ViewArrays

HIDDEN, SHARE = np.float32(OCCLUSION_FACTOR), np.float32(1.0 / BLOCK_SIDE)
ONE, ZERO = np.float32(1.0), np.float32(0.0)
EVERY_LANE = (1 << LANES) - 1


@compiled_leaf
def is_occluded(views: ViewArrays, view: int, u: float, v: float, own: float) -> bool:
    """Whether a view sees something nearer in the direction of a surface point.

    Args:
        views: the light field.
        view: which.
        u: column of the point in the view's finest level, inside the image.
        v: its row.
        own: the point's inverse depth in the view.
    """
    width, height = views.depth_size[view, 0], views.depth_size[view, 1]
    if width == 0:
        return False
    column = min(int((u + 0.5) * (width / views.level_size[view, 0, 0])), width - 1)
    row = min(int((v + 0.5) * (height / views.level_size[view, 0, 1])), height - 1)
    seen = np.float64(views.inverse_depth[views.depth_start[view] + row * width + column])
    return bool(seen > OCCLUSION_FACTOR * own)


@compiled_part
def leave_out_hidden(
    views: ViewArrays, view: int, level: int, scratch: Float32Array, count: int
) -> None:
    """Sets the weights of a chunk's points to 0 before which a view has something nearer.

    Args:
        views: the light field.
        view: which.
        level: the pyramid level on which the points are placed.
        scratch: of the chunk, changed.
        count: of the points, a multiple of ``LANES``.
    """
    for number in range(0, count, LANES):
        first = np.uintp(number)
        places = (COLUMN + first, ROW + first, NEARNESS + first)
        lanes = hidden_lanes(EVERY_LANE, views, view, level, scratch, places)
        if lanes:
            set_lanes(lanes, scratch, UPPER + first, ZERO)
            set_lanes(lanes, scratch, LOWER + first, ZERO)


@compiled_leaf
def hidden_lanes(
    lanes: int,
    views: ViewArrays,
    view: int,
    level: int,
    scratch: Float32Array,
    places: tuple[np.uintp, np.uintp, np.uintp],
) -> int:
    """Which of ``LANES`` points a view does not show, since it has something nearer before them.

    Args:
        lanes: a bit for each point, 1 where that is asked.
        views: the light field.
        view: which.
        level: of its pyramid, that columns and rows are of.
        scratch: with the points.
        places: where in it the points' columns, rows and inverse depths in the view begin.

    Returns:
        A bit for each point, 1 where it is hidden.
    """
    width, height = views.depth_size[view, 0], views.depth_size[view, 1]
    if width == 0:
        return 0
    across, down = np.float32(width), np.float32(height)
    scale_x = across / np.float32(views.level_size[view, level, 0])
    scale_y = down / np.float32(views.level_size[view, level, 1])
    lanes = find_hidden_lanes(
        lanes,
        views.blocks,
        views.block_start[view],
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
        return 0
    return find_hidden_lanes(
        lanes,
        views.inverse_depth,
        views.depth_start[view],
        np.int32(width),
        scale_x,
        scale_y,
        across - ONE,
        down - ONE,
        HIDDEN,
        scratch,
        places,
    )
