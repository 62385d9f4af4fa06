"""The inner loops of direct image alignment: errors, weights and normal equations of one view."""

import numpy as np

from pipelines.artifacts.array_types import BoolArray, Float32Array, FloatArray
from pipelines.lightfield.compiled import compiled, compiled_leaf, compiled_loop

# A pixel whose neighbours differ by less than so many grey levels says nothing about the pose.
FLAT = 10.0
# Sums over a pixel's channels, see ``_add_channels``.
SUMS = 14
# Numbers of an unknown: how it turns and shifts points, and how it moves a pixel.
MOTION_NUMBERS = 8
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
    motions, sums = np.empty((len(axes), MOTION_NUMBERS)), np.empty(SUMS)
    _add_normal_equations(
        image,
        inverse_depth,
        target,
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
        sums,
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
    sums: FloatArray,
    hessian: FloatArray,
    clusters: FloatArray,
) -> None:
    """``normal_equations``, of whose arguments most are.

    Args:
        image: see there, as all up to tiles_across.
        inverse_depth: see there.
        target: see there.
        gain: see there.
        offset: see there.
        limit: see there.
        intrinsics: see there.
        rotation: see there.
        lever: see there.
        axes: see there.
        turns: see there.
        tiles_across: see there.
        motions: (D, MOTION_NUMBERS) overwritten: turning and shifting, see ``_set_motions``, and
            how the pixel at hand moves, two numbers.
        sums: (SUMS,) overwritten.
        hessian: (D + 2, D + 2) zeros, receives the sum.
        clusters: (tiles, D + 2) zeros, receives the gradient of each tile.
    """
    height, width = inverse_depth.shape
    unknowns = len(axes)
    _set_motions(rotation, lever, axes, turns, motions)
    for y in range(1, height - 1):
        tile_row = y * tiles_across // height * tiles_across
        for x in range(1, width - 1):
            if not _add_channels(image, target, x, y, gain, offset, 1.0 / limit, sums):
                continue
            ray_x = (x - intrinsics[2]) / intrinsics[0]
            ray_y = (y - intrinsics[3]) / intrinsics[1]
            nearness = np.float64(inverse_depth[y, x])
            for k in range(unknowns):
                wx, wy, wz = motions[k, 0], motions[k, 1], motions[k, 2]
                depth_step = wx * ray_y - wy * ray_x + nearness * motions[k, 5]
                x_step = wy - wz * ray_y + nearness * motions[k, 3]
                y_step = wz * ray_x - wx + nearness * motions[k, 4]
                motions[k, 6] = intrinsics[0] * (x_step - ray_x * depth_step)
                motions[k, 7] = intrinsics[1] * (y_step - ray_y * depth_step)
            tile = tile_row + x * tiles_across // width
            for k in range(unknowns):
                ax, ay = motions[k, 6], motions[k, 7]
                by_x, by_y = sums[0] * ax + sums[1] * ay, sums[1] * ax + sums[2] * ay
                clusters[tile, k] += sums[3] * ax + sums[4] * ay
                for other in range(k, unknowns):
                    hessian[k, other] += by_x * motions[other, 6] + by_y * motions[other, 7]
                hessian[k, unknowns] += sums[5] * ax + sums[6] * ay
                hessian[k, unknowns + 1] += sums[7] * ax + sums[8] * ay
            clusters[tile, unknowns] += sums[9]
            clusters[tile, unknowns + 1] += sums[10]
            hessian[unknowns, unknowns] += sums[11]
            hessian[unknowns, unknowns + 1] += sums[12]
            hessian[unknowns + 1, unknowns + 1] += sums[13]
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
        motions: (D, MOTION_NUMBERS) whose first three numbers receive w, which is zero for shifts,
            and the next three t.
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
def _add_channels(
    image: Float32Array,
    target: Float32Array,
    x: int,
    y: int,
    gain: float,
    offset: float,
    inverse_limit: float,
    sums: FloatArray,
) -> bool:
    """Writes one pixel's weighted sums over the channels; False where it says nothing.

    With slopes g and h across and down, error e, value v and weight w, they are those of
    w g g, w g h, w h h, w g e, w h e, w g v, w h v, w g, w h, w v e, w e, w v v, w v, w.
    """
    around = image[y - 1, x, 3] * image[y + 1, x, 3] * image[y, x - 1, 3] * image[y, x + 1, 3]
    if around * image[y, x, 3] * target[y, x, 3] == NOTHING:
        return False
    steepest = NOTHING
    for channel in range(3):
        across = image[y, x + 1, channel] - image[y, x - 1, channel]
        down = image[y + 1, x, channel] - image[y - 1, x, channel]
        steepest = max(steepest, abs(across), abs(down))
    if steepest < FLAT:
        return False
    for i in range(SUMS):
        sums[i] = 0.0
    for channel in range(3):
        value = np.float64(image[y, x, channel])
        error = gain * value + offset - np.float64(target[y, x, channel])
        ratio = error * inverse_limit
        inside = max(1.0 - ratio * ratio, 0.0)
        weight = inside * inside
        g = 0.5 * gain * np.float64(image[y, x + 1, channel] - image[y, x - 1, channel])
        h = 0.5 * gain * np.float64(image[y + 1, x, channel] - image[y - 1, x, channel])
        wg, wh, wv = weight * g, weight * h, weight * value
        sums[0] += wg * g
        sums[1] += wg * h
        sums[2] += wh * h
        sums[3] += wg * error
        sums[4] += wh * error
        sums[5] += wg * value
        sums[6] += wh * value
        sums[7] += wg
        sums[8] += wh
        sums[9] += wv * error
        sums[10] += weight * error
        sums[11] += wv * value
        sums[12] += wv
        sums[13] += weight
    return True
