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
from pipelines.lightfield.lane_intrinsics import first_lane, lanes_within
from pipelines.lightfield.proxy import PIXEL_PARTS, sample_steps
from pipelines.lightfield.record_type import compiled_record
from pipelines.lightfield.vector_code import LANES
from pipelines.lightfield.views import ViewArrays

# Samples in a batch; always so many, so that none are left over. They are taken from strips of so
# many rows.
TOGETHER, STRIP = 64, 12
# Neighbours stand so far apart in a batch, an odd number, so that all places are taken.
APART = 51
# Behind the mesh, what lies outside goes to so many places by turns: numbers that are written to
# one place, one after the other, wait for each other.
ELSEWHERE = 16
# By so much of a cell single precision errs at most.
MARGIN = np.float32(0.01)
# A view's map into the mesh, and the mesh's four borders.
NUMBERS = 28
# Points nearer to the camera's plane than this share of their recorded depth are left out.
SMALLEST_DEPTH = np.float32(1e-9)
HALF, ONE, TWO, ZERO = np.float32(0.5), np.float32(1.0), np.float32(2.0), np.float32(0.0)
# Unsigned, as in ``sampling_kernels``: where rows and inverse depths of a batch begin, and zeros
# beside what is compared with them.
_ROW, _DEPTH, _ZEROS = np.uintp(TOGETHER), np.uintp(2 * TOGETHER), np.uintp(LANES)


