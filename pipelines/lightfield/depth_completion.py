"""Depth where no neighbouring view confirms any: the surfaces around it are carried on.

What only one photo shows has no parallax. A floor or a wall mostly goes on as it was, so planes are
fitted at the rim of the unconfirmed region and extended into it.
"""

from dataclasses import replace

import cv2
import numpy as np

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray, IntArray
from pipelines.lightfield.stereo_depth import DepthMap

# Specks of confidence smaller than half of this window, in pixels, are no surface to start from.
SPECK_SIZE = 7
MEDIAN_SIZE = 5
# A surface is fitted to the known pixels so near to its rim, along rows and columns, ...
FIT_RADIUS = 12
# ... whose inverse depth differs from the rim's by no more than this share,
FIT_TOLERANCE = 0.06
# and is taken to be level where fewer pixels than this remain.
FIT_PIXELS = 40
# Pulls slopes towards level, as if so many pixels a unit away said so.
FIT_DAMPING = 50.0
# A surface is not carried on beyond this share of the inverse depth at its rim, and its inverse.
SMALLEST_CHANGE = 0.5
# Places on the rim that are fitted together, so that their surroundings fit into a near cache.
RIMS_TOGETHER = 256
# Down and to the right: where a pixel looks for the rim. The second half mirrors the first.
DIRECTIONS = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))


def complete_depth(depth_map: DepthMap) -> DepthMap:
    """Replaces depth that is not confident by that of the surfaces around it.

    Returns:
        Depth everywhere, unchanged where it is still confident; a map without any confident pixel
        keeps its depth.
    """
    confident = depth_map.confident.astype(np.uint8)
    known = np.asarray((cv2.medianBlur(confident, SPECK_SIZE) > 0) & depth_map.confident)
    if not np.any(known):
        return replace(depth_map, confident=known)
    carried = carry_on(depth_map.inverse_depth, known)
    # Single directions leave streaks. A mean would take them away too, and blur the rim.
    smooth = np.asarray(cv2.medianBlur(carried, MEDIAN_SIZE), dtype=np.float32)
    completed = np.where(known, depth_map.inverse_depth, smooth)
    return replace(depth_map, inverse_depth=completed, confident=known)


def carry_on(inverse_depth: Float32Array, known: BoolArray) -> Float32Array:
    """Depth where none is known: planes through the surfaces around, in eight directions.

    Args:
        inverse_depth: ``(H, W)``.
        known: ``(H, W)`` where it can be relied on, and stays.

    Returns:
        ``(H, W)``: the weighted median of what the eight say, nearer ones counting more; as it was
        where there are none.
    """
    width = known.shape[1]
    unknown = np.flatnonzero(~known)
    if unknown.size == 0:
        return inverse_depth.copy()
    rims = np.stack([_nearest_known(known, *way).ravel()[unknown] for way in DIRECTIONS], axis=1)
    # One more place for -1, which stands for none.
    is_rim = np.zeros(known.size + 1, dtype=np.bool_)
    is_rim[rims] = True
    places = np.flatnonzero(is_rim[:-1])
    slopes = np.zeros((2, known.size))
    slopes[:, places] = _slopes(inverse_depth, known, places)
    down = (unknown // width)[:, None] - rims // width
    right = (unknown % width)[:, None] - rims % width
    start = inverse_depth.ravel().astype(np.float64)[rims]
    with np.errstate(over="ignore", invalid="ignore"):
        carried = start + slopes[0, rims] * down + slopes[1, rims] * right
        carried = np.maximum(carried, start * SMALLEST_CHANGE)
        carried = np.minimum(carried, start / SMALLEST_CHANGE)
    counts = (rims >= 0) & ~np.isnan(carried)
    carried[~counts] = np.inf
    weights = np.where(counts, 1.0 / np.maximum(np.hypot(down, right), 1.0), 0.0)
    order = np.argsort(carried, axis=1, kind="stable")
    total = np.cumsum(np.take_along_axis(weights, order, axis=1), axis=1)
    # Where two halves balance, rounding must not tip them.
    middle = np.argmax(total >= 0.5 * total[:, -1:] * (1.0 - 1e-12), axis=1)
    some = np.flatnonzero(counts.any(axis=1))
    completed = inverse_depth.copy()
    completed.reshape(-1)[unknown[some]] = carried[some, order[some, middle[some]]]
    return completed


def _nearest_known(known: BoolArray, down: int, right: int) -> IntArray:
    """Index in the image of the known pixel ``(H, W)`` that is next in a direction; -1: none."""
    height, width = known.shape
    index = np.arange(known.size).reshape(known.shape)
    if (down, right) > (0, 0):
        mirrored = _nearest_known(known[::-1, ::-1], -down, -right)[::-1, ::-1]
        return np.where(mirrored >= 0, known.size - 1 - mirrored, -1)
    found = np.full((height + 1, width + 2), -1)
    if down == 0:
        np.maximum.accumulate(np.where(known, index, -1), axis=1, out=found[1:, 1:-1])
        return found[1:, :-2]
    for row in range(height):
        before = found[row, 1 + right : 1 + right + width]
        found[row + 1, 1:-1] = np.where(known[row], index[row], before)
    return found[:-1, 1 + right : 1 + right + width]


def _slopes(inverse_depth: Float32Array, known: BoolArray, rims: IntArray) -> FloatArray:
    """How the surfaces at places on the rim rise down and to the right, ``(2, R)``, a pixel."""
    side = 2 * FIT_RADIUS + 1
    # What is not known, or beyond the border, is no number, and near nothing.
    values = np.where(known, inverse_depth, np.float32(np.nan))
    padded = np.pad(values, FIT_RADIUS, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side))
    arm = np.arange(-FIT_RADIUS, FIT_RADIUS + 1.0)
    down, right = np.repeat(arm, side), np.tile(arm, side)
    # Sums of these are whole numbers that single precision holds exactly.
    products = np.stack([np.ones(side**2), down**2, down * right, right**2], axis=1)
    slopes = np.zeros((2, len(rims)))
    for first in range(0, len(rims), RIMS_TOGETHER):
        part = slice(first, first + RIMS_TOGETHER)
        rows, columns = np.divmod(rims[part], known.shape[1])
        start = inverse_depth[rows, columns, None, None]
        with np.errstate(over="ignore", invalid="ignore"):
            rise = windows[rows, columns] - start
            near = np.abs(rise) <= np.float32(FIT_TOLERANCE) * start
        rise[~near] = 0.0
        sums = near.reshape(-1, side**2).astype(np.float32) @ products.astype(np.float32)
        count, dd, dr, rr = sums.astype(np.float64).T
        dd, rr = dd + FIT_DAMPING, rr + FIT_DAMPING
        with np.errstate(over="ignore", invalid="ignore"):
            rise_down, rise_right = rise.sum(axis=2) @ arm, rise.sum(axis=1) @ arm
            fitted = np.stack([rr * rise_down - dr * rise_right, dd * rise_right - dr * rise_down])
            slopes[:, part] = np.where(count >= FIT_PIXELS, fitted / (dd * rr - dr * dr), 0.0)
    return slopes
