"""Depth maps projected into a virtual image, compiled: the corners of its surface's mesh."""

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
from pipelines.lightfield.compiled import compiled, compiled_leaf, compiled_loop
from pipelines.lightfield.proxy import PIXEL_PARTS, sample_steps
from pipelines.lightfield.record_type import compiled_record
from pipelines.lightfield.views import ViewArrays

# Samples that are worked on together; always so many, so that none are left over. They are taken
# from strips of so many rows.
TOGETHER, STRIP = 128, 12
# Neighbours stand so far apart in a batch, an odd number, so that all places are taken.
APART = 29
# Behind the mesh, what lies outside goes to so many places by turns: numbers that are written to
# one place, one after the other, wait for each other.
ELSEWHERE = 16
# By so much of a cell single precision errs at most.
MARGIN = np.float32(0.01)
# A view's map into the mesh, and the mesh's four borders.
NUMBERS = 28
# Points nearer to the camera's plane than this share of their recorded depth are left out.
SMALLEST_DEPTH = np.float32(1e-9)
HALF, ONE, ZERO = np.float32(0.5), np.float32(1.0), np.float32(0.0)


@compiled_record
class DepthSamples(NamedTuple):
    """What is projected of the depth maps, for one size of the mesh's cells: up to S samples.

    They stand in batches of ``TOGETHER`` that lie near each other; neighbours do not follow each
    other, since what is written to one place, one after the other, waits. A view's last sample
    fills up its last batch.

    Attributes:
        is_source: ``(N,)`` which views' depth maps are sampled.
        steps: ``(N,)`` from one of their pixels to the next, ``PIXEL_PARTS`` of which are one.
        starts: ``(N,)`` where each view's samples begin, at the beginning of a batch, and
        ends: ``(N,)`` where they end.
        columns: ``(S,)`` in the depth map, from its middle, and
        rows: likewise, and
        inverse_depth: likewise, positive.
        boxes: ``(S / TOGETHER, 6)`` around batches: the middle of columns, rows and inverse depths,
            and how far these go from there.
    """

    is_source: BoolArray
    steps: IntArray
    starts: IntArray
    ends: IntArray
    columns: Float32Array
    rows: Float32Array
    inverse_depth: Float32Array
    boxes: Float32Array


