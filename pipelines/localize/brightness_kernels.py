"""Gain and offset between a rendered view and a camera image, robustly, compiled."""

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray, IntArray
from pipelines.lightfield.compiled import compiled, compiled_leaf, compiled_loop

# Standard deviation of a normal distribution over its median absolute deviation.
MAD_TO_SIGMA = 1.4826
# Rounds of reweighting in which the brightness settles.
BRIGHTNESS_ROUNDS = 3
# A bin is an eighth of a grey level wide, or a quarter where both signs are counted.
HISTOGRAM_BINS = 2041


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
    most = 3 * -(-height // stride) * -(-width // stride)
    values, wanted, errors = np.empty((3, most))
    histogram = np.empty(HISTOGRAM_BINS, np.int64)
    return _fit(
        view,
        target,
        stride,
        cutoff,
        smallest_scale,
        largest_gain,
        values,
        wanted,
        errors,
        histogram,
    )


@compiled_leaf
def _gather(
    view: Float32Array, target: Float32Array, stride: int, values: FloatArray, wanted: FloatArray
) -> int:
    """Writes the values of the channels of compared pixels, and what is wanted; their number."""
    count = 0
    for y in range(0, view.shape[0], stride):
        for x in range(0, view.shape[1], stride):
            if view[y, x, 3] * target[y, x, 3] > 0.0:
                for channel in range(3):
                    values[count] = view[y, x, channel]
                    wanted[count] = target[y, x, channel]
                    count += 1
    return count


@compiled
def _fit(
    view: Float32Array,
    target: Float32Array,
    stride: int,
    cutoff: float,
    smallest_scale: float,
    largest_gain: float,
    values: FloatArray,
    wanted: FloatArray,
    errors: FloatArray,
    histogram: IntArray,
) -> tuple[float, float, float]:
    """``fitted_brightness``, of whose arguments most are.

    Args:
        view: see there, as all up to largest_gain.
        target: see there.
        stride: see there.
        cutoff: see there.
        smallest_scale: see there.
        largest_gain: see there.
        values: (n,) for three of each pixel that is used, overwritten; so are the next two.
        wanted: likewise.
        errors: likewise.
        histogram: (HISTOGRAM_BINS,) overwritten.
    """
    count = _gather(view, target, stride, values, wanted)
    if count == 0:
        return 1.0, 0.0, smallest_scale
    values, wanted, errors = values[:count], wanted[:count], errors[:count]
    for i in range(len(values)):
        errors[i] = wanted[i] - values[i]
    gain, offset = 1.0, binned_median(errors, -255.0, 255.0, histogram)
    scale = smallest_scale
    for step in range(BRIGHTNESS_ROUNDS + 1):
        for i in range(len(values)):
            errors[i] = abs(gain * values[i] + offset - wanted[i])
        median = binned_median(errors, 0.0, 255.0, histogram)
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
