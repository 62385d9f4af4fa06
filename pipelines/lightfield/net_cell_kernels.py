"""The cells of a net, compiled, and the memory that making one takes.

The net of one virtual image is written as *cells*: regions of the image with up to three views and
their weights, ``weight = a x + b y + c + d x y`` with d = 0 here. A triangle is a cell; so is an
interval of a one-dimensional net, the strip beyond an outer edge (two views), and the wedge beyond
an outer corner (one). A label image says which cell a pixel lies in.
"""

from typing import NamedTuple

import numpy as np

from pipelines.artifacts.array_types import FloatArray, IntArray
from pipelines.lightfield.compiled import compiled_leaf
from pipelines.lightfield.record_type import compiled_record
from pipelines.lightfield.triangulation import (
    GHOST,
    Triangulation,
    delaunay,
    triangulation_for,
    turn,
)


@compiled_record
class NetRoom(NamedTuple):
    """Memory for nets of up to N views.

    Attributes:
        indices: ``(N,)`` the views that take part.
        corners: ``(N, 2)`` where their centres project to, pixels.
        offsets: ``(N, 3)`` of the centres from the virtual one, and
        distances: ``(N,)`` how far away they are.
        order: ``(N,)`` of whatever is sorted.
        kept: ``(N,)`` corners that do not coincide.
        points: ``(N, 2)`` these.
        positions: ``(N,)`` of them along a line.
        direction: ``(2,)`` of that line.
        scatter: ``(3, 3)`` of the centres around the virtual one.
        spread: ``(3, 3)`` the same along its own axes, and
        axes: ``(3, 3)`` these, column by column.
        hull: ``(4 N + 8, 2)`` edges around the net.
        triangulation: of the corners.
    """

    indices: IntArray
    corners: FloatArray
    offsets: FloatArray
    distances: FloatArray
    order: IntArray
    kept: IntArray
    points: FloatArray
    positions: FloatArray
    direction: FloatArray
    scatter: FloatArray
    spread: FloatArray
    axes: FloatArray
    hull: IntArray
    triangulation: Triangulation


def net_room_for(count: int) -> NetRoom:
    """Memory for nets of up to so many views."""
    return NetRoom(
        np.empty(count, np.int64),
        np.empty((count, 2)),
        np.empty((count, 3)),
        np.empty(count),
        np.empty(count, np.int64),
        np.empty(count, np.int64),
        np.empty((count, 2)),
        np.empty(count),
        np.empty(2),
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty((4 * count + 8, 2), np.int64),
        triangulation_for(count),
    )


@compiled_leaf
def line_net(
    count: int,
    room: NetRoom,
    cell_corners: IntArray,
    cell_weights: FloatArray,
    label: IntArray,
) -> int:
    """Cells of a one-dimensional net.

    Args:
        count: of the corners.
        room: with their positions along a direction, and their order.
        cell_corners: (c, k) receives corner indices of each cell.
        cell_weights: (c, k, 4) receives the coefficients a, b, c of each corner's weight.
        label: (H, W) receives each pixel's cell.

    Returns:
        The number of cells: one below, one between any two, one above the corners.
    """
    positions, direction, order = room.positions, room.direction, room.order
    cell_weights[: count + 1] = 0.0
    cell_corners[: count + 1] = GHOST
    for cell in range(count + 1):
        first, second = order[max(cell - 1, 0)], order[min(cell, count - 1)]
        cell_corners[cell, 0], cell_corners[cell, 1] = first, second
        width = positions[second] - positions[first]
        if cell in (0, count) or width <= 0.0:
            cell_weights[cell, 0, 2] = 1.0
            continue
        for axis in range(2):
            cell_weights[cell, 1, axis] = direction[axis] / width
            cell_weights[cell, 0, axis] = -direction[axis] / width
        cell_weights[cell, 1, 2] = -positions[first] / width
        cell_weights[cell, 0, 2] = 1.0 + positions[first] / width
    height, image_width = label.shape
    for y in range(height):
        cell = 0
        for x in range(image_width):
            position = x * direction[0] + y * direction[1]
            while cell < count and positions[order[cell]] <= position:
                cell += 1
            while cell > 0 and positions[order[cell - 1]] > position:
                cell -= 1
            label[y, x] = cell
    return count + 1


@compiled_leaf
def triangle_net(
    count: int,
    room: NetRoom,
    cell_corners: IntArray,
    cell_weights: FloatArray,
    label: IntArray,
) -> int:
    """Cells of a two-dimensional net.

    Args:
        count: of the corners.
        room: with them as its points, distinct.
        cell_corners: (c, k) receives corner indices, c >= 4 n + 8.
        cell_weights: (c, k, 4) receives the coefficients of each corner's weight.
        label: (H, W) receives each pixel's cell.

    Returns:
        The number of cells; 0 where the points lie on a line.
    """
    points, triangles, hull = room.points, room.triangulation.triangles, room.hull
    total = delaunay(points, count, room.triangulation)
    if total == 0:
        return 0
    label[:] = -1
    hull_count = 0
    cells, filled = 0, 0
    for row in range(total):
        a, b, c = triangles[row, 0], triangles[row, 1], triangles[row, 2]
        if c == GHOST:
            hull[hull_count, 0], hull[hull_count, 1] = a, b
            hull_count += 1
            continue
        cell_corners[cells] = GHOST
        cell_weights[cells] = 0.0
        cell_corners[cells, 0], cell_corners[cells, 1], cell_corners[cells, 2] = a, b, c
        _barycentric(points[a], points[b], points[c], cell_weights[cells])
        filled += _fill(points[a], points[b], points[c], cells, label)
        cells += 1
    if filled == label.size:
        return cells
    return _label_outside(points, hull, hull_count, cells, cell_corners, cell_weights, label)


