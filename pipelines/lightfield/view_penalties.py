"""Penalties of a view for how it shows a point of the scene, and whether it shows it at all.

The penalties of unstructured-lumigraph rendering (Buehler, Bosse, McMillan, Gortler, Cohen 2001):
for the angle between the view's ray and the virtual one, for a coarser resolution, and for showing
the point near the border of the image. They rank the views that a pixel is blended from
(``render.blending``) and say which photos a model needs (``view_selection``).
"""

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, IntArray

# Cost of a view at twice the distance, in radians of viewing angle.
RESOLUTION_PENALTY = 0.05
# The penalty of the border begins at this share of the shorter side from it, and is so many radians
# where half of that is left. A wider strip or a higher penalty softens what is left of seams within
# tiles, and shows held-out photos worse: the next best view is seldom as good.
BORDER_SHARE = 0.03
BORDER_PENALTY = 0.03
# Smallest distance from the border that counts, as a share of the strip: penalties stay finite.
SMALLEST_MARGIN = 1e-6


def ray_penalties(centres: FloatArray, virtual_centre: FloatArray, point: FloatArray) -> FloatArray:
    """Penalty ``(...)`` of views for the angle and the resolution under which they show points.

    Args:
        centres: ``(..., 3)`` of the views.
        virtual_centre: ``(..., 3)`` from where the points are to be shown.
        point: ``(..., 3)`` the points, world coordinates.
    """
    virtual, recorded = point - virtual_centre, point - centres
    virtual_distance = np.linalg.norm(virtual, axis=-1)
    distance = np.linalg.norm(recorded, axis=-1)
    cosine = np.sum(recorded * virtual, axis=-1) / (distance * virtual_distance)
    # The chord 2 sin(angle / 2): the angle where it is small, without an inverse cosine.
    angle = np.sqrt(np.maximum(2.0 - 2.0 * cosine, 0.0))
    coarser = np.maximum(distance / virtual_distance - 1.0, 0.0)
    return np.asarray(angle + RESOLUTION_PENALTY * coarser)


def border_penalties(target: FloatArray, size: IntArray) -> FloatArray:
    """Penalty ``(...)`` of views for showing points near the border of their images.

    Args:
        target: ``(..., 3)`` homogeneous pixels of the points, inside the images.
        size: ``(..., 2)`` width and height of the images.
    """
    pixel = target[..., :2] / target[..., 2:]
    margin = np.minimum(pixel + 0.5, size - 0.5 - pixel).min(axis=-1)
    share = margin / (BORDER_SHARE * size.min(axis=-1))
    return np.asarray(
        BORDER_PENALTY * np.maximum(1.0 / np.maximum(share, SMALLEST_MARGIN) - 1.0, 0.0)
    )


def sees(homogeneous: FloatArray, width: IntArray | int, height: IntArray | int) -> BoolArray:
    """Whether homogeneous pixels ``(..., 3)`` lie in front of a view and inside its image."""
    depth = homogeneous[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = homogeneous[..., 0] / depth, homogeneous[..., 1] / depth
    inside = (x >= -0.5) & (x <= width - 0.5) & (y >= -0.5) & (y <= height - 0.5)
    return np.asarray((depth > 0.0) & inside)
