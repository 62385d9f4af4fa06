"""What the fast renderer reads and writes: the light field, and memory for the views it draws."""

import contextlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from pipelines.artifacts.array_types import (
    BoolArray,
    Float32Array,
    FloatArray,
    Int32Array,
    IntArray,
)
from pipelines.lightfield.aligned_memory import aligned
from pipelines.lightfield.blending import VIEWS_PER_TILE
from pipelines.lightfield.blending_kernels import Tiling, tiling_for
from pipelines.lightfield.net_cell_kernels import NetRoom, net_room_for
from pipelines.lightfield.pixel_order_kernels import PixelOrder, pixel_order_for
from pipelines.lightfield.record_type import compiled_record
from pipelines.lightfield.sampling_kernels import COEFFICIENTS, ROW_LENGTH, SCRATCH_SIZE
from pipelines.lightfield.view_index import GROUP_VIEWS, ViewIndex
from pipelines.lightfield.views import ViewArrays

# A cell has fewer views than this.
SLOTS = 16
# Pixels that their cells leave empty are shown by others so many at a time.
SUBSTITUTES_TOGETHER = 1024
# Workspaces are kept for images of so many pixels at most, and of so many sizes.
MOST_KEPT_PIXELS, MOST_KEPT_SIZES = 80_000, 8
# Behind the last cell of a chain.
END = -1


@compiled_record
class LightField(NamedTuple):
    """A light field and how it is rendered, in the form that compiled code takes.

    Attributes:
        views: the photos.
        view_index: of those that may take part.
        usable: ``(N,)`` which these are.
        has_depth: whether depth maps may hide the surface.
        is_net: whether views are blended by the Delaunay net; else by the unstructured lumigraph.
    """

    views: ViewArrays
    view_index: ViewIndex
    usable: BoolArray
    has_depth: bool
    is_net: bool


@compiled_record
class Links(NamedTuple):
    """The cells that show the same view, for each view.

    A cell's view is entry ``cell * SLOTS + slot``.

    Attributes:
        views: ``(N,)`` those that any cell shows.
        first: ``(N,)`` the first entry of each view; ``END``: none.
        next: ``(c * SLOTS,)`` the next entry of the same view; ``END``: none.
    """

    views: IntArray
    first: IntArray
    next: IntArray


def links_for(views: int, cells: int) -> Links:
    """Memory for the chains of so many views and cells."""
    return Links(
        np.empty(views, np.int64),
        np.full(views, END, np.int64),
        np.empty(cells * SLOTS, np.int64),
    )


@compiled_record
class Substitutes(NamedTuple):
    """Pixels that none of their cell's views show, and the views that do instead.

    Attributes:
        pixels: ``(H W,)`` int32 which of those that are rendered, and
        views: ``(H W, 1)`` the view of each.
        order: the order of as many as are rendered at a time, each of which is a cell, and
        links: their chains, and
        cell_weights: ``(n, 1, 4)`` their weights, all 1, and
        cell_origins: ``(n, 2)``.
        everywhere: ``(N,)`` views that may show any, and
        here: ``(N,)`` any of a row.
        box: ``(6,)`` around pixels: columns, rows, inverse depths, two of each.
        offset: ``(3,)`` of a centre from the virtual one, and
        corner: ``(2,)`` where it projects to.
    """

    pixels: Int32Array
    views: IntArray
    order: PixelOrder
    links: Links
    cell_weights: FloatArray
    cell_origins: FloatArray
    everywhere: IntArray
    here: IntArray
    box: FloatArray
    offset: FloatArray
    corner: FloatArray


def substitutes_for(pixels: int, views: int) -> Substitutes:
    """Memory for the substitutes of so many pixels, by so many views."""
    order = pixel_order_for(np.zeros(SUBSTITUTES_TOGETHER, np.int32), 1, SUBSTITUTES_TOGETHER)
    order.starts[:] = np.arange(SUBSTITUTES_TOGETHER + 1)
    weights = np.zeros((SUBSTITUTES_TOGETHER, 1, 4))
    weights[..., 2] = 1.0
    return Substitutes(
        np.empty(pixels, np.int32),
        np.empty((pixels, 1), np.int64),
        order,
        links_for(views, SUBSTITUTES_TOGETHER),
        weights,
        np.zeros((SUBSTITUTES_TOGETHER, 2)),
        np.empty(views, np.int64),
        np.empty(views, np.int64),
        np.empty(6),
        np.empty(3),
        np.empty(2),
    )