def depth_samples(
    views: ViewArrays, is_source: BoolArray, focal: float, spacing: float
) -> DepthSamples:
    """Samples of depth maps, somewhat denser than a mesh's corners will be.

    Args:
        views: the light field.
        is_source: (N,) whose depth maps are sampled.
        focal: of the virtual camera, pixels.
        spacing: of the mesh's corners, virtual pixels.
    """
    width, height = views.depth_size[:, 0], views.depth_size[:, 1]
    steps = sample_steps(views, focal, spacing)
    columns, rows = (-(-PIXEL_PARTS * size // steps) for size in (width, height))
    batches = -(-columns * rows // TOGETHER)
    most, count = int(batches[is_source].sum()) * TOGETHER, len(width)
    samples = DepthSamples(
        is_source,
        steps,
        np.empty(count, np.int64),
        np.empty(count, np.int64),
        aligned(most, np.float32),
        aligned(most, np.float32),
        aligned(most, np.float32),
        np.empty((most // TOGETHER, 6), np.float32),
    )
    _fill(views, samples)
    return samples


@compiled
def _fill(views: ViewArrays, samples: DepthSamples) -> None:
    """Takes the samples of the views that are sources."""
    columns, rows, inverse_depth = samples.columns, samples.rows, samples.inverse_depth
    found = 0
    for view in range(len(samples.is_source)):
        samples.starts[view] = found
        if samples.is_source[view]:
            width, height = views.depth_size[view, 0], views.depth_size[view, 1]
            start, step = views.depth_start[view], samples.steps[view]
            below, right = PIXEL_PARTS * height, PIXEL_PARTS * width
            # Column by column of a strip, so that batches are about as wide as high.
            for top in range(0, below, STRIP * step):
                for x in range(0, right, step):
                    for y in range(top, min(top + STRIP * step, below), step):
                        column, row = x // PIXEL_PARTS, y // PIXEL_PARTS
                        value = views.inverse_depth[start + row * width + column]
                        if value > ZERO:
                            place = _place_in_batch(found)
                            columns[place] = column + 0.5 - 0.5 * width
                            rows[place] = row + 0.5 - 0.5 * height
                            inverse_depth[place] = value
                            found += 1
        while found % TOGETHER > 0:
            place, last = _place_in_batch(found), _place_in_batch(found - 1)
            columns[place], rows[place] = columns[last], rows[last]
            inverse_depth[place] = inverse_depth[last]
            found += 1
        samples.ends[view] = found
        for first in range(samples.starts[view], found, TOGETHER):
            batch = first // TOGETHER
            _set_box(columns, first, samples.boxes, batch, 0)
            _set_box(rows, first, samples.boxes, batch, 1)
            _set_box(inverse_depth, first, samples.boxes, batch, 2)


@compiled_leaf
def _place_in_batch(number: int) -> int:
    return number // TOGETHER * TOGETHER + number * APART % TOGETHER


@compiled_leaf
def _set_box(values: Float32Array, first: int, boxes: Float32Array, batch: int, axis: int) -> None:
    """Writes the middle of a batch's values and how far they go from there."""
    low, high = values[first], values[first]
    for i in range(first + 1, first + TOGETHER):
        low, high = min(low, values[i]), max(high, values[i])
    boxes[batch, axis] = HALF * (low + high)
    boxes[batch, 3 + axis] = HALF * (high - low)


@compiled_leaf
def _set_borders(numbers: Float32Array, width: int, height: int) -> None:
    """Writes linear functions of a sample that are negative outside of the mesh.

    Args:
        numbers: (NUMBERS,) the first twelve as ``_place`` takes them; behind them four functions of
            column, row, 1 and inverse depth.
        width: of the mesh, and
        height: of it.
    """
    for axis, size in enumerate((width, height)):
        for i in range(4):
            along, depth = numbers[4 * axis + i], numbers[8 + i]
            # A little beyond the border: no place is exact.
            numbers[12 + 8 * axis + i] = along + (HALF + MARGIN) * depth
            numbers[16 + 8 * axis + i] = (np.float32(size) - HALF + MARGIN) * depth - along


@compiled_leaf
def _is_outside(boxes: Float32Array, batch: int, numbers: Float32Array) -> bool:
    """Whether a batch lies outside of the mesh, beyond one of its borders."""
    for border in range(12, NUMBERS, 4):
        highest = np.float64(numbers[border + 2])
        for axis in range(3):
            factor = numbers[border + axis] if axis < 2 else numbers[border + 3]
            highest += factor * boxes[batch, axis] + abs(factor) * boxes[batch, 3 + axis]
        if highest < 0.0:
            return True
    return False


@compiled_leaf
def splat(
    views: ViewArrays,
    samples: DepthSamples,
    view: int,
    matrix: FloatArray,
    spacing: float,
    numbers: Float32Array,
    elsewhere: Float32Array,
    scratch: Float32Array,
    cells: Int32Array,
    corners: Float32Array,
    height: int,
    width: int,
) -> None:
    """Projects one depth map into the virtual image; of points in one cell the nearest stays.

    Args:
        views: the light field.
        samples: of its depth maps.
        view: whose depth map.
        matrix: (3, 4) world points to homogeneous virtual pixels.
        spacing: of the mesh's corners, virtual pixels.
        numbers: (NUMBERS,) overwritten.
        elsewhere: (TOGETHER,) places behind the mesh, by turns.
        scratch: (TOGETHER,) overwritten.
        cells: (TOGETHER,) int32, overwritten.
        corners: ((height + 2) * (width + 2) + ELSEWHERE,) inverse depths at the mesh's corners with
            a border, and what lies outside; changed.
        height: rows of the mesh.
        width: of the mesh.
    """
    full_width, full_height = views.level_size[view, 0, 0], views.level_size[view, 0, 1]
    scale_x, scale_y = (
        full_width / views.depth_size[view, 0],
        full_height / views.depth_size[view, 1],
    )
    middle_x, middle_y = 0.5 * (full_width - 1), 0.5 * (full_height - 1)
    for i in range(3):
        # Columns and rows of the mesh.
        scale = 1.0 / spacing if i < 2 else 1.0
        a, b, c, shift = 0.0, 0.0, 0.0, scale * matrix[i, 3]
        for k in range(3):
            own = scale * matrix[i, k]
            a += own * views.rays[view, k, 0]
            b += own * views.rays[view, k, 1]
            c += own * views.rays[view, k, 2]
            shift += own * views.centres[view, k]
        numbers[4 * i], numbers[4 * i + 1] = a * scale_x, b * scale_y
        numbers[4 * i + 2], numbers[4 * i + 3] = a * middle_x + b * middle_y + c, shift
    _set_borders(numbers, width, height)
    for first in range(samples.starts[view], samples.ends[view], TOGETHER):
        if _is_outside(samples.boxes, first // TOGETHER, numbers):
            continue
        _place(
            samples.columns,
            samples.rows,
            samples.inverse_depth,
            np.uintp(first),
            numbers,
            height,
            width,
            elsewhere,
            scratch,
            cells,
        )
        for i in range(np.uintp(TOGETHER)):
            cell = np.uintp(cells[i])
            corners[cell] = max(corners[cell], scratch[i])


@compiled_loop
def _place(
    sample_columns: Float32Array,
    sample_rows: Float32Array,
    inverse_depth: Float32Array,
    first: np.uintp,
    numbers: Float32Array,
    height: int,
    width: int,
    elsewhere: Float32Array,
    scratch: Float32Array,
    cells: Int32Array,
) -> None:
    """In which cells samples lie, and how near they are to the virtual camera.

    From the middle of a depth map the numbers are small, and single precision is enough for them.

    Args:
        sample_columns: see ``DepthSamples``, and
        sample_rows: likewise, and
        inverse_depth: likewise.
        first: of the samples.
        numbers: three rows of turn and shift: a pixel p of the depth map, from its middle, at
            inverse depth d is at turn p + shift d.
        height: rows of the mesh.
        width: of the mesh.
        elsewhere: (TOGETHER,) where what lies outside goes.
        scratch: receives inverse depths in the virtual image.
        cells: receives the corners' indices; behind the mesh for what lies outside.
    """
    t0, t1, t2, s0 = numbers[0], numbers[1], numbers[2], numbers[3]
    t3, t4, t5, s1 = numbers[4], numbers[5], numbers[6], numbers[7]
    t6, t7, t8, s2 = numbers[8], numbers[9], numbers[10], numbers[11]
    right, bottom = np.float32(width), np.float32(height)
    row_length, start = np.float32(width + 2), np.float32(width + 3)
    for i in range(np.uintp(TOGETHER)):
        x, y, value = sample_columns[first + i], sample_rows[first + i], inverse_depth[first + i]
        depth = t6 * x + t7 * y + t8 + value * s2
        reciprocal = ONE / depth
        u = (t0 * x + t1 * y + t2 + value * s0) * reciprocal + HALF
        v = (t3 * x + t4 * y + t5 + value * s1) * reciprocal + HALF
        is_inside = depth > SMALLEST_DEPTH
        is_inside &= (u >= ZERO) & (u < right) & (v >= ZERO) & (v < bottom)
        # Whole numbers, that single precision holds; sums of two of 32 bits would take 64.
        cell = np.floor(v) * row_length + np.floor(u) + start
        cells[i] = np.int32(cell if is_inside else elsewhere[i])
        scratch[i] = value * reciprocal if is_inside else ZERO
