"""The inner loops of direct image alignment: errors, weights and normal equations of one view."""

import numpy as np

from pipelines.artifacts.array_types import BoolArray, Float32Array, FloatArray, IntArray
from pipelines.lightfield.compiled import compiled, compiled_leaf, compiled_loop

# Standard deviation of a normal distribution over its median absolute deviation.
MAD_TO_SIGMA = 1.4826
# A pixel whose neighbours differ by less than so many grey levels says nothing about the pose.
FLAT = 4.0
# Rounds of reweighting in which the brightness settles.
BRIGHTNESS_ROUNDS = 3
# A bin is an eighth of a grey level wide, or a quarter where both signs are counted.
HISTOGRAM_BINS = 2041
# Sums over a pixel's channels, see ``_add_channels``.
SUMS = 14
ONE, NOTHING = np.float32(1.0), np.float32(0.0)


@compiled
def fitted_brightness(
    view: Float32Array,
    target: Float32Array,
    stride: int,
    cutoff: float,
    smallest_scale: float,
    largest_gain: float,
) -> tuple[float, float, float]:
    """Gain and offset that take a rendered view to the camera image, outliers apart.

    Iteratively reweighted least squares with Tukey's biweight.

    Args:
        view: (H, W, 4) rendered, and 1 where covered.
        target: (H, W, 4) camera image, and 1 where it is to be compared.
        stride: only every so many-th pixel of every so many-th row is used.
        cutoff: errors beyond so many standard deviations count as something else.
        smallest_scale: the standard deviation of the errors is taken for at least this.
        largest_gain: the gain stays between this and its inverse.

    Returns:
        Gain, offset and the standard deviation of what remains, estimated robustly; grey levels.
    """
    height, width = view.shape[:2]
    values = np.empty(3 * ((height + stride - 1) // stride) * ((width + stride - 1) // stride))
    wanted = np.empty_like(values)
    count = 0
    for y in range(0, height, stride):
        for x in range(0, width, stride):
            if view[y, x, 3] * target[y, x, 3] > 0.0:
                for channel in range(3):
                    values[count] = view[y, x, channel]
                    wanted[count] = target[y, x, channel]
                    count += 1
    if count == 0:
        return 1.0, 0.0, smallest_scale
    values, wanted = values[:count], wanted[:count]
    histogram = np.empty(HISTOGRAM_BINS, np.int64)
    gain, offset = 1.0, binned_median(wanted - values, -255.0, 255.0, histogram)
    scale = smallest_scale
    for step in range(BRIGHTNESS_ROUNDS + 1):
        errors = gain * values + offset - wanted
        median = binned_median(np.abs(errors), 0.0, 255.0, histogram)
        scale = max(smallest_scale, MAD_TO_SIGMA * median)
        if step == BRIGHTNESS_ROUNDS:
            break
        weights, first, second, squares, products = _brightness_sums(
            values, wanted, errors, 1.0 / (cutoff * scale)
        )
        mean, wanted_mean = first / weights, second / weights
        variance = squares / weights - mean * mean
        # Below one grey level of contrast there is no gain to be told.
        if variance < 1.0:
            break
        gain = (products / weights - mean * wanted_mean) / variance
        gain = min(max(gain, 1.0 / largest_gain), largest_gain)
        offset = wanted_mean - gain * mean
    return gain, offset, scale


@compiled_leaf
def binned_median(values: FloatArray, low: float, high: float, histogram: IntArray) -> float:
    """The median of numbers (n,), to within a bin: exact enough for a scale, and much faster.

    Args:
        values: at least one.
        low: numbers below this count as it, and
        high: numbers above this as that.
        histogram: (HISTOGRAM_BINS,) overwritten.
    """
    histogram[:] = 0
    bins = len(histogram)
    scale = (bins - 1) / (high - low)
    for i in range(len(values)):
        place = min(max(values[i], low), high)
        histogram[int((place - low) * scale + 0.5)] += 1
    half, seen = (len(values) + 1) // 2, 0
    for i in range(bins):
        seen += histogram[i]
        if seen >= half:
            return low + i / scale
    return high


@compiled_loop
def _brightness_sums(
    values: FloatArray, wanted: FloatArray, errors: FloatArray, inverse_limit: float
) -> tuple[float, float, float, float, float]:
    """Sums of Tukey's weights, and of them times value, wanted, value^2 and value wanted."""
    weights, first, second, squares, products = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(values)):
        ratio = errors[i] * inverse_limit
        inside = max(1.0 - ratio * ratio, 0.0)
        weight = inside * inside
        weights += weight
        first += weight * values[i]
        second += weight * wanted[i]
        squares += weight * values[i] * values[i]
        products += weight * values[i] * wanted[i]
    return weights, first, second, squares, products


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


@compiled
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
    hessian: FloatArray,
    clusters: FloatArray,
) -> None:
    """Adds up the weighted normal equations of one comparison.

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
        hessian: (D + 2, D + 2) receives the sum; the last two unknowns are gain and offset.
        clusters: (tiles, D + 2) receives the gradient of each tile.
    """
    height, width = inverse_depth.shape
    unknowns = len(axes)
    count = unknowns + 2
    turning, shifting = np.zeros((unknowns, 3)), np.empty((unknowns, 3))
    _set_motions(rotation, lever, axes, turns, turning, shifting)
    along = np.empty((unknowns, 2))
    sums = np.empty(SUMS)
    for y in range(1, height - 1):
        tile_row = y * tiles_across // height * tiles_across
        for x in range(1, width - 1):
            if not _add_channels(image, target, x, y, gain, offset, 1.0 / limit, sums):
                continue
            ray_x = (x - intrinsics[2]) / intrinsics[0]
            ray_y = (y - intrinsics[3]) / intrinsics[1]
            nearness = np.float64(inverse_depth[y, x])
            for k in range(unknowns):
                wx, wy, wz = turning[k, 0], turning[k, 1], turning[k, 2]
                depth_step = wx * ray_y - wy * ray_x + nearness * shifting[k, 2]
                x_step = wy - wz * ray_y + nearness * shifting[k, 0]
                y_step = wz * ray_x - wx + nearness * shifting[k, 1]
                along[k, 0] = intrinsics[0] * (x_step - ray_x * depth_step)
                along[k, 1] = intrinsics[1] * (y_step - ray_y * depth_step)
            tile = tile_row + x * tiles_across // width
            for k in range(unknowns):
                ax, ay = along[k, 0], along[k, 1]
                by_x, by_y = sums[0] * ax + sums[1] * ay, sums[1] * ax + sums[2] * ay
                clusters[tile, k] += sums[3] * ax + sums[4] * ay
                for other in range(k, unknowns):
                    hessian[k, other] += by_x * along[other, 0] + by_y * along[other, 1]
                hessian[k, unknowns] += sums[5] * ax + sums[6] * ay
                hessian[k, unknowns + 1] += sums[7] * ax + sums[8] * ay
            clusters[tile, unknowns] += sums[9]
            clusters[tile, unknowns + 1] += sums[10]
            hessian[unknowns, unknowns] += sums[11]
            hessian[unknowns, unknowns + 1] += sums[12]
            hessian[unknowns + 1, unknowns + 1] += sums[13]
    for k in range(count):
        for other in range(k):
            hessian[k, other] = hessian[other, k]


@compiled_leaf
def _set_motions(
    rotation: FloatArray,
    lever: FloatArray,
    axes: FloatArray,
    turns: BoolArray,
    turning: FloatArray,
    shifting: FloatArray,
) -> None:
    """Writes how surface points move against the camera for each unknown, in its axes.

    Shifted or turned by a unit, the camera sees a point on the ray r at inverse depth d move by
    -(w x r + d t), times its depth.

    Args:
        rotation: (3, 3), lever: (3,), axes: (D, 3), turns: (D,) as for ``normal_equations``.
        lever: see there.
        axes: see there.
        turns: see there.
        turning: (D, 3) receives w; zero for shifts.
        shifting: (D, 3) receives t.
    """
    for k in range(len(axes)):
        for i in range(3):
            own, arm = 0.0, 0.0
            for j in range(3):
                own += rotation[j, i] * axes[k, j]
                # The cross product of axis and lever.
                p, q = (j + 1) % 3, (j + 2) % 3
                arm += rotation[j, i] * (axes[k, p] * lever[q] - axes[k, q] * lever[p])
            turning[k, i] = own if turns[k] else 0.0
            shifting[k, i] = arm if turns[k] else own


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
