"""How different is a rendered view from a camera image? One cost in [0, 1] for each.

All costs share one signature, so that the filter can use any. The paper compares pixel by pixel
(``squared``, section 6); the others stand beside it for light that changes (``zncc``, ``gradient``)
and for things that are not in the model (``robust``). A pixel that no view covers costs as much as
a bad one there, so that looking at nothing never wins.

``evidence`` is of another kind: each pixel adds what its difference says for "the map shows this
here" against "the map does not", as a table of logarithms has it (``pixel_evidence``). A pixel that
no view covers says nothing and adds 0, so that looking at nothing earns nothing.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from pipelines.artifacts.array_types import BoolArray, Float32Array, ImageArray, Int32Array
from pipelines.artifacts.errors import OptionError
from pipelines.lightfield.aligned_memory import aligned
from pipelines.lightfield.compiled import compiled_leaf, compiled_loop, compiled_part


class Cost(IntEnum):
    """The kinds of comparison.

    SQUARED: mean squared colour difference, the paper's, relative to 255^2.
    ROBUST: mean absolute colour difference, each limited to ``ROBUST_LIMIT``, relative to that.
    ZNCC: (1 - zero-mean normalised cross-correlation) / 2, over all three channels together.
    GRADIENT: mean absolute difference of horizontal and vertical gradients, limited like ROBUST.
    EVIDENCE: minus the sum of the pixels' logarithms of a likelihood ratio; not limited to [0, 1].
    """

    SQUARED = 0
    ROBUST = 1
    ZNCC = 2
    GRADIENT = 3
    EVIDENCE = 4


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
# Of EVIDENCE: differences, summed over the channels, are told apart in bins of so many levels, and
# count as the last one's beyond it; pixels by how strong they are, in so many rows.
EVIDENCE_BINS, EVIDENCE_ROWS = 24, 8
EVIDENCE_BIN = 10.0


# Numbers (four a pixel) that are added up in single precision, before the sum is kept in double.
BLOCK = 1024
ZERO, ONE = np.float32(0.0), np.float32(1.0)
LIMIT = np.float32(ROBUST_LIMIT)
# Of all costs but EVIDENCE.
NO_TABLE = np.empty(0, dtype=np.float32)


@dataclass(frozen=True)
class PixelEvidence:
    """What the difference of a pixel says for "the map shows this here" against "it does not".

    Attributes:
        edges: ``(EVIDENCE_ROWS - 1,)`` rising: strengths of a pixel between the rows. The strength
            is how far its channels are from 128, summed up.
        table: ``(EVIDENCE_ROWS, EVIDENCE_BINS)`` logarithms of the likelihood ratio of a difference
            in each bin, for a pixel of each row's strength.
        expected: ``(EVIDENCE_ROWS,)`` what a pixel of each row says on average at the right pose.
    """

    edges: Float32Array
    table: Float32Array
    expected: Float32Array

    def rows(self, channels: Float32Array) -> Float32Array:
        """The row ``(...)``, 0 to EVIDENCE_ROWS - 1, of pixels ``(..., 3)``."""
        strengths = pixel_strength(channels)
        return np.searchsorted(self.edges, strengths, side="right").astype(np.float32)


def pixel_strength(channels: Float32Array) -> Float32Array:
    """How far the channels of pixels ``(..., 3)`` are from 128, summed up: ``(...)``."""
    return np.asarray(np.abs(channels - np.float32(128.0)).sum(axis=-1), dtype=np.float32)


def evidence_table(cost: Cost, evidence: PixelEvidence | None) -> Float32Array:
    """What the comparison looks up, see ``compare``; nothing for any cost but EVIDENCE.

    Raises:
        OptionError: EVIDENCE without a table, or another cost with one.
    """
    if (cost is Cost.EVIDENCE) != (evidence is not None):
        raise OptionError("the cost EVIDENCE, and no other, takes a table of evidence")
    if evidence is None:
        return NO_TABLE
    return np.append(np.zeros(EVIDENCE_BINS, np.float32), evidence.table.reshape(-1))


def prepared(query: ImageArray | Float32Array) -> Float32Array:
    """A camera image as ``compare`` takes it.

    Args:
        query: ``(H, W, 3)``, 0 to 255; NaN where it is not to be compared.

    Returns:
        ``(H, W, 4)``: colours, zero where not to be compared, and 1 where they are, else 0.
    """
    known = _known(query)
    result = np.empty((*query.shape[:2], 4), dtype=np.float32)
    result[..., :3] = query
    if not known.all():
        result[~known] = 0.0
    result[..., 3] = known
    return result


def prepared_pixels(query: ImageArray | Float32Array) -> tuple[Int32Array, Float32Array]:
    """Those pixels of a camera image that are to be compared, as ``compare`` takes them.

    Args:
        query: as for ``prepared``.

    Returns:
        Their indices ``(P,)``, rising, and ``(1, P, 4)`` their colours, and 1.
    """
    chosen = np.flatnonzero(_known(query)).astype(np.int32)
    pixels = aligned(4 * len(chosen), np.float32).reshape((1, len(chosen), 4))
    pixels[0, :, :3] = query.reshape(-1, 3)[chosen]
    pixels[..., 3] = ONE
    return chosen, pixels


def _known(query: ImageArray | Float32Array) -> BoolArray:
    """Which pixels ``(H, W)`` of a camera image are to be compared."""
    image = np.asarray(query, dtype=np.float32)
    # Not a number in one channel is none in their sum.
    return np.asarray(np.isfinite(image[..., 0] + image[..., 1] + image[..., 2]))


@compiled_part
def compare(
    kind: int, image: Float32Array, query: Float32Array, fit_gain: bool, table: Float32Array
) -> float:
    """The cost of one rendered view.

    Args:
        kind: a ``Cost``.
        image: (H, W, 4) rendered, 0 to 255, and 1 where covered, else 0.
        query: (H, W, 4) camera image, see ``prepared``. For EVIDENCE its last number is, where the
            pixel is to be compared, 1 and the pixel's row of the table.
        fit_gain: whether one brightness factor is fitted first.
        table: of EVIDENCE alone, row by row: EVIDENCE_BINS zeros, then ``PixelEvidence.table``.

    Returns:
        Cost, in [0, 1] but for EVIDENCE; smaller is better.
    """
    a, b = image.reshape(-1), query.reshape(-1)
    if kind == 4:
        return _evidence_cost(a, b, table)
    if kind == 2:
        return _correlation(a, b)
    gain = ONE
    if fit_gain:
        gain = np.float32(fitted_gain(a, b, kind == 1))
    if kind == 3:
        return _gradient(image, query, gain)
    return _difference(a, b, gain, kind == 1)


@compiled_loop
def _gain_sums(
    image: Float32Array, query: Float32Array, limit: np.float32
) -> tuple[np.float32, np.float32]:
    """Sums of products and of squares over the colours that differ by less than ``limit``."""
    product, square = ZERO, ZERO
    for i in range(len(image) // 4):
        used = image[4 * i + 3] * query[4 * i + 3]
        for channel in range(3):
            value, wanted = image[4 * i + channel], query[4 * i + channel]
            weight = used if abs(value - wanted) < limit else ZERO
            product += weight * value * wanted
            square += weight * value * value
    return product, square


@compiled_leaf
def fitted_gain(image: Float32Array, query: Float32Array, trimmed: bool) -> float:
    """The factor, between 1 / LARGEST_GAIN and LARGEST_GAIN, that fits the image best.

    Args:
        image: (4 P,) rendered, as for ``compare``, flat.
        query: (4 P,) likewise.
        trimmed: whether it is found from those colours alone that are nearly equal already: what
            stands in front of the scene must not change the brightness of what is seen beside it.
    """
    product, square = 0.0, 0.0
    limit = LIMIT if trimmed else np.float32(np.inf)
    for first in range(0, len(image), BLOCK):
        sums = _gain_sums(image[first : first + BLOCK], query[first : first + BLOCK], limit)
        product += float(sums[0])
        square += float(sums[1])
    if square <= 0.0:
        return 1.0
    return float(min(max(product / square, 1.0 / LARGEST_GAIN), LARGEST_GAIN))


@compiled_loop
def _difference_sums(
    image: Float32Array, query: Float32Array, gain: np.float32, robust: bool
) -> tuple[np.float32, np.float32, np.float32]:
    """Sum of differences, and numbers of pixels compared with something and compared at all."""
    total, covered, compared = ZERO, ZERO, ZERO
    for i in range(len(image) // 4):
        used = image[4 * i + 3] * query[4 * i + 3]
        covered += used
        compared += query[4 * i + 3]
        red = gain * image[4 * i] - query[4 * i]
        green = gain * image[4 * i + 1] - query[4 * i + 1]
        blue = gain * image[4 * i + 2] - query[4 * i + 2]
        if robust:
            total += used * (min(abs(red), LIMIT) + min(abs(green), LIMIT) + min(abs(blue), LIMIT))
        else:
            total += used * (red * red + green * green + blue * blue)
    return total, covered, compared


@compiled_leaf
def _difference(image: Float32Array, query: Float32Array, gain: np.float32, robust: bool) -> float:
    """Mean squared or limited absolute difference, relative to the largest."""
    total, covered, compared = 0.0, 0.0, 0.0
    for first in range(0, len(image), BLOCK):
        part, wanted = image[first : first + BLOCK], query[first : first + BLOCK]
        sums = _difference_sums(part, wanted, gain, robust)
        total += float(sums[0])
        covered += float(sums[1])
        compared += float(sums[2])
    largest = ROBUST_LIMIT if robust else 255.0 * 255.0
    uncovered = UNCOVERED_ROBUST if robust else UNCOVERED_SQUARED
    total += 3.0 * largest * uncovered * (compared - covered)
    return float(total / (3.0 * largest * max(compared, 1.0)))


@compiled_loop
def _moments(
    image: Float32Array, query: Float32Array
) -> tuple[float, float, float, float, float, float, float]:
    """Numbers of pixels covered and compared; sums of a, b, a a, b b, a b over covered colours."""
    covered, compared = 0.0, 0.0
    a1, b1, a2, b2, ab = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(image) // 4):
        used = np.float64(image[4 * i + 3] * query[4 * i + 3])
        covered += used
        compared += query[4 * i + 3]
        for channel in range(3):
            a = used * np.float64(image[4 * i + channel])
            b = used * np.float64(query[4 * i + channel])
            a1 += a
            b1 += b
            a2 += a * a
            b2 += b * b
            ab += a * b
    return covered, compared, a1, b1, a2, b2, ab


@compiled_leaf
def _correlation(image: Float32Array, query: Float32Array) -> float:
    covered, compared, a1, b1, a2, b2, ab = _moments(image, query)
    share = covered / max(compared, 1.0)
    if covered == 0.0:
        return UNCOVERED_ZNCC
    n = 3.0 * covered
    variance_a, variance_b = a2 - a1 * a1 / n, b2 - b1 * b1 / n
    correlation = 0.0
    # Below one grey level of contrast there is nothing to correlate.
    if variance_a > n and variance_b > n:
        correlation = (ab - a1 * b1 / n) / np.sqrt(variance_a * variance_b)
    return float(share * (1.0 - correlation) / 2.0 + (1.0 - share) * UNCOVERED_ZNCC)


@compiled_leaf
def _evidence_cost(image: Float32Array, query: Float32Array, table: Float32Array) -> float:
    total = 0.0
    scale = np.float32(1.0 / EVIDENCE_BIN)
    largest = np.float32(EVIDENCE_BINS - 1)
    for i in range(len(image) // 4):
        difference = (
            abs(image[4 * i] - query[4 * i])
            + abs(image[4 * i + 1] - query[4 * i + 1])
            + abs(image[4 * i + 2] - query[4 * i + 2])
        )
        # Pixels that are not covered or not compared look up the row of zeros: no branch.
        row = np.uintp(image[4 * i + 3] * query[4 * i + 3])
        column = np.uintp(min(difference * scale, largest))
        total -= float(table[row * np.uintp(EVIDENCE_BINS) + column])
    return total


@compiled_leaf
def _gradient(image: Float32Array, query: Float32Array, gain: np.float32) -> float:
    total = 0.0
    count = 0
    limit = np.float32(GRADIENT_LIMIT)
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            for step in range(2):
                other_y, other_x = y + step, x + 1 - step
                if other_y >= image.shape[0] or other_x >= image.shape[1]:
                    continue
                if query[y, x, 3] * query[other_y, other_x, 3] == 0.0:
                    continue
                count += 1
                if image[y, x, 3] * image[other_y, other_x, 3] == 0.0:
                    total += 3.0 * GRADIENT_LIMIT * UNCOVERED_GRADIENT
                    continue
                for channel in range(3):
                    rendered = image[other_y, other_x, channel] - image[y, x, channel]
                    taken = query[other_y, other_x, channel] - query[y, x, channel]
                    total += min(abs(gain * rendered - taken), limit)
    return float(total / (3.0 * GRADIENT_LIMIT * max(count, 1)))
