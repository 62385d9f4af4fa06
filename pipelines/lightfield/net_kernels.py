"""The net of recording centres, fast: the same weights as ``net``, compiled.

The net of one virtual image is written as *cells*: regions of the image with up to three views and
their weights, ``weight = a x + b y + c + d x y`` with d = 0 here. A triangle is a cell; so is an
interval of a one-dimensional net, the strip beyond an outer edge (two views), and the wedge beyond
an outer corner (one). A label image says which cell a pixel lies in.
"""

import numpy as np

from pipelines.artifacts.array_types import BoolArray, FloatArray, IntArray
from pipelines.lightfield.compiled import compiled, compiled_leaf
from pipelines.lightfield.net import (
    COINCIDENT_PIXELS,
    COINCIDENT_SHARE,
    FLATNESS_LIMIT,
    SMALLEST_RELATIVE_DEPTH,
)
from pipelines.lightfield.triangulation import GHOST, delaunay, turn


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


@compiled
def distinct_corners(corners: FloatArray, distance: FloatArray, kept: IntArray) -> int:
    """Writes the indices of corners that do not coincide, nearest first; returns their number."""
    count = 0
    # Stable: views from one place, as a turning camera takes them, are no matter of chance.
    for index in np.argsort(distance, kind="mergesort"):
        largest = max(abs(corners[index, 0]), abs(corners[index, 1]))
        limit = max(COINCIDENT_PIXELS, COINCIDENT_SHARE * largest)
        is_new = True
        for other in kept[:count]:
            gap = max(
                abs(corners[index, 0] - corners[other, 0]),
                abs(corners[index, 1] - corners[other, 1]),
            )
            if gap <= limit:
                is_new = False
                break
        if is_new:
            kept[count] = index
            count += 1
    return count


@compiled
def flat_direction(
    offsets: FloatArray, rotation: FloatArray, intrinsics: FloatArray, direction: FloatArray
) -> bool:
    """Whether centres at ``offsets`` (n, 3) are coplanar with the virtual one.

    Writes the direction (2,) of the line on which they project, whatever the answer.
    """
    scatter = np.zeros((3, 3))
    for row in range(len(offsets)):
        for i in range(3):
            for j in range(3):
                scatter[i, j] += offsets[row, i] * offsets[row, j]
    values, vectors = np.linalg.eigh(scatter)
    normal_x, normal_y = 0.0, 0.0
    for i in range(3):
        normal_x += rotation[i, 0] * vectors[i, 0]
        normal_y += rotation[i, 1] * vectors[i, 0]
    along_x, along_y = -normal_y / intrinsics[1], normal_x / intrinsics[0]
    length = np.sqrt(along_x * along_x + along_y * along_y)
    if length * max(intrinsics[0], intrinsics[1]) < 1e-12:
        direction[0], direction[1] = 1.0, 0.0
    else:
        direction[0], direction[1] = along_x / length, along_y / length
    total = values[0] + values[1] + values[2]
    return bool(values[0] <= FLATNESS_LIMIT * FLATNESS_LIMIT * total)


@compiled
def line_net(
    positions: FloatArray,
    direction: FloatArray,
    cell_corners: IntArray,
    cell_weights: FloatArray,
    label: IntArray,
) -> int:
    """Cells of a one-dimensional net.

    Args:
        positions: (n,) of the corners along ``direction``.
        direction: (2,) unit vector in the image.
        cell_corners: (c, k) receives corner indices of each cell.
        cell_weights: (c, k, 4) receives the coefficients a, b, c of each corner's weight.
        label: (H, W) receives each pixel's cell.

    Returns:
        The number of cells: one below, one between any two, one above the corners.
    """
    order = np.argsort(positions, kind="mergesort")
    count = len(order)
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


@compiled
def triangle_net(
    points: FloatArray, cell_corners: IntArray, cell_weights: FloatArray, label: IntArray
) -> int:
    """Cells of a two-dimensional net.

    Args:
        points: (n, 2) corners, pixels, distinct.
        cell_corners: (c, k) receives corner indices, c >= 4 n + 8.
        cell_weights: (c, k, 4) receives the coefficients of each corner's weight.
        label: (H, W) receives each pixel's cell.

    Returns:
        The number of cells; 0 where the points lie on a line.
    """
    triangles = np.empty((4 * len(points) + 8, 3), dtype=np.int64)
    total = delaunay(points, triangles)
    if total == 0:
        return 0
    label[:] = -1
    hull = np.empty((total, 2), dtype=np.int64)
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
    return _label_outside(points, hull[:hull_count], cells, cell_corners, cell_weights, label)


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


