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
from pipelines.lightfield.compiled import compiled_leaf, compiled_loop, compiled_step
from pipelines.lightfield.proxy import SAMPLES_PER_CELL
from pipelines.lightfield.views import ViewArrays

# Samples that are worked on together; always so many, so that none are left over. They are taken
# from strips of so many rows.
TOGETHER, STRIP = 128, 12
# Behind the mesh, what lies outside goes to so many places by turns: numbers that are written to
# one place, one after the other, wait for each other.
ELSEWHERE = 16
# Points nearer to the camera's plane than this share of their recorded depth are left out.
# By so much of a cell single precision errs at most.
MARGIN = np.float32(0.01)
SMALLEST_DEPTH = np.float32(1e-9)
HALF, ONE, ZERO = np.float32(0.5), np.float32(1.0), np.float32(0.0)


class DepthSamples(NamedTuple):
    """What is projected of the depth maps, for one size of the mesh's cells: S samples.

    They stand in batches of ``TOGETHER`` that lie near each other; a view's last batch is not full.

    Attributes:
        starts: ``(N,)`` where each view's samples begin, at the beginning of a batch, and
        ends: ``(N,)`` where they end.
        columns: ``(S,)`` in the depth map, from its middle, and
        rows: likewise, and
        inverse_depth: likewise, positive.
        boxes: ``(S / TOGETHER, 6)`` around batches: the middle of columns, rows and inverse depths,
            and how far these go from there.
    """

    starts: IntArray
    ends: IntArray
    columns: Float32Array
    rows: Float32Array
    inverse_depth: Float32Array
    boxes: FloatArray


@compiled_step
def depth_samples(
    views: ViewArrays, is_source: BoolArray, focal: float, spacing: float
) -> DepthSamples:
    """Chooses samples of depth maps, somewhat denser than a mesh's corners will be.

    Args:
        views: the light field.
        is_source: (N,) whose depth maps are wanted.
        focal: of the virtual camera, pixels.
        spacing: of the mesh's corners, virtual pixels.
    """
    count = len(views.centres)
    starts, ends = np.zeros(count, np.int64), np.zeros(count, np.int64)
    strides = np.ones(count, np.int64)
    most = 0
    for view in range(count):
        if not is_source[view]:
            continue
        width, height = views.depth_size[view, 0], views.depth_size[view, 1]
        scale = width / views.level_size[view, 0, 0]
        stride = max(1, int(spacing * views.focal[view] * scale / focal / SAMPLES_PER_CELL))
        strides[view] = stride
        samples = ((width + stride - 1) // stride) * ((height + stride - 1) // stride)
        most += (samples + TOGETHER - 1) // TOGETHER * TOGETHER
    columns, rows = np.zeros(most, np.float32), np.zeros(most, np.float32)
    inverse_depth = np.zeros(most, np.float32)
    found = 0
    for view in range(count):
        if not is_source[view]:
            continue
        width, height = views.depth_size[view, 0], views.depth_size[view, 1]
        stride, starts[view] = strides[view], found
        # Column by column of a strip, so that batches are about as wide as high.
        for top in range(0, height, STRIP * stride):
            for column in range(0, width, stride):
                for row in range(top, min(top + STRIP * stride, height), stride):
                    value = views.inverse_depth[views.depth_start[view] + row * width + column]
                    if value > 0.0:
                        columns[found] = column + 0.5 - 0.5 * width
                        rows[found] = row + 0.5 - 0.5 * height
                        inverse_depth[found] = value
                        found += 1
        ends[view] = found
        found = (found + TOGETHER - 1) // TOGETHER * TOGETHER
    boxes = np.zeros((most // TOGETHER, 6))
    for view in range(count):
        for first in range(starts[view], ends[view], TOGETHER):
            last = min(first + TOGETHER, ends[view])
            for axis, values in enumerate((columns, rows, inverse_depth)):
                low, high = values[first:last].min(), values[first:last].max()
                boxes[first // TOGETHER, axis] = 0.5 * (low + high)
                boxes[first // TOGETHER, 3 + axis] = 0.5 * (high - low)
    return DepthSamples(starts, ends, columns, rows, inverse_depth, boxes)


@compiled_leaf
def _set_borders(numbers: Float32Array, width: int, height: int) -> None:
    """Writes linear functions of a sample that are negative outside of the mesh.

    Args:
        numbers: (28,) the first twelve as ``_place`` takes them; behind them four functions of
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
def _is_outside(boxes: FloatArray, batch: int, numbers: Float32Array) -> bool:
    """Whether a batch lies outside of the mesh, beyond one of its borders."""
    for border in range(12, 28, 4):
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
        numbers: (28,) overwritten.
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
        for i in range(np.uintp(min(TOGETHER, samples.ends[view] - first))):
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
