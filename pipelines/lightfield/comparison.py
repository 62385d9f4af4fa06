"""How different is a rendered view from a camera image? One cost in [0, 1] for each.

All costs share one signature, so that the filter can use any. The paper compares pixel by pixel
(``squared``, section 6); the others stand beside it for light that changes (``zncc``, ``gradient``)
and for things that are not in the model (``robust``). A pixel that no view covers costs as much as
a bad one, so that looking at nothing never wins.
"""

from enum import IntEnum

import numpy as np

from pipelines.artifacts.array_types import BoolArray, Float32Array, FloatArray
from pipelines.lightfield.compiled import compiled, compiled_leaf


class Cost(IntEnum):
    """The kinds of comparison.

    SQUARED: mean squared colour difference, the paper's, relative to 255^2.
    ROBUST: mean absolute colour difference, each limited to ``ROBUST_LIMIT``, relative to that.
    ZNCC: (1 - zero-mean normalised cross-correlation) / 2, over all three channels together.
    GRADIENT: mean absolute difference of horizontal and vertical gradients, limited like ROBUST.
    """

    SQUARED = 0
    ROBUST = 1
    ZNCC = 2
    GRADIENT = 3


# Grey levels of 255. Differences beyond the limit are "something else", however large.
ROBUST_LIMIT = 64.0
GRADIENT_LIMIT = 32.0
# What an uncovered pixel costs, on each cost's own scale: about what unrelated image parts cost.
UNCOVERED_SQUARED = 0.06
UNCOVERED_ROBUST = 0.8
UNCOVERED_ZNCC = 0.5
UNCOVERED_GRADIENT = 0.5
# Gains beyond this factor are no exposure change but another place.
LARGEST_GAIN = 1.5


@compiled_leaf
def best_gain(image: Float32Array, covered: BoolArray, query: Float32Array) -> float:
    """The factor, between 1 / LARGEST_GAIN and LARGEST_GAIN, that fits the image best."""
    product, square = 0.0, 0.0
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            if covered[y, x] and not np.isnan(query[y, x, 0]):
                for channel in range(3):
                    value = image[y, x, channel]
                    product += value * query[y, x, channel]
                    square += value * value
    if square <= 0.0:
        return 1.0
    return float(min(max(product / square, 1.0 / LARGEST_GAIN), LARGEST_GAIN))


@compiled_leaf
def trimmed_gain(image: Float32Array, covered: BoolArray, query: Float32Array) -> float:
    """Like ``best_gain``, from those colours alone that are nearly equal already.

    What stands in front of the scene must not change the brightness of what is seen beside it.
    """
    product, square = 0.0, 0.0
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            if covered[y, x] and not np.isnan(query[y, x, 0]):
                for channel in range(3):
                    value = image[y, x, channel]
                    if abs(value - query[y, x, channel]) < ROBUST_LIMIT:
                        product += value * query[y, x, channel]
                        square += value * value
    if square <= 0.0:
        return 1.0
    return float(min(max(product / square, 1.0 / LARGEST_GAIN), LARGEST_GAIN))


@compiled
def compare(
    kind: int, image: Float32Array, covered: BoolArray, query: Float32Array, fit_gain: bool
) -> float:
    """The cost of one rendered view.

    Args:
        kind: a ``Cost``.
        image: (H, W, 3) rendered, 0 to 255.
        covered: (H, W).
        query: (H, W, 3) camera image, 0 to 255; NaN where it is not to be compared.
        fit_gain: whether one brightness factor is fitted first.

    Returns:
        Cost in [0, 1]; smaller is better.
    """
    gain = np.float32(1.0)
    if fit_gain and kind == 1:
        gain = np.float32(trimmed_gain(image, covered, query))
    elif fit_gain:
        gain = np.float32(best_gain(image, covered, query))
    if kind == 0:
        return _squared(image, covered, query, gain)
    if kind == 1:
        return _robust(image, covered, query, gain)
    if kind == 2:
        return _correlation(image, covered, query)
    return _gradient(image, covered, query, gain)


