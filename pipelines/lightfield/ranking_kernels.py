"""The views that show surface points best, fast: the ranking of ``blending``, compiled.

Sixteen points are looked at together. For each view in turn the penalties at all of them are
computed, and each point keeps its best few. Whole groups of views (``view_index``) are passed over
when even the best that they could hold is worse than what every point has: the angle between a ray
to a point and any ray from inside a sphere differs from that to the sphere's centre by no more than
the sphere's own angle allows.
"""

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray, Int32Array, IntArray
from pipelines.lightfield.blending import (
    BORDER_PENALTY,
    RESOLUTION_PENALTY,
    SMALLEST_MARGIN,
    SMALLEST_PENALTY,
    VIEWS_PER_CORNER,
)
from pipelines.lightfield.compiled import compiled_leaf, compiled_loop
from pipelines.lightfield.occlusion_kernels import find_hidden
from pipelines.lightfield.sorting_kernels import sort_indices
from pipelines.lightfield.texel_intrinsic import LANES
from pipelines.lightfield.views import ViewArrays

# Points that are ranked together.
POINTS = LANES
# Rows of the scratch: the point, the direction from the virtual centre to it, and one over its
# distance from there; the smallest penalties so far, the last of which is only to compare with; the
# penalty of the view at hand; its column and row there, the point's inverse depth in it, and
# whether it is hidden from it.
PX, PY, PZ, VX, VY, VZ, NEARNESS = range(0, 7 * POINTS, POINTS)
BEST, OWN, COLUMN, ROW, INVERSE, SEEN = (POINTS * row for row in (7, 11, 12, 13, 14, 15))
RANKING_SCRATCH = 16 * POINTS
# Before anything is ranked, inverse depths stand where penalties will.
DEPTH = np.uintp(OWN)
RANKS = VIEWS_PER_CORNER + 1
HALF, ONE, TWO, ZERO = np.float32(0.5), np.float32(1.0), np.float32(2.0), np.float32(0.0)
NEVER = np.float32(np.inf)
BORDER, MARGIN = np.float32(BORDER_PENALTY), np.float32(SMALLEST_MARGIN)
RESOLUTION, SMALLEST = np.float32(RESOLUTION_PENALTY), np.float32(SMALLEST_PENALTY)
# Bounds in single precision are smaller than they should be by less than this.
ROUNDING = np.float32(1e-5)
# Metres; what lies beyond is taken to be as far away as this. Single precision ends somewhere.
FARTHEST = 1e7


@compiled_leaf
def gather_depths(
    surface: Float32Array, pixels: Int32Array, first: np.uintp, scratch: Float32Array
) -> None:
    """Writes the inverse depths of the surface at the pixels of ``POINTS`` points.

    Args:
        surface: (H W,) virtual inverse depths.
        pixels: (C,) of all points.
        first: where those that are ranked together begin.
        scratch: (RANKING_SCRATCH,) changed.
    """
    for i in range(np.uintp(POINTS)):
        scratch[DEPTH + i] = surface[pixels[first + i]]


