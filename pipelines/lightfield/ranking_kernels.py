"""The views that show surface points best, fast: the ranking of ``blending``, compiled.

Sixteen points are looked at together. For each view in turn the penalties at all of them are
computed, and each point keeps its best few.
"""

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray, Int32Array
from pipelines.lightfield.blending import (
    BORDER_PENALTY,
    RESOLUTION_PENALTY,
    SMALLEST_MARGIN,
    SMALLEST_PENALTY,
    VIEWS_PER_CORNER,
)
from pipelines.lightfield.compiled import compiled_leaf, compiled_loop
from pipelines.lightfield.lane_intrinsics import either, lanes_within, set_lanes
from pipelines.lightfield.occlusion_kernels import hidden_lanes
from pipelines.lightfield.view_index import VIEW_NUMBERS, ViewIndex
from pipelines.lightfield.views import ViewArrays

# Points that are ranked together.
POINTS = 16
# Rows of the scratch: the point, the direction from the virtual centre to it, and one over its
# distance from there; the smallest penalties so far, the last of which is only to compare with; the
# penalty of the view at hand; the point's column, row and inverse depth in it; and what penalties
# are compared with.
PX, PY, PZ, VX, VY, VZ, NEARNESS = range(0, 7 * POINTS, POINTS)
BEST, OWN, COLUMN, ROW, AWAY, LIMIT = (POINTS * row for row in (7, 11, 12, 13, 14, 15))
RANKING_SCRATCH = 16 * POINTS
RANKS = VIEWS_PER_CORNER + 1
# Before anything is ranked, inverse depths stand where penalties will.
DEPTH = np.uintp(OWN)
# Unsigned, as in ``sampling_kernels``: the place in the view; the rows of the best; and where in a
# view's numbers those for its columns begin, those for rows, depths, its centre, size and strip.
LANES = np.uintp(POINTS)
SIGHT = (np.uintp(COLUMN), np.uintp(ROW), np.uintp(AWAY))
BEST0, BEST1, BEST2, BEST3 = (np.uintp(BEST + rank * POINTS) for rank in range(RANKS))
_1, _2, _3, _V, _DEPTH, _CENTRE, _WIDTH, _HEIGHT, _STRIP = (
    np.uintp(place) for place in (1, 2, 3, 4, 8, 12, 15, 16, 17)
)
HALF, ONE, TWO, ZERO = np.float32(0.5), np.float32(1.0), np.float32(2.0), np.float32(0.0)
NEVER = np.float32(np.inf)
BORDER, MARGIN = np.float32(BORDER_PENALTY), np.float32(SMALLEST_MARGIN)
RESOLUTION, SMALLEST = np.float32(RESOLUTION_PENALTY), np.float32(SMALLEST_PENALTY)
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
def deviation(
    px: np.float32,
    py: np.float32,
    pz: np.float32,
    vx: np.float32,
    vy: np.float32,
    vz: np.float32,
    x: np.float32,
    y: np.float32,
    z: np.float32,
) -> tuple[np.float32, np.float32]:
    """How far a point's ray from a place is from that of the virtual camera, and the distance.

    The former as the chord between unit vectors: no cosine near 1 whose digits would be lost.

    Args:
        px: of the point, with py, pz.
        py: see there.
        pz: see there.
        vx: of its direction from the virtual camera, with vy, vz.
        vy: see there.
        vz: see there.
        x: of the place, with y, z.
        y: see there.
        z: see there.
    """
    rx, ry, rz = px - x, py - y, pz - z
    distance = np.sqrt(rx * rx + ry * ry + rz * rz)
    shrink = ONE / distance
    ex, ey, ez = rx * shrink - vx, ry * shrink - vy, rz * shrink - vz
    return np.sqrt(ex * ex + ey * ey + ez * ez), distance