@compiled_record
class Workspace(NamedTuple):
    """What rendering one view writes on its way; made once for many views of one size.

    Attributes:
        rays: ``(3, 3)`` virtual pixels to world directions.
        maps: ``(N, 3, 3)`` and
        shifts: ``(N, 3)``: virtual pixel p at inverse depth d is at map p + shift d of a view.
        is_mapped: ``(N,)`` for which views these are there.
        takes_part: ``(N,)`` views of the net.
        cell_views: ``(c, VIEWS_PER_TILE)`` the views of each cell; -1 behind the last.
        cell_weights: ``(c, VIEWS_PER_TILE, 4)`` coefficients of x, y, 1, x y, relative to
        cell_origins: ``(c, 2)`` columns and rows.
        tiling: how views are chosen for tiles; of the smallest image where cells are a net's.
        room: of the net, for no views where there is none.
        labels: ``(H, W)`` each pixel's cell.
        order: the pixels that are rendered, by cell.
        links: chains of cells.
        substitutes: of pixels that their cells leave empty.
        scratch: of a chunk, see ``sampling_kernels``.
        targets: ``(CHUNK,)`` int32, and
        offsets: likewise.
        coefficients: ``(COEFFICIENTS,)``.
    """

    rays: FloatArray
    maps: FloatArray
    shifts: FloatArray
    is_mapped: BoolArray
    takes_part: BoolArray
    cell_views: IntArray
    cell_weights: FloatArray
    cell_origins: FloatArray
    tiling: Tiling
    room: NetRoom
    labels: IntArray
    order: PixelOrder
    links: Links
    substitutes: Substitutes
    scratch: Float32Array
    targets: Int32Array
    offsets: Int32Array
    coefficients: Float32Array


def workspace_for(field: LightField, width: int, height: int, chosen: Int32Array) -> Workspace:
    """Memory for rendering some pixels of views of one size.

    Args:
        field: the light field.
        width: of the virtual images, and
        height: of them.
        chosen: (P,) int32 the pixels, rising.
    """
    count = len(field.views.centres)
    if field.is_net:
        room, tiling = net_room_for(count), tiling_for(1, 1, 0, 0)
        cells = 4 * count + 8
        origins = np.zeros((cells, 2))
    else:
        groups = len(field.view_index.members) // GROUP_VIEWS
        room, tiling = net_room_for(0), tiling_for(width, height, count, groups)
        tiles = (len(tiling.down) - 1, len(tiling.across) - 1)
        cells = tiles[0] * tiles[1]
        corners = np.empty((*tiles, 2))
        corners[..., 0], corners[..., 1] = tiling.across[:-1], tiling.down[:-1, None]
        origins = corners.reshape((cells, 2))
    return Workspace(
        np.empty((3, 3)),
        np.empty((count, 3, 3)),
        np.empty((count, 3)),
        np.zeros(count, np.bool_),
        np.zeros(count, np.bool_),
        np.empty((cells, VIEWS_PER_TILE), np.int64),
        np.empty((cells, VIEWS_PER_TILE, 4)),
        origins,
        tiling,
        room,
        np.zeros((height, width), np.int64),
        pixel_order_for(chosen, width, cells),
        links_for(count, cells),
        substitutes_for(width * height, count),
        *_chunk_memory(),
        np.empty(COEFFICIENTS, np.float32),
    )


class Workspaces:
    """Workspaces of a light field that are not in use: to make one takes as long as some particles.

    Threads may share it.

    Args:
        field: the light field.
    """

    def __init__(self, field: LightField) -> None:
        self._field = field
        self._idle: dict[tuple[int, int], list[Workspace]] = {}

    @contextlib.contextmanager
    def one_for(self, width: int, height: int, chosen: Int32Array) -> Iterator[Workspace]:
        """A workspace that is nobody else's meanwhile; see ``workspace_for``."""
        idle = self._idle.setdefault((width, height), [])
        try:
            space = idle.pop()
        except IndexError:
            space = workspace_for(self._field, width, height, chosen)
        if not np.array_equal(space.order.chosen, chosen):
            order = pixel_order_for(chosen, width, len(space.cell_views))
            space = space._replace(order=order)
        yield space
        if width * height <= MOST_KEPT_PIXELS:
            idle.append(space)
        for oldest in list(self._idle)[:-MOST_KEPT_SIZES]:
            self._idle.pop(oldest, None)


def _chunk_memory() -> tuple[Float32Array, Int32Array, Int32Array]:
    """A chunk's scratch and two rows of whole numbers, aligned for the widest vectors."""
    numbers = aligned(SCRATCH_SIZE + 2 * ROW_LENGTH, np.float32)
    numbers[:] = 0.0
    rows = numbers.view(np.int32)
    return (
        numbers[:SCRATCH_SIZE],
        rows[SCRATCH_SIZE : SCRATCH_SIZE + ROW_LENGTH],
        rows[SCRATCH_SIZE + ROW_LENGTH :],
    )