@compiled_loop
def set_points(
    pose: FloatArray,
    rays: FloatArray,
    origin: FloatArray,
    columns: Float32Array,
    rows: Float32Array,
    first: np.uintp,
    scratch: Float32Array,
) -> None:
    """Writes the surface points that are ranked.

    Args:
        pose: (4, 4) world_from_camera.
        rays: (3, 3) virtual pixels to world directions.
        origin: (3,) see ``ViewIndex``.
        columns: (C,) of the points' pixels, and
        rows: likewise.
        first: where those that are ranked together begin.
        scratch: (RANKING_SCRATCH,) with their inverse depths; 0: there is no surface, and no view
            shows the point. Changed.
    """
    r0, r1, r2 = rays[0, 0], rays[0, 1], rays[0, 2]
    r3, r4, r5 = rays[1, 0], rays[1, 1], rays[1, 2]
    r6, r7, r8 = rays[2, 0], rays[2, 1], rays[2, 2]
    cx, cy, cz = pose[0, 3] - origin[0], pose[1, 3] - origin[1], pose[2, 3] - origin[2]
    for i in range(np.uintp(POINTS)):
        x, y = np.float64(columns[first + i]), np.float64(rows[first + i])
        inverse_depth = np.float64(scratch[DEPTH + i])
        distance = 1.0 / max(inverse_depth, 1.0 / FARTHEST)
        # A point that is nowhere is seen from nowhere: its depth in any view is not a number.
        distance = distance if inverse_depth > 0.0 else np.nan
        rx, ry, rz = r0 * x + r1 * y + r2, r3 * x + r4 * y + r5, r6 * x + r7 * y + r8
        shrink = 1.0 / np.sqrt(rx * rx + ry * ry + rz * rz)
        scratch[PX + i] = cx + distance * rx
        scratch[PY + i] = cy + distance * ry
        scratch[PZ + i] = cz + distance * rz
        scratch[VX + i] = rx * shrink
        scratch[VY + i] = ry * shrink
        scratch[VZ + i] = rz * shrink
        scratch[NEARNESS + i] = shrink / distance


@compiled_loop
def _start(scratch: Float32Array, best: Int32Array) -> None:
    """Forgets all views."""
    for i in range(RANKS * POINTS):
        scratch[BEST + i] = NEVER
        best[i] = -1


@compiled_loop
def _deviation(
    scratch: Float32Array, i: int, x: np.float32, y: np.float32, z: np.float32
) -> tuple[np.float32, np.float32]:
    """How far a point's ray from a place is from that of the virtual camera, and the distance.

    The former as the square of the chord between unit vectors: no cosine near 1 whose digits would
    be lost.
    """
    rx, ry, rz = scratch[PX + i] - x, scratch[PY + i] - y, scratch[PZ + i] - z
    distance = np.sqrt(rx * rx + ry * ry + rz * rz)
    shrink = ONE / distance
    ex = rx * shrink - scratch[VX + i]
    ey = ry * shrink - scratch[VY + i]
    ez = rz * shrink - scratch[VZ + i]
    return ex * ex + ey * ey + ez * ez, distance


@compiled_loop
def _count_open(scratch: Float32Array, spheres: Float32Array, group: int) -> np.float32:
    """For how many points a group may hold a view that is better than the last of their best.

    For vectors p, q: |p/|p| - q/|q|| <= 2 |p - q| / (|p| + |q|) (Dunkl and Williams 1964).
    """
    x, y, z, radius = spheres[group, 0], spheres[group, 1], spheres[group, 2], spheres[group, 3]
    count = ZERO
    for i in range(POINTS):
        squared, distance = _deviation(scratch, i, x, y, z)
        chord = np.sqrt(squared)
        slack = TWO * radius / max(TWO * distance - radius, ROUNDING * radius)
        bound = chord - slack - ROUNDING
        count += ONE if bound < scratch[BEST + (RANKS - 1) * POINTS + i] else ZERO
    return count


