"""The fast renderer, compiled: one virtual view into a buffer that stays in the processor's cache.

Same steps and results as ``reference``: surface, mappings, views in the frustum, weights, blend.
Everything here is a function of its arguments and releases the interpreter lock.
"""

import numpy as np

from pipelines.artifacts.array_types import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
)
from pipelines.lightfield.blending import VIEWS_PER_TILE
from pipelines.lightfield.blending_kernels import build_tiles, is_occluded, tile_count
from pipelines.lightfield.compiled import compiled, compiled_leaf
from pipelines.lightfield.net_kernels import build_net, project_centre
from pipelines.lightfield.proxy_kernels import depth_surface, plane_surface
from pipelines.lightfield.reference import FRUSTUM_SAMPLES, SMALLEST_WEIGHT
from pipelines.lightfield.sampling_kernels import add_view, is_inside, locate
from pipelines.lightfield.views import ViewArrays


@compiled_leaf
def virtual_rays(pose: FloatArray, intrinsics: FloatArray, rays: FloatArray) -> None:
    """Writes the (3, 3) matrix R K^-1 from virtual pixels to world directions."""
    for i in range(3):
        x, y, z = pose[i, 0] / intrinsics[0], pose[i, 1] / intrinsics[1], pose[i, 2]
        rays[i, 0], rays[i, 1] = x, y
        rays[i, 2] = z - x * intrinsics[2] - y * intrinsics[3]


@compiled_leaf
def view_mapping(
    projection: FloatArray,
    view: int,
    pose: FloatArray,
    rays: FloatArray,
    maps: FloatArray,
    shifts: FloatArray,
) -> None:
    """Writes a view's map (3, 3) and shift (3,): pixel p at inverse depth d is map p + shift d."""
    for i in range(3):
        shifts[view, i] = projection[view, i, 3]
        for j in range(3):
            shifts[view, i] += projection[view, i, j] * pose[j, 3]
            maps[view, i, j] = (
                projection[view, i, 0] * rays[0, j]
                + projection[view, i, 1] * rays[1, j]
                + projection[view, i, 2] * rays[2, j]
            )


@compiled
def is_in_frustum(
    views: ViewArrays, view: int, maps: FloatArray, shifts: FloatArray, surface: FloatArray
) -> bool:
    """Whether a view sees any of a grid of surface points of the virtual frustum."""
    height, width = surface.shape
    for i in range(FRUSTUM_SAMPLES):
        y = i * (height - 1) // (FRUSTUM_SAMPLES - 1)
        for j in range(FRUSTUM_SAMPLES):
            x = j * (width - 1) // (FRUSTUM_SAMPLES - 1)
            if surface[y, x] <= 0.0:
                continue
            u, v, depth = locate(x, y, surface[y, x], view, maps, shifts)
            if depth > 0.0 and is_inside(views.level_size, view, u, v):
                return True
    return False


@compiled
def render_view(
    pose: FloatArray,
    intrinsics: FloatArray,
    blending: int,
    cell_size: float,
    usual_inverse_depth: float,
    plane: FloatArray,
    view_is_in_front: BoolArray,
    views: ViewArrays,
    image: Float32Array,
    covered: BoolArray,
) -> None:
    """Renders one virtual view.

    Args:
        pose: (4, 4) world_from_camera of the virtual camera.
        intrinsics: (4,) fx, fy, cx, cy.
        blending: a ``Blending``.
        cell_size: of the surface's mesh, virtual pixels; 0: the plane.
        usual_inverse_depth: median of all depth maps.
        plane: (4,) unit normal and offset.
        view_is_in_front: (N,) whether a recording centre lies on the plane's seen side.
        views: the light field.
        image: (H, W, 3) receives RGB in 0 to 255, zero where uncovered.
        covered: (H, W) receives which pixels any view shows.
    """
    image[:] = 0.0
    covered[:] = False
    count = len(views.centres)
    rays = np.empty((3, 3))
    virtual_rays(pose, intrinsics, rays)
    surface = np.empty(covered.shape)
    usable = np.ones(count, dtype=np.bool_)
    if cell_size > 0.0:
        depth_surface(views, usual_inverse_depth, pose, intrinsics, cell_size, surface)
    else:
        plane_surface(pose, rays, plane, surface)
        usable[:] = view_is_in_front
    maps, shifts = np.empty((count, 3, 3)), np.empty((count, 3))
    for view in range(count):
        view_mapping(views.projection, view, pose, rays, maps, shifts)
    height, width = covered.shape
    capacity = max(4 * count + 8, tile_count(width) * tile_count(height))
    cell_views = np.empty((capacity, VIEWS_PER_TILE), dtype=np.int64)
    cell_weights = np.empty((capacity, VIEWS_PER_TILE, 4))
    label = np.empty(covered.shape, dtype=np.int64)
    if blending == 0:
        for view in range(count):
            usable[view] = usable[view] and is_in_frustum(views, view, maps, shifts, surface)
        cells = build_net(
            views.centres,
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
            pose, rays, surface, views, usable, maps, shifts, cell_views, cell_weights, label
        )
    if cells > 0:
        _blend(
            pose,
            intrinsics,
            cell_size > 0.0,
            surface,
            views,
            usable,
            maps,
            shifts,
            cell_views,
            cell_weights,
            label,
            image,
            covered,
        )


