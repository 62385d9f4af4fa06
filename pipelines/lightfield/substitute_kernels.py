"""Pixels that none of their cell's views show: which other view does, compiled.

Most such pixels are shown by no view at all. So views are ruled out for whole regions first: the
surface points of a rectangle of pixels lie within a box of columns, rows and inverse depths, and
places in a view are linear in these; where all corners of the box are beyond the same border of a
view, everything between them is.
"""

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray, IntArray
from pipelines.lightfield.compiled import compiled_leaf, compiled_part
from pipelines.lightfield.mapping_kernels import is_inside, locate, view_mapping
from pipelines.lightfield.net_kernels import project_centre
from pipelines.lightfield.occlusion_kernels import is_occluded
from pipelines.lightfield.pixel_order_kernels import PixelOrder
from pipelines.lightfield.workspace import LightField, Workspace


@compiled_leaf
def _may_show(
    maps: FloatArray, shifts: FloatArray, level_size: IntArray, view: int, box: FloatArray
) -> bool:
    """Whether a view may show a point of a box: columns, rows, inverse depths, two of each (6,)."""
    right, bottom = level_size[view, 0, 0] - 0.5, level_size[view, 0, 1] - 0.5
    behind, left_of, right_of, above, below = 0, 0, 0, 0, 0
    for corner in range(8):
        x, y, d = box[corner % 2], box[2 + corner // 2 % 2], box[4 + corner // 4]
        u = maps[view, 0, 0] * x + maps[view, 0, 1] * y + maps[view, 0, 2] + shifts[view, 0] * d
        v = maps[view, 1, 0] * x + maps[view, 1, 1] * y + maps[view, 1, 2] + shifts[view, 1] * d
        w = maps[view, 2, 0] * x + maps[view, 2, 1] * y + maps[view, 2, 2] + shifts[view, 2] * d
        behind += w <= 0.0
        left_of += u < -0.5 * w
        right_of += u > right * w
        above += v < -0.5 * w
        below += v > bottom * w
    return max(behind, left_of, right_of, above, below) < 8


@compiled_leaf
def _set_box(
    image: Float32Array,
    surface: Float32Array,
    order: PixelOrder,
    first: int,
    last: int,
    box: FloatArray,
) -> bool:
    """Writes the box around the uncovered ones of some pixels; False where there are none."""
    for i in range(3):
        box[2 * i], box[2 * i + 1] = np.inf, -np.inf
    found = False
    for i in range(first, last):
        d = np.float64(surface[order.chosen[i]])
        if image[i, 3] > 0.0 or d <= 0.0:
            continue
        found = True
        x, y = np.float64(order.chosen_columns[i]), np.float64(order.chosen_rows[i])
        box[0], box[1] = min(box[0], x), max(box[1], x)
        box[2], box[3] = min(box[2], y), max(box[3], y)
        box[4], box[5] = min(box[4], d), max(box[5], d)
    return found


@compiled_part
def find_substitutes(
    field: LightField,
    pose: FloatArray,
    intrinsics: FloatArray,
    surface: Float32Array,
    width: int,
    image: Float32Array,
    space: Workspace,
) -> int:
    """Finds for each uncovered pixel the view with the nearest projected centre that shows it.

    Args:
        field: the light field.
        pose: (4, 4) world_from_camera.
        intrinsics: (4,) fx, fy, cx, cy.
        surface: (H W,) inverse depths; 0: there is no surface.
        width: of the virtual image.
        image: (P, 4) where the last number is 0, the pixel is not covered.
        space: its substitutes receive those of the P pixels that a view shows, and the views; maps
            and shifts are changed.

    Returns:
        How many these are.
    """
    views, order = field.views, space.order
    count, pixel_count = len(views.centres), len(order.chosen)
    pixels, chosen = space.substitutes.pixels, space.substitutes.views
    everywhere, here = space.substitutes.everywhere, space.substitutes.here
    box = space.substitutes.box
    if not _set_box(image, surface, order, 0, pixel_count, box):
        return 0
    candidates = 0
    for view in range(count):
        if not field.usable[view] or (field.is_net and not space.takes_part[view]):
            continue
        if not space.is_mapped[view]:
            view_mapping(views.projection, view, pose, space.rays, space.maps, space.shifts)
            space.is_mapped[view] = True
        if _may_show(space.maps, space.shifts, views.level_size, view, box):
            everywhere[candidates] = view
            candidates += 1
    found, last = 0, 0
    while last < pixel_count and candidates > 0:
        first, row = last, order.chosen_rows[last]
        while last < pixel_count and order.chosen_rows[last] == row:
            last += 1
        if not _set_box(image, surface, order, first, last, box):
            continue
        in_row = 0
        for number in range(candidates):
            view = everywhere[number]
            if _may_show(space.maps, space.shifts, views.level_size, view, box):
                here[in_row] = view
                in_row += 1
        for i in range(first, last):
            pixel = order.chosen[i]
            if in_row == 0 or image[i, 3] > 0.0 or surface[pixel] <= 0.0:
                continue
            view = _nearest(field, pose, intrinsics, pixel, width, surface, here, in_row, space)
            if view >= 0:
                pixels[found], chosen[found, 0] = i, view
                found += 1
    return found


@compiled_leaf
def _nearest(
    field: LightField,
    pose: FloatArray,
    intrinsics: FloatArray,
    pixel: int,
    width: int,
    surface: Float32Array,
    candidates: IntArray,
    count: int,
    space: Workspace,
) -> int:
    """Of the first ``count`` candidates that show a pixel the nearest; -1 for none.

    One that may be occluded is taken only where all others are.
    """
    views = field.views
    x, y, inverse_depth = pixel % width, pixel // width, np.float64(surface[pixel])
    best, shortest = -1, np.inf
    best_hidden, shortest_hidden = -1, np.inf
    offset, corner = space.substitutes.offset, space.substitutes.corner
    for number in range(count):
        view = candidates[number]
        u, v, depth = locate(x, y, inverse_depth, view, space.maps, space.shifts)
        if depth <= 0.0 or not is_inside(views.level_size, view, u, v):
            continue
        for i in range(3):
            offset[i] = views.centres[view, i] - pose[i, 3]
        project_centre(offset, pose, intrinsics, corner)
        distance = (corner[0] - x) ** 2 + (corner[1] - y) ** 2
        own = inverse_depth / depth
        if field.has_depth and is_occluded(views, view, u, v, own):
            if distance < shortest_hidden:
                best_hidden, shortest_hidden = view, distance
        elif distance < shortest:
            best, shortest = view, distance
    return best if best >= 0 else best_hidden
