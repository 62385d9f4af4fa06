"""The compiled parts of ``depth``: warps, costs of windows, semi-global aggregation.

A *padded* image is grey, float32, and carries ``RADIUS`` more pixels on each side (its border
repeated), so that a window never leaves the array. Everything here is a function of its arguments
and releases the interpreter lock.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipelines.artifacts.array_types import Float32Array, FloatArray, ImageArray, Int32Array
from pipelines.lightfield.compiled import compiled, compiled_leaf, compiled_part
from pipelines.lightfield.record_type import compiled_record

RADIUS = 1
# Costs run from 0 (alike) to about this where the windows have nothing in common.
LARGEST_COST = np.float32(240.0)
# What a view costs that does not see the point.
UNSEEN_COST = np.float32(255.0)
_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_FAR = np.float32(1e9)
# Homogeneous depth below which a point counts as behind the camera.
_NEAR = np.float32(1e-6)


@compiled_part
def _repeat_border(padded: Float32Array) -> None:
    """Fills the border of a padded image with its nearest pixels."""
    height, width = padded.shape
    for y in range(RADIUS, height - RADIUS):
        for x in range(RADIUS):
            padded[y, x] = padded[y, RADIUS]
            padded[y, width - 1 - x] = padded[y, width - 1 - RADIUS]
    for y in range(RADIUS):
        for x in range(width):
            padded[y, x] = padded[RADIUS, x]
            padded[height - 1 - y, x] = padded[height - 1 - RADIUS, x]


@compiled
def pack(image: ImageArray, texels: NDArray[np.uint32]) -> None:
    """Joins each four neighbouring pixels, so that interpolating between them is one read.

    Args:
        image: ``(h, w)``.
        texels: ``(h - 1, w - 1)`` result, from the lowest byte: top left and right, bottom left and
            right.
    """
    height, width = image.shape
    for y in range(height - 1):
        for x in range(width - 1):
            top = np.uint32(image[y, x]) | np.uint32(image[y, x + 1]) << np.uint32(8)
            bottom = np.uint32(image[y + 1, x]) | np.uint32(image[y + 1, x + 1]) << np.uint32(8)
            texels[y, x] = np.uint32(top | bottom << np.uint32(16))


@compiled
def warp(
    texels: NDArray[np.uint32],
    rays: FloatArray,
    shift: FloatArray,
    inverse_depth: float,
    padded: Float32Array,
    seen: Float32Array,
    fractions: Float32Array,
    places: NDArray[np.uint32],
) -> None:
    """Writes a neighbour's image as the reference view would see it if all were at one depth.

    Args:
        texels: ``(h - 1, w - 1)`` the neighbour's image, packed.
        rays: ``(3, 3)`` A and ``shift`` ``(3,)`` b: a reference pixel p with inverse depth q lies
            at the neighbour's homogeneous pixel A p + q b.
        shift: see ``rays``.
        inverse_depth: of the plane.
        padded: ``(H + 2 RADIUS, W + 2 RADIUS)`` result.
        seen: ``(H, W)`` result: 1 where the neighbour sees the point, else 0.
        fractions: ``(2, W)`` overwritten, and
        places: ``(2, W)`` likewise.
    """
    height, width = seen.shape
    last_row, last_column = np.int32(texels.shape[0] - 1), np.int32(texels.shape[1] - 1)
    last_u, last_v = np.float32(texels.shape[1]), np.float32(texels.shape[0])
    flat = texels.reshape(-1)
    step_u, step_v = np.float32(rays[0, 0]), np.float32(rays[1, 0])
    step_depth = np.float32(rays[2, 0])
    across, down = fractions[0], fractions[1]
    place, four = places[0], places[1]
    for y in range(height):
        start_u = np.float32(rays[0, 1] * y + rays[0, 2] + inverse_depth * shift[0])
        start_v = np.float32(rays[1, 1] * y + rays[1, 2] + inverse_depth * shift[1])
        start_depth = np.float32(rays[2, 1] * y + rays[2, 2] + inverse_depth * shift[2])
        seen_row, row = seen[y], padded[y + RADIUS]
        # Where to look, looking, and interpolating apart: the first and the last of these loops are
        # done many pixels at a time.
        for x in range(width):
            column = np.float32(np.int32(x))
            depth = step_depth * column + start_depth
            scale = _ONE / max(depth, _NEAR)
            u = (step_u * column + start_u) * scale
            v = (step_v * column + start_v) * scale
            near_u, near_v = min(max(u, _ZERO), last_u), min(max(v, _ZERO), last_v)
            away = max(abs(u - near_u), abs(v - near_v))
            seen_row[x] = _ONE if (away <= _HALF and depth > _NEAR) else _ZERO
            left = np.int32(min(np.int32(near_u), last_column))
            top = np.int32(min(np.int32(near_v), last_row))
            across[x], down[x] = near_u - np.float32(left), near_v - np.float32(top)
            place[x] = np.uint32(top * np.int32(last_column + 1) + left)
        for x in range(width):
            four[x] = flat[np.uint64(place[x])]
        for x in range(width):
            first = np.float32(np.uint8(four[x]))
            second = np.float32(np.uint8(four[x] >> np.uint32(8)))
            third = np.float32(np.uint8(four[x] >> np.uint32(16)))
            fourth = np.float32(np.uint8(four[x] >> np.uint32(24)))
            upper = first + across[x] * (second - first)
            lower = third + across[x] * (fourth - third)
            row[x + RADIUS] = upper + down[x] * (lower - upper)
    _repeat_border(padded)


@compiled
def add_view_cost(
    reference: Float32Array,
    warped: Float32Array,
    seen: Float32Array,
    offsets: NDArray[np.int64],
    saturation: float,
    best: Float32Array,
    cost: Float32Array,
) -> None:
    """Compares windows, less the grey of their centres, and keeps the costs of the best views.

    Args:
        reference: padded image.
        warped: padded image of a neighbour as the reference would see it.
        seen: ``(H, W)`` 1 where the neighbour sees the point.
        offsets: ``(K, 2)`` rows and columns, not negative, of the window's pixels in it.
        saturation: grey levels; larger differences all cost the same.
        best: ``(k, H, W)`` the k smallest costs so far, ascending; updated.
        cost: ``(W,)`` overwritten.
    """
    height, width = seen.shape
    count = len(offsets)
    limit = np.float32(saturation)
    weight = np.float32(LARGEST_COST / np.float32(count))
    for y in range(height):
        cost[:] = _ZERO
        centre, other_centre = reference[y + RADIUS], warped[y + RADIUS]
        for k in range(count):
            row, other_row = reference[y + offsets[k, 0]], warped[y + offsets[k, 0]]
            column = offsets[k, 1]
            left, other_left = row[column : column + width], other_row[column : column + width]
            for x in range(width):
                difference = (left[x] - centre[x + RADIUS]) - (
                    other_left[x] - other_centre[x + RADIUS]
                )
                cost[x] += min(abs(difference), limit)
        for x in range(width):
            cost[x] = UNSEEN_COST if seen[y, x] == _ZERO else cost[x] * weight / limit
        for k in range(len(best)):
            kept = best[k, y]
            for x in range(width):
                larger = max(kept[x], cost[x])
                kept[x] = min(kept[x], cost[x])
                cost[x] = larger


@compiled
def write_layer(best: Float32Array, layer: ImageArray, sums: Float32Array) -> None:
    """Writes the mean of the best views' costs ``(k, H, W)`` as bytes ``(H, W)``.

    Args:
        best: the costs.
        layer: receives the result.
        sums: ``(2, W)`` overwritten.
    """
    count, height, width = best.shape
    total, seeing = sums[0], sums[1]
    for y in range(height):
        total[:] = _ZERO
        seeing[:] = _ZERO
        for k in range(count):
            costs = best[k, y]
            for x in range(width):
                is_seen = costs[x] < UNSEEN_COST
                total[x] += costs[x] if is_seen else _ZERO
                seeing[x] += _ONE if is_seen else _ZERO
        row = layer[y]
        for x in range(width):
            mean = total[x] / max(seeing[x], _ONE) + _HALF
            row[x] = np.uint8(np.int32(mean if seeing[x] > _ZERO else UNSEEN_COST))


@compiled
def fill_unseen(volume: ImageArray, sums: Int32Array) -> None:
    """Gives planes on which no view sees a pixel that pixel's mean cost on the others.

    Args:
        volume: ``(D, H, W)`` costs, changed.
        sums: ``(2, W)`` overwritten.
    """
    planes, height, width = volume.shape
    total, seeing = sums[0], sums[1]
    for y in range(height):
        total[:] = 0
        seeing[:] = 0
        for d in range(planes):
            row = volume[d, y]
            for x in range(width):
                is_seen = row[x] < 255
                total[x] += np.int32(row[x]) if is_seen else np.int32(0)
                seeing[x] += np.int32(is_seen)
        for d in range(planes):
            row = volume[d, y]
            for x in range(width):
                if row[x] == 255:
                    row[x] = np.uint8(total[x] // max(seeing[x], np.int32(1)))


@compiled
def distinctness(
    volume: ImageArray, index: Float32Array, total: Float32Array, distinct: Float32Array
) -> None:
    """How much better than the average plane the chosen one fits: 0 where all planes look alike.

    Args:
        volume: ``(D, H, W)`` costs.
        index: ``(H, W)`` number of the chosen plane, with a fraction.
        total: ``(W,)`` overwritten.
        distinct: ``(H, W)`` result: mean cost less the chosen plane's.
    """
    planes, height, width = volume.shape
    share = np.float32(1.0 / planes)
    for y in range(height):
        total[:] = _ZERO
        for d in range(planes):
            row = volume[d, y]
            for x in range(width):
                total[x] += np.float32(row[x])
        for x in range(width):
            plane = np.int64(index[y, x] + _HALF)
            distinct[y, x] = total[x] * share - np.float32(volume[plane, y, x])


@compiled_leaf
def _step(
    cost: Float32Array,
    before: Float32Array,
    smallest: np.float32,
    small: np.float32,
    large: np.float32,
    after: Float32Array,
) -> np.float32:
    """One step along a path; arrays ``(D + 2,)`` with a wall at both ends; returns the minimum."""
    jump = smallest + large
    least = _FAR
    for d in range(1, len(cost) - 1):
        way = min(before[d], jump, min(before[d - 1], before[d + 1]) + small)
        value = cost[d] + way - smallest
        after[d] = value
        least = min(least, value)
    return np.float32(least)


@compiled_leaf
def _first_step(cost: Float32Array, after: Float32Array) -> np.float32:
    """The beginning of a path: copies the costs ``(D + 2,)`` and returns the minimum."""
    least = _FAR
    for d in range(1, len(cost) - 1):
        after[d] = cost[d]
        least = min(least, cost[d])
    return np.float32(least)


@compiled_part
def _load_row(volume: ImageArray, y: int, costs: Float32Array) -> None:
    """Row y of the volume ``(D, H, W)`` as ``(W, D + 2)``."""
    for d in range(volume.shape[0]):
        layer = volume[d, y]
        for x in range(len(layer)):
            costs[x, d + 1] = np.float32(layer[x])


@compiled_part
def _path_row(
    costs: Float32Array,
    grey: Float32Array,
    y: int,
    back: int,
    penalties: FloatArray,
    above: Float32Array,
    above_least: Float32Array,
    current: Float32Array,
    current_least: Float32Array,
) -> None:
    """Four paths into each pixel of a row: from its side, and from three pixels of the row before.

    ``back`` is +1 for the pass from the top left, -1 for the one from the bottom right.
    """
    height, width = grey.shape
    small = np.float32(penalties[0])
    large, contrast = np.float32(penalties[1]), np.float32(penalties[2])
    floor = np.float32(penalties[0] + penalties[3])
    for i in range(width):
        x = i if back > 0 else width - 1 - i
        for path in range(4):
            from_x = x - back if path == 0 else x + path - 2
            from_y = y if path == 0 else y - back
            if from_x < 0 or from_x >= width or from_y < 0 or from_y >= height:
                current_least[path, x] = _first_step(costs[x], current[path, x])
                continue
            step = abs(grey[y, x] - grey[from_y, from_x])
            jump = max(large / (_ONE + step / contrast), floor)
            if path == 0:
                before, least = current[path, from_x], current_least[path, from_x]
            else:
                before, least = above[path, from_x], above_least[path, from_x]
            current_least[path, x] = _step(costs[x], before, least, small, jump, current[path, x])


@compiled_record
class AggregationRoom(NamedTuple):
    """Memory for ``aggregate``.

    Attributes:
        total: ``(H, W, D)`` sums over the paths.
        costs: ``(W, D + 2)`` of a row, with a wall at both ends.
        rows: ``(2, 4, W, D + 2)`` along four paths, of a row and of the one before.
        least: ``(2, 4, W)`` their smallest.
    """

    total: Float32Array
    costs: Float32Array
    rows: Float32Array
    least: Float32Array


def aggregation_room_for(planes: int, height: int, width: int) -> AggregationRoom:
    """Memory for so many planes and images of one size."""
    return AggregationRoom(
        np.empty((height, width, planes), np.float32),
        np.full((width, planes + 2), _FAR, np.float32),
        np.full((2, 4, width, planes + 2), _FAR, np.float32),
        np.zeros((2, 4, width), np.float32),
    )


@compiled
def aggregate(
    volume: ImageArray,
    grey: Float32Array,
    penalties: FloatArray,
    index: Float32Array,
    room: AggregationRoom,
) -> None:
    """Semi-global matching along eight paths, winner takes all, between planes.

    Args:
        volume: ``(D, H, W)`` costs.
        grey: ``(H, W)`` reference image: jumps are cheaper across its edges.
        penalties: ``(4,)``: for a step of one plane; for a jump; grey levels at which a jump costs
            half; by how much a jump costs more than a step at least.
        index: ``(H, W)`` result, the plane's number with its fraction.
        room: for so many planes and images of this size; changed.
    """
    planes, height, width = volume.shape
    costs, rows, least, total = room.costs, room.rows, room.least, room.total
    for y in range(height):
        _load_row(volume, y, costs)
        above, current = y % 2, 1 - y % 2
        _path_row(
            costs, grey, y, 1, penalties, rows[above], least[above], rows[current], least[current]
        )
        for x in range(width):
            for d in range(planes):
                total[y, x, d] = (
                    rows[current, 0, x, d + 1]
                    + rows[current, 1, x, d + 1]
                    + rows[current, 2, x, d + 1]
                    + rows[current, 3, x, d + 1]
                )
    for i in range(height):
        y = height - 1 - i
        _load_row(volume, y, costs)
        above, current = i % 2, 1 - i % 2
        _path_row(
            costs, grey, y, -1, penalties, rows[above], least[above], rows[current], least[current]
        )
        for x in range(width):
            sums = total[y, x]
            for d in range(planes):
                sums[d] += (
                    rows[current, 0, x, d + 1]
                    + rows[current, 1, x, d + 1]
                    + rows[current, 2, x, d + 1]
                    + rows[current, 3, x, d + 1]
                )
            index[y, x] = _lowest(sums)


@compiled_leaf
def _lowest(values: Float32Array) -> np.float32:
    """Index of the smallest value, with a fraction from its neighbours."""
    best = 0
    for d in range(1, len(values)):
        if values[d] < values[best]:
            best = d
    if best == 0 or best == len(values) - 1:
        return np.float32(best)
    before, after = values[best - 1] - values[best], values[best + 1] - values[best]
    if before <= _ZERO and after <= _ZERO:
        return np.float32(best)
    # Sums of absolute differences rise linearly on both sides: two lines of equal slope, no
    # parabola, which would be drawn towards the planes.
    return np.float32(best + _HALF * (before - after) / max(before, after))
