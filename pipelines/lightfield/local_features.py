"""Local features of an image: SIFT (Lowe 2004).

Their descriptors are compared by the Hellinger distance (Arandjelovic, Zisserman 2012, "Three
things everyone should know to improve object retrieval"). Pixels have their centres at integers.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from pipelines.artifacts.arrays import Float32Array, FloatArray, ImageArray

# SIFT's threshold of contrast.
CONTRAST = 0.02
# A pixel of which a mask leaves more than this share counts as used.
FULLY_USED = 0.99


@dataclass(frozen=True)
class Features:
    """SIFT features of an image, strongest first.

    Attributes:
        pixels: ``(F, 2)`` positions in the image at its full size, pixel centres at integers.
        descriptors: ``(F, 128)`` unit vectors.
    """

    pixels: FloatArray
    descriptors: Float32Array


def find_features(
    grey: ImageArray, max_size: int, max_features: int, used: ImageArray | None = None
) -> Features:
    """Detects the features of an image.

    Args:
        grey: ``(height, width)``.
        max_size: they are detected in the image reduced to this longer side, pixels.
        max_features: the most that are kept.
        used: ``(height, width)``, 0 where there shall be no feature; None: nowhere.
    """
    height, width = grey.shape
    scale = min(1.0, max_size / max(height, width))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA) if scale < 1.0 else grey
    # Without precise upscaling OpenCV's positions are shifted by a quarter of a pixel.
    sift = cv2.SIFT.create(
        # OpenCV applies the mask last: masked features would count among the strongest. 0: all.
        nfeatures=max_features if used is None else 0,
        contrastThreshold=CONTRAST,
        enable_precise_upscale=True,
    )
    mask = None if used is None else _reduced_mask(used, size)
    keypoints, descriptors = sift.detectAndCompute(small, mask)
    if len(keypoints) == 0:
        return Features(np.empty((0, 2)), np.empty((0, 128), dtype=np.float32))
    order = np.argsort([-keypoint.response for keypoint in keypoints], kind="stable")
    order = order[:max_features] if used is not None else order
    pixels = np.array([keypoint.pt for keypoint in keypoints], dtype=np.float64)[order]
    factors = np.array([width / size[0], height / size[1]])
    shares = descriptors[order] / np.maximum(descriptors[order].sum(axis=1, keepdims=True), 1e-12)
    return Features((pixels + 0.5) * factors - 0.5, np.sqrt(shares).astype(np.float32))


def _reduced_mask(used: ImageArray, size: tuple[int, int]) -> ImageArray:
    """Not 0 where all of a pixel of the reduced image, width and height ``size``, is used."""
    shares = (used != 0).astype(np.float32)
    reduced = cv2.resize(shares, size, interpolation=cv2.INTER_AREA)
    return np.asarray(reduced > FULLY_USED, dtype=np.uint8)
