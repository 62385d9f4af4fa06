"""The fast renderer, compiled: the steps that a few virtual views take together.

Same steps and results as ``reference``: mappings, views in the frustum, weights, blend. Each step
is compiled by itself and works on as many views as fit into the processor's cache: in one piece,
the compiler would optimise every step again inside the next. Everything here is a function of its
arguments and releases the interpreter lock.
"""

import numpy as np

from pipelines.artifacts.array_types import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
)
from pipelines.lightfield.blending_kernels import build_tiles, is_occluded
from pipelines.lightfield.compiled import compiled, compiled_leaf
from pipelines.lightfield.net_kernels import build_net, project_centre
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
def prepare(
    poses: FloatArray,
    intrinsics: FloatArray,
    projection: FloatArray,
    rays: FloatArray,
    maps: FloatArray,
    shifts: FloatArray,
) -> None:
    """Writes, for B virtual cameras, what takes their pixels to world directions and into views.

    Args:
        poses: (B, 4, 4) world_from_camera.
        intrinsics: (4,) fx, fy, cx, cy.
        projection: (N, 3, 4), see ``ViewArrays``.
        rays: (B, 3, 3) receives the directions' matrices.
        maps: (B, N, 3, 3) and
        shifts: (B, N, 3) receive the views' mappings, see ``view_mapping``.
    """
    for index in range(len(poses)):
        virtual_rays(poses[index], intrinsics, rays[index])
        for view in range(len(projection)):
            view_mapping(projection, view, poses[index], rays[index], maps[index], shifts[index])


@compiled
def net_cells(
    poses: FloatArray,
    intrinsics: FloatArray,
    surfaces: FloatArray,
    views: ViewArrays,
    maps: FloatArray,
    shifts: FloatArray,
    usable: BoolArray,
    cell_views: IntArray,
    cell_weights: FloatArray,
    labels: IntArray,
) -> None:
    """Cells of the Delaunay net in B virtual images; see ``net_kernels.build_net``.

    Args:
        poses: (B, 4, 4).
        intrinsics: (4,).
        surfaces: (B, H, W) virtual inverse depth; 0: none.
        views: the light field.
        maps: (B, N, 3, 3).
        shifts: (B, N, 3).
        usable: (B, N) which views may take part; those that see nothing of the frustum are taken
            out.
        cell_views: (B, c, k) receives the cells' views.
        cell_weights: (B, c, k, 4) receives their weights.
        labels: (B, H, W) receives each pixel's cell; -1 everywhere where no view takes part.
    """
    for index in range(len(poses)):
        for view in range(len(views.centres)):
            usable[index, view] = usable[index, view] and is_in_frustum(
                views, view, maps[index], shifts[index], surfaces[index]
            )
        cells = build_net(
            views.centres,
            poses[index, :3, 3],
            poses[index, :3, :3],
            intrinsics,
            usable[index],
            cell_views[index],
            cell_weights[index],
            labels[index],
        )
        if cells == 0:
            labels[index] = -1


@compiled
def tile_cells(
    poses: FloatArray,
    rays: FloatArray,
    surfaces: FloatArray,
    views: ViewArrays,
    maps: FloatArray,
    shifts: FloatArray,
    usable: BoolArray,
    cell_views: IntArray,
    cell_weights: FloatArray,
    labels: IntArray,
) -> None:
    """Cells of the unstructured-lumigraph rule in B virtual images; see ``build_tiles``."""
    for index in range(len(poses)):
        build_tiles(
            poses[index],
            rays[index],
            surfaces[index],
            views,
            usable[index],
            maps[index],
            shifts[index],
            cell_views[index],
            cell_weights[index],
            labels[index],
        )


@compiled
def blend_cells(
    poses: FloatArray,
    intrinsics: FloatArray,
    has_depth: bool,
    surfaces: FloatArray,
    views: ViewArrays,
    maps: FloatArray,
    shifts: FloatArray,
    usable: BoolArray,
    cell_views: IntArray,
    cell_weights: FloatArray,
    labels: IntArray,
    images: Float32Array,
    covered: BoolArray,
) -> None:
    """Renders B virtual views from their cells.

    Args:
        poses: (B, 4, 4) to
        labels: as for ``net_cells``; ``has_depth`` says whether depth maps may hide the surface.
        images: (B, H, W, 3) receives RGB in 0 to 255, zero where uncovered.
        covered: (B, H, W) receives which pixels any view shows.
    """
    images[:] = 0.0
    covered[:] = False
    for index in range(len(poses)):
        if labels[index, 0, 0] >= 0:
            _blend(
                poses[index],
                intrinsics,
                has_depth,
                surfaces[index],
                views,
                usable[index],
                maps[index],
                shifts[index],
                cell_views[index],
                cell_weights[index],
                labels[index],
                images[index],
                covered[index],
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
