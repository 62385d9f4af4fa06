"""Cells, fast: the net of a virtual view as cells, and what the views of cells show.

A cell is a region of the virtual image with some views and their weights. Pixels are worked on cell
by cell, so that everything that is the same for a cell is computed once.
"""

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray, IntArray
from pipelines.lightfield.compiled import compiled_leaf, compiled_part
from pipelines.lightfield.mapping_kernels import is_inside, locate, view_mapping
from pipelines.lightfield.net_kernels import build_net
from pipelines.lightfield.occlusion_kernels import leave_out_hidden
from pipelines.lightfield.pixel_order_kernels import PixelOrder, order_by_label
from pipelines.lightfield.reference import FRUSTUM_SAMPLES
from pipelines.lightfield.sampling_kernels import (
    CHUNK,
    add_samples,
    chunk_coefficients,
    end_weights,
    load_cell,
    place_samples,
)
from pipelines.lightfield.vector_code import LANES
from pipelines.lightfield.views import ViewArrays
from pipelines.lightfield.workspace import END, SLOTS, LightField, Links, Workspace

# On a pyramid level a pixel spans about one: levels change where it spans sqrt(2) 2^k of the finest
# one's, at these depths times the ratio of focal lengths.
LEVEL_BORDERS = np.sqrt(2.0) / 2.0 ** np.arange(32)


@compiled_leaf
def set_net(
    field: LightField,
    pose: FloatArray,
    intrinsics: FloatArray,
    surface: Float32Array,
    width: int,
    space: Workspace,
) -> int:
    """Sets the cells of the Delaunay net of the views that see any of the virtual frustum."""
    views, height = field.views, len(surface) // width
    for view in range(len(views.centres)):
        space.takes_part[view] = field.usable[view]
        if not field.usable[view]:
            continue
        view_mapping(views.projection, view, pose, space.rays, space.maps, space.shifts)
        space.is_mapped[view] = True
        space.takes_part[view] = _sees_any(views, view, surface, width, height, space)
    cells = build_net(
        views.centres,
        pose,
        intrinsics,
        space.takes_part,
        space.room,
        space.cell_views,
        space.cell_weights,
        space.labels,
    )
    if cells > 0:
        order_by_label(space.labels, cells, surface, space.order)
    return cells


@compiled_leaf
def _sees_any(
    views: ViewArrays,
    view: int,
    surface: Float32Array,
    width: int,
    height: int,
    space: Workspace,
) -> bool:
    """Whether a view, which is mapped, sees any of a grid of surface points."""
    for i in range(FRUSTUM_SAMPLES):
        y = i * (height - 1) // (FRUSTUM_SAMPLES - 1)
        for j in range(FRUSTUM_SAMPLES):
            x = j * (width - 1) // (FRUSTUM_SAMPLES - 1)
            d = surface[y * width + x]
            u, v, depth = locate(x, y, d, view, space.maps, space.shifts)
            if d > 0.0 and depth > 0.0 and is_inside(views.level_size, view, u, v):
                return True
    return False


@compiled_leaf
def _link_cells(cells: int, cell_views: IntArray, starts: IntArray, links: Links) -> int:
    """Chains the cells that show the same view, for each view.

    Args:
        cells: their number.
        cell_views: (c, k) views of each cell, -1 behind the last.
        starts: (c + 1,) where cells begin in the order of the pixels.
        links: changed.

    Returns:
        How many views any cell shows.
    """
    count = 0
    # From the last to the first, so that each chain runs from the first to the last.
    for cell in range(cells - 1, -1, -1):
        if starts[cell] == starts[cell + 1]:
            continue
        for slot in range(cell_views.shape[1]):
            view = cell_views[cell, slot]
            if view < 0:
                break
            if links.first[view] == END:
                links.views[count] = view
                count += 1
            entry = cell * SLOTS + slot
            links.next[entry] = links.first[view]
            links.first[view] = entry
    return count


