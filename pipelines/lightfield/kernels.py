"""The fast renderer, compiled: from surfaces to virtual views and their likeness to a camera image.

Same steps and results as ``reference``: the surface (``proxy_kernels``), which views to blend with
which weights (``blending_kernels``, ``net_kernels``), what they show (``cell_kernels``). Everything
here is a function of its arguments and releases the interpreter lock.

The compiler optimises every step again inside the next. So there are few steps, each blending rule
and each kind of surface has an entry of its own, and nobody waits for what is not used.
"""

from typing import cast

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray
from pipelines.lightfield.blending_kernels import build_tiles
from pipelines.lightfield.cell_kernels import blend_cells, set_net
from pipelines.lightfield.comparison import compare
from pipelines.lightfield.compiled import compiled, compiled_loop
from pipelines.lightfield.mapping_kernels import virtual_rays
from pipelines.lightfield.reference import SMALLEST_WEIGHT
from pipelines.lightfield.sampling_kernels import LANES
from pipelines.lightfield.substitute_kernels import find_substitutes
from pipelines.lightfield.workspace import LightField, Workspace, workspace_for

OPAQUE = np.float32(255.0)
ONE, ZERO, SMALLEST = np.float32(1.0), np.float32(0.0), np.float32(SMALLEST_WEIGHT)
# Of a type like any other, and not a constant, for which the compiler would make one more version.
NOTHING_HIDES: bool = cast("bool", np.bool_(False))
# Instead of a ``Cost``: the views are wanted themselves.
NO_COMPARISON = -1


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
def _show_cells(
    field: LightField,
    pose: FloatArray,
    intrinsics: FloatArray,
    cells: int,
    width: int,
    surface: Float32Array,
    space: Workspace,
    image: Float32Array,
) -> None:
    """Renders one virtual view, whose cells are set, into ``image`` (H W, 4)."""
    image[:] = 0.0
    focal = 0.5 * (intrinsics[0] + intrinsics[1])
    for i in range(len(surface)):
        space.surface[i] = surface[space.pixels[i]]
    hides, starts = field.has_depth, space.starts
    columns, rows, depths, pixels = space.columns, space.rows, space.surface, space.pixels
    cell_views, cell_weights = space.cell_views, space.cell_weights
    cell_origins = space.cell_origins
    # First what the cells' views show, then the pixels that none of them does: each is a cell.
    for turn in range(2):
        blend_cells(
            field,
            hides,
            pose,
            focal,
            cells,
            cell_views,
            cell_weights,
            cell_origins,
            starts,
            columns,
            rows,
            depths,
            pixels,
            space,
            image,
        )
        if turn == 1:
            for i in range(cells):
                image[pixels[i], 3] = ONE
            break
        empty = _normalised(image.reshape(-1))
        if empty == 0:
            break
        pixels, cell_views = np.empty(empty, np.int32), np.empty((empty, 1), np.int64)
        cells = find_substitutes(
            field, pose, intrinsics, surface, width, image, space, pixels, cell_views
        )
        if cells == 0:
            break
        columns, rows = np.zeros(cells + LANES, np.float32), np.zeros(cells + LANES, np.float32)
        depths = np.zeros(cells + LANES, np.float32)
        for i in range(cells):
            columns[i], rows[i] = pixels[i] % width, pixels[i] // width
            depths[i] = surface[pixels[i]]
        hides, starts = NOTHING_HIDES, np.arange(cells + 1)
        cell_weights, cell_origins = np.zeros((cells, 1, 4)), np.zeros((cells, 2))
        cell_weights[:, :, 2] = 1.0


@compiled
def render_tiles(
    field: LightField,
    poses: FloatArray,
    intrinsics: FloatArray,
    surfaces: Float32Array,
    query: Float32Array,
    kind: int,
    fit_gain: bool,
    images: Float32Array,
    costs: FloatArray,
) -> None:
    """Renders B virtual views by the unstructured lumigraph, and compares them if asked to.

    Args:
        field: the light field.
        poses: (B, 4, 4) world_from_camera.
        intrinsics: (4,) fx, fy, cx, cy.
        surfaces: (B, H, W) virtual inverse depths; 0: none.
        query: (H, W, 4) camera image, see ``comparison.prepared``.
        kind: a ``Cost``, or ``NO_COMPARISON``.
        fit_gain: whether a brightness factor is fitted before the comparison.
        images: (B, H, W, 4) receives RGB in 0 to 255, and 1 where any view shows the pixel; all
            zero elsewhere. For a comparison (1, H, W, 4) are enough.
        costs: (B,) receives the costs.
    """
    height, width = images.shape[1:3]
    space = workspace_for(field, width, height)
    for index in range(len(poses)):
        pose, surface = poses[index], surfaces[index].reshape(-1)
        image = images[index % len(images)]
        virtual_rays(pose, intrinsics, space.rays)
        space.is_mapped[:] = False
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
        cells = len(space.cell_views)
        pixels = image.reshape((-1, 4))
        _show_cells(field, pose, intrinsics, cells, width, surface, space, pixels)
        if kind != NO_COMPARISON:
            costs[index] = compare(kind, image, query, fit_gain)


@compiled
def render_nets(
    field: LightField,
    poses: FloatArray,
    intrinsics: FloatArray,
    surfaces: Float32Array,
    query: Float32Array,
    kind: int,
    fit_gain: bool,
    images: Float32Array,
    costs: FloatArray,
) -> None:
    """Like ``render_tiles``, by the Delaunay net."""
    height, width = images.shape[1:3]
    space = workspace_for(field, width, height)
    for index in range(len(poses)):
        pose, surface = poses[index], surfaces[index].reshape(-1)
        image = images[index % len(images)]
        virtual_rays(pose, intrinsics, space.rays)
        space.is_mapped[:] = False
        cells = set_net(field, pose, intrinsics, surface, width, space)
        pixels = image.reshape((-1, 4))
        if cells == 0:
            image[:] = 0.0
        else:
            _show_cells(field, pose, intrinsics, cells, width, surface, space, pixels)
        if kind != NO_COMPARISON:
            costs[index] = compare(kind, image, query, fit_gain)
