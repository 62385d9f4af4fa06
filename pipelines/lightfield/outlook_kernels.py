"""The views that show a few points best, of very many: the outlook of ``blending``, compiled.

Of a large light field most views are far from the best everywhere. At each point only those groups
of views (``view_index``) are looked at that may hold one better than the best so far: the angle
between a ray to the point and any ray from inside a sphere differs from that to the sphere's centre
by no more than the sphere's own angle allows, and no view shows what is outside of the planes
around all that the group's views see. The views of a group are looked at all at once.
"""

import numpy as np

from pipelines.artifacts.array_types import Float32Array, Int32Array
from pipelines.lightfield.compiled import compiled_leaf, compiled_loop
from pipelines.lightfield.lane_intrinsics import either, first_lane, lanes_within
from pipelines.lightfield.occlusion_kernels import is_occluded
from pipelines.lightfield.ranking_kernels import (
    AWAY,
    BEST,
    COLUMN,
    LANES,
    LIMIT,
    NEARNESS,
    NEVER,
    ONE,
    OWN,
    POINTS,
    PX,
    PY,
    PZ,
    RESOLUTION,
    ROW,
    TWO,
    VX,
    VY,
    VZ,
    ZERO,
    deviation,
    penalty_of,
)
from pipelines.lightfield.view_index import GROUP_NUMBERS, GROUP_VIEWS, VIEW_NUMBERS, ViewIndex
from pipelines.lightfield.views import ViewArrays

# Where the group that promises most at each point stands, and its bound; before it the best view,
# and its penalty.
NEAREST = POINTS
# Instead of infinity, which stands for what is not shown.
LARGEST = np.float32(np.finfo(np.float32).max)
# Bounds in single precision are smaller than they should be by less than this.
ROUNDING = np.float32(1e-5)
# Unsigned, as in ``sampling_kernels``: steps from number to number of a view in a group, from group
# to group, and where in a group's numbers those for the sides of images begin.
STEP, STRIDE = np.uintp(GROUP_VIEWS), np.uintp(GROUP_NUMBERS)
_1, _2, _3 = (np.uintp(place) for place in (1, 2, 3))
LEFT, RIGHT, TOP, BOTTOM = (np.uintp(4 * side) for side in range(1, 5))


@compiled_loop
def _inside(
    numbers: Float32Array,
    first: np.uintp,
    rx: np.float32,
    ry: np.float32,
    rz: np.float32,
    distance: np.float32,
) -> np.float32:
    """How far a point may be on the inner side of a group's planes for one side of images.

    Args:
        numbers: of the groups, see ``ViewIndex``; those of the side begin at
        first: there.
        rx: of the way from the middle of the group's sphere to the point, with ry, rz.
        ry: see there.
        rz: see there.
        distance: its length.

    Returns:
        What is too small by the sphere's radius at most.
    """
    across = numbers[first] * rx + numbers[first + _1] * ry + numbers[first + _2] * rz
    return np.float32(across + (numbers[first + _3] + ROUNDING) * distance)


@compiled_loop
def _set_bounds(
    scratch: Float32Array,
    numbers: Float32Array,
    group: np.uintp,
    bounds: Float32Array,
    best: Int32Array,
) -> None:
    """Writes what the penalty of a group's views at each point is no smaller than.

    For vectors p, q: |p/|p| - q/|q|| <= 2 |p - q| / (|p| + |q|) (Dunkl and Williams 1964).

    Args:
        scratch: (RANKING_SCRATCH,) with the points set.
        numbers: (G * GROUP_NUMBERS,) of the groups, see ``ViewIndex``.
        group: which.
        bounds: (G * POINTS,) changed.
        best: (RANKS * POINTS,) int32 changed where the group promises more than those before.
    """
    first = group * STRIDE
    x, y, z, radius = numbers[first], numbers[first + _1], numbers[first + _2], numbers[first + _3]
    for i in range(POINTS):
        px, py, pz = scratch[PX + i], scratch[PY + i], scratch[PZ + i]
        vx, vy, vz = scratch[VX + i], scratch[VY + i], scratch[VZ + i]
        chord, distance = deviation(px, py, pz, vx, vy, vz, x, y, z)
        slack = TWO * radius / max(TWO * distance - radius, ROUNDING * radius)
        coarser = max((distance - radius) * scratch[NEARNESS + i] - ONE, ZERO)
        bound = chord - slack + RESOLUTION * coarser - ROUNDING
        rx, ry, rz = px - x, py - y, pz - z
        inside = min(
            _inside(numbers, first + LEFT, rx, ry, rz, distance),
            _inside(numbers, first + RIGHT, rx, ry, rz, distance),
            _inside(numbers, first + TOP, rx, ry, rz, distance),
            _inside(numbers, first + BOTTOM, rx, ry, rz, distance),
        )
        bound = bound if inside + radius >= ZERO else NEVER
        bounds[group * LANES + np.uintp(i)] = bound
        before = scratch[BEST + NEAREST + i]
        best[NEAREST + i] = either(bound < before, np.int32(group), best[NEAREST + i])
        scratch[BEST + NEAREST + i] = min(bound, before)


