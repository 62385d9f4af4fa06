"""The fast renderer, compiled: one virtual view into a buffer that stays in the processor's cache.

Same steps and results as ``reference``: mappings over the plane, views in the frustum, net, blend.
Everything here is a function of its arguments and releases the interpreter lock.
"""

import numpy as np

from pipelines.artifacts.array_types import (
    BoolArray,
    Float32Array,
    FloatArray,
    ImageArray,
    IntArray,
)
from pipelines.lightfield.blending import TILE_COLUMNS, TILE_ROWS
from pipelines.lightfield.blending_kernels import build_tiles
from pipelines.lightfield.compiled import compiled
from pipelines.lightfield.net_kernels import build_net, project_centre
from pipelines.lightfield.reference import FRUSTUM_SAMPLES, SMALLEST_WEIGHT

MAX_TILES = TILE_ROWS * TILE_COLUMNS


@compiled
def plane_rays(
    pose: FloatArray, intrinsics: FloatArray, plane: FloatArray, points: FloatArray
) -> float:
    """Writes the (4, 3) matrix from virtual pixels to homogeneous points on the plane.

    A pixel p maps to ``points @ p`` with the homogeneous coordinate ``-n . r(p)`` in the last row,
    which is positive where the ray meets the plane in front of the virtual camera.

    Returns:
        The virtual centre's signed distance from the plane.
    """
    height = plane[3]
    for i in range(3):
        height += plane[i] * pose[i, 3]
    for i in range(3):
        x, y, z = pose[i, 0] / intrinsics[0], pose[i, 1] / intrinsics[1], pose[i, 2]
        points[i, 0], points[i, 1] = x, y
        points[i, 2] = z - x * intrinsics[2] - y * intrinsics[3]
    for j in range(3):
        facing = plane[0] * points[0, j] + plane[1] * points[1, j] + plane[2] * points[2, j]
        for i in range(3):
            points[i, j] = height * points[i, j] - pose[i, 3] * facing
        points[3, j] = -facing
    return float(height)


@compiled
def view_mapping(projection: FloatArray, points: FloatArray, mapping: FloatArray) -> None:
    """Writes the (3, 3) mapping from virtual pixels into a view, the paper's B_i B_V^-1."""
    for i in range(3):
        for j in range(3):
            mapping[i, j] = (
                projection[i, 0] * points[0, j]
                + projection[i, 1] * points[1, j]
                + projection[i, 2] * points[2, j]
                + projection[i, 3] * points[3, j]
            )


@compiled
def is_in_frustum(
    mapping: FloatArray,
    facing: FloatArray,
    view_width: int,
    view_height: int,
    width: int,
    height: int,
) -> bool:
    """Whether a view sees any of a grid of surface points of the virtual frustum."""
    for row in range(FRUSTUM_SAMPLES):
        y = -0.5 + height * row / (FRUSTUM_SAMPLES - 1)
        for column in range(FRUSTUM_SAMPLES):
            x = -0.5 + width * column / (FRUSTUM_SAMPLES - 1)
            if facing[0] * x + facing[1] * y + facing[2] <= 0.0:
                continue
            depth = mapping[2, 0] * x + mapping[2, 1] * y + mapping[2, 2]
            if depth <= 0.0:
                continue
            u = (mapping[0, 0] * x + mapping[0, 1] * y + mapping[0, 2]) / depth
            v = (mapping[1, 0] * x + mapping[1, 1] * y + mapping[1, 2]) / depth
            if -0.5 <= u <= view_width - 0.5 and -0.5 <= v <= view_height - 0.5:
                return True
    return False


@compiled
def level_limits(mapping: FloatArray, limits: FloatArray) -> None:
    """Writes, for each pyramid level, the largest depth at which it is coarse enough to use.

    A virtual pixel covers |det H| / depth^3 pixels of the view; level l is used where the square
    root of that lies between 2^(l - 1/2) and 2^(l + 1/2).
    """
    determinant = abs(
        mapping[0, 0] * (mapping[1, 1] * mapping[2, 2] - mapping[1, 2] * mapping[2, 1])
        - mapping[0, 1] * (mapping[1, 0] * mapping[2, 2] - mapping[1, 2] * mapping[2, 0])
        + mapping[0, 2] * (mapping[1, 0] * mapping[2, 1] - mapping[1, 1] * mapping[2, 0])
    )
    limits[0] = np.inf
    for level in range(1, len(limits)):
        limits[level] = np.cbrt(determinant * 2.0 / 4.0**level)


