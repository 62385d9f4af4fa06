"""Delaunay triangulation of the corners of a net, compiled.

Bowyer's and Watson's incremental algorithm (1981) with ghost triangles: the corner ``GHOST`` stands
for the point at infinity, so that the hull needs no artificial outer triangle.

Recording centres on a regular grid, four of them on a circle everywhere and whole rows on a line,
are no exception but what a camera gantry delivers. Rounding then answers the question whether a
point lies in a circumcircle at random, and the triangles that say yes need neither hang together
nor surround the point. So the hole that is torn for a point grows from the triangle around it
across edges only, and goes on growing until the point sees the whole rim: the result is a
triangulation in any case, and the Delaunay triangulation to within rounding.
"""

from typing import NamedTuple

import numpy as np

from pipelines.artifacts.array_types import BoolArray, FloatArray, IntArray
from pipelines.lightfield.compiled import compiled_leaf, compiled_part
from pipelines.lightfield.net import SMALLEST_AREA
from pipelines.lightfield.record_type import compiled_record

GHOST = -1


@compiled_record
class Triangulation(NamedTuple):
    """The triangles between up to n points, and memory for finding them.

    Attributes:
        triangles: ``(4 n + 8, 3)`` indices of the corners; in a ghost triangle the third one is
            ``GHOST`` and the first two are a hull edge with the hull on its right.
        edges: ``(12 n + 24, 2)`` of the rim of a hole.
        conflicting: ``(4 n + 8,)`` triangles in whose circumcircle a point lies.
        removed: ``(4 n + 8,)`` which triangles make way for a point.
    """

    triangles: IntArray
    edges: IntArray
    conflicting: IntArray
    removed: BoolArray


def triangulation_for(count: int) -> Triangulation:
    """Memory for the triangulation of so many points."""
    most = 4 * count + 8
    return Triangulation(
        np.empty((most, 3), np.int64),
        np.empty((3 * most, 2), np.int64),
        np.empty(most, np.int64),
        np.empty(most, np.bool_),
    )


@compiled_part
def delaunay(points: FloatArray, count: int, room: Triangulation) -> int:
    """Delaunay triangulation of distinct points that are not all on a line.

    Args:
        points: (n, 2) pixels, of which the first
        count: are to be triangulated.
        room: receives the triangles.

    Returns:
        The number of triangles, ghosts included; 0 where all points lie on a line.
    """
    triangles = room.triangles
    third = -1
    for candidate in range(2, count):
        if turn(points[0], points[1], points[candidate]) != 0.0:
            third = candidate
            break
    if third < 0:
        return 0
    first, second = 0, 1
    if turn(points[0], points[1], points[third]) < 0.0:
        first, second = 1, 0
    start = (first, second, third)
    total = 4
    for i in range(3):
        triangles[0, i] = start[i]
        # Seen from outside, a hull edge runs the other way round.
        triangles[i + 1, 0], triangles[i + 1, 1] = start[(i + 1) % 3], start[i]
        triangles[i + 1, 2] = GHOST
    for index in range(2, count):
        if index != third:
            total = _insert(
                points, triangles, total, index, room.edges, room.conflicting, room.removed
            )
    return total


