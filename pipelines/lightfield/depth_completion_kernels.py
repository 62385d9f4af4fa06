"""The compiled part of ``depth_completion``: surfaces carried on into unconfirmed pixels."""

import numpy as np

from pipelines.artifacts.array_types import BoolArray, Float32Array, FloatArray, IntArray
from pipelines.lightfield.compiled import compiled, compiled_part

# Rows and columns to the eight neighbours of a pixel.
DIRECTIONS = np.array([(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)])
# A surface is fitted to the confident pixels so near to its rim ...
FIT_RADIUS = 12
# ... whose inverse depth differs from the rim's by no more than this share,
FIT_TOLERANCE = 0.06
# and is taken to be level where fewer pixels than this remain.
FIT_PIXELS = 40
# Pulls slopes towards level, as if so many pixels a unit away said so.
FIT_DAMPING = 50.0
# A surface is not carried on beyond this share of the inverse depth at its rim, and its inverse.
SMALLEST_CHANGE = 0.5


@compiled_part
def _slopes(
    inverse_depth: Float32Array, known: BoolArray, row: int, column: int, slopes: FloatArray
) -> None:
    """Writes how the surface at a pixel rises along rows and columns (inverse depth a pixel)."""
    height, width = inverse_depth.shape
    middle = inverse_depth[row, column]
    rr, rc, cc, rq, cq = FIT_DAMPING, 0.0, FIT_DAMPING, 0.0, 0.0
    count = 0
    for y in range(max(row - FIT_RADIUS, 0), min(row + FIT_RADIUS + 1, height)):
        for x in range(max(column - FIT_RADIUS, 0), min(column + FIT_RADIUS + 1, width)):
            rise = inverse_depth[y, x] - middle
            if not known[y, x] or abs(rise) > FIT_TOLERANCE * middle:
                continue
            down, right = np.float64(y - row), np.float64(x - column)
            rr += down * down
            rc += down * right
            cc += right * right
            rq += down * rise
            cq += right * rise
            count += 1
    determinant = rr * cc - rc * rc
    slopes[0], slopes[1] = 0.0, 0.0
    if count >= FIT_PIXELS and determinant > 0.0:
        slopes[0] = (cc * rq - rc * cq) / determinant
        slopes[1] = (rr * cq - rc * rq) / determinant


@compiled
def carry_on(
    inverse_depth: Float32Array,
    known: BoolArray,
    missing: BoolArray,
    directions: IntArray,
    completed: Float32Array,
    room: FloatArray,
) -> None:
    """Gives missing pixels the depth of the surfaces around them.

    In eight directions the nearest known pixel is looked up, and the plane there carried on; the
    result is the weighted median of what they say, nearer ones counting more.

    Args:
        inverse_depth: ``(H, W)``.
        known: ``(H, W)`` where it can be relied on.
        missing: ``(H, W)`` where it is to be replaced.
        directions: ``(8, 2)`` rows and columns.
        completed: ``(H, W)`` result; a pixel from which no known one is found keeps its value.
        room: ``(3, 8)`` overwritten.
    """
    height, width = inverse_depth.shape
    values, weights, slopes = room[0], room[1], room[2]
    for y in range(height):
        for x in range(width):
            completed[y, x] = inverse_depth[y, x]
            if not missing[y, x]:
                continue
            count = 0
            for k in range(len(directions)):
                down, right = directions[k, 0], directions[k, 1]
                row, column, steps = y + down, x + right, 1
                while 0 <= row < height and 0 <= column < width and not known[row, column]:
                    row += down
                    column += right
                    steps += 1
                if not (0 <= row < height and 0 <= column < width):
                    continue
                _slopes(inverse_depth, known, row, column, slopes)
                start = np.float64(inverse_depth[row, column])
                value = start + slopes[0] * (y - row) + slopes[1] * (x - column)
                values[count] = min(max(value, start * SMALLEST_CHANGE), start / SMALLEST_CHANGE)
                weights[count] = 1.0 / (steps * np.sqrt(np.float64(down * down + right * right)))
                count += 1
            if count > 0:
                completed[y, x] = np.float32(_weighted_median(values[:count], weights[:count]))


@compiled_part
def _weighted_median(values: FloatArray, weights: FloatArray) -> float:
    half = 0.0
    for weight in weights:
        half += 0.5 * weight
    lowest, smallest = values[0], -np.inf
    total = 0.0
    # Takes the values in ascending order, equal ones together.
    while total < half:
        lowest = np.inf
        for value in values:
            if smallest < value < lowest:
                lowest = value
        for index in range(len(values)):
            if values[index] == lowest:
                total += weights[index]
        smallest = lowest
    return float(lowest)
