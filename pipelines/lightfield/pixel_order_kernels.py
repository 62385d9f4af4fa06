"""The pixels that are rendered, cell by cell, compiled.

Often these are all pixels of the image; where only some are compared, it is those. They have two
numbers: their place in the list of what is rendered, and their index in the image.
"""

from typing import NamedTuple

import numpy as np

from pipelines.artifacts.array_types import Float32Array, Int32Array, IntArray
from pipelines.lightfield.compiled import compiled_leaf
from pipelines.lightfield.record_type import compiled_record
from pipelines.lightfield.vector_code import LANES

# Pixels that are passed over at once where a row's labels stay the same.
STRIDE = 8


@compiled_record
class PixelOrder(NamedTuple):
    """P pixels of an image, in the order of the cells that they lie in.

    What is ``LANES`` longer may be read beyond its end.

    Attributes:
        chosen: ``(P,)`` int32 their indices in the image, rising.
        chosen_columns: ``(P,)`` where that is, and
        chosen_rows: likewise.
        starts: ``(c + 1,)`` where cells begin in their order.
        columns: ``(P + LANES,)`` places of the pixels in that order, and
        rows: likewise, and
        surface: their inverse depths, and
        pixels: likewise, int32 their places in ``chosen``, and
        indices: likewise, int32 their indices in the image.
    """

    chosen: Int32Array
    chosen_columns: Float32Array
    chosen_rows: Float32Array
    starts: IntArray
    columns: Float32Array
    rows: Float32Array
    surface: Float32Array
    pixels: Int32Array
    indices: Int32Array


def pixel_order_for(chosen: Int32Array, width: int, cells: int) -> PixelOrder:
    """Memory for the order of some pixels of an image, by up to so many cells."""
    count = len(chosen)
    return PixelOrder(
        chosen,
        (chosen % width).astype(np.float32),
        (chosen // width).astype(np.float32),
        np.zeros(cells + 1, np.int64),
        np.zeros(count + LANES, np.float32),
        np.zeros(count + LANES, np.float32),
        np.zeros(count + LANES, np.float32),
        np.zeros(count + LANES, np.int32),
        np.zeros(count + LANES, np.int32),
    )


@compiled_leaf
def order_by_label(labels: IntArray, cells: int, surface: Float32Array, order: PixelOrder) -> None:
    """Sorts the chosen pixels, and their inverse depths, by their labels.

    Args:
        labels: (H, W) each pixel's cell.
        cells: their number.
        surface: (H W,) inverse depths.
        order: changed.
    """
    starts = order.starts
    for cell in range(cells + 1):
        starts[cell] = 0
    if len(order.chosen) == labels.size:
        _order_all(labels, cells, surface, order)
    else:
        _order_some(labels.reshape(-1), cells, surface, order)
    # Each start has moved to the next one's place.
    for cell in range(cells, 0, -1):
        starts[cell] = starts[cell - 1]
    starts[0] = 0


@compiled_leaf
def _add_up(starts: IntArray, cells: int) -> None:
    """Turns the sizes of cells, each of which stands one behind its own place, into beginnings."""
    for cell in range(cells):
        starts[cell + 1] += starts[cell]


@compiled_leaf
def _order_some(labels: IntArray, cells: int, surface: Float32Array, order: PixelOrder) -> None:
    """Pixel by pixel; a cell's place is read and written only where another cell begins."""
    starts, count = order.starts, np.uintp(len(order.chosen))
    last, run = np.int64(0), np.int64(0)
    for i in range(count):
        label = labels[np.uintp(order.chosen[i])]
        if label != last:
            starts[last + 1] += run
            last, run = label, np.int64(0)
        run += 1
    starts[last + 1] += run
    _add_up(starts, cells)
    last = np.int64(0)
    place = np.uintp(starts[0])
    for i in range(count):
        label = labels[np.uintp(order.chosen[i])]
        if label != last:
            starts[last] = place
            last, place = label, np.uintp(starts[label])
        order.columns[place] = order.chosen_columns[i]
        order.rows[place] = order.chosen_rows[i]
        order.pixels[place] = i
        order.indices[place] = order.chosen[i]
        order.surface[place] = surface[np.uintp(order.chosen[i])]
        place += np.uintp(1)
    starts[last] = place


@compiled_leaf
def _order_all(labels: IntArray, cells: int, surface: Float32Array, order: PixelOrder) -> None:
    """All pixels of an image, by runs of equal labels."""
    starts = order.starts
    height, width = labels.shape
    for y in range(height):
        first = 0
        while first < width:
            last = _end_of_run(labels, y, first, width)
            starts[labels[y, first] + 1] += last - first
            first = last
    _add_up(starts, cells)
    for y in range(height):
        first = 0
        while first < width:
            last = _end_of_run(labels, y, first, width)
            place = np.uintp(starts[labels[y, first]])
            starts[labels[y, first]] += last - first
            pixel = np.uintp(y * width + first)
            for i in range(np.uintp(last - first)):
                order.columns[place + i] = np.float32(first + np.int32(i))
                order.rows[place + i] = np.float32(y)
                order.pixels[place + i] = y * width + first + np.int32(i)
                order.indices[place + i] = y * width + first + np.int32(i)
                order.surface[place + i] = surface[pixel + i]
            first = last


@compiled_leaf
def _end_of_run(labels: IntArray, y: int, first: int, width: int) -> int:
    """The column behind the last of the pixels that share their label with the first.

    Cells are convex, so that what lies between two pixels of one is of it too.
    """
    last = first + 1
    for step in (STRIDE, 1):
        while last + step <= width and labels[y, last + step - 1] == labels[y, first]:
            last += step
    return last