@compiled_record
class DepthSamples(NamedTuple):
    """What is projected of the depth maps, for one size of the mesh's cells: up to B batches.

    Batches are of ``TOGETHER`` samples that lie near each other; neighbours do not follow each
    other, since what is written to one place, one after the other, waits. A view's last sample
    fills up its last batch.

    Attributes:
        is_source: ``(N,)`` which views' depth maps are sampled.
        steps: ``(N,)`` from one of their pixels to the next, ``PIXEL_PARTS`` of which are one.
        starts: ``(N,)`` each view's first batch, and
        ends: ``(N,)`` the one behind its last.
        values: ``(3 * TOGETHER * B,)`` of each batch columns in the depth map, from its middle;
            then rows, likewise; then inverse depths, positive.
        boxes: ``(6 * (B + LANES),)`` around batches: the middles of columns, of rows and of inverse
            depths, of one batch after the other, and how far these go from there.
    """

    is_source: BoolArray
    steps: IntArray
    starts: IntArray
    ends: IntArray
    values: Float32Array
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
    most, count = int((-(-columns * rows // TOGETHER))[is_source].sum()), len(width)
    samples = DepthSamples(
        is_source,
        steps,
        np.empty(count, np.int64),
        np.empty(count, np.int64),
        aligned(3 * TOGETHER * most, np.float32),
        np.zeros(6 * (most + LANES), np.float32),
    )
    _fill(views, samples)
    return samples


@compiled
def _fill(views: ViewArrays, samples: DepthSamples) -> None:
    """Takes the samples of the views that are sources."""
    found = 0
    for view in range(len(samples.is_source)):
        samples.starts[view] = found // TOGETHER
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
                            place = _place_of(found)
                            samples.values[place] = column + 0.5 - 0.5 * width
                            samples.values[place + TOGETHER] = row + 0.5 - 0.5 * height
                            samples.values[place + 2 * TOGETHER] = value
                            found += 1
        while found % TOGETHER > 0:
            place, last = _place_of(found), _place_of(found - 1)
            for axis in range(0, 3 * TOGETHER, TOGETHER):
                samples.values[place + axis] = samples.values[last + axis]
            found += 1
        samples.ends[view] = found // TOGETHER
        for batch in range(samples.starts[view], samples.ends[view]):
            _set_box(samples.values, samples.boxes, batch)


@compiled_leaf
def _place_of(number: int) -> int:
    """Where the column of a sample stands."""
    return number // TOGETHER * (3 * TOGETHER) + number * APART % TOGETHER


@compiled_leaf
def _set_box(values: Float32Array, boxes: Float32Array, batch: int) -> None:
    """Writes the middle of a batch's values and how far they go from there."""
    step = len(boxes) // 6
    for axis in range(3):
        first = (3 * batch + axis) * TOGETHER
        low, high = values[first], values[first]
        for i in range(first + 1, first + TOGETHER):
            low, high = min(low, values[i]), max(high, values[i])
        boxes[axis * step + batch] = HALF * (low + high)
        boxes[(3 + axis) * step + batch] = HALF * (high - low)


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


@compiled_loop
def _set_reach(
    boxes: Float32Array, first: np.uintp, numbers: Float32Array, reach: Float32Array
) -> None:
    """Writes how far ``LANES`` batches reach into the mesh; with less than 0 they lie outside.

    Args:
        boxes: see ``DepthSamples``.
        first: of the batches.
        numbers: with the borders set.
        reach: (2 * LANES,) receives the result, then zeros.
    """
    step = np.uintp(len(boxes) // 6)
    for i in range(np.uintp(LANES)):
        place = first + i
        column, row, depth = boxes[place], boxes[place + step], boxes[place + step + step]
        place += step + step + step
        beside, below, behind = boxes[place], boxes[place + step], boxes[place + step + step]
        # Beyond which border it lies most: the place in it that lies beyond each of them least.
        lowest = np.float32(np.inf)
        for border in range(12, NUMBERS, 4):
            a, b = numbers[border], numbers[border + 1]
            c, d = numbers[border + 2], numbers[border + 3]
            highest = a * column + b * row + c + d * depth
            highest += abs(a) * beside + abs(b) * below + abs(d) * behind
            lowest = min(lowest, highest)
        reach[i], reach[i + _ZEROS] = lowest, ZERO


@compiled_leaf
def splat(
    views: ViewArrays,
    samples: DepthSamples,
    view: int,
    matrix: FloatArray,
    spacing: float,
    numbers: Float32Array,
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
        scratch: (LANES * TOGETHER,) overwritten.
        cells: (LANES * TOGETHER,) int32, overwritten.
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
    for first in range(samples.starts[view], samples.ends[view], LANES):
        _set_reach(samples.boxes, np.uintp(first), numbers, scratch)
        inside = lanes_within(scratch, _ZEROS, scratch, np.uintp(0))
        inside &= (1 << min(samples.ends[view] - first, LANES)) - 1
        # First all of them are placed, then all are written: placing need not wait for that.
        count = np.uintp(0)
        while inside:
            batch = first + first_lane(inside)
            inside &= inside - 1
            place = np.uintp(3 * TOGETHER * batch)
            _place(samples.values, place, numbers, height, width, scratch, cells, count)
            count += np.uintp(TOGETHER)
        for i in range(count):
            cell = np.uintp(cells[i])
            corners[cell] = max(corners[cell], scratch[i])


@compiled_loop
def _place(
    values: Float32Array,
    first: np.uintp,
    numbers: Float32Array,
    height: int,
    width: int,
    scratch: Float32Array,
    cells: Int32Array,
    target: np.uintp,
) -> None:
    """In which cells a batch of samples lies, and how near they are to the virtual camera.

    From the middle of a depth map the numbers are small, and single precision is enough for them.

    Args:
        values: see ``DepthSamples``; those of the batch begin at
        first: there.
        numbers: three rows of turn and shift: a pixel p of the depth map, from its middle, at
            inverse depth d is at turn p + shift d.
        height: rows of the mesh.
        width: of the mesh.
        scratch: receives inverse depths in the virtual image.
        cells: receives the corners' indices; behind the mesh for what lies outside.
        target: where in these two the batch's begin.
    """
    t0, t1, t2, s0 = numbers[0], numbers[1], numbers[2], numbers[3]
    t3, t4, t5, s1 = numbers[4], numbers[5], numbers[6], numbers[7]
    t6, t7, t8, s2 = numbers[8], numbers[9], numbers[10], numbers[11]
    right, bottom = np.float32(width), np.float32(height)
    row_length, start = np.float32(width + 2), np.float32(width + 3)
    behind = (bottom + TWO) * row_length
    for i in range(np.uintp(TOGETHER)):
        x, y, value = values[first + i], values[first + i + _ROW], values[first + i + _DEPTH]
        depth = t6 * x + t7 * y + t8 + value * s2
        reciprocal = ONE / depth
        u = (t0 * x + t1 * y + t2 + value * s0) * reciprocal + HALF
        v = (t3 * x + t4 * y + t5 + value * s1) * reciprocal + HALF
        is_inside = depth > SMALLEST_DEPTH
        is_inside &= (u >= ZERO) & (u < right) & (v >= ZERO) & (v < bottom)
        # Whole numbers, that single precision holds; sums of two of 32 bits would take 64.
        cell = np.floor(v) * row_length + np.floor(u) + start
        elsewhere = behind + np.float32(i % np.uintp(ELSEWHERE))
        cells[target + i] = np.int32(cell if is_inside else elsewhere)
        scratch[target + i] = value * reciprocal if is_inside else ZERO
