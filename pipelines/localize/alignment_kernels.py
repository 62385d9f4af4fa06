"""The inner loops of direct image alignment: errors, weights and normal equations of one view."""

import numpy as np

from pipelines.artifacts.array_types import BoolArray, Float32Array, FloatArray
from pipelines.lightfield.compiled import compiled, compiled_leaf, compiled_loop

# A pixel whose neighbours differ by less than so many grey levels says nothing about the pose.
FLAT = 10.0
# Sums over a pixel's channels, see ``_set_sums``.
SUMS = 14
# Numbers of an unknown: how it turns and shifts points.
MOTION_NUMBERS = 6
# Numbers of an unknown and a pixel: how it moves the pixel, across and down, and these times the
# pixel's matrix of slopes.
MOVES = 4
# A row's pixels are worked on so many at a time. What is kept of them stands in flat arrays, number
# by number at this distance, which lets the compiler work on several pixels at once: the kernel
# takes 0.6 of the time that it takes pixel by pixel.
CHUNK = 64
ONE, NOTHING = np.float32(1.0), np.float32(0.0)


@compiled
def robust_error(
    view: Float32Array, target: Float32Array, gain: float, offset: float, limit: float
) -> float:
    """Mean of Tukey's loss over all pixels, squared grey levels; an uncovered one costs the most.

    Args:
        view: (H, W, 4) rendered, and 1 where covered.
        target: (H, W, 4) camera image, and 1 where it is to be compared.
        gain: factor on the rendered view.
        offset: added to it.
        limit: error beyond which a pixel counts as something else, grey levels.
    """
    total, count = 0.0, 0.0
    for y in range(len(view)):
        sums = _loss_sums(
            view[y].reshape(-1),
            target[y].reshape(-1),
            np.float32(gain / limit),
            np.float32(offset / limit),
            np.float32(1.0 / limit),
        )
        total += float(sums[0])
        count += float(sums[1])
    return float(total * limit * limit / 6.0 / (3.0 * max(count, 1.0)))