@compiled
def sample_view(
    x: int,
    y: int,
    view: int,
    mappings: FloatArray,
    limits: FloatArray,
    texels: ImageArray,
    level_start: IntArray,
    level_size: IntArray,
) -> tuple[bool, np.float32, np.float32, np.float32]:
    """Whether a view shows a virtual pixel, and its red, green, blue there.

    Arrays of all views come in whole: a slice of one view would cost more than the sample.
    """
    nothing = (False, np.float32(0.0), np.float32(0.0), np.float32(0.0))
    depth = mappings[view, 2, 0] * x + mappings[view, 2, 1] * y + mappings[view, 2, 2]
    if depth <= 0.0:
        return nothing
    inverse_depth = 1.0 / depth
    u = (mappings[view, 0, 0] * x + mappings[view, 0, 1] * y + mappings[view, 0, 2]) * inverse_depth
    v = (mappings[view, 1, 0] * x + mappings[view, 1, 1] * y + mappings[view, 1, 2]) * inverse_depth
    full_width, full_height = level_size[view, 0, 0], level_size[view, 0, 1]
    if not (-0.5 <= u <= full_width - 0.5 and -0.5 <= v <= full_height - 0.5):
        return nothing
    level = 0
    while level + 1 < limits.shape[1] and depth <= limits[view, level + 1]:
        level += 1
    width, height = level_size[view, level, 0], level_size[view, level, 1]
    if level > 0:
        u = (u + 0.5) * width / full_width - 0.5
        v = (v + 0.5) * height / full_height - 0.5
    u = min(max(u, 0.0), width - 1.0)
    v = min(max(v, 0.0), height - 1.0)
    left, top = int(u), int(v)
    upper = level_start[view, level] + top * width + left
    lower = upper + (width if top + 1 < height else 0)
    right = 1 if left + 1 < width else 0
    fraction_x, fraction_y = np.float32(u - left), np.float32(v - top)
    rest_x, rest_y = np.float32(1.0) - fraction_x, np.float32(1.0) - fraction_y
    a, b = rest_x * rest_y, fraction_x * rest_y
    c, d = rest_x * fraction_y, fraction_x * fraction_y
    red = (
        a * np.float32(texels[upper, 0])
        + b * np.float32(texels[upper + right, 0])
        + c * np.float32(texels[lower, 0])
        + d * np.float32(texels[lower + right, 0])
    )
    green = (
        a * np.float32(texels[upper, 1])
        + b * np.float32(texels[upper + right, 1])
        + c * np.float32(texels[lower, 1])
        + d * np.float32(texels[lower + right, 1])
    )
    blue = (
        a * np.float32(texels[upper, 2])
        + b * np.float32(texels[upper + right, 2])
        + c * np.float32(texels[lower, 2])
        + d * np.float32(texels[lower + right, 2])
    )
    return True, red, green, blue


