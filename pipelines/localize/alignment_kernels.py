"""The inner loops of direct image alignment: errors, weights and normal equations of one view."""

import numpy as np

from pipelines.artifacts.array_types import BoolArray, Float32Array, FloatArray
from pipelines.lightfield.compiled import compiled

# Standard deviation of a normal distribution over its median absolute deviation.
MAD_TO_SIGMA = 1.4826
# A pixel whose neighbours differ by less than so many grey levels says nothing about the pose.
FLAT = 4.0
# Rounds of reweighting in which the brightness settles.
BRIGHTNESS_ROUNDS = 3


@compiled
def fitted_brightness(
    image: Float32Array,
    covered: BoolArray,
    target: Float32Array,
    stride: int,
    cutoff: float,
    smallest_scale: float,
    largest_gain: float,
) -> tuple[float, float, float]:
    """Gain and offset that take a rendered view to the camera image, outliers apart.

    Iteratively reweighted least squares with Tukey's biweight.

    Args:
        image: (H, W, 3) rendered.
        covered: (H, W).
        target: (H, W, 3) camera image.
        stride: only every so many-th pixel of every so many-th row is used.
        cutoff: errors beyond so many standard deviations count as something else.
        smallest_scale: the standard deviation of the errors is taken for at least this.
        largest_gain: the gain stays between this and its inverse.

    Returns:
        Gain, offset and the standard deviation of what remains, estimated robustly; grey levels.
    """
    height, width = covered.shape
    values = np.empty(3 * ((height + stride - 1) // stride) * ((width + stride - 1) // stride))
    wanted = np.empty_like(values)
    count = 0
    for y in range(0, height, stride):
        for x in range(0, width, stride):
            if covered[y, x] and not np.isnan(target[y, x, 0]):
                for channel in range(3):
                    values[count] = image[y, x, channel]
                    wanted[count] = target[y, x, channel]
                    count += 1
    if count == 0:
        return 1.0, 0.0, smallest_scale
    values, wanted = values[:count], wanted[:count]
    gain, offset = 1.0, np.median(wanted - values)
    scale = smallest_scale
    for step in range(BRIGHTNESS_ROUNDS + 1):
        errors = gain * values + offset - wanted
        scale = max(smallest_scale, MAD_TO_SIGMA * np.median(np.abs(errors)))
        if step == BRIGHTNESS_ROUNDS:
            break
        sums = np.zeros(5)
        for i in range(count):
            inside = 1.0 - (errors[i] / (cutoff * scale)) ** 2
            if inside > 0.0:
                weight = inside * inside
                sums[0] += weight
                sums[1] += weight * values[i]
                sums[2] += weight * wanted[i]
                sums[3] += weight * values[i] * values[i]
                sums[4] += weight * values[i] * wanted[i]
        mean, wanted_mean = sums[1] / sums[0], sums[2] / sums[0]
        variance = sums[3] / sums[0] - mean * mean
        # Below one grey level of contrast there is no gain to be told.
        if variance < 1.0:
            break
        gain = (sums[4] / sums[0] - mean * wanted_mean) / variance
        gain = min(max(gain, 1.0 / largest_gain), largest_gain)
        offset = wanted_mean - gain * mean
    return gain, offset, scale


@compiled
def robust_error(
    image: Float32Array,
    covered: BoolArray,
    target: Float32Array,
    gain: float,
    offset: float,
    limit: float,
) -> float:
    """Mean of Tukey's loss over all pixels, squared grey levels; an uncovered one costs the most.

    Args:
        image: (H, W, 3) rendered.
        covered: (H, W).
        target: (H, W, 3) camera image; NaN where it is not to be compared.
        gain: factor on the rendered view.
        offset: added to it.
        limit: error beyond which a pixel counts as something else, grey levels.
    """
    total, count = 0.0, 0
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            if np.isnan(target[y, x, 0]):
                continue
            count += 1
            if not covered[y, x]:
                total += 3.0
                continue
            for channel in range(3):
                error = (gain * image[y, x, channel] + offset - target[y, x, channel]) / limit
                inside = max(1.0 - error * error, 0.0)
                total += 1.0 - inside * inside * inside
    return float(total * limit * limit / 6.0 / (3.0 * max(count, 1)))


@compiled
def normal_equations(
    image: Float32Array,
    covered: BoolArray,
    inverse_depth: FloatArray,
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
    hessian: FloatArray,
    clusters: FloatArray,
) -> None:
    """Adds up the weighted normal equations of one comparison.

    A surface point at offset Y from the camera's centre, in its axes, moves by
    -R^T (dp + w x (X - p)) when the body at p is shifted by dp and turned by w; divided by its
    depth this stays finite for points far away. Its colour is taken to move along.

    Args:
        image: (H, W, 3) rendered, covered: (H, W), inverse_depth: (H, W), target: (H, W, 3).
        covered: see there.
        inverse_depth: see there.
        target: see there.
        gain: see ``robust_error``, as offset and limit.
        offset: see there.
        limit: see there.
        intrinsics: (4,) fx, fy, cx, cy.
        rotation: (3, 3) of world_from_camera.
        lever: (3,) from the body's origin to the camera's centre, world axes.
        axes: (D, 3) world axis of each unknown.
        turns: (D,) whether the unknown is a turn about its axis, or a shift along it.
        tiles_across: the image's gradients are kept apart for so many times so many tiles.
        hessian: (D + 2, D + 2) receives the sum; the last two unknowns are gain and offset.
        clusters: (tiles, D + 2) receives the gradient of each tile.
    """
    height, width = covered.shape
    unknowns = len(axes)
    count = unknowns + 2
    along_x, along_y = np.empty(unknowns), np.empty(unknowns)
    row = np.empty(count)
    ray, arm, shift, motion = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for y in range(1, height - 1):
        for x in range(1, width - 1):
            if not (
                covered[y, x]
                and covered[y - 1, x]
                and covered[y + 1, x]
                and covered[y, x - 1]
                and covered[y, x + 1]
            ) or np.isnan(target[y, x, 0]):
                continue
            steepest = np.float32(0.0)
            for channel in range(3):
                across = image[y, x + 1, channel] - image[y, x - 1, channel]
                along = image[y + 1, x, channel] - image[y - 1, x, channel]
                steepest = max(steepest, abs(across), abs(along))
            if steepest < FLAT:
                continue
            ray[0] = (x - intrinsics[2]) / intrinsics[0]
            ray[1] = (y - intrinsics[3]) / intrinsics[1]
            ray[2] = 1.0
            nearness = inverse_depth[y, x]
            for i in range(3):
                arm[i] = nearness * lever[i]
                for j in range(3):
                    arm[i] += rotation[i, j] * ray[j]
            for k in range(unknowns):
                if turns[k]:
                    shift[0] = axes[k, 1] * arm[2] - axes[k, 2] * arm[1]
                    shift[1] = axes[k, 2] * arm[0] - axes[k, 0] * arm[2]
                    shift[2] = axes[k, 0] * arm[1] - axes[k, 1] * arm[0]
                else:
                    for i in range(3):
                        shift[i] = nearness * axes[k, i]
                for i in range(3):
                    motion[i] = 0.0
                    for j in range(3):
                        motion[i] -= rotation[j, i] * shift[j]
                along_x[k] = intrinsics[0] * (motion[0] - ray[0] * motion[2])
                along_y[k] = intrinsics[1] * (motion[1] - ray[1] * motion[2])
            tile = (y * tiles_across // height) * tiles_across + x * tiles_across // width
            for channel in range(3):
                value = image[y, x, channel]
                error = gain * value + offset - target[y, x, channel]
                inside = 1.0 - (error / limit) ** 2
                if inside <= 0.0:
                    continue
                weight = inside * inside
                slope_x = 0.5 * gain * (image[y, x + 1, channel] - image[y, x - 1, channel])
                slope_y = 0.5 * gain * (image[y + 1, x, channel] - image[y - 1, x, channel])
                for k in range(unknowns):
                    row[k] = -(slope_x * along_x[k] + slope_y * along_y[k])
                row[unknowns] = value
                row[unknowns + 1] = 1.0
                for k in range(count):
                    scaled = weight * row[k]
                    clusters[tile, k] += scaled * error
                    for other in range(k, count):
                        hessian[k, other] += scaled * row[other]
    for k in range(count):
        for other in range(k):
            hessian[k, other] = hessian[other, k]
