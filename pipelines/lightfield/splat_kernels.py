"""Depth maps projected into a virtual image, compiled: the corners of its surface's mesh."""

import numpy as np

from pipelines.artifacts.array_types import FloatArray, Int32Array
from pipelines.lightfield.compiled import compiled, compiled_loop
from pipelines.lightfield.proxy import SAMPLES_PER_CELL
from pipelines.lightfield.views import ViewArrays

# Samples that are worked on together.
TOGETHER = 256
# Points nearer to the camera's plane than this share of their recorded depth are left out.
SMALLEST_DEPTH = 1e-9


@compiled
def splat(
    views: ViewArrays,
    view: int,
    matrix: FloatArray,
    focal: float,
    spacing: float,
    scratch: FloatArray,
    cells: Int32Array,
    mesh: FloatArray,
) -> None:
    """Projects one depth map into the virtual image; of points in one cell the nearest stays.

    Args:
        views: the light field.
        view: whose depth map.
        matrix: (3, 4) world points to homogeneous virtual pixels.
        focal: of the virtual camera, pixels.
        spacing: of the mesh's corners, virtual pixels.
        scratch: (TOGETHER,) overwritten.
        cells: (TOGETHER,) int32, overwritten.
        mesh: (h, w + 1) inverse depths at the corners, changed; the last column takes what lies
            outside.
    """
    width, height = views.depth_size[view, 0], views.depth_size[view, 1]
    scale = width / views.level_size[view, 0, 0]
    stride = max(1, int(spacing * views.focal[view] * scale / focal / SAMPLES_PER_CELL))
    scale_x = views.level_size[view, 0, 0] / width
    scale_y = views.level_size[view, 0, 1] / height
    numbers = np.zeros(12)
    for i in range(3):
        numbers[9 + i] = matrix[i, 3]
        for k in range(3):
            numbers[9 + i] += matrix[i, k] * views.centres[view, k]
            for j in range(3):
                numbers[3 * i + j] += matrix[i, k] * views.rays[view, k, j]
    corners = mesh.reshape(-1)
    start = views.depth_start[view]
    samples = (width + stride - 1) // stride
    for row in range(0, height, stride):
        y = (row + 0.5) * scale_y - 0.5
        for first in range(0, samples, TOGETHER):
            count = min(TOGETHER, samples - first)
            place = start + row * width + first * stride
            for i in range(np.uintp(count)):
                scratch[i] = views.inverse_depth[np.uintp(place) + i * np.uintp(stride)]
            x = (first * stride + 0.5) * scale_x - 0.5
            step = stride * scale_x
            _place(scratch, cells, count, numbers, x, step, y, spacing, len(mesh), mesh.shape[1])
            for i in range(np.uintp(count)):
                cell = np.uintp(cells[i])
                corners[cell] = max(corners[cell], scratch[i])


@compiled_loop
def _place(
    scratch: FloatArray,
    cells: Int32Array,
    count: int,
    numbers: FloatArray,
    first_x: float,
    step_x: float,
    y: float,
    spacing: float,
    height: int,
    columns: int,
) -> None:
    """In which cells a row's samples lie, and how near they are to the virtual camera.

    Args:
        scratch: inverse depths in the view; receives those in the virtual image.
        cells: receives the corners' indices; the end of a row for what lies outside.
        count: samples.
        numbers: (12,) turn (3, 3) and shift (3,): a pixel p of the view at inverse depth d is at
            turn p + shift d.
        first_x: column of the first sample in the view's finest level.
        step_x: columns from one to the next.
        y: their row.
        spacing: of the mesh's corners, virtual pixels.
        height: rows of the mesh.
        columns: of the mesh, with the one for what lies outside.
    """
    # Columns and rows of the mesh.
    t0, t1, t2 = numbers[0] / spacing, numbers[1] / spacing, numbers[2] / spacing
    t3, t4, t5 = numbers[3] / spacing, numbers[4] / spacing, numbers[5] / spacing
    t6, t7, t8 = numbers[6], numbers[7], numbers[8]
    s0, s1, s2 = numbers[9] / spacing, numbers[10] / spacing, numbers[11]
    right, bottom = np.float64(columns - 1), np.float64(height)
    outside, row_length = np.int32(columns - 1), np.int32(columns)
    for i in range(count):
        value = scratch[i]
        x = first_x + step_x * i
        depth = t6 * x + t7 * y + t8 + value * s2
        reciprocal = 1.0 / depth
        u = (t0 * x + t1 * y + t2 + value * s0) * reciprocal + 0.5
        v = (t3 * x + t4 * y + t5 + value * s1) * reciprocal + 0.5
        is_inside = (value > 0.0) & (depth > SMALLEST_DEPTH)
        is_inside &= (u >= 0.0) & (u < right) & (v >= 0.0) & (v < bottom)
        column, row = np.int32(u if is_inside else 0.0), np.int32(v if is_inside else 0.0)
        cells[i] = row * row_length + column if is_inside else outside
        scratch[i] = value * reciprocal if is_inside else 0.0
