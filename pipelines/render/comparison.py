"""How different is a rendered view from a camera image? One cost in [0, 1] for each.

All costs share one signature, so that the filter can use any. The paper compares pixel by pixel
(``squared``, section 6); others tolerate light that changes (``zncc``, ``gradient``) or things that
are not in the model (``robust``). A pixel that no view covers costs about as much as an unrelated
one, so that a pose that sees nothing of the map never wins.

``evidence`` is a log-likelihood ratio: each pixel adds what its difference says for "the map shows
this here" against "the map does not", looked up in a table (``pixel_evidence``). A pixel that no
view covers adds 0, so that a pose that sees nothing of the map gains nothing.
"""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arguments import checked_instance
from pipelines.artifacts.arrays import BoolArray, Float32Array, ImageArray, Int32Array
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.camera import Intrinsics
from pipelines.native import image_cost
from pipelines.render.choices import Cost

# Grey levels of 255. Differences beyond the limit are outliers, however large.
ROBUST_LIMIT = 64.0
GRADIENT_LIMIT = 32.0
# What an uncovered pixel costs, on each cost's own scale: about what unrelated image parts cost.
UNCOVERED_SQUARED = 0.06
UNCOVERED_ROBUST = 0.8
UNCOVERED_ZNCC = 0.5
UNCOVERED_GRADIENT = 0.5
# Gains beyond this factor are no exposure change but another place.
LARGEST_GAIN = 1.5
# Size of the table of EVIDENCE: a row for each range of a pixel's strength, a bin for each range of
# differences, summed over the channels. A bin is so many levels wide; the last one is open.
EVIDENCE_BINS, EVIDENCE_ROWS = 24, 8
EVIDENCE_BIN = 10.0

# As the C++ core takes them.
LIMITS = np.array([ROBUST_LIMIT, GRADIENT_LIMIT, LARGEST_GAIN])
UNCOVERED = np.array([UNCOVERED_SQUARED, UNCOVERED_ROBUST, UNCOVERED_ZNCC, UNCOVERED_GRADIENT])
# The table of all costs but EVIDENCE.
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
    return sum_of_channels(np.abs(channels - np.float32(128.0)))


def sum_of_channels(values: Float32Array) -> Float32Array:
    """The sum of three channels ``(..., 3)``: ``(...)``. NumPy's own is six times as slow."""
    return np.asarray(values[..., 0] + values[..., 1] + values[..., 2], dtype=np.float32)


def evidence_table(cost: Cost, evidence: PixelEvidence | None) -> Float32Array:
    """The table that the comparison looks up, row by row; empty for all costs but EVIDENCE.

    Args:
        cost: the kind of comparison.
        evidence: of the pixels' differences; needed for EVIDENCE and for no other cost.

    Raises:
        OptionError: EVIDENCE without a table, or another cost with one.
    """
    checked_instance(cost, "cost", Cost)
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
        query: ``(H, W, 3)``, 0 to 255; NaN where it is not to be compared.

    Returns:
        Their indices ``(P,)``, rising, and ``(1, P, 4)`` their colours, and 1.
    """
    chosen = np.flatnonzero(_known(query)).astype(np.int32)
    pixels = np.empty((1, len(chosen), 4), dtype=np.float32)
    pixels[0, :, :3] = query.reshape(-1, 3)[chosen]
    pixels[..., 3] = 1.0
    return chosen, pixels


@dataclass(frozen=True)
class PreparedQuery:
    """A camera image ready for the comparison with many rendered views.

    Attributes:
        intrinsics: of the image.
        pixels: ``(P,)`` indices of the pixels that are rendered and compared, rising.
        target: ``(h, w, 4)`` these P = h w pixels as ``compare`` takes them.
        cost: the kind of comparison.
        fit_gain: whether a brightness factor is fitted for each view.
        table: of EVIDENCE as ``compare`` takes it; else empty.
    """

    intrinsics: Intrinsics
    pixels: Int32Array
    target: Float32Array
    cost: Cost
    fit_gain: bool
    table: Float32Array


def prepare_query(
    query: ImageArray | Float32Array,
    intrinsics: Intrinsics,
    cost: Cost,
    fit_gain: bool,
    evidence: PixelEvidence | None,
) -> PreparedQuery:
    """Prepares a camera image for the comparison with many rendered views.

    Args:
        query: ``(H, W, 3)``, 0 to 255; NaN where it is not to be compared.
        intrinsics: of the image.
        cost: the kind of comparison.
        fit_gain: whether a brightness factor is fitted for each view.
        evidence: of the pixels' differences; needed for EVIDENCE and for no other cost.

    Raises:
        OptionError: another size than the intrinsics', EVIDENCE without a table, or another cost
            with one.
    """
    check_query(query, intrinsics)
    table = evidence_table(cost, evidence)
    # Gradients are differences between neighbours; else what is not compared is not rendered.
    if cost is Cost.GRADIENT:
        pixels, target = every_pixel(intrinsics), prepared(query)
    else:
        pixels, target = prepared_pixels(query)
    if evidence is not None:
        target[..., 3] *= np.float32(1.0) + evidence.rows(target[..., :3])
    return PreparedQuery(intrinsics, pixels, target, cost, fit_gain, table)


def every_pixel(intrinsics: Intrinsics) -> Int32Array:
    """Indices ``(H W,)`` of all pixels of an image."""
    return np.arange(intrinsics.width * intrinsics.height, dtype=np.int32)


def check_query(query: ImageArray | Float32Array, intrinsics: Intrinsics) -> None:
    """Refuses a camera image that is not ``(H, W, 3)`` of its intrinsics.

    Raises:
        OptionError: another size, or no image and intrinsics.
    """
    checked_instance(intrinsics, "intrinsics", Intrinsics)
    checked_instance(query, "camera image", np.ndarray)
    if query.shape != (intrinsics.height, intrinsics.width, 3):
        raise OptionError(
            f"camera image of shape {query.shape} for intrinsics of "
            f"{intrinsics.width}x{intrinsics.height} pixels"
        )


def _known(query: ImageArray | Float32Array) -> BoolArray:
    """Which pixels ``(H, W)`` of a camera image are to be compared."""
    image = np.asarray(query, dtype=np.float32)
    # NaN in one channel makes the sum NaN.
    return np.asarray(np.isfinite(image[..., 0] + image[..., 1] + image[..., 2]))


def compare(
    cost: Cost, view: Float32Array, query: Float32Array, fit_gain: bool, table: Float32Array
) -> float:
    """The cost of one rendered view.

    Args:
        cost: the kind of comparison.
        view: ``(H, W, 4)`` rendered, 0 to 255, and 1 where covered, else 0.
        query: ``(H, W, 4)`` camera image as ``prepared`` returns it. For EVIDENCE the fourth number
            of pixels to be compared is 1 plus the pixel's row of the table.
        fit_gain: whether one brightness factor is fitted first, between 1 / ``LARGEST_GAIN`` and
            ``LARGEST_GAIN``. For ROBUST it is fitted to those colours alone that are nearly equal
            already: what stands in front of the scene must not change the brightness of what is
            seen beside it.
        table: for EVIDENCE, row by row: EVIDENCE_BINS zeros, then ``PixelEvidence.table``; else
            empty.

    Returns:
        Cost, in [0, 1] but for EVIDENCE; smaller is better.
    """
    rows = table.reshape((-1, EVIDENCE_BINS))
    return image_cost(
        view=view,
        query=query,
        cost=int(cost),
        fit_gain=fit_gain,
        limits=LIMITS,
        uncovered=UNCOVERED,
        table=rows,
        evidence_bin=EVIDENCE_BIN,
    )
