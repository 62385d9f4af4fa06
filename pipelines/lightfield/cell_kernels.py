"""Cells, fast: the net of a virtual view as cells, and what the views of cells show.

A cell is a region of the virtual image with some views and their weights. Pixels are worked on cell
by cell, so that everything that is the same for a cell is computed once.
"""

import numpy as np

from pipelines.artifacts.array_types import (
    BoolArray,
    Float32Array,
    FloatArray,
    ImageArray,
    Int32Array,
    IntArray,
)
from pipelines.lightfield.compiled import compiled_leaf, compiled_part
from pipelines.lightfield.mapping_kernels import is_inside, locate, view_mapping
from pipelines.lightfield.net_kernels import build_net
from pipelines.lightfield.pixel_order_kernels import PixelOrder, order_by_label
from pipelines.lightfield.reference import FRUSTUM_SAMPLES
from pipelines.lightfield.sampling_kernels import (
    CHUNK,
    LANES,
    add_samples,
    chunk_coefficients,
    end_weights,
    leave_out_hidden,
    load_chunk,
    load_weights,
    place_samples,
)
from pipelines.lightfield.workspace import MOST_MEMBERS, LightField, Workspace

# On a pyramid level a pixel spans about one: levels change where it spans sqrt(2) 2^k of the finest
# one's, at these depths times the ratio of focal lengths.
LEVEL_BORDERS = np.sqrt(2.0) / 2.0 ** np.arange(32)
# In the list of a cell's views: the end, and a view that was shown with an earlier cell.
NO_VIEW, DONE = -1, -2


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
        sees = False
        for i in range(FRUSTUM_SAMPLES):
            y = i * (height - 1) // (FRUSTUM_SAMPLES - 1)
            for j in range(FRUSTUM_SAMPLES):
                x = j * (width - 1) // (FRUSTUM_SAMPLES - 1)
                d = surface[y * width + x]
                u, v, depth = locate(x, y, d, view, space.maps, space.shifts)
                is_seen = d > 0.0 and depth > 0.0 and is_inside(views.level_size, view, u, v)
                sees = sees or is_seen
        space.takes_part[view] = sees
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
        order_by_label(space.labels, cells, space.order)
    return cells


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
    space: Workspace,
    image: Float32Array,
) -> None:
    """Adds to each pixel what the views of its cell show, times their weights.

    Cells that follow each other and show the same view are worked on together.

    Args:
        field: the light field.
        has_depth: whether depth maps may hide the surface.
        pose: (4, 4) world_from_camera.
        focal: of the virtual camera, pixels.
        cells: their number.
        cell_views: (c, k) views of each cell, -1 behind the last; changed.
        cell_weights: (c, k, 4) coefficients of x, y, 1, x y, relative to
        cell_origins: (c, 2) columns and rows.
        order: the pixels in the cells' order, with their inverse depths.
        space: maps, shifts and scratch are changed.
        image: (P, 4) sums of weighted colours and of 255 times the weights, changed.
    """
    members, starts = space.members, order.starts
    for cell in range(cells):
        first = starts[cell]
        for slot in range(cell_views.shape[1]):
            view = cell_views[cell, slot]
            if view == NO_VIEW:
                break
            if view == DONE:
                continue
            count = _gather_members(cell, slot, cells, cell_views, starts, members)
            last = starts[cell + count]
            for begin in range(first, last, CHUNK):
                _blend_chunk(
                    view,
                    begin,
                    min(CHUNK, last - begin),
                    members,
                    count,
                    has_depth,
                    pose,
                    focal,
                    cell_weights,
                    cell_origins,
                    starts,
                    order.columns,
                    order.rows,
                    order.surface,
                    order.pixels,
                    field.views.projection,
                    field.views.focal,
                    field.views.texels,
                    field.views.level_start,
                    field.views.level_size,
                    field.views.inverse_depth,
                    field.views.depth_start,
                    field.views.depth_size,
                    space.rays,
                    space.maps,
                    space.shifts,
                    space.is_mapped,
                    space.scratch,
                    space.offsets,
                    space.places,
                    space.coefficients,
                    image,
                )