@compiled_leaf
def _squared(
    image: Float32Array, covered: BoolArray, query: Float32Array, gain: np.float32
) -> float:
    total, count = 0.0, 0
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            if np.isnan(query[y, x, 0]):
                continue
            count += 1
            if covered[y, x]:
                for channel in range(3):
                    difference = gain * image[y, x, channel] - query[y, x, channel]
                    total += difference * difference
            else:
                total += 3.0 * 255.0 * 255.0 * UNCOVERED_SQUARED
    return float(total / (3.0 * 255.0 * 255.0 * max(count, 1)))


@compiled_leaf
def _robust(
    image: Float32Array, covered: BoolArray, query: Float32Array, gain: np.float32
) -> float:
    total, count = 0.0, 0
    limit = np.float32(ROBUST_LIMIT)
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            if np.isnan(query[y, x, 0]):
                continue
            count += 1
            if covered[y, x]:
                for channel in range(3):
                    difference = abs(gain * image[y, x, channel] - query[y, x, channel])
                    total += min(difference, limit)
            else:
                total += 3.0 * ROBUST_LIMIT * UNCOVERED_ROBUST
    return float(total / (3.0 * ROBUST_LIMIT * max(count, 1)))


@compiled
def _correlation(image: Float32Array, covered: BoolArray, query: Float32Array) -> float:
    count, compared = 0, 0
    sums = np.zeros(5)
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            if np.isnan(query[y, x, 0]):
                continue
            compared += 1
            if covered[y, x]:
                count += 1
                for channel in range(3):
                    a, b = float(image[y, x, channel]), float(query[y, x, channel])
                    sums[0] += a
                    sums[1] += b
                    sums[2] += a * a
                    sums[3] += b * b
                    sums[4] += a * b
    share = count / max(compared, 1)
    if count == 0:
        return UNCOVERED_ZNCC
    n = 3.0 * count
    variance_a = sums[2] - sums[0] * sums[0] / n
    variance_b = sums[3] - sums[1] * sums[1] / n
    correlation = 0.0
    # Below one grey level of contrast there is nothing to correlate.
    if variance_a > n and variance_b > n:
        correlation = (sums[4] - sums[0] * sums[1] / n) / np.sqrt(variance_a * variance_b)
    return float(share * (1.0 - correlation) / 2.0 + (1.0 - share) * UNCOVERED_ZNCC)


@compiled_leaf
def _gradient(
    image: Float32Array, covered: BoolArray, query: Float32Array, gain: np.float32
) -> float:
    total = 0.0
    count = 0
    limit = np.float32(GRADIENT_LIMIT)
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            for step in range(2):
                other_y, other_x = y + step, x + 1 - step
                if other_y >= image.shape[0] or other_x >= image.shape[1]:
                    continue
                if np.isnan(query[y, x, 0]) or np.isnan(query[other_y, other_x, 0]):
                    continue
                count += 1
                if not (covered[y, x] and covered[other_y, other_x]):
                    total += 3.0 * GRADIENT_LIMIT * UNCOVERED_GRADIENT
                    continue
                for channel in range(3):
                    rendered = image[other_y, other_x, channel] - image[y, x, channel]
                    taken = query[other_y, other_x, channel] - query[y, x, channel]
                    total += min(abs(gain * rendered - taken), limit)
    return float(total / (3.0 * GRADIENT_LIMIT * max(count, 1)))


@compiled
def compare_all(
    kind: int,
    images: Float32Array,
    covered: BoolArray,
    query: Float32Array,
    fit_gain: bool,
    costs: FloatArray,
) -> None:
    """Writes the costs (B,) of B rendered views (B, H, W, 3); see ``compare``."""
    for index in range(len(images)):
        costs[index] = compare(kind, images[index], covered[index], query, fit_gain)