@compiled_loop
def penalty_of(
    px: np.float32,
    py: np.float32,
    pz: np.float32,
    vx: np.float32,
    vy: np.float32,
    vz: np.float32,
    nearness: np.float32,
    numbers: Float32Array,
    first: np.uintp,
    step: np.uintp,
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """The penalty of a view at a point; infinite where it does not show the point.

    Args:
        px: of the point, as in the scratch, with py, pz.
        py: see there.
        pz: see there.
        vx: see there, with vy, vz.
        vy: see there.
        vz: see there.
        nearness: see there.
        numbers: of views, see ``ViewIndex``; those of this one begin at
        first: and are
        step: apart.

    Returns:
        The penalty; the point's column, row and inverse depth in the view.
    """
    u = numbers[first] * px + numbers[first + _1 * step] * py
    u += numbers[first + _2 * step] * pz + numbers[first + _3 * step]
    row = first + _V * step
    v = numbers[row] * px + numbers[row + _1 * step] * py
    v += numbers[row + _2 * step] * pz + numbers[row + _3 * step]
    row = first + _DEPTH * step
    depth = numbers[row] * px + numbers[row + _1 * step] * py
    depth += numbers[row + _2 * step] * pz + numbers[row + _3 * step]
    row = first + _CENTRE * step
    x, y, z = numbers[row], numbers[row + _1 * step], numbers[row + _2 * step]
    own, recorded = deviation(px, py, pz, vx, vy, vz, x, y, z)
    own += RESOLUTION * max(recorded * nearness - ONE, ZERO)
    # All times the depth, which spares a division.
    half, strip = HALF * depth, numbers[first + _STRIP * step] * depth
    right = numbers[first + _WIDTH * step] * depth - half - u
    below = numbers[first + _HEIGHT * step] * depth - half - v
    margin = min(u + half, right, v + half, below)
    own += BORDER * max(strip / max(margin, MARGIN * strip) - ONE, ZERO)
    away = ONE / depth
    return (own if (depth > ZERO) & (margin >= ZERO) else NEVER), u * away, v * away, away


@compiled_loop
def _penalty_at(
    scratch: Float32Array, i: int, numbers: Float32Array, first: np.uintp
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """``penalty_of`` a view, whose numbers begin there, at a point of the scratch."""
    return penalty_of(
        scratch[PX + i],
        scratch[PY + i],
        scratch[PZ + i],
        scratch[VX + i],
        scratch[VY + i],
        scratch[VZ + i],
        scratch[NEARNESS + i],
        numbers,
        first,
        np.uintp(1),
    )


@compiled_loop
def _set_penalties(scratch: Float32Array, numbers: Float32Array, first: np.uintp) -> None:
    """Writes the penalty of a view, whose numbers begin there, at each point."""
    for i in range(POINTS):
        own, u, v, away = _penalty_at(scratch, i, numbers, first)
        scratch[OWN + i] = own
        scratch[COLUMN + i], scratch[ROW + i], scratch[AWAY + i] = u, v, away


@compiled_loop
def _insert(
    scratch: Float32Array, best: Int32Array, i: int, own: np.float32, view: np.int32
) -> None:
    """Puts the view in its place among the best of a point; of equal ones the first stays."""
    p0, p1 = scratch[BEST + i], scratch[BEST + POINTS + i]
    p2, p3 = scratch[BEST + 2 * POINTS + i], scratch[BEST + 3 * POINTS + i]
    v0, v1, v2, v3 = best[i], best[POINTS + i], best[2 * POINTS + i], best[3 * POINTS + i]
    scratch[BEST + i] = min(p0, own)
    scratch[BEST + POINTS + i] = max(p0, min(p1, own))
    scratch[BEST + 2 * POINTS + i] = max(p1, min(p2, own))
    scratch[BEST + 3 * POINTS + i] = max(p2, min(p3, own))
    best[i] = either(own < p0, view, v0)
    best[POINTS + i] = either(own < p0, v0, either(own < p1, view, v1))
    best[2 * POINTS + i] = either(own < p1, v1, either(own < p2, view, v2))
    best[3 * POINTS + i] = either(own < p2, v2, either(own < p3, view, v3))


@compiled_loop
def _insert_all(scratch: Float32Array, best: Int32Array, view: np.int32) -> None:
    """Puts the view in its place among the best of each point."""
    for i in range(POINTS):
        _insert(scratch, best, i, scratch[OWN + i], view)


@compiled_loop
def _rank(
    scratch: Float32Array,
    numbers: Float32Array,
    first: np.uintp,
    best: Int32Array,
    view: np.int32,
) -> None:
    """Puts a view, whose numbers begin there, in its place among the best of each point."""
    for i in range(POINTS):
        own, _, _, _ = _penalty_at(scratch, i, numbers, first)
        _insert(scratch, best, i, own, view)


@compiled_leaf
def _leave_out_hidden(scratch: Float32Array, views: ViewArrays, view: int) -> None:
    """Makes penalties infinite where the view is one of the best but sees something nearer."""
    # Where it is none of the best, nobody needs to know.
    lanes = lanes_within(scratch, np.uintp(OWN), scratch, BEST3)
    lanes = hidden_lanes(lanes, views, view, 0, scratch, SIGHT)
    if lanes:
        set_lanes(lanes, scratch, np.uintp(OWN), NEVER)


@compiled_leaf
def rank_views(
    views: ViewArrays,
    index: ViewIndex,
    rows: Int32Array,
    count: int,
    has_depth: bool,
    scratch: Float32Array,
    best: Int32Array,
) -> None:
    """Finds the views with the smallest penalties at ``POINTS`` surface points.

    Args:
        views: the light field.
        index: of the views that may take part.
        rows: (n,) int32 those of the index that are ranked, rising.
        count: their number.
        has_depth: whether depth maps may hide the points.
        scratch: (RANKING_SCRATCH,) with the points set; from ``BEST`` on it receives the penalties
            of the best, rank by rank; infinite: no view.
        best: (RANKS * POINTS,) int32 receives the views; -1: none.
    """
    for i in range(RANKS * POINTS):
        scratch[BEST + i] = NEVER
        best[i] = -1
    # Two loops: what is between ranking and inserting keeps the best from staying in registers.
    if has_depth:
        for number in range(count):
            row = rows[number]
            view = index.order[row]
            _set_penalties(scratch, index.numbers, np.uintp(row * VIEW_NUMBERS))
            _leave_out_hidden(scratch, views, view)
            _insert_all(scratch, best, view)
        return
    for number in range(count):
        row = rows[number]
        _rank(scratch, index.numbers, np.uintp(row * VIEW_NUMBERS), best, index.order[row])


@compiled_loop
def set_shares(
    scratch: Float32Array,
    best: Int32Array,
    first: np.uintp,
    views: Int32Array,
    weights: Float32Array,
) -> None:
    """Writes weights with sum 1 that fall to zero where the next view takes over.

    Args:
        scratch: as ``rank_views`` left it.
        best: likewise.
        first: where in the results the points' begin, rank by rank.
        views: (VIEWS_PER_CORNER * C,) int32 receives the views; -1: none.
        weights: (VIEWS_PER_CORNER * C,) receives their weights.
    """
    second, third = first + LANES, first + LANES + LANES
    for i in range(np.uintp(POINTS)):
        p0, p1 = scratch[i + BEST0], scratch[i + BEST1]
        p2, p3 = scratch[i + BEST2], scratch[i + BEST3]
        scale = ONE / max(p3, TWO * SMALLEST)
        w0 = max(ONE - p0 * scale, ZERO) / max(p0, SMALLEST) if p0 < NEVER else ZERO
        w1 = max(ONE - p1 * scale, ZERO) / max(p1, SMALLEST) if p1 < NEVER else ZERO
        w2 = max(ONE - p2 * scale, ZERO) / max(p2, SMALLEST) if p2 < NEVER else ZERO
        total = w0 + w1 + w2
        found = ONE + (ONE if p1 < NEVER else ZERO) + (ONE if p2 < NEVER else ZERO)
        factor = ONE / total if total > ZERO else ONE / found
        # Where all are as good as the next one, they share alike.
        w0, w1, w2 = (w0, w1, w2) if total > ZERO else (ONE, ONE, ONE)
        weights[first + i], weights[second + i] = w0 * factor, w1 * factor
        weights[third + i] = w2 * factor
        views[first + i], views[second + i] = best[i], best[i + LANES]
        views[third + i] = best[i + LANES + LANES]