@compiled_leaf
def _gather_members(
    cell: int,
    slot: int,
    cells: int,
    cell_views: IntArray,
    starts: IntArray,
    members: IntArray,
) -> int:
    """Finds the cells from one on that show the same view and fit into a chunk together.

    Args:
        cell: the first.
        slot: of the view in it.
        cells: their number.
        cell_views: (c, k); the view is marked as done in the others.
        starts: (c + 1,) where they begin.
        members: (MOST_MEMBERS, 2) receives each cell and the view's slot in it.

    Returns:
        Their number.
    """
    view = cell_views[cell, slot]
    members[0, 0], members[0, 1] = cell, slot
    count = 1
    while (
        count < MOST_MEMBERS
        and cell + count < cells
        and starts[cell + count + 1] - starts[cell] <= CHUNK
    ):
        found = -1
        for other in range(cell_views.shape[1]):
            own = cell_views[cell + count, other]
            if own == view:
                found = other
            if own in (view, NO_VIEW):
                break
        if found < 0:
            break
        cell_views[cell + count, found] = DONE
        members[count, 0], members[count, 1] = cell + count, found
        count += 1
    return count


@compiled_leaf
def _blend_chunk(
    view: int,
    first: int,
    count: int,
    members: IntArray,
    member_count: int,
    has_depth: bool,
    pose: FloatArray,
    focal: float,
    cell_weights: FloatArray,
    cell_origins: FloatArray,
    starts: IntArray,
    columns: Float32Array,
    rows: Float32Array,
    surface: Float32Array,
    pixels: Int32Array,
    projection: FloatArray,
    focals: FloatArray,
    texels: ImageArray,
    level_start: IntArray,
    level_size: IntArray,
    inverse_depth: Float32Array,
    depth_start: IntArray,
    depth_size: IntArray,
    rays: FloatArray,
    maps: FloatArray,
    shifts: FloatArray,
    is_mapped: BoolArray,
    scratch: Float32Array,
    offsets: Int32Array,
    places: Int32Array,
    coefficients: Float32Array,
    image: Float32Array,
) -> None:
    """``blend_cells`` for one view and up to ``CHUNK`` pixels, from ``first`` on in their order."""
    x0, y0 = columns[first], rows[first]
    filled = (count + LANES - 1) // LANES * LANES
    load_chunk(columns, rows, surface, np.uintp(first), np.uintp(filled), scratch)
    for number in range(member_count):
        cell = members[number, 0]
        begin, end = max(starts[cell] - first, 0), min(starts[cell + 1] - first, count)
        load_weights(
            cell_weights, cell_origins, cell, members[number, 1], x0, y0, begin, end, scratch
        )
    end_weights(scratch, np.uintp(count))
    if not is_mapped[view]:
        view_mapping(projection, view, pose, rays, maps, shifts)
        is_mapped[view] = True
    chunk_coefficients(maps, shifts, view, x0, y0, coefficients)
    levels = level_size.shape[1]
    ratio = focals[view] / focal
    full_width, full_height = level_size[view, 0, 0], level_size[view, 0, 1]
    # Most chunks need one level, that of their first pixel; others are gone through.
    middle = coefficients[8] + coefficients[11] * surface[first]
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
            np.float32(full_width),
            np.float32(full_height),
            np.float32(level_size[view, level, 0] / full_width),
            np.float32(level_size[view, level, 1] / full_height),
        )
        if here > 0:
            if has_depth:
                leave_out_hidden(
                    scratch,
                    places,
                    filled,
                    inverse_depth,
                    depth_start[view],
                    depth_size[view, 0],
                    depth_size[view, 1],
                    full_width,
                    full_height,
                )
            start, width = level_start[view, level], level_size[view, level, 0]
            add_samples(scratch, offsets, pixels, first, count, texels, start, width, image)
        if elsewhere == 0:
            break
