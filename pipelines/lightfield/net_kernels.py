"""The net of recording centres, fast: the same weights as ``net``, compiled.

What its cells are says ``net_cell_kernels``.
"""

import numpy as np

from pipelines.artifacts.array_types import BoolArray, FloatArray, IntArray
from pipelines.lightfield.compiled import compiled_leaf, compiled_part
from pipelines.lightfield.net import (
    COINCIDENT_PIXELS,
    COINCIDENT_SHARE,
    FLATNESS_LIMIT,
    SMALLEST_RELATIVE_DEPTH,
)
from pipelines.lightfield.net_cell_kernels import NetRoom, line_net, triangle_net
from pipelines.lightfield.sorting_kernels import sort_indices
from pipelines.lightfield.triangulation import GHOST

# Rounds of Jacobi's method. Each squares what is left beside the diagonal: five leave nothing.
SWEEPS = 6


@compiled_leaf
def project_centre(
    offset: FloatArray, rotation: FloatArray, intrinsics: FloatArray, corner: FloatArray
) -> None:
    """Writes the projection (pixels) of a centre at ``offset`` (3,) from the virtual one."""
    x = rotation[0, 0] * offset[0] + rotation[1, 0] * offset[1] + rotation[2, 0] * offset[2]
    y = rotation[0, 1] * offset[0] + rotation[1, 1] * offset[1] + rotation[2, 1] * offset[2]
    z = rotation[0, 2] * offset[0] + rotation[1, 2] * offset[1] + rotation[2, 2] * offset[2]
    smallest = max(SMALLEST_RELATIVE_DEPTH * np.sqrt(x * x + y * y + z * z), 1e-300)
    if abs(z) < smallest:
        z = smallest
    corner[0] = intrinsics[0] * x / z + intrinsics[2]
    corner[1] = intrinsics[1] * y / z + intrinsics[3]


@compiled_leaf
def _distinct_corners(count: int, room: NetRoom) -> int:
    """Keeps those of ``count`` corners that do not coincide, nearest first; their number."""
    kept = 0
    for number in range(count):
        index = room.order[number]
        x, y = room.corners[index, 0], room.corners[index, 1]
        limit = max(COINCIDENT_PIXELS, COINCIDENT_SHARE * max(abs(x), abs(y)))
        is_new = True
        for earlier in range(kept):
            other = room.kept[earlier]
            gap = max(abs(x - room.corners[other, 0]), abs(y - room.corners[other, 1]))
            if gap <= limit:
                is_new = False
                break
        if is_new:
            room.kept[kept] = index
            kept += 1
    return kept


@compiled_leaf
def _set_scatter(count: int, room: NetRoom) -> bool:
    """Writes the scatter matrix of the kept centres around the virtual one.

    Returns:
        Whether it is plain without its eigenvalues that they are not coplanar with that: the
        smallest is at least 4 times the determinant over the square of the trace.
    """
    s = room.scatter
    for i in range(3):
        for j in range(3):
            s[i, j] = 0.0
            for number in range(count):
                row = room.kept[number]
                s[i, j] += room.offsets[row, i] * room.offsets[row, j]
    determinant = (
        s[0, 0] * (s[1, 1] * s[2, 2] - s[1, 2] * s[2, 1])
        - s[0, 1] * (s[1, 0] * s[2, 2] - s[1, 2] * s[2, 0])
        + s[0, 2] * (s[1, 0] * s[2, 1] - s[1, 1] * s[2, 0])
    )
    trace = s[0, 0] + s[1, 1] + s[2, 2]
    return bool(4.0 * determinant > FLATNESS_LIMIT * FLATNESS_LIMIT * trace**3)


@compiled_leaf
def _set_axes(room: NetRoom) -> int:
    """Writes the axes of the scatter matrix and the spread along them; the one with the least.

    Jacobi's method: each turn about an axis takes away one of the numbers beside the diagonal.
    """
    spread, axes = room.spread, room.axes
    for i in range(3):
        for j in range(3):
            spread[i, j], axes[i, j] = room.scatter[i, j], 1.0 if i == j else 0.0
    for turn in range(3 * SWEEPS):
        p, q = turn % 3, (turn + 1) % 3
        if spread[p, q] == 0.0:
            continue
        ratio = 0.5 * (spread[q, q] - spread[p, p]) / spread[p, q]
        tangent = 1.0 / (abs(ratio) + np.sqrt(ratio * ratio + 1.0))
        tangent = tangent if ratio >= 0.0 else -tangent
        cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
        sine = tangent * cosine
        for i in range(3):
            a, b = spread[p, i], spread[q, i]
            spread[p, i], spread[q, i] = cosine * a - sine * b, sine * a + cosine * b
        for i in range(3):
            a, b = spread[i, p], spread[i, q]
            spread[i, p], spread[i, q] = cosine * a - sine * b, sine * a + cosine * b
            a, b = axes[i, p], axes[i, q]
            axes[i, p], axes[i, q] = cosine * a - sine * b, sine * a + cosine * b
        spread[p, q], spread[q, p] = 0.0, 0.0
    least = 0
    for i in range(1, 3):
        if spread[i, i] < spread[least, least]:
            least = i
    return least


