"""The fast renderer, compiled: from surfaces to virtual views and their likeness to a camera image.

Same steps and results as ``reference``: the surface (``proxy_kernels``), which views to blend with
which weights (``blending_kernels``, ``net_kernels``), what they show (``cell_kernels``). Everything
here is a function of its arguments and releases the interpreter lock.

Each blending rule and each kind of surface has an entry of its own, so that nobody waits for the
compiling of what is not used.
"""

from typing import cast

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray
from pipelines.lightfield.blending_kernels import build_tiles, set_labels
from pipelines.lightfield.cell_kernels import blend_cells, set_net
from pipelines.lightfield.comparison import compare
from pipelines.lightfield.compiled import (
    compiled,
    compiled_leaf,
    compiled_loop,
    compiled_part,
)
from pipelines.lightfield.mapping_kernels import virtual_rays
from pipelines.lightfield.pixel_order_kernels import order_by_label
from pipelines.lightfield.reference import SMALLEST_WEIGHT
from pipelines.lightfield.substitute_kernels import find_substitutes
from pipelines.lightfield.workspace import SUBSTITUTES_TOGETHER, LightField, Workspace

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


@compiled_leaf
def _show_cells(
    field: LightField,
    pose: FloatArray,
    intrinsics: FloatArray,
    cells: int,
    surface: Float32Array,
    space: Workspace,
    image: Float32Array,
    colours: Float32Array,
) -> int:
    """Renders one virtual view, whose cells are set.

    Args:
        field: the light field.
        pose: (4, 4) world_from_camera.
        intrinsics: (4,) fx, fy, cx, cy.
        cells: their number.
        surface: (H W,) inverse depths.
        space: changed.
        image: (P, 4) receives the view's P pixels that are rendered.
        colours: (4 P,) the same memory.

    Returns:
        How many pixels none of the views of their cells shows.
    """
    order = space.order
    # A net's pixels are ordered anew for each view, and their surface with them.
    if not field.is_net:
        for i in range(np.uintp(len(order.chosen))):
            order.surface[i] = surface[np.uintp(order.indices[i])]
    for i in range(len(colours)):
        colours[i] = ZERO
    blend_cells(
        field,
        field.has_depth,
        pose,
        0.5 * (intrinsics[0] + intrinsics[1]),
        cells,
        space.cell_views,
        space.cell_weights,
        space.cell_origins,
        order,
        space.links,
        space,
        image,
    )
    return _normalised(colours)


@compiled_part
def _show_substitutes(
    field: LightField,
    pose: FloatArray,
    intrinsics: FloatArray,
    found: int,
    surface: Float32Array,
    space: Workspace,
    image: Float32Array,
) -> None:
    """Renders pixels that none of their cell's views shows, by their substitutes; each is a cell.

    Args:
        field: the light field.
        pose: (4, 4) world_from_camera.
        intrinsics: (4,) fx, fy, cx, cy.
        found: how many pixels these are.
        surface: (H W,) inverse depths.
        space: changed.
        image: (P, 4) changed.
    """
    substitutes, rendered = space.substitutes, space.order
    order = substitutes.order
    for first in range(0, found, SUBSTITUTES_TOGETHER):
        cells = min(found - first, SUBSTITUTES_TOGETHER)
        for i in range(cells):
            pixel = substitutes.pixels[first + i]
            order.columns[i], order.rows[i] = (
                rendered.chosen_columns[pixel],
                rendered.chosen_rows[pixel],
            )
            order.surface[i] = surface[rendered.chosen[pixel]]
            order.pixels[i] = pixel
        blend_cells(
            field,
            NOTHING_HIDES,
            pose,
            0.5 * (intrinsics[0] + intrinsics[1]),
            cells,
            substitutes.views[first:],
            substitutes.cell_weights,
            substitutes.cell_origins,
            order,
            substitutes.links,
            space,
            image,
        )
        for i in range(cells):
            image[order.pixels[i], 3] = ONE