@compiled_leaf
def _barycentric(a: FloatArray, b: FloatArray, c: FloatArray, weights: FloatArray) -> None:
    """Writes the linear functions (3, 3) that are 1 at the own corner and 0 at the others."""
    area = turn(a, b, c)
    corners = (a, b, c)
    for i in range(3):
        p, q = corners[(i + 1) % 3], corners[(i + 2) % 3]
        weights[i, 0] = (p[1] - q[1]) / area
        weights[i, 1] = (q[0] - p[0]) / area
        weights[i, 2] = (p[0] * q[1] - p[1] * q[0]) / area


@compiled_leaf
def _crossing(p: FloatArray, q: FloatArray, y: int) -> float:
    """Where the edge p q crosses row y; the same for p q and q p, so that no cracks open."""
    if p[1] > q[1] or (p[1] == q[1] and p[0] > q[0]):
        p, q = q, p
    return float(p[0] + (y - p[1]) * ((q[0] - p[0]) / (q[1] - p[1])))


@compiled_leaf
def _fill(a: FloatArray, b: FloatArray, c: FloatArray, cell: int, label: IntArray) -> int:
    """Writes ``cell`` at the pixels inside a triangle, half-open towards larger x and y.

    Returns:
        The number of these pixels; no two triangles share any.
    """
    height, width = label.shape
    filled = 0
    corners = (a, b, c)
    top = max(0.0, np.ceil(min(a[1], b[1], c[1])))
    bottom = min(float(height - 1), np.floor(max(a[1], b[1], c[1])))
    for y in range(int(top), int(bottom) + 1):
        low, high = np.inf, -np.inf
        for i in range(3):
            p, q = corners[i], corners[(i + 1) % 3]
            if (p[1] <= y) != (q[1] <= y):
                x = _crossing(p, q, y)
                low, high = min(low, x), max(high, x)
        if low < high and high >= 0.0 and low <= width:
            first, last = int(np.ceil(max(low, 0.0))), int(np.ceil(min(high, float(width))))
            label[y, first:last] = cell
            filled += max(last - first, 0)
    return filled


@compiled_leaf
def _label_outside(
    points: FloatArray,
    hull: IntArray,
    edges: int,
    cells: int,
    cell_corners: IntArray,
    cell_weights: FloatArray,
    label: IntArray,
) -> int:
    """Adds the cells beyond outer edges and corners and labels the pixels outside the net."""
    for edge in range(edges):
        first, second = hull[edge, 0], hull[edge, 1]
        a, b = points[first], points[second]
        dx, dy = b[0] - a[0], b[1] - a[1]
        squared = dx * dx + dy * dy
        strip, wedge = cells + edge, cells + edges + edge
        for cell in (strip, wedge):
            cell_corners[cell] = GHOST
            cell_weights[cell] = 0.0
            cell_corners[cell, 0], cell_corners[cell, 1] = first, second
        cell_weights[strip, 1, 0], cell_weights[strip, 1, 1] = dx / squared, dy / squared
        cell_weights[strip, 1, 2] = -(a[0] * dx + a[1] * dy) / squared
        cell_weights[strip, 0, 0], cell_weights[strip, 0, 1] = -dx / squared, -dy / squared
        cell_weights[strip, 0, 2] = 1.0 - cell_weights[strip, 1, 2]
        cell_weights[wedge, 0, 2] = 1.0
    width = label.shape[1]
    for y in range(label.shape[0]):
        x = 0
        while x < width:
            if label[y, x] >= 0:
                x += 1
                continue
            gap = x + 1
            while gap < width and label[y, gap] < 0:
                gap += 1
            while x < gap:
                own = _nearest_border(points, hull, edges, float(x), float(y))
                last = _end_of_region(points, hull, edges, own, x, gap, y)
                label[y, x:last] = cells + own
                x = last
    return cells + 2 * edges


@compiled_leaf
def _end_of_region(
    points: FloatArray, hull: IntArray, edges: int, own: int, first: int, gap: int, y: int
) -> int:
    """The column behind the last in [first, gap) that is nearest to the same part of the hull.

    Strips and wedges are convex: what lies between two pixels of one is of it too.
    """
    if _nearest_border(points, hull, edges, float(gap - 1), float(y)) == own:
        return gap
    inside, outside = first, gap - 1
    while outside - inside > 1:
        middle = (inside + outside) // 2
        if _nearest_border(points, hull, edges, float(middle), float(y)) == own:
            inside = middle
        else:
            outside = middle
    return outside


@compiled_leaf
def _nearest_border(points: FloatArray, hull: IntArray, edges: int, x: float, y: float) -> int:
    """Index of the nearest hull edge's strip, or, plus their number, of a corner's wedge."""
    best, shortest = 0, np.inf
    for edge in range(edges):
        a, b = points[hull[edge, 0]], points[hull[edge, 1]]
        dx, dy = b[0] - a[0], b[1] - a[1]
        along = ((x - a[0]) * dx + (y - a[1]) * dy) / (dx * dx + dy * dy)
        # A corner belongs to the edge that starts there; the one that ends there leaves it alone.
        if along > 1.0:
            continue
        clamped = max(along, 0.0)
        gap_x, gap_y = x - (a[0] + clamped * dx), y - (a[1] + clamped * dy)
        squared = gap_x * gap_x + gap_y * gap_y
        if squared < shortest:
            shortest = squared
            best = edge if along > 0.0 else edges + edge
    return best
