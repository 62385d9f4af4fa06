"""Reading views: where the surface points of some pixels lie in a view, and what it shows there.

The innermost part of the fast renderer. It works on chunks of up to ``CHUNK`` pixels in two steps:
places and weights of all of them, sixteen at once, as plain arithmetic on flat arrays
(``place_samples``), then the photo's texels, a pixel at a time (``add_samples``).
"""

import numpy as np

from pipelines.artifacts.array_types import (
    Float32Array,
    FloatArray,
    ImageArray,
    Int32Array,
)
from pipelines.lightfield.compiled import compiled_leaf, compiled_loop
from pipelines.lightfield.texel_intrinsic import add_texels, load_lanes
from pipelines.lightfield.vector_code import LANES

# Pixels that are worked on together; what they need stays in the processor's nearest cache.
CHUNK = 128
# Chunks are filled up to a multiple of ``LANES``, what a processor works on at once. Where the rows
# of a chunk's scratch begin: x, y, inverse depth and the view's weight; what comes out: fraction,
# upper and lower weight; and the place in the view's level and the point's inverse depth there.
# Unsigned: for signed indices the compiler would have to count from the end, too, and could not see
# that they follow each other.
ROW_LENGTH = CHUNK + LANES
X, Y, SURFACE, WEIGHT, FRACTION, UPPER, LOWER, COLUMN, ROW, NEARNESS = (
    np.uintp(row * ROW_LENGTH) for row in range(10)
)
SCRATCH_SIZE = 10 * ROW_LENGTH
# Numbers that take a chunk's pixels into a view: map (9), shift (3).
COEFFICIENTS = 12
ZERO, HALF, ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)


@compiled_leaf
def load_cell(
    weights: FloatArray,
    origins: FloatArray,
    cell: int,
    slot: int,
    columns: Float32Array,
    rows: Float32Array,
    surface: Float32Array,
    pixels: Int32Array,
    first: int,
    count: int,
    place: int,
    x: float,
    y: float,
    scratch: Float32Array,
    targets: Int32Array,
) -> None:
    """Writes places, inverse depths, weights and targets of pixels of one cell into a chunk.

    What stands behind them in the chunk is overwritten, up to a multiple of ``LANES``.

    Args:
        weights: (c, k, 4) coefficients of x, y, 1, x y, relative to
        origins: (c, 2) columns and rows.
        cell: of the pixels, and
        slot: of the view in it.
        columns: (P + LANES,) places of the pixels in the order of their cells, and
        rows: likewise, and
        surface: their inverse depths, and
        pixels: int32 where they stand in the image that is made.
        first: of them, and
        count: how many.
        place: of the first in the chunk.
        x: column of the chunk's first pixel, and
        y: its row.
        scratch: of the chunk, changed.
        targets: (ROW_LENGTH,) int32, likewise.
    """
    a, b = weights[cell, slot, 0], weights[cell, slot, 1]
    c, d = weights[cell, slot, 2], weights[cell, slot, 3]
    across, down = x - origins[cell, 0], y - origins[cell, 1]
    coefficients = (
        np.float32(x),
        np.float32(y),
        np.float32(a + d * down),
        np.float32(b + d * across),
        np.float32(a * across + b * down + c + d * across * down),
        np.float32(d),
    )
    for i in range(0, count, LANES):
        load_lanes(
            columns,
            rows,
            surface,
            pixels,
            first + i,
            place + i,
            coefficients,
            scratch,
            ROW_LENGTH,
            targets,
        )


@compiled_loop
def end_weights(scratch: Float32Array, count: np.uintp) -> None:
    """Takes the weights of what stands behind a chunk's ``count`` pixels."""
    for i in range(np.uintp(LANES)):
        scratch[count + i + WEIGHT] = ZERO


@compiled_leaf
def chunk_coefficients(
    maps: FloatArray,
    shifts: FloatArray,
    view: int,
    x: float,
    y: float,
    coefficients: Float32Array,
) -> None:
    """Writes what takes pixels into a view, relative to the chunk's first pixel.

    Relative to a near pixel the numbers are small, and single precision is enough for them.

    Args:
        maps: (N, 3, 3) and
        shifts: (N, 3), see ``view_mapping``.
        view: which.
        x: column of the first pixel, and
        y: its row.
        coefficients: (COEFFICIENTS,) receives map and shift.
    """
    for i in range(3):
        coefficients[3 * i] = maps[view, i, 0]
        coefficients[3 * i + 1] = maps[view, i, 1]
        coefficients[3 * i + 2] = maps[view, i, 0] * x + maps[view, i, 1] * y + maps[view, i, 2]
        coefficients[9 + i] = shifts[view, i]


