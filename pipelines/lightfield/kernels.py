"""The fast renderer, compiled: from a pose to a virtual view and its likeness to a camera image.

Same steps and results as ``reference``: the surface, which views to blend with which weights
(``blending_kernels``, ``net_kernels``), what they show (``cell_kernels``). Everything here is a
function of its arguments and releases the interpreter lock.
"""

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray
from pipelines.lightfield.blending_kernels import build_tiles
from pipelines.lightfield.cell_kernels import blend_cells, set_net
from pipelines.lightfield.comparison import compare
from pipelines.lightfield.compiled import compiled, compiled_loop
from pipelines.lightfield.mapping_kernels import is_inside, locate, view_mapping, virtual_rays
from pipelines.lightfield.net_kernels import project_centre
from pipelines.lightfield.proxy_kernels import depth_surface, plane_surface
from pipelines.lightfield.ranking_kernels import is_occluded
from pipelines.lightfield.reference import SMALLEST_WEIGHT
from pipelines.lightfield.sampling_kernels import LANES
from pipelines.lightfield.workspace import LightField, Workspace, workspace_for

OPAQUE = np.float32(255.0)
ONE, ZERO, SMALLEST = np.float32(1.0), np.float32(0.0), np.float32(SMALLEST_WEIGHT)


@compiled_loop
def _normalised(image: Float32Array) -> int:
    """Divides colours by their weights; alpha becomes 1 or, where no view shows anything, 0.

    Args:
        image: (4 P,) sums as ``add_samples`` leaves them, changed.

    Returns:
        How many pixels no view shows.
    """
    empty = 0
    for i in range(len(image) // 4):
        total = image[4 * i + 3] / OPAQUE
        is_shown = total > SMALLEST
        factor = ONE / total if is_shown else ZERO
        image[4 * i] *= factor
        image[4 * i + 1] *= factor
        image[4 * i + 2] *= factor
        image[4 * i + 3] = ONE if is_shown else ZERO
        empty += not is_shown
    return empty


@compiled
def _substitute(
    x: float,
    y: float,
    inverse_depth: float,
    pose: FloatArray,
    intrinsics: FloatArray,
    field: LightField,
    space: Workspace,
) -> int:
    """The view with the nearest projected centre, of those that show the pixel; -1 for none.

    One that may be occluded is taken only where all others are.
    """
    views = field.views
    best, shortest = -1, np.inf
    best_hidden, shortest_hidden = -1, np.inf
    offset, corner = np.empty(3), np.empty(2)
    for view in range(len(views.centres)):
        if not field.usable[view] or (field.is_net and not space.takes_part[view]):
            continue
        if not space.is_mapped[view]:
            view_mapping(views.projection, view, pose, space.rays, space.maps, space.shifts)
            space.is_mapped[view] = True
        u, v, depth = locate(x, y, inverse_depth, view, space.maps, space.shifts)
        if depth <= 0.0 or not is_inside(views.level_size, view, u, v):
            continue
        for i in range(3):
            offset[i] = views.centres[view, i] - pose[i, 3]
        project_centre(offset, pose, intrinsics, corner)
        distance = (corner[0] - x) ** 2 + (corner[1] - y) ** 2
        if field.has_depth and is_occluded(
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


@compiled
def _fill(
    field: LightField,
    pose: FloatArray,
    intrinsics: FloatArray,
    focal: float,
    surface: Float32Array,
    width: int,
    empty: int,
    space: Workspace,
    image: Float32Array,
) -> None:
    """Shows the pixels that none of their cell's views show by any other view that does."""
    columns, rows = np.zeros(empty + LANES, np.float32), np.zeros(empty + LANES, np.float32)
    depths, pixels = np.zeros(empty + LANES, np.float32), np.empty(empty, np.int32)
    chosen = np.empty((empty, 1), np.int64)
    starts = np.arange(empty + 1)
    found = 0
    for pixel in range(len(surface)):
        if image[pixel, 3] > 0.0 or surface[pixel] <= 0.0:
            continue
        x, y = pixel % width, pixel // width
        view = _substitute(x, y, surface[pixel], pose, intrinsics, field, space)
        if view >= 0:
            columns[found], rows[found] = x, y
            depths[found], pixels[found], chosen[found, 0] = surface[pixel], pixel, view
            found += 1
    weights = np.zeros((found, 1, 4))
    weights[:, :, 2] = 1.0
    blend_cells(
        field,
        False,
        pose,
        focal,
        found,
        chosen,
        weights,
        np.zeros((found, 2)),
        starts,
        columns,
        rows,
        depths,
        pixels,
        space,
        image,
    )
    for i in range(found):
        image[pixels[i], 3] = 1.0


@compiled
def _draw(
    field: LightField,
    pose: FloatArray,
    intrinsics: FloatArray,
    spacing: float,
    width: int,
    space: Workspace,
    surface: Float32Array,
    image: Float32Array,
) -> None:
    """Renders one virtual view into ``surface`` (H W,) and ``image`` (H W, 4)."""
    image[:] = 0.0
    shape = (len(surface) // width, width)
    virtual_rays(pose, intrinsics, space.rays)
    space.is_mapped[:] = False
    if field.has_depth:
        depth_surface(
            field.views,
            field.usual_inverse_depth,
            pose,
            intrinsics,
            spacing,
            surface.reshape(shape),
        )
    else:
        plane_surface(pose, space.rays, field.plane, surface.reshape(shape))
    if field.is_net:
        cells = set_net(field, pose, intrinsics, surface, width, space)
        if cells == 0:
            return
    else:
        cells = len(space.cell_views)
        build_tiles(
            pose,
            space.rays,
            surface,
            width,
            field.views,
            field.view_index,
            field.has_depth,
            space.slots,
            space.cell_views,
            space.cell_weights,
            space.cell_origins,
        )
    for i in range(len(surface)):
        space.surface[i] = surface[space.pixels[i]]
    focal = 0.5 * (intrinsics[0] + intrinsics[1])
    blend_cells(
        field,
        field.has_depth,
        pose,
        focal,
        cells,
        space.cell_views,
        space.cell_weights,
        space.cell_origins,
        space.starts,
        space.columns,
        space.rows,
        space.surface,
        space.pixels,
        space,
        image,
    )
    empty = _normalised(image.reshape(-1))
    if empty > 0:
        _fill(field, pose, intrinsics, focal, surface, width, empty, space, image)


@compiled
def draw_views(
    field: LightField,
    poses: FloatArray,
    intrinsics: FloatArray,
    spacing: float,
    surfaces: Float32Array,
    images: Float32Array,
) -> None:
    """Renders B virtual views.

    Args:
        field: the light field.
        poses: (B, 4, 4) world_from_camera.
        intrinsics: (4,) fx, fy, cx, cy.
        spacing: of the corners of the surface's mesh, virtual pixels.
        surfaces: (B, H, W) receives virtual inverse depths; 0: none.
        images: (B, H, W, 4) receives RGB in 0 to 255, and 1 where any view shows the pixel; all
            zero elsewhere.
    """
    height, width = images.shape[1:3]
    space = workspace_for(field, width, height)
    for index in range(len(poses)):
        _draw(
            field,
            poses[index],
            intrinsics,
            spacing,
            width,
            space,
            surfaces[index].reshape(-1),
            images[index].reshape((-1, 4)),
        )


@compiled
def score_views(
    field: LightField,
    poses: FloatArray,
    intrinsics: FloatArray,
    spacing: float,
    query: Float32Array,
    kind: int,
    fit_gain: bool,
    costs: FloatArray,
) -> None:
    """Renders B virtual views and compares each with a camera image.

    Args:
        field: the light field.
        poses: (B, 4, 4) world_from_camera.
        intrinsics: (4,) fx, fy, cx, cy.
        spacing: of the corners of the surface's mesh, virtual pixels.
        query: (H, W, 4) camera image, see ``comparison.prepared``.
        kind: a ``Cost``.
        fit_gain: whether a brightness factor is fitted first.
        costs: (B,) receives the costs.
    """
    height, width = query.shape[:2]
    space = workspace_for(field, width, height)
    surface = np.empty(height * width, np.float32)
    image = np.empty((height * width, 4), np.float32)
    for index in range(len(poses)):
        _draw(field, poses[index], intrinsics, spacing, width, space, surface, image)
        costs[index] = compare(kind, image.reshape((height, width, 4)), query, fit_gain)
