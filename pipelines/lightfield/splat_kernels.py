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

# Samples that are worked on together; always so many, so that none are left over.
TOGETHER = 128
# Behind the mesh, what lies outside goes to so many places by turns: numbers that are written to
# one place, one after the other, wait for each other.
ELSEWHERE = 16
# Points nearer to the camera's plane than this share of their recorded depth are left out.
SMALLEST_DEPTH = 1e-9


class DepthSamples(NamedTuple):
    """What is projected of the depth maps, for one size of the mesh's cells: S samples.

    Attributes:
        starts: ``(N + 1,)`` where each view's samples begin.
        columns: ``(S + TOGETHER,)`` in the depth map, and
        rows: likewise, and
        inverse_depth: likewise, positive.
    """

    starts: IntArray
    columns: Float32Array
    rows: Float32Array
    inverse_depth: Float32Array


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
    starts = np.zeros(count + 1, np.int64)
    strides = np.ones(count, np.int64)
    most = 0
    for view in range(count):
        if not is_source[view]:
            continue
        width, height = views.depth_size[view, 0], views.depth_size[view, 1]
        scale = width / views.level_size[view, 0, 0]
        stride = max(1, int(spacing * views.focal[view] * scale / focal / SAMPLES_PER_CELL))
        strides[view] = stride
        most += ((width + stride - 1) // stride) * ((height + stride - 1) // stride)
    columns, rows = np.zeros(most + TOGETHER, np.float32), np.zeros(most + TOGETHER, np.float32)
    inverse_depth = np.zeros(most + TOGETHER, np.float32)
    found = 0
    for view in range(count):
        width, height = views.depth_size[view, 0], views.depth_size[view, 1]
        starts[view + 1] = found
        if not is_source[view]:
            continue
        for row in range(0, height, strides[view]):
            for column in range(0, width, strides[view]):
                value = views.inverse_depth[views.depth_start[view] + row * width + column]
                if value > 0.0:
                    columns[found], rows[found], inverse_depth[found] = column, row, value
                    found += 1
        starts[view + 1] = found
    return DepthSamples(starts, columns, rows, inverse_depth)


@compiled_leaf
def splat(
    views: ViewArrays,
    samples: DepthSamples,
    view: int,
    matrix: FloatArray,
    spacing: float,
    numbers: FloatArray,
    scratch: FloatArray,
    cells: Int32Array,
    corners: FloatArray,
    height: int,
    columns: int,
) -> None:
    """Projects one depth map into the virtual image; of points in one cell the nearest stays.

    Args:
        views: the light field.
        samples: of its depth maps.
        view: whose depth map.
        matrix: (3, 4) world points to homogeneous virtual pixels.
        spacing: of the mesh's corners, virtual pixels.
        numbers: (16,) overwritten.
        scratch: (TOGETHER,) overwritten.
        cells: (TOGETHER,) int32, overwritten.
        corners: (height * columns + ELSEWHERE,) inverse depths at the mesh's corners, and what lies
            outside; changed.
        height: rows of the mesh.
        columns: of the mesh.
    """
    numbers[12] = views.level_size[view, 0, 0] / views.depth_size[view, 0]
    numbers[13] = views.level_size[view, 0, 1] / views.depth_size[view, 1]
    for i in range(3):
        # Columns and rows of the mesh.
        scale = 1.0 / spacing if i < 2 else 1.0
        numbers[9 + i] = scale * matrix[i, 3]
        for j in range(3):
            numbers[3 * i + j] = 0.0
        for k in range(3):
            numbers[9 + i] += scale * matrix[i, k] * views.centres[view, k]
            for j in range(3):
                numbers[3 * i + j] += scale * matrix[i, k] * views.rays[view, k, j]
    for first in range(samples.starts[view], samples.starts[view + 1], TOGETHER):
        _place(
            samples.columns,
            samples.rows,
            samples.inverse_depth,
            np.uintp(first),
            numbers,
            height,
            columns,
            scratch,
            cells,
        )
        for i in range(np.uintp(min(TOGETHER, samples.starts[view + 1] - first))):
            cell = np.uintp(cells[i])
            corners[cell] = max(corners[cell], scratch[i])


@compiled_loop
def _place(
    sample_columns: Float32Array,
    sample_rows: Float32Array,
    inverse_depth: Float32Array,
    first: np.uintp,
    numbers: FloatArray,
    height: int,
    columns: int,
    scratch: FloatArray,
    cells: Int32Array,
) -> None:
    """In which cells samples lie, and how near they are to the virtual camera.

    Args:
        sample_columns: see ``DepthSamples``, and
        sample_rows: likewise, and
        inverse_depth: likewise.
        first: of the samples.
        numbers: turn (3, 3), shift (3,), columns and rows of the view's finest level that one of
            the depth map spans: a pixel p of that level at inverse depth d is at turn p + shift d.
        height: rows of the mesh.
        columns: of the mesh.
        scratch: receives inverse depths in the virtual image.
        cells: receives the corners' indices; behind the mesh for what lies outside.
    """
    t0, t1, t2, t3, t4 = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    t5, t6, t7, t8 = numbers[5], numbers[6], numbers[7], numbers[8]
    s0, s1, s2, scale_x, scale_y = numbers[9], numbers[10], numbers[11], numbers[12], numbers[13]
    right, bottom = np.float64(columns), np.float64(height)
    outside, row_length = np.int32(height * columns), np.int32(columns)
    for i in range(np.uintp(TOGETHER)):
        value = np.float64(inverse_depth[first + i])
        x = (np.float64(sample_columns[first + i]) + 0.5) * scale_x - 0.5
        y = (np.float64(sample_rows[first + i]) + 0.5) * scale_y - 0.5
        depth = t6 * x + t7 * y + t8 + value * s2
        reciprocal = 1.0 / depth
        u = (t0 * x + t1 * y + t2 + value * s0) * reciprocal + 0.5
        v = (t3 * x + t4 * y + t5 + value * s1) * reciprocal + 0.5
        is_inside = depth > SMALLEST_DEPTH
        is_inside &= (u >= 0.0) & (u < right) & (v >= 0.0) & (v < bottom)
        column, row = np.int32(u if is_inside else 0.0), np.int32(v if is_inside else 0.0)
        cell, turn = np.int32(row * row_length) + column, np.int32(i) & np.int32(ELSEWHERE - 1)
        cells[i] = cell if is_inside else outside + turn
        scratch[i] = value * reciprocal if is_inside else 0.0
