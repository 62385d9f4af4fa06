"""What a user can choose of rendering and comparison, by name.

Nothing is imported here, so that a command line can be built from these names at once. What each of
them does stands in the module that does it.
"""

from enum import Enum, IntEnum


class Blending(IntEnum):
    """The blending rules (``blending``)."""

    DELAUNAY = 0
    UNSTRUCTURED = 1


class Quality(IntEnum):
    """Size of the surface's cells in pixels of the virtual image; 0: one plane for everything."""

    PLANE = 0
    FINE = 1
    MEDIUM = 2
    COARSE = 4


class Channels(Enum):
    """What of images is compared (``channels``)."""

    COLOUR = "colour"
    CONTRAST = "contrast"
    GRADIENT = "gradient"
    MIXED = "mixed"
    CHROMA = "chroma"


class Cost(IntEnum):
    """The kinds of comparison (``comparison``).

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
