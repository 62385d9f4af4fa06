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

import numpy as np

from pipelines.artifacts.arrays import BoolArray, Float32Array, ImageArray, Int32Array
from pipelines.artifacts.errors import OptionError
from pipelines.native import image_cost
from pipelines.render.choices import Cost

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

# As the C++ core takes them.
LIMITS = np.array([ROBUST_LIMIT, GRADIENT_LIMIT, LARGEST_GAIN])
UNCOVERED = np.array([UNCOVERED_SQUARED, UNCOVERED_ROBUST, UNCOVERED_ZNCC, UNCOVERED_GRADIENT])
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
    pixels = np.empty((1, len(chosen), 4), dtype=np.float32)
    pixels[0, :, :3] = query.reshape(-1, 3)[chosen]
    pixels[..., 3] = 1.0
    return chosen, pixels


def _known(query: ImageArray | Float32Array) -> BoolArray:
    """Which pixels ``(H, W)`` of a camera image are to be compared."""
    image = np.asarray(query, dtype=np.float32)
    # Not a number in one channel is none in their sum.
    return np.asarray(np.isfinite(image[..., 0] + image[..., 1] + image[..., 2]))


def compare(
    cost: Cost, view: Float32Array, query: Float32Array, fit_gain: bool, table: Float32Array
) -> float:
    """The cost of one rendered view.

    Args:
        cost: the kind of comparison.
        view: ``(H, W, 4)`` rendered, 0 to 255, and 1 where covered, else 0.
        query: ``(H, W, 4)`` camera image, see ``prepared``. For EVIDENCE its last number is, where
            the pixel is to be compared, 1 and the pixel's row of the table.
        fit_gain: whether one brightness factor is fitted first, between 1 / ``LARGEST_GAIN`` and
            ``LARGEST_GAIN``. Of ROBUST it is found from those colours alone that are nearly equal
            already: what stands in front of the scene must not change the brightness of what is
            seen beside it.
        table: of EVIDENCE alone, row by row: EVIDENCE_BINS zeros, then ``PixelEvidence.table``.

    Returns:
        Cost, in [0, 1] but for EVIDENCE; smaller is better.
    """
    rows = table.reshape((-1, EVIDENCE_BINS))
    return image_cost(view, query, int(cost), fit_gain, LIMITS, UNCOVERED, rows, EVIDENCE_BIN)