@compiled_loop
def _loss_sums(
    view: Float32Array,
    target: Float32Array,
    gain: np.float32,
    offset: np.float32,
    scale: np.float32,
) -> tuple[np.float32, np.float32]:
    """Sum of the losses of one row, relative to the largest, and number of pixels compared."""
    total, count = NOTHING, NOTHING
    for i in range(len(view) // 4):
        used = target[4 * i + 3]
        count += used
        seen = used * view[4 * i + 3]
        for channel in range(3):
            error = gain * view[4 * i + channel] + offset - scale * target[4 * i + channel]
            inside = max(ONE - error * error, NOTHING)
            total += used - seen * inside * inside * inside
    return total, count


def normal_equations(
    image: Float32Array,
    inverse_depth: Float32Array,
    target: Float32Array,
    gain: float,
    offset: float,
    limit: float,
    intrinsics: FloatArray,
    rotation: FloatArray,
    lever: FloatArray,
    axes: FloatArray,
    turns: BoolArray,
    tiles_across: int,
) -> tuple[FloatArray, FloatArray]:
    """The weighted normal equations of one comparison.

    A surface point at offset Y from the camera's centre, in its axes, moves by
    -R^T (dp + w x (X - p)) when the body at p is shifted by dp and turned by w; divided by its
    depth this stays finite for points far away. Its colour is taken to move along.

    Args:
        image: (H, W, 4) rendered, and 1 where covered.
        inverse_depth: (H, W) of the surface.
        target: (H, W, 4) camera image, and 1 where it is to be compared.
        gain: see ``robust_error``, as offset and limit.
        offset: see there.
        limit: see there.
        intrinsics: (4,) fx, fy, cx, cy.
        rotation: (3, 3) of world_from_camera.
        lever: (3,) from the body's origin to the camera's centre, world axes.
        axes: (D, 3) world axis of each unknown.
        turns: (D,) whether the unknown is a turn about its axis, or a shift along it.
        tiles_across: the image's gradients are kept apart for so many times so many tiles.

    Returns:
        The Hessian (D + 2, D + 2), whose last two unknowns are gain and offset, and the gradient of
        each tile (tiles, D + 2).
    """
    count = len(axes) + 2
    hessian, clusters = np.zeros((count, count)), np.zeros((tiles_across**2, count))
    motions, moves = np.empty((len(axes), MOTION_NUMBERS)), np.empty((len(axes), MOVES * CHUNK))
    sums, ray = np.empty(SUMS * CHUNK), np.empty(image.shape[1])
    _add_normal_equations(
        image.reshape(-1),
        inverse_depth,
        target.reshape(-1),
        gain,
        offset,
        limit,
        intrinsics,
        rotation,
        lever,
        axes,
        turns,
        tiles_across,
        motions,
        moves,
        sums,
        ray,
        hessian,
        clusters,
    )
    return hessian, clusters


@compiled
def _add_normal_equations(
    image: Float32Array,
    inverse_depth: Float32Array,
    target: Float32Array,
    gain: float,
    offset: float,
    limit: float,
    intrinsics: FloatArray,
    rotation: FloatArray,
    lever: FloatArray,
    axes: FloatArray,
    turns: BoolArray,
    tiles_across: int,
    motions: FloatArray,
    moves: FloatArray,
    sums: FloatArray,
    ray: FloatArray,
    hessian: FloatArray,
    clusters: FloatArray,
) -> None:
    """``normal_equations``, of whose arguments most are.

    Args:
        image: see there, as all up to tiles_across; flat.
        inverse_depth: see there.
        target: see there; flat.
        gain: see there.
        offset: see there.
        limit: see there.
        intrinsics: see there.
        rotation: see there.
        lever: see there.
        axes: see there.
        turns: see there.
        tiles_across: see there.
        motions: (D, MOTION_NUMBERS) overwritten, see ``_set_motions``.
        moves: (D, MOVES CHUNK) overwritten, see ``_set_moves``.
        sums: (SUMS CHUNK,) overwritten, see ``_set_sums``.
        ray: (W,) overwritten.
        hessian: (D + 2, D + 2) zeros, receives the sum.
        clusters: (tiles, D + 2) zeros, receives the gradient of each tile.
    """
    height, width = inverse_depth.shape
    unknowns = len(axes)
    _set_motions(rotation, lever, axes, turns, motions)
    for x in range(width):
        ray[x] = (x - intrinsics[2]) / intrinsics[0]
    for y in range(1, height - 1):
        ray_y = (y - intrinsics[3]) / intrinsics[1]
        tile_row = y * tiles_across // height * tiles_across
        for first in range(1, width - 1, CHUNK):
            last = min(first + CHUNK, width - 1)
            start, end = 4 * (y * width + first), 4 * (y * width + last)
            _set_sums(
                image[start - 4 * width : end - 4 * width],
                image[start - 4 : end + 4],
                image[start + 4 * width : end + 4 * width],
                target[start:end],
                gain,
                offset,
                1.0 / limit,
                sums,
            )
            for k in range(unknowns):
                _set_moves(
                    motions[k],
                    inverse_depth[y, first:last],
                    ray[first:last],
                    ray_y,
                    intrinsics[0],
                    intrinsics[1],
                    sums,
                    moves[k],
                )
            _add_hessian(sums, moves, last - first, hessian)
            for column in range(first * tiles_across // width, tiles_across):
                # The pixels whose tile, x * tiles_across // width, is this one.
                left = max(first, -(-column * width // tiles_across))
                right = min(last, -(-(column + 1) * width // tiles_across))
                if left >= last:
                    break
                tile = clusters[tile_row + column]
                _add_gradient(sums, moves, left - first, right - first, tile)
    for k in range(unknowns + 2):
        for other in range(k):
            hessian[k, other] = hessian[other, k]


@compiled_leaf
def _set_motions(
    rotation: FloatArray,
    lever: FloatArray,
    axes: FloatArray,
    turns: BoolArray,
    motions: FloatArray,
) -> None:
    """Writes how surface points move against the camera for each unknown, in its axes.

    Shifted or turned by a unit, the camera sees a point on the ray r at inverse depth d move by
    -(w x r + d t), times its depth.

    Args:
        rotation: (3, 3), lever: (3,), axes: (D, 3), turns: (D,) as for ``normal_equations``.
        lever: see there.
        axes: see there.
        turns: see there.
        motions: (D, MOTION_NUMBERS) receives w, which is zero for shifts, and t.
    """
    for k in range(len(axes)):
        for i in range(3):
            own, arm = 0.0, 0.0
            for j in range(3):
                own += rotation[j, i] * axes[k, j]
                # The cross product of axis and lever.
                p, q = (j + 1) % 3, (j + 2) % 3
                arm += rotation[j, i] * (axes[k, p] * lever[q] - axes[k, q] * lever[p])
            motions[k, i] = own if turns[k] else 0.0
            motions[k, 3 + i] = arm if turns[k] else own


@compiled_leaf
def _add_hessian(sums: FloatArray, moves: FloatArray, count: int, hessian: FloatArray) -> None:
    """Adds so many pixels' part to the upper half of the Hessian.

    Args:
        sums: see ``_set_sums``.
        moves: (D, MOVES CHUNK) see ``_set_moves``.
        count: of pixels.
        hessian: (D + 2, D + 2) changed.
    """
    unknowns = len(moves)
    for k in range(unknowns):
        for other in range(k, unknowns):
            hessian[k, other] += _products(moves[k], 2, moves[other], 0, 0, count)
        hessian[k, unknowns] += _products(sums, 5, moves[k], 0, 0, count)
        hessian[k, unknowns + 1] += _products(sums, 7, moves[k], 0, 0, count)
    hessian[unknowns, unknowns] += _sum(sums, 11, 0, count)
    hessian[unknowns, unknowns + 1] += _sum(sums, 12, 0, count)
    hessian[unknowns + 1, unknowns + 1] += _sum(sums, 13, 0, count)


@compiled_leaf
def _add_gradient(
    sums: FloatArray, moves: FloatArray, start: int, end: int, gradient: FloatArray
) -> None:
    """Adds some pixels' part to the gradient of their tile.

    Args:
        sums: see ``_set_sums``.
        moves: (D, MOVES CHUNK) see ``_set_moves``.
        start: the first of the pixels, and
        end: the one behind the last.
        gradient: (D + 2,) changed.
    """
    unknowns = len(moves)
    for k in range(unknowns):
        gradient[k] += _products(sums, 3, moves[k], 0, start, end)
    gradient[unknowns] += _sum(sums, 9, start, end)
    gradient[unknowns + 1] += _sum(sums, 10, start, end)


@compiled_loop
def _set_sums(
    above: Float32Array,
    row: Float32Array,
    below: Float32Array,
    target: Float32Array,
    gain: float,
    offset: float,
    inverse_limit: float,
    sums: FloatArray,
) -> None:
    """Writes weighted sums over the channels of n pixels of a row; zeros where one says nothing.

    With slopes g and h across and down, error e, value v and weight w, they are those of
    w g g, w g h, w h h, w g e, w h e, w g v, w h v, w g, w h, w v e, w e, w v v, w v, w.

    Args:
        above: (4 n,) the rendered pixels above them, flat.
        row: (4 n + 8,) the rendered pixels, with one more before and one more behind.
        below: (4 n,) those below.
        target: (4 n,) of the camera image.
        gain: see ``robust_error``, as offset.
        offset: see there.
        inverse_limit: 1 / limit.
        sums: (SUMS CHUNK,) receives the result, number by number.
    """
    for x in range(len(target) // 4):
        i = 4 * x
        around = above[i + 3] * below[i + 3] * row[i + 3] * row[i + 11]
        used = np.float64(around * row[i + 7] * target[i + 3])
        steepest = NOTHING
        gg, gh, hh, ge, he, gv, hv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        g1, h1, ve, e1, vv, v1, w1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for channel in range(3):
            across = row[i + 8 + channel] - row[i + channel]
            down = below[i + channel] - above[i + channel]
            steepest = max(steepest, abs(across), abs(down))
            value = np.float64(row[i + 4 + channel])
            error = gain * value + offset - np.float64(target[i + channel])
            ratio = error * inverse_limit
            inside = max(1.0 - ratio * ratio, 0.0)
            weight = inside * inside
            g, h = 0.5 * gain * np.float64(across), 0.5 * gain * np.float64(down)
            wg, wh, wv = weight * g, weight * h, weight * value
            gg += wg * g
            gh += wg * h
            hh += wh * h
            ge += wg * error
            he += wh * error
            gv += wg * value
            hv += wh * value
            g1 += wg
            h1 += wh
            ve += wv * error
            e1 += weight * error
            vv += wv * value
            v1 += wv
            w1 += weight
        used *= np.float64(steepest >= FLAT)
        sums[x] = used * gg
        sums[CHUNK + x] = used * gh
        sums[2 * CHUNK + x] = used * hh
        sums[3 * CHUNK + x] = used * ge
        sums[4 * CHUNK + x] = used * he
        sums[5 * CHUNK + x] = used * gv
        sums[6 * CHUNK + x] = used * hv
        sums[7 * CHUNK + x] = used * g1
        sums[8 * CHUNK + x] = used * h1
        sums[9 * CHUNK + x] = used * ve
        sums[10 * CHUNK + x] = used * e1
        sums[11 * CHUNK + x] = used * vv
        sums[12 * CHUNK + x] = used * v1
        sums[13 * CHUNK + x] = used * w1


@compiled_loop
def _set_moves(
    motion: FloatArray,
    nearness: Float32Array,
    ray: FloatArray,
    ray_y: float,
    focal_x: float,
    focal_y: float,
    sums: FloatArray,
    moves: FloatArray,
) -> None:
    """Writes how an unknown moves each of n pixels of a row.

    Args:
        motion: (MOTION_NUMBERS,) of the unknown, see ``_set_motions``.
        nearness: (n,) inverse depths.
        ray: (n,) the pixels' rays, across, and
        ray_y: down.
        focal_x: pixels, as
        focal_y: is.
        sums: see ``_set_sums``; the first three are the matrix of slopes.
        moves: (MOVES CHUNK,) receives the result, number by number.
    """
    wx, wy, wz = motion[0], motion[1], motion[2]
    tx, ty, tz = motion[3], motion[4], motion[5]
    for x in range(len(nearness)):
        near = np.float64(nearness[x])
        depth_step = wx * ray_y - wy * ray[x] + near * tz
        across = focal_x * (wy - wz * ray_y + near * tx - ray[x] * depth_step)
        down = focal_y * (wz * ray[x] - wx + near * ty - ray_y * depth_step)
        moves[x] = across
        moves[CHUNK + x] = down
        moves[2 * CHUNK + x] = sums[x] * across + sums[CHUNK + x] * down
        moves[3 * CHUNK + x] = sums[CHUNK + x] * across + sums[2 * CHUNK + x] * down


@compiled_loop
def _products(a: FloatArray, first: int, b: FloatArray, second: int, start: int, end: int) -> float:
    """Over some pixels, the sum of the products of two numbers each of a and b.

    Args:
        a: numbers of pixels, CHUNK of each.
        first: which of these; the one behind it is the other.
        b: likewise.
        second: likewise.
        start: the first pixel, and
        end: the one behind the last.
    """
    total = 0.0
    i, j = first * CHUNK, second * CHUNK
    for x in range(start, end):
        total += a[i + x] * b[j + x] + a[i + CHUNK + x] * b[j + CHUNK + x]
    return total


@compiled_loop
def _sum(a: FloatArray, number: int, start: int, end: int) -> float:
    """Over some pixels, the sum of one of their numbers; see ``_products``."""
    total = 0.0
    for x in range(number * CHUNK + start, number * CHUNK + end):
        total += a[x]
    return total