@compiled_leaf
def _flat_direction(rotation: FloatArray, intrinsics: FloatArray, room: NetRoom) -> bool:
    """Whether centres are coplanar with the virtual one, by their scatter matrix around it.

    Writes the direction (2,) of the line on which they project, whatever the answer.
    """
    least, direction = _set_axes(room), room.direction
    normal_x, normal_y = 0.0, 0.0
    for i in range(3):
        normal_x += rotation[i, 0] * room.axes[i, least]
        normal_y += rotation[i, 1] * room.axes[i, least]
    along_x, along_y = -normal_y / intrinsics[1], normal_x / intrinsics[0]
    length = np.sqrt(along_x * along_x + along_y * along_y)
    if length * max(intrinsics[0], intrinsics[1]) < 1e-12:
        direction[0], direction[1] = 1.0, 0.0
    else:
        direction[0], direction[1] = along_x / length, along_y / length
    total = room.spread[0, 0] + room.spread[1, 1] + room.spread[2, 2]
    return bool(room.spread[least, least] <= FLATNESS_LIMIT * FLATNESS_LIMIT * total)


@compiled_part
def build_net(
    centres: FloatArray,
    pose: FloatArray,
    intrinsics: FloatArray,
    visible: BoolArray,
    room: NetRoom,
    cell_views: IntArray,
    cell_weights: FloatArray,
    label: IntArray,
) -> int:
    """The net of the visible views in one virtual image.

    Args:
        centres: (N, 3) of all views.
        pose: (4, 4) world_from_camera of the virtual camera.
        intrinsics: (4,) fx, fy, cx, cy.
        visible: (N,) views that take part.
        room: for N views; changed.
        cell_views: (c, k) receives view indices, c >= 4 N + 8.
        cell_weights: (c, k, 4) receives weight coefficients.
        label: (H, W) receives each pixel's cell.

    Returns:
        The number of cells; 0 where no view is visible.
    """
    count = 0
    for view in range(len(centres)):
        if not visible[view]:
            continue
        room.indices[count] = view
        squared = 0.0
        for i in range(3):
            room.offsets[count, i] = centres[view, i] - pose[i, 3]
            squared += room.offsets[count, i] ** 2
        project_centre(room.offsets[count], pose, intrinsics, room.corners[count])
        room.distances[count] = np.sqrt(squared)
        count += 1
    if count == 0:
        return 0
    sort_indices(room.distances, count, room.order)
    kept = _distinct_corners(count, room)
    for number in range(kept):
        for i in range(2):
            room.points[number, i] = room.corners[room.kept[number], i]
    is_flat = not _set_scatter(kept, room)
    if is_flat:
        is_flat = _flat_direction(pose, intrinsics, room) or kept < 3
    cells = 0
    if not is_flat:
        cells = triangle_net(kept, room, cell_views, cell_weights, label)
        if cells == 0:
            _flat_direction(pose, intrinsics, room)
    if cells == 0:
        _set_positions(kept, room)
        sort_indices(room.positions, kept, room.order)
        cells = line_net(kept, room, cell_views, cell_weights, label)
    for cell in range(cells):
        for i in range(cell_views.shape[1]):
            if cell_views[cell, i] != GHOST:
                cell_views[cell, i] = room.indices[room.kept[cell_views[cell, i]]]
    return cells


@compiled_leaf
def _set_positions(count: int, room: NetRoom) -> None:
    """Writes where the corners lie along their line; two are their own."""
    points, direction = room.points, room.direction
    if count == 2:
        dx, dy = points[1, 0] - points[0, 0], points[1, 1] - points[0, 1]
        length = np.sqrt(dx * dx + dy * dy)
        direction[0], direction[1] = dx / length, dy / length
    for number in range(count):
        room.positions[number] = points[number, 0] * direction[0] + points[number, 1] * direction[1]