@compiled_leaf
def turn(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    """Twice the signed area of a triangle, positive when a, b, c turn from x towards y.

    Zero where the three lie on a line to within rounding.
    """
    ab_x, ab_y = b[0] - a[0], b[1] - a[1]
    ac_x, ac_y = c[0] - a[0], c[1] - a[1]
    bc_x, bc_y = c[0] - b[0], c[1] - b[1]
    area = ab_x * ac_y - ab_y * ac_x
    longest = max(ab_x * ab_x + ab_y * ab_y, ac_x * ac_x + ac_y * ac_y, bc_x * bc_x + bc_y * bc_y)
    return float(area) if abs(area) > SMALLEST_AREA * longest else 0.0


@compiled_leaf
def _conflicts(points: FloatArray, triangle: IntArray, p: FloatArray) -> bool:
    """Whether p lies in the circumcircle of a triangle (for a ghost: beyond its hull edge)."""
    if triangle[2] == GHOST:
        a, b = points[triangle[0]], points[triangle[1]]
        side = turn(a, b, p)
        if side != 0.0:
            return side > 0.0
        along = (p[0] - a[0]) * (b[0] - p[0]) + (p[1] - a[1]) * (b[1] - p[1])
        return bool(along > 0.0)
    ax, ay = points[triangle[0], 0] - p[0], points[triangle[0], 1] - p[1]
    bx, by = points[triangle[1], 0] - p[0], points[triangle[1], 1] - p[1]
    cx, cy = points[triangle[2], 0] - p[0], points[triangle[2], 1] - p[1]
    determinant = (
        (ax * ax + ay * ay) * (bx * cy - cx * by)
        - (bx * bx + by * by) * (ax * cy - cx * ay)
        + (cx * cx + cy * cy) * (ax * by - bx * ay)
    )
    return bool(determinant > 0.0)


@compiled_leaf
def _depth_inside(points: FloatArray, triangle: IntArray, p: FloatArray) -> float:
    """How far p lies inside a triangle, relative to its sides; negative outside."""
    sides = 1 if triangle[2] == GHOST else 3
    depth = np.inf
    for i in range(sides):
        a, b = points[triangle[i]], points[triangle[(i + 1) % 3]]
        dx, dy = b[0] - a[0], b[1] - a[1]
        area = dx * (p[1] - a[1]) - dy * (p[0] - a[0])
        depth = min(depth, area / (dx * dx + dy * dy))
    return float(depth)


@compiled_leaf
def _insert(
    points: FloatArray,
    triangles: IntArray,
    total: int,
    index: int,
    edges: IntArray,
    conflicting: IntArray,
    removed: BoolArray,
) -> int:
    """Replaces the triangles whose circumcircle holds a point by the fan from it to their rim."""
    point = points[index]
    conflicts = 0
    around = -1
    deepest = -np.inf
    for row in range(total):
        removed[row] = False
        if _conflicts(points, triangles[row], point):
            conflicting[conflicts] = row
            conflicts += 1
            depth = _depth_inside(points, triangles[row], point)
            if depth > deepest:
                deepest = depth
                around = row
    if around < 0:
        # By rounding alone: the point all but coincides with a corner, which stands for it.
        return total
    removed[around] = True
    edge_count = _add_to_region(triangles[around], edges, 0)
    grows = True
    while grows:
        grows = False
        for number in range(conflicts):
            row = conflicting[number]
            if not removed[row] and _touches_region(triangles[row], edges, edge_count):
                removed[row] = True
                edge_count = _add_to_region(triangles[row], edges, edge_count)
                grows = True
        if not grows:
            row = _row_behind_hidden_edge(points, triangles, total, point, edges, edge_count)
            if row >= 0 and not removed[row]:
                removed[row] = True
                edge_count = _add_to_region(triangles[row], edges, edge_count)
                grows = True
    kept = 0
    for row in range(total):
        if not removed[row]:
            for i in range(3):
                triangles[kept, i] = triangles[row, i]
            kept += 1
    for row in range(edge_count):
        start, end = edges[row, 0], edges[row, 1]
        # The ghost stands last in its triangle; turning the corners keeps the orientation.
        if start == GHOST:
            triangles[kept, 0], triangles[kept, 1], triangles[kept, 2] = end, index, GHOST
        elif end == GHOST:
            triangles[kept, 0], triangles[kept, 1], triangles[kept, 2] = index, start, GHOST
        else:
            triangles[kept, 0], triangles[kept, 1], triangles[kept, 2] = start, end, index
        kept += 1
    return kept


@compiled_leaf
def _row_behind_hidden_edge(
    points: FloatArray,
    triangles: IntArray,
    total: int,
    point: FloatArray,
    edges: IntArray,
    edge_count: int,
) -> int:
    """The triangle beyond an edge of the rim that a point in the region cannot see; -1 for none."""
    for edge in range(edge_count):
        start, end = edges[edge, 0], edges[edge, 1]
        if GHOST in (start, end) or turn(points[start], points[end], point) > 0.0:
            continue
        for row in range(total):
            for i in range(3):
                if triangles[row, i] == end and triangles[row, (i + 1) % 3] == start:
                    return row
    return -1


@compiled_leaf
def _touches_region(triangle: IntArray, edges: IntArray, edge_count: int) -> bool:
    """Whether a triangle shares an edge with a region that is known by its rim."""
    for i in range(3):
        start, end = triangle[i], triangle[(i + 1) % 3]
        for other in range(edge_count):
            if edges[other, 0] == end and edges[other, 1] == start:
                return True
    return False


@compiled_leaf
def _add_to_region(triangle: IntArray, edges: IntArray, edge_count: int) -> int:
    """Adds a triangle to a region that is known by its rim; returns the rim's number of edges."""
    for i in range(3):
        start, end = triangle[i], triangle[(i + 1) % 3]
        # An edge between two triangles of the region appears in both directions: it is no rim.
        is_rim = True
        for other in range(edge_count):
            if edges[other, 0] == end and edges[other, 1] == start:
                edge_count -= 1
                edges[other, 0], edges[other, 1] = edges[edge_count, 0], edges[edge_count, 1]
                is_rim = False
                break
        if is_rim:
            edges[edge_count, 0], edges[edge_count, 1] = start, end
            edge_count += 1
    return edge_count