@compiled
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


@compiled
def _label_outside(
    points: FloatArray,
    hull: IntArray,
    cells: int,
    cell_corners: IntArray,
    cell_weights: FloatArray,
    label: IntArray,
) -> int:
    """Adds the cells beyond outer edges and corners and labels the pixels outside the net."""
    edges = len(hull)
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
                own = _nearest_border(points, hull, float(x), float(y))
                last = _end_of_region(points, hull, own, x, gap, y)
                label[y, x:last] = cells + own
                x = last
    return cells + 2 * edges


@compiled_leaf
def _end_of_region(
    points: FloatArray, hull: IntArray, own: int, first: int, gap: int, y: int
) -> int:
    """The column behind the last in [first, gap) that is nearest to the same part of the hull.

    Strips and wedges are convex: what lies between two pixels of one is of it too.
    """
    if _nearest_border(points, hull, float(gap - 1), float(y)) == own:
        return gap
    inside, outside = first, gap - 1
    while outside - inside > 1:
        middle = (inside + outside) // 2
        if _nearest_border(points, hull, float(middle), float(y)) == own:
            inside = middle
        else:
            outside = middle
    return outside


@compiled_leaf
def _nearest_border(points: FloatArray, hull: IntArray, x: float, y: float) -> int:
    """Index of the nearest hull edge's strip, or, plus their number, of a corner's wedge."""
    edges = len(hull)
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


@compiled
def build_net(
    centres: FloatArray,
    virtual_centre: FloatArray,
    rotation: FloatArray,
    intrinsics: FloatArray,
    visible: BoolArray,
    cell_views: IntArray,
    cell_weights: FloatArray,
    label: IntArray,
) -> int:
    """The net of the visible views in one virtual image.

    Args:
        centres: (N, 3) of all views.
        virtual_centre: (3,).
        rotation: (3, 3) world_from_camera of the virtual camera.
        intrinsics: (4,) fx, fy, cx, cy.
        visible: (N,) views that take part.
        cell_views: (c, k) receives view indices, c >= 4 N + 8.
        cell_weights: (c, k, 4) receives weight coefficients.
        label: (H, W) receives each pixel's cell.

    Returns:
        The number of cells; 0 where no view is visible.
    """
    indices = np.flatnonzero(visible)
    count = len(indices)
    if count == 0:
        return 0
    corners = np.empty((count, 2))
    distance = np.empty(count)
    offset = np.empty(3)
    for number in range(count):
        for i in range(3):
            offset[i] = centres[indices[number], i] - virtual_centre[i]
        project_centre(offset, rotation, intrinsics, corners[number])
        distance[number] = np.sqrt(offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2)
    kept = np.empty(count, dtype=np.int64)
    kept_count = distinct_corners(corners, distance, kept)
    points = np.empty((kept_count, 2))
    offsets = np.empty((kept_count, 3))
    for number in range(kept_count):
        for i in range(2):
            points[number, i] = corners[kept[number], i]
        for i in range(3):
            offsets[number, i] = centres[indices[kept[number]], i] - virtual_centre[i]
    direction = np.empty(2)
    flat = flat_direction(offsets, rotation, intrinsics, direction) or kept_count < 3
    cells = 0
    if not flat:
        cells = triangle_net(points, cell_views, cell_weights, label)
    if cells == 0:
        if kept_count == 2:
            dx, dy = points[1, 0] - points[0, 0], points[1, 1] - points[0, 1]
            length = np.sqrt(dx * dx + dy * dy)
            direction[0], direction[1] = dx / length, dy / length
        positions = points[:, 0] * direction[0] + points[:, 1] * direction[1]
        cells = line_net(positions, direction, cell_views, cell_weights, label)
    for cell in range(cells):
        for i in range(cell_views.shape[1]):
            if cell_views[cell, i] != GHOST:
                cell_views[cell, i] = indices[kept[cell_views[cell, i]]]
    return cells