@compiled_loop
def _set_penalties(scratch: Float32Array, numbers: Float32Array, row: int) -> np.float32:
    """Writes a view's penalty at each point; infinite where it does not show the point.

    Returns:
        At how many points it may be among the best.
    """
    a0, a1, a2, a3 = numbers[row, 0], numbers[row, 1], numbers[row, 2], numbers[row, 3]
    b0, b1, b2, b3 = numbers[row, 4], numbers[row, 5], numbers[row, 6], numbers[row, 7]
    c0, c1, c2, c3 = numbers[row, 8], numbers[row, 9], numbers[row, 10], numbers[row, 11]
    cx, cy, cz = numbers[row, 12], numbers[row, 13], numbers[row, 14]
    right, bottom, strip = numbers[row, 15] - HALF, numbers[row, 16] - HALF, numbers[row, 17]
    count = ZERO
    for i in range(POINTS):
        px, py, pz = scratch[PX + i], scratch[PY + i], scratch[PZ + i]
        depth = c0 * px + c1 * py + c2 * pz + c3
        reciprocal = ONE / depth
        u = (a0 * px + a1 * py + a2 * pz + a3) * reciprocal
        v = (b0 * px + b1 * py + b2 * pz + b3) * reciprocal
        squared, recorded = _deviation(scratch, i, cx, cy, cz)
        own = np.sqrt(squared)
        own += RESOLUTION * max(recorded * scratch[NEARNESS + i] - ONE, ZERO)
        margin = min(u + HALF, right - u, v + HALF, bottom - v)
        own += BORDER * max(strip / max(margin, MARGIN * strip) - ONE, ZERO)
        is_shown = (depth > ZERO) & (margin >= ZERO)
        is_better = is_shown & (own <= scratch[BEST + (RANKS - 1) * POINTS + i])
        count += ONE if is_better else ZERO
        scratch[OWN + i] = own if is_shown else NEVER
        # Where it is none of the best, nobody needs to know whether it is hidden.
        scratch[COLUMN + i] = u if is_better else ZERO
        scratch[ROW + i] = v if is_better else ZERO
        scratch[INVERSE + i] = reciprocal if is_better else NEVER
    return count


@compiled_leaf
def _find_hidden(views: ViewArrays, view: int, scratch: Float32Array) -> bool:
    """Marks points before which the view sees something nearer; returns whether any is."""
    return find_hidden(
        views.blocks,
        views.block_start[view],
        views.inverse_depth,
        views.depth_start[view],
        views.depth_size[view, 0],
        views.depth_size[view, 1],
        views.level_size[view, 0, 0],
        views.level_size[view, 0, 1],
        # Maps of all views are looked up in turn.
        0,
        scratch,
        np.uintp(COLUMN),
        np.uintp(ROW),
        np.uintp(INVERSE),
        np.uintp(SEEN),
        POINTS,
    )


@compiled_loop
def _leave_out_hidden(scratch: Float32Array) -> None:
    """Makes the penalty infinite where the view sees something nearer than the point."""
    for i in range(POINTS):
        own = scratch[OWN + i]
        scratch[OWN + i] = NEVER if scratch[SEEN + i] > ZERO else own


@compiled_loop
def _insert(scratch: Float32Array, best: Int32Array, view: np.int32) -> None:
    """Puts the view in its place among the best of each point; of equal ones the first stays."""
    for i in range(POINTS):
        own = scratch[OWN + i]
        p0, p1 = scratch[BEST + i], scratch[BEST + POINTS + i]
        p2, p3 = scratch[BEST + 2 * POINTS + i], scratch[BEST + 3 * POINTS + i]
        v0, v1, v2, v3 = best[i], best[POINTS + i], best[2 * POINTS + i], best[3 * POINTS + i]
        before0 = (own < p0) | ((own == p0) & (view < v0))
        before1 = (own < p1) | ((own == p1) & (view < v1))
        before2 = (own < p2) | ((own == p2) & (view < v2))
        before3 = (own < p3) | ((own == p3) & (view < v3))
        scratch[BEST + 3 * POINTS + i] = p2 if before2 else (own if before3 else p3)
        best[3 * POINTS + i] = v2 if before2 else (view if before3 else v3)
        scratch[BEST + 2 * POINTS + i] = p1 if before1 else (own if before2 else p2)
        best[2 * POINTS + i] = v1 if before1 else (view if before2 else v2)
        scratch[BEST + POINTS + i] = p0 if before0 else (own if before1 else p1)
        best[POINTS + i] = v0 if before0 else (view if before1 else v1)
        scratch[BEST + i] = own if before0 else p0
        best[i] = view if before0 else v0