@compiled
def render_view(
    pose: FloatArray,
    intrinsics: FloatArray,
    blending: int,
    plane: FloatArray,
    view_is_in_front: BoolArray,
    projection: FloatArray,
    centres: FloatArray,
    texels: ImageArray,
    level_start: IntArray,
    level_size: IntArray,
    image: Float32Array,
    covered: BoolArray,
) -> None:
    """Renders one virtual view.

    Args:
        pose: (4, 4) world_from_camera of the virtual camera.
        intrinsics: (4,) fx, fy, cx, cy.
        blending: a ``Blending``.
        plane: (4,) unit normal and offset.
        view_is_in_front: (N,) whether a recording centre lies on the plane's seen side.
        projection: (N, 3, 4), centres: (N, 3), texels, level_start, level_size: see ``Views``.
        image: (H, W, 3) receives RGB in 0 to 255, zero where uncovered.
        covered: (H, W) receives which pixels any view shows.
    """
    height, width = covered.shape
    image[:] = 0.0
    covered[:] = False
    count = len(centres)
    points = np.empty((4, 3))
    if plane_rays(pose, intrinsics, plane, points) <= 0.0:
        return
    mappings = np.empty((count, 3, 3))
    limits = np.empty((count, level_start.shape[1]))
    usable = view_is_in_front.copy()
    for view in range(count):
        if usable[view]:
            view_mapping(projection[view], points, mappings[view])
            level_limits(mappings[view], limits[view])
    cell_views = np.empty((max(4 * count + 8, MAX_TILES), 3), dtype=np.int64)
    cell_weights = np.empty((max(4 * count + 8, MAX_TILES), 3, 3))
    label = np.empty((height, width), dtype=np.int64)
    if blending == 0:
        for view in range(count):
            usable[view] = usable[view] and is_in_frustum(
                mappings[view],
                points[3],
                level_size[view, 0, 0],
                level_size[view, 0, 1],
                width,
                height,
            )
        cells = build_net(
            centres,
            pose[:3, 3],
            pose[:3, :3],
            intrinsics,
            usable,
            cell_views,
            cell_weights,
            label,
        )
    else:
        cells = build_tiles(
            pose,
            points,
            usable,
            centres,
            mappings,
            level_size,
            cell_views,
            cell_weights,
            label,
        )
    if cells == 0:
        return
    for y in range(height):
        for x in range(width):
            if points[3, 0] * x + points[3, 1] * y + points[3, 2] <= 0.0:
                continue
            cell = label[y, x]
            total = np.float32(0.0)
            red, green, blue = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for corner in range(3):
                weight = np.float32(
                    cell_weights[cell, corner, 0] * x
                    + cell_weights[cell, corner, 1] * y
                    + cell_weights[cell, corner, 2]
                )
                if weight <= 0.0:
                    continue
                shown, r, g, b = sample_view(
                    x,
                    y,
                    cell_views[cell, corner],
                    mappings,
                    limits,
                    texels,
                    level_start,
                    level_size,
                )
                if shown:
                    total += weight
                    red += weight * r
                    green += weight * g
                    blue += weight * b
            if total > SMALLEST_WEIGHT:
                red, green, blue = red / total, green / total, blue / total
                covered[y, x] = True
            else:
                view = substitute_view(
                    x, y, pose, intrinsics, usable, centres, mappings, level_size
                )
                if view < 0:
                    continue
                covered[y, x], red, green, blue = sample_view(
                    x, y, view, mappings, limits, texels, level_start, level_size
                )
            image[y, x, 0] = red
            image[y, x, 1] = green
            image[y, x, 2] = blue


@compiled
def substitute_view(
    x: int,
    y: int,
    pose: FloatArray,
    intrinsics: FloatArray,
    usable: BoolArray,
    centres: FloatArray,
    mappings: FloatArray,
    level_size: IntArray,
) -> int:
    """The view with the nearest projected centre, of those that show the pixel; -1 for none."""
    shortest = np.inf
    best = -1
    offset = np.empty(3)
    corner = np.empty(2)
    for view in range(len(centres)):
        if not usable[view]:
            continue
        depth = mappings[view, 2, 0] * x + mappings[view, 2, 1] * y + mappings[view, 2, 2]
        if depth <= 0.0:
            continue
        u = (mappings[view, 0, 0] * x + mappings[view, 0, 1] * y + mappings[view, 0, 2]) / depth
        v = (mappings[view, 1, 0] * x + mappings[view, 1, 1] * y + mappings[view, 1, 2]) / depth
        if not (
            -0.5 <= u <= level_size[view, 0, 0] - 0.5 and -0.5 <= v <= level_size[view, 0, 1] - 0.5
        ):
            continue
        for i in range(3):
            offset[i] = centres[view, i] - pose[i, 3]
        project_centre(offset, pose, intrinsics, corner)
        distance = (corner[0] - x) ** 2 + (corner[1] - y) ** 2
        if distance < shortest:
            shortest = distance
            best = view
    return best