@compiled_part
def blend_cells(
    field: LightField,
    has_depth: bool,
    pose: FloatArray,
    focal: float,
    cells: int,
    cell_views: IntArray,
    cell_weights: FloatArray,
    cell_origins: FloatArray,
    order: PixelOrder,
    links: Links,
    space: Workspace,
    image: Float32Array,
) -> None:
    """Adds to each pixel what the views of its cell show, times their weights.

    View by view, as many pixels of its cells at a time as fit into a chunk.

    Args:
        field: the light field.
        has_depth: whether depth maps may hide the surface.
        pose: (4, 4) world_from_camera.
        focal: of the virtual camera, pixels.
        cells: their number.
        cell_views: (c, k) views of each cell, -1 behind the last.
        cell_weights: (c, k, 4) coefficients of x, y, 1, x y, relative to
        cell_origins: (c, 2) columns and rows.
        order: the pixels in the cells' order, with their inverse depths.
        links: for so many cells.
        space: maps, shifts and scratch are changed.
        image: (P, 4) sums of weighted colours and of 255 times the weights, changed.
    """
    starts = order.starts
    for number in range(_link_cells(cells, cell_views, starts, links)):
        view = links.views[number]
        entry, links.first[view] = links.first[view], END
        cell, slot = entry // SLOTS, entry % SLOTS
        first, last = starts[cell], starts[cell + 1]
        while entry != END:
            x0, y0, nearness, count = (
                order.columns[first],
                order.rows[first],
                order.surface[first],
                0,
            )
            while entry != END and count < CHUNK:
                taken = min(last - first, CHUNK - count)
                load_cell(
                    cell_weights,
                    cell_origins,
                    cell,
                    slot,
                    order.columns,
                    order.rows,
                    order.surface,
                    order.pixels,
                    first,
                    taken,
                    count,
                    x0,
                    y0,
                    space.scratch,
                    space.targets,
                )
                count += taken
                first += taken
                if first == last:
                    entry = links.next[entry]
                    if entry != END:
                        cell, slot = entry // SLOTS, entry % SLOTS
                        first, last = starts[cell], starts[cell + 1]
            _blend_chunk(
                view,
                count,
                x0,
                y0,
                nearness,
                has_depth,
                pose,
                focal,
                field.views,
                space,
                image,
            )


@compiled_leaf
def _blend_chunk(
    view: int,
    count: int,
    x: float,
    y: float,
    nearness: float,
    has_depth: bool,
    pose: FloatArray,
    focal: float,
    views: ViewArrays,
    space: Workspace,
    image: Float32Array,
) -> None:
    """``blend_cells`` for one view and a chunk of pixels.

    Args:
        view: which.
        count: pixels of the chunk, in the scratch.
        x: column of the first, and
        y: its row, and
        nearness: its inverse depth.
        has_depth: see ``blend_cells``, as for all else.
    """
    scratch, offsets, coefficients = space.scratch, space.offsets, space.coefficients
    filled = (count + LANES - 1) // LANES * LANES
    end_weights(scratch, np.uintp(count))
    if not space.is_mapped[view]:
        view_mapping(views.projection, view, pose, space.rays, space.maps, space.shifts)
        space.is_mapped[view] = True
    chunk_coefficients(space.maps, space.shifts, view, x, y, coefficients)
    level_size = views.level_size
    levels = level_size.shape[1]
    ratio = views.focal[view] / focal
    full_width, full_height = level_size[view, 0, 0], level_size[view, 0, 1]
    # Most chunks need one level, that of their first pixel; others are gone through.
    middle = coefficients[8] + coefficients[11] * nearness
    guess = 0
    while guess + 1 < levels and middle <= ratio * LEVEL_BORDERS[guess + 1]:
        guess += 1
    for turn in range(levels):
        level = guess if turn == 0 else (turn - 1 if turn <= guess else turn)
        nearest = ratio * LEVEL_BORDERS[level + 1] if level + 1 < levels else 0.0
        farthest = ratio * LEVEL_BORDERS[level] if level > 0 else np.inf
        here, elsewhere = place_samples(
            scratch,
            offsets,
            filled,
            coefficients,
            np.float32(nearest),
            np.float32(farthest),
            np.int32(level_size[view, level, 0]),
            np.int32(level_size[view, level, 1]),
            np.float32(level_size[view, level, 0] / full_width),
            np.float32(level_size[view, level, 1] / full_height),
        )
        if here > 0:
            if has_depth:
                leave_out_hidden(views, view, level, scratch, filled)
            start, width = views.level_start[view, level], level_size[view, level, 0]
            add_samples(scratch, offsets, space.targets, count, views.texels, start, width, image)
        if elsewhere == 0:
            break
