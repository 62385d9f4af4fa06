"""Reading views: where a surface point lies in a view, and what it shows along a run of pixels.

The innermost loop of the fast renderer; everything that does not change along a run is read once.
"""

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray, ImageArray, IntArray
from pipelines.lightfield.blending_kernels import is_occluded
from pipelines.lightfield.compiled import compiled_leaf


@compiled_leaf
def locate(
    x: int, y: int, inverse_depth: float, view: int, maps: FloatArray, shifts: FloatArray
) -> tuple[float, float, float]:
    """Column and row in a view of a virtual pixel's surface point, and its depth there.

    The depth is relative to the virtual one; it is 0 for points behind the view.
    """
    depth = (
        maps[view, 2, 0] * x
        + maps[view, 2, 1] * y
        + maps[view, 2, 2]
        + shifts[view, 2] * inverse_depth
    )
    if depth <= 0.0:
        return 0.0, 0.0, 0.0
    reciprocal = 1.0 / depth
    u = (
        maps[view, 0, 0] * x
        + maps[view, 0, 1] * y
        + maps[view, 0, 2]
        + shifts[view, 0] * inverse_depth
    ) * reciprocal
    v = (
        maps[view, 1, 0] * x
        + maps[view, 1, 1] * y
        + maps[view, 1, 2]
        + shifts[view, 1] * inverse_depth
    ) * reciprocal
    return u, v, depth


@compiled_leaf
def is_inside(level_size: IntArray, view: int, u: float, v: float) -> bool:
    """Whether a place lies inside a view's image."""
    return bool(
        -0.5 <= u <= level_size[view, 0, 0] - 0.5 and -0.5 <= v <= level_size[view, 0, 1] - 0.5
    )


@compiled_leaf
def pyramid_level(scale: float, levels: int) -> int:
    """The level on which a pixel that spans ``scale`` pixels of the finest one spans about one."""
    level, limit = 0, np.sqrt(2.0)
    while level + 1 < levels and scale >= limit:
        level += 1
        limit *= 2.0
    return level


@compiled_leaf
def add_view(
    y: int,
    first: int,
    last: int,
    view: int,
    cell: int,
    slot: int,
    weights: FloatArray,
    has_depth: bool,
    surface: FloatArray,
    maps: FloatArray,
    shifts: FloatArray,
    focal_ratio: float,
    texels: ImageArray,
    level_start: IntArray,
    level_size: IntArray,
    inverse_depth: Float32Array,
    depth_start: IntArray,
    depth_size: IntArray,
    total: Float32Array,
    image: Float32Array,
) -> None:
    """Adds what one view shows, times its weight, to a run of pixels of one row.

    All that does not change along the run is read once, before the loop.

    Args:
        y: the row.
        first: first column of the run.
        last: column behind the run.
        view: which.
        cell: of the run, and
        slot: of the view in it: where its weight stands in
        weights: (c, k, 4) coefficients of x, y, 1, x y.
        has_depth: whether depth maps may hide the surface.
        surface: (H, W) virtual inverse depth.
        maps: (N, 3, 3), shifts: (N, 3), see ``view_mapping``.
        focal_ratio: focal length of the view over that of the virtual camera.
        texels: and the following five: see ``ViewArrays``.
        total: (W,) sums of weights, changed.
        image: (H, W, 3) sums of weighted colours, changed.
    """
    weight_step = weights[cell, slot, 0] + weights[cell, slot, 3] * y
    weight_base = weights[cell, slot, 1] * y + weights[cell, slot, 2]
    step_u, step_v, step_w = maps[view, 0, 0], maps[view, 1, 0], maps[view, 2, 0]
    base_u = maps[view, 0, 1] * y + maps[view, 0, 2]
    base_v = maps[view, 1, 1] * y + maps[view, 1, 2]
    base_w = maps[view, 2, 1] * y + maps[view, 2, 2]
    shift_u, shift_v, shift_w = shifts[view, 0], shifts[view, 1], shifts[view, 2]
    full_width, full_height = level_size[view, 0, 0], level_size[view, 0, 1]
    right_border, lower_border = full_width - 0.5, full_height - 0.5
    levels = level_size.shape[1]
    # A level is right for depths in (nearest, farthest]; most often the next pixel needs the same.
    nearest, farthest = np.inf, -np.inf
    width, height, start = 1, 1, 0
    scale_x, scale_y = 1.0, 1.0
    for x in range(first, last):
        weight = np.float32(weight_step * x + weight_base)
        own = surface[y, x]
        if weight <= 0.0 or own <= 0.0:
            continue
        depth = step_w * x + base_w + shift_w * own
        if depth <= 0.0:
            continue
        reciprocal = 1.0 / depth
        u = (step_u * x + base_u + shift_u * own) * reciprocal
        v = (step_v * x + base_v + shift_v * own) * reciprocal
        if not (-0.5 <= u <= right_border and -0.5 <= v <= lower_border):
            continue
        if has_depth and is_occluded(
            inverse_depth, depth_start, depth_size, level_size, view, u, v, own * reciprocal
        ):
            continue
        if depth <= nearest or depth > farthest:
            level = pyramid_level(focal_ratio * reciprocal, levels)
            width, height = level_size[view, level, 0], level_size[view, level, 1]
            start = level_start[view, level]
            scale_x, scale_y = width / full_width, height / full_height
            coarsest = level + 1 >= levels
            nearest = 0.0 if coarsest else focal_ratio / (np.sqrt(2.0) * 2.0**level)
            farthest = np.inf if level == 0 else focal_ratio * np.sqrt(2.0) / 2.0**level
        u = min(max((u + 0.5) * scale_x - 0.5, 0.0), width - 1.0)
        v = min(max((v + 0.5) * scale_y - 0.5, 0.0), height - 1.0)
        left, top = int(u), int(v)
        upper = start + top * width + left
        lower = upper + (width if top + 1 < height else 0)
        right = 1 if left + 1 < width else 0
        fraction_x, fraction_y = np.float32(u - left), np.float32(v - top)
        rest_y = weight * (np.float32(1.0) - fraction_y)
        fraction_y *= weight
        b, d = fraction_x * rest_y, fraction_x * fraction_y
        a, c = rest_y - b, fraction_y - d
        total[x] += weight
        for channel in range(3):
            image[y, x, channel] += (
                a * np.float32(texels[upper, channel])
                + b * np.float32(texels[upper + right, channel])
                + c * np.float32(texels[lower, channel])
                + d * np.float32(texels[lower + right, channel])
            )