@compiled_loop
def place_samples(
    scratch: Float32Array,
    offsets: Int32Array,
    count: int,
    coefficients: Float32Array,
    nearest: np.float32,
    farthest: np.float32,
    width: np.int32,
    height: np.int32,
    scale_x: np.float32,
    scale_y: np.float32,
) -> tuple[np.float32, np.float32]:
    """Where in a pyramid level of a view a chunk's surface points lie, and with which weight.

    Args:
        scratch: (SCRATCH_SIZE,); the first four rows are read, the others written.
        offsets: (CHUNK,) int32 receives the index of each point's upper left texel in the level.
        count: pixels of the chunk, a multiple of ``LANES``.
        coefficients: see ``chunk_coefficients``.
        nearest: depths, relative to the virtual one, in (nearest, farthest] belong to the level.
        farthest: see there.
        width: of the level, and
        height: likewise.
        scale_x: how many of the level's columns one of the finest level's is, and
        scale_y: of its rows. Worked out here they would be divisions at every point: the compiler
            may move them.

    Returns:
        How many of the points the view shows on this level, and how many on other levels. All
        others get the weight 0.
    """
    m6, m7, m8, s2 = coefficients[6], coefficients[7], coefficients[8], coefficients[11]
    # From the finest level to this one: a pixel's middle is half of one from its corner.
    shift_x, shift_y = HALF * scale_x - HALF, HALF * scale_y - HALF
    m0, m1 = scale_x * coefficients[0] + shift_x * m6, scale_x * coefficients[1] + shift_x * m7
    m2, s0 = scale_x * coefficients[2] + shift_x * m8, scale_x * coefficients[9] + shift_x * s2
    m3, m4 = scale_y * coefficients[3] + shift_y * m6, scale_y * coefficients[4] + shift_y * m7
    m5, s1 = scale_y * coefficients[5] + shift_y * m8, scale_y * coefficients[10] + shift_y * s2
    right, bottom = np.float32(width) - HALF, np.float32(height) - HALF
    last_x, last_y = np.float32(width - 1), np.float32(height - 1)
    # The texel on the right and the row below are there; at the border they get all the weight.
    last_left, last_top = max(last_x - ONE, ZERO), max(last_y - ONE, ZERO)
    here, elsewhere = ZERO, ZERO
    for i in range(np.uintp(count)):
        x, y, d, weight = scratch[i + X], scratch[i + Y], scratch[i + SURFACE], scratch[i + WEIGHT]
        depth = m6 * x + m7 * y + m8 + s2 * d
        reciprocal = ONE / depth
        u = (m0 * x + m1 * y + m2 + s0 * d) * reciprocal
        v = (m3 * x + m4 * y + m5 + s1 * d) * reciprocal
        is_shown = (depth > ZERO) & (d > ZERO) & (weight > ZERO)
        is_shown &= (u >= -HALF) & (u <= right) & (v >= -HALF) & (v <= bottom)
        is_here = is_shown & (depth > nearest) & (depth <= farthest)
        here += ONE if is_here else ZERO
        elsewhere += ONE if is_shown & ~is_here else ZERO
        weight = weight if is_here else ZERO
        u = u if is_here else ZERO
        v = v if is_here else ZERO
        scratch[i + COLUMN] = u
        scratch[i + ROW] = v
        scratch[i + NEARNESS] = d * reciprocal
        u, v = min(max(u, ZERO), last_x), min(max(v, ZERO), last_y)
        left, top = np.int32(min(u, last_left)), np.int32(min(v, last_top))
        offsets[i] = top * width + left
        scratch[i + FRACTION] = u - np.float32(left)
        lower = weight * (v - np.float32(top))
        scratch[i + LOWER] = lower
        scratch[i + UPPER] = weight - lower
    return here, elsewhere


@compiled_leaf
def add_samples(
    scratch: Float32Array,
    offsets: Int32Array,
    targets: Int32Array,
    count: int,
    texels: ImageArray,
    start: int,
    width: int,
    image: Float32Array,
) -> None:
    """Adds a chunk's weighted colours to its pixels.

    Args:
        scratch: as the steps before left it.
        offsets: (CHUNK,) int32 index of each point's upper left texel in the level.
        targets: (CHUNK,) int32 the pixels.
        count: pixels of the chunk.
        texels: (T, 4); there may be more than 32 bits can count.
        start: index of the level's first texel.
        width: of the level.
        image: (P, 4) sums of weighted colours and of 255 times the weights, changed.
    """
    for i in range(np.uintp(count)):
        upper = start + np.int64(offsets[i])
        add_texels(
            texels,
            upper,
            upper + width,
            scratch[i + FRACTION],
            scratch[i + UPPER],
            scratch[i + LOWER],
            image,
            targets[i],
        )