@compiled_loop
def _set_penalties(
    scratch: Float32Array, point: int, blocks: Float32Array, first: np.uintp
) -> None:
    """Writes the penalties of a group's views at a point, and beside them the point's best."""
    px, py, pz = scratch[PX + point], scratch[PY + point], scratch[PZ + point]
    vx, vy, vz = scratch[VX + point], scratch[VY + point], scratch[VZ + point]
    nearness, best = scratch[NEARNESS + point], scratch[BEST + point]
    for i in range(GROUP_VIEWS):
        own, u, v, away = penalty_of(
            px, py, pz, vx, vy, vz, nearness, blocks, first + np.uintp(i), STEP
        )
        scratch[OWN + i] = own
        scratch[COLUMN + i], scratch[ROW + i], scratch[AWAY + i] = u, v, away
        scratch[LIMIT + i] = best


@compiled_leaf
def _look_at_group(
    views: ViewArrays,
    index: ViewIndex,
    has_depth: bool,
    group: int,
    point: int,
    scratch: Float32Array,
    best: Int32Array,
) -> None:
    """Puts the best of a group's views there if none before it was as good at a point."""
    _set_penalties(scratch, point, index.blocks, np.uintp(group * VIEW_NUMBERS * GROUP_VIEWS))
    lanes = lanes_within(scratch, np.uintp(OWN), scratch, np.uintp(LIMIT))
    while lanes:
        lane = first_lane(lanes)
        lanes &= lanes - 1
        own, row = scratch[OWN + lane], index.members[group * GROUP_VIEWS + lane]
        before = scratch[BEST + point]
        # Of equal ones the first of all stays.
        if own > before or (own == before and row > best[point]):
            continue
        u, v, away = scratch[COLUMN + lane], scratch[ROW + lane], scratch[AWAY + lane]
        if has_depth and is_occluded(views, index.order[row], u, v, away):
            continue
        scratch[BEST + point], best[point] = own, row


@compiled_leaf
def look_out(
    views: ViewArrays,
    index: ViewIndex,
    has_depth: bool,
    scratch: Float32Array,
    best: Int32Array,
    bounds: Float32Array,
) -> None:
    """Finds the view with the smallest penalty at each of ``POINTS`` surface points.

    Args:
        views: the light field.
        index: of the views that may take part.
        has_depth: whether depth maps may hide the points.
        scratch: (RANKING_SCRATCH,) with the points set; changed.
        best: (RANKS * POINTS,) int32 receives the views' rows in the index; -1: none.
        bounds: (G * POINTS,) overwritten.
    """
    for i in range(2 * POINTS):
        scratch[BEST + i] = LARGEST
        best[i] = -1
    groups = len(index.members) // GROUP_VIEWS
    for group in range(groups):
        _set_bounds(scratch, index.groups, np.uintp(group), bounds, best)
    # The most promising ones first spare a look at most others.
    for point in range(POINTS):
        if best[NEAREST + point] >= 0:
            _look_at_group(views, index, has_depth, best[NEAREST + point], point, scratch, best)
    for group in range(groups):
        points = lanes_within(bounds, np.uintp(group * POINTS), scratch, np.uintp(BEST))
        while points:
            point = first_lane(points)
            points &= points - 1
            if best[NEAREST + point] != group:
                _look_at_group(views, index, has_depth, group, point, scratch, best)