@compiled_leaf
def rank_views(
    views: ViewArrays,
    numbers: Float32Array,
    order: Int32Array,
    starts: IntArray,
    spheres: Float32Array,
    groups: IntArray,
    group_count: int,
    has_depth: bool,
    scratch: Float32Array,
    best: Int32Array,
) -> None:
    """Finds the views with the smallest penalties at ``POINTS`` surface points.

    Args:
        views: the light field.
        numbers: (S, VIEW_NUMBERS) of the views that may take part, see ``ViewIndex``, and
        order: (S,) int32 which these are, and
        starts: (G + 1,) where groups of them begin, and
        spheres: (G, 4) around the groups.
        groups: (G,) in which order groups are looked at; the most promising first spare a look at
            most others.
        group_count: their number; where there is one, its sphere does not matter.
        has_depth: whether depth maps may hide the points.
        scratch: (RANKING_SCRATCH,) with the points set; from ``BEST`` on it receives the penalties
            of the best, rank by rank; infinite: no view.
        best: (RANKS * POINTS,) int32 receives the views; -1: none.
    """
    _start(scratch, best)
    for number in range(group_count):
        group = groups[number]
        if group_count > 1 and _count_open(scratch, spheres, group) == ZERO:
            continue
        for row in range(starts[group], starts[group + 1]):
            if _set_penalties(scratch, numbers, row) == ZERO:
                continue
            view = order[row]
            if has_depth and _find_hidden(views, view, scratch):
                _leave_out_hidden(scratch)
            _insert(scratch, best, view)


@compiled_leaf
def order_groups(
    spheres: Float32Array, scratch: Float32Array, deviations: FloatArray, order: IntArray
) -> None:
    """Sorts groups by how far their centres deviate from the ray to the first point.

    Args:
        spheres: (G, 4) see ``ViewIndex``.
        scratch: (RANKING_SCRATCH,) with the points set.
        deviations: (G,) overwritten.
        order: (G,) receives the groups.
    """
    for group in range(len(spheres)):
        rx = scratch[PX] - spheres[group, 0]
        ry = scratch[PY] - spheres[group, 1]
        rz = scratch[PZ] - spheres[group, 2]
        along = rx * scratch[VX] + ry * scratch[VY] + rz * scratch[VZ]
        # Minus the cosine.
        deviations[group] = -along / np.sqrt(rx * rx + ry * ry + rz * rz)
    sort_indices(deviations, len(spheres), order)


@compiled_loop
def set_shares(
    scratch: Float32Array, best: Int32Array, first: int, views: Int32Array, weights: Float32Array
) -> None:
    """Writes weights with sum 1 that fall to zero where the next view takes over.

    Args:
        scratch: as ``rank_views`` left it.
        best: likewise.
        first: where in the results the points' begin.
        views: (VIEWS_PER_CORNER, C) int32 receives the views; -1: none.
        weights: (VIEWS_PER_CORNER, C) receives their weights.
    """
    for i in range(POINTS):
        p0, p1 = scratch[BEST + i], scratch[BEST + POINTS + i]
        p2, p3 = scratch[BEST + 2 * POINTS + i], scratch[BEST + 3 * POINTS + i]
        scale = ONE / max(p3, TWO * SMALLEST)
        w0 = max(ONE - p0 * scale, ZERO) / max(p0, SMALLEST) if p0 < NEVER else ZERO
        w1 = max(ONE - p1 * scale, ZERO) / max(p1, SMALLEST) if p1 < NEVER else ZERO
        w2 = max(ONE - p2 * scale, ZERO) / max(p2, SMALLEST) if p2 < NEVER else ZERO
        total = w0 + w1 + w2
        found = ONE + (ONE if p1 < NEVER else ZERO) + (ONE if p2 < NEVER else ZERO)
        factor = ONE / total if total > ZERO else ONE / found
        # Where all are as good as the next one, they share alike.
        w0, w1, w2 = (w0, w1, w2) if total > ZERO else (ONE, ONE, ONE)
        weights[0, first + i], weights[1, first + i] = w0 * factor, w1 * factor
        weights[2, first + i] = w2 * factor
        views[0, first + i], views[1, first + i] = best[i], best[POINTS + i]
        views[2, first + i] = best[2 * POINTS + i]