@compiled
def _blend(
    pose: FloatArray,
    intrinsics: FloatArray,
    has_depth: bool,
    surface: FloatArray,
    views: ViewArrays,
    usable: BoolArray,
    maps: FloatArray,
    shifts: FloatArray,
    cell_views: IntArray,
    cell_weights: FloatArray,
    label: IntArray,
    image: Float32Array,
    covered: BoolArray,
) -> None:
    """Writes the weighted sum of what the cells' views show; what they do not, others show."""
    height, width = covered.shape
    focal = 0.5 * (intrinsics[0] + intrinsics[1])
    total = np.empty(width, dtype=np.float32)
    alone = np.array([[[0.0, 0.0, 1.0, 0.0]]])
    for y in range(height):
        total[:] = 0.0
        first = 0
        while first < width:
            cell = label[y, first]
            last = first + 1
            while last < width and label[y, last] == cell:
                last += 1
            for slot in range(cell_views.shape[1]):
                view = cell_views[cell, slot]
                if view < 0:
                    break
                add_view(
                    y,
                    first,
                    last,
                    view,
                    cell,
                    slot,
                    cell_weights,
                    has_depth,
                    surface,
                    maps,
                    shifts,
                    views.focal[view] / focal,
                    views.texels,
                    views.level_start,
                    views.level_size,
                    views.inverse_depth,
                    views.depth_start,
                    views.depth_size,
                    total,
                    image,
                )
            first = last
        for x in range(width):
            if surface[y, x] <= 0.0:
                continue
            if total[x] > SMALLEST_WEIGHT:
                covered[y, x] = True
                factor = np.float32(1.0) / total[x]
                for channel in range(3):
                    image[y, x, channel] *= factor
                continue
            image[y, x] = 0.0
            view = _substitute(
                x,
                y,
                surface[y, x],
                pose,
                intrinsics,
                has_depth,
                views,
                usable,
                maps,
                shifts,
            )
            if view >= 0:
                covered[y, x] = True
                add_view(
                    y,
                    x,
                    x + 1,
                    view,
                    0,
                    0,
                    alone,
                    False,
                    surface,
                    maps,
                    shifts,
                    views.focal[view] / focal,
                    views.texels,
                    views.level_start,
                    views.level_size,
                    views.inverse_depth,
                    views.depth_start,
                    views.depth_size,
                    total,
                    image,
                )


@compiled
def _substitute(
    x: int,
    y: int,
    inverse_depth: float,
    pose: FloatArray,
    intrinsics: FloatArray,
    has_depth: bool,
    views: ViewArrays,
    usable: BoolArray,
    maps: FloatArray,
    shifts: FloatArray,
) -> int:
    """The view with the nearest projected centre, of those that show the pixel; -1 for none.

    One that may be occluded is taken only where all others are.
    """
    best, shortest = -1, np.inf
    best_hidden, shortest_hidden = -1, np.inf
    offset, corner = np.empty(3), np.empty(2)
    for view in range(len(views.centres)):
        if not usable[view]:
            continue
        u, v, depth = locate(x, y, inverse_depth, view, maps, shifts)
        if depth <= 0.0 or not is_inside(views.level_size, view, u, v):
            continue
        for i in range(3):
            offset[i] = views.centres[view, i] - pose[i, 3]
        project_centre(offset, pose, intrinsics, corner)
        distance = (corner[0] - x) ** 2 + (corner[1] - y) ** 2
        if has_depth and is_occluded(
            views.inverse_depth,
            views.depth_start,
            views.depth_size,
            views.level_size,
            view,
            u,
            v,
            inverse_depth / depth,
        ):
            if distance < shortest_hidden:
                best_hidden, shortest_hidden = view, distance
        elif distance < shortest:
            best, shortest = view, distance
    return best if best >= 0 else best_hidden