@compiled_leaf
def _show(
    field: LightField,
    pose: FloatArray,
    intrinsics: FloatArray,
    cells: int,
    width: int,
    surface: Float32Array,
    space: Workspace,
    image: Float32Array,
) -> None:
    """Renders one virtual view, whose cells are set: what they show, then what others show instead.

    Args:
        field: the light field.
        pose: (4, 4) world_from_camera.
        intrinsics: (4,) fx, fy, cx, cy.
        cells: their number; 0: nothing is shown.
        width: of the virtual image.
        surface: (H W,) inverse depths.
        space: changed.
        image: (h, w, 4) receives the view's P = h w pixels that are rendered.
    """
    pixels = image.reshape((-1, 4))
    empty = _show_cells(field, pose, intrinsics, cells, surface, space, pixels, pixels.reshape(-1))
    if cells > 0 and empty > 0:
        found = find_substitutes(field, pose, intrinsics, surface, width, pixels, space)
        if found > 0:
            _show_substitutes(field, pose, intrinsics, found, surface, space, pixels)


@compiled
def render_tiles(
    field: LightField,
    poses: FloatArray,
    intrinsics: FloatArray,
    surfaces: Float32Array,
    space: Workspace,
    query: Float32Array,
    kind: int,
    fit_gain: bool,
    table: Float32Array,
    images: Float32Array,
    costs: FloatArray,
) -> None:
    """Renders B virtual views by the unstructured lumigraph, and compares them if asked to.

    Args:
        field: the light field.
        poses: (B, 4, 4) world_from_camera.
        intrinsics: (4,) fx, fy, cx, cy.
        surfaces: (B, H, W) virtual inverse depths; 0: none.
        space: made for this light field and size of image, and P pixels of it; changed.
        query: camera image, see ``comparison.prepared``: (H, W, 4) or, of some pixels, (1, P, 4).
        kind: a ``Cost``, or ``NO_COMPARISON``.
        fit_gain: whether a brightness factor is fitted before the comparison.
        table: of EVIDENCE, see ``comparison.compare``; else empty.
        images: (B, H, W, 4), or (B, 1, P, 4), receives RGB in 0 to 255, and 1 where any view shows
            the pixel; all zero elsewhere. For a comparison one is enough.
        costs: (B,) receives the costs.
    """
    if len(poses) == 0:
        return
    width, cells = surfaces.shape[2], len(space.cell_views)
    set_labels(space.tiling.across, space.tiling.down, space.labels)
    order_by_label(space.labels, cells, surfaces[0].reshape(-1), space.order)
    for index in range(len(poses)):
        pose, surface = poses[index], surfaces[index].reshape(-1)
        image = images[index % len(images)]
        virtual_rays(pose, intrinsics, space.rays)
        space.is_mapped[:] = False
        build_tiles(
            pose,
            space.rays,
            surface,
            field.views,
            field.view_index,
            field.has_depth,
            space.tiling,
            space.cell_views,
            space.cell_weights,
        )
        _show(field, pose, intrinsics, cells, width, surface, space, image)
        if kind != NO_COMPARISON:
            costs[index] = compare(kind, image, query, fit_gain, table)


@compiled
def render_nets(
    field: LightField,
    poses: FloatArray,
    intrinsics: FloatArray,
    surfaces: Float32Array,
    space: Workspace,
    query: Float32Array,
    kind: int,
    fit_gain: bool,
    table: Float32Array,
    images: Float32Array,
    costs: FloatArray,
) -> None:
    """Like ``render_tiles``, by the Delaunay net."""
    width = surfaces.shape[2]
    for index in range(len(poses)):
        pose, surface = poses[index], surfaces[index].reshape(-1)
        image = images[index % len(images)]
        virtual_rays(pose, intrinsics, space.rays)
        space.is_mapped[:] = False
        cells = set_net(field, pose, intrinsics, surface, width, space)
        _show(field, pose, intrinsics, cells, width, surface, space, image)
        if kind != NO_COMPARISON:
            costs[index] = compare(kind, image, query, fit_gain, table)
