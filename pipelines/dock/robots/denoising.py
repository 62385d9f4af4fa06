"""Smooths the noise of few traced paths and keeps what textures and edges show.

What a surface's own colour does to the light is known without noise, and so are its shape and
place. The light alone is smoothed, over pixels that lie on the same surface, and multiplied by the
colour again (cross-bilateral filter of the demodulated irradiance; Dammertz et al. 2010,
"Edge-avoiding à-trous wavelet transform for fast global illumination filtering").
"""

from dataclasses import dataclass

import cv2
import numpy as np

from pipelines.artifacts.array_types import Float32Array

# Keeps black surfaces from dividing by nothing.
LEAST_ALBEDO = 0.05
# Rings of the filter, each twice as wide as the one before; how different pixels may be.
RINGS = 3
NORMAL_SPREAD, DEPTH_SPREAD, ALBEDO_SPREAD = 0.15, 0.02, 0.15
# Light more different than this factor, on a logarithmic scale, is an edge of a shadow.
LIGHT_SPREAD = 0.7
# The binomial kernel of five taps, from the middle on.
TAPS = (0.375, 0.25, 0.0625)


@dataclass(frozen=True)
class Features:
    """What is known of each pixel without noise.

    Attributes:
        albedo: ``(H, W, 3)`` the surface's own colour.
        normal: ``(H, W, 3)``.
        depth: ``(H, W)`` metres.
    """

    albedo: Float32Array
    normal: Float32Array
    depth: Float32Array


def denoised(radiance: Float32Array, features: Features) -> Float32Array:
    """The radiance ``(H, W, 3)`` without the noise of its light."""
    albedo = np.maximum(features.albedo, 0.0) + LEAST_ALBEDO
    light = np.log(np.maximum(radiance, 0.0) / albedo + 1e-2)
    light = _without_fireflies(light.astype(np.float32))
    for ring in range(RINGS):
        light = _smoothed(light, features, 2**ring, LIGHT_SPREAD / 2**ring)
    return np.asarray(np.maximum(np.exp(light) - 1e-2, 0.0) * albedo, dtype=np.float32)


def _without_fireflies(light: Float32Array) -> Float32Array:
    """Single pixels far brighter or darker than their neighbours are brought back to them."""
    channels = [cv2.medianBlur(np.ascontiguousarray(light[..., c]), 5) for c in range(3)]
    middle = np.stack(channels, axis=-1)
    return np.asarray(np.clip(light, middle - 1.0, middle + 1.0), dtype=np.float32)


def _smoothed(
    light: Float32Array, features: Features, spacing: int, light_spread: float
) -> Float32Array:
    guides = (
        (features.normal, NORMAL_SPREAD),
        (np.log(np.maximum(features.depth, 1e-3))[..., None], DEPTH_SPREAD * spacing),
        (features.albedo, ALBEDO_SPREAD),
        (cv2.GaussianBlur(light, (0, 0), 1.0), light_spread),
    )
    total = np.zeros_like(light)
    weights = np.zeros(light.shape[:2], dtype=np.float32)
    for row in range(-2, 3):
        for column in range(-2, 3):
            shift = (row * spacing, column * spacing)
            distance = np.zeros(light.shape[:2], dtype=np.float32)
            for values, spread in guides:
                apart = np.asarray(values - _shifted(values, *shift))
                distance += np.sum(apart**2, axis=-1) / np.float32(spread**2)
            weight = np.float32(TAPS[abs(row)] * TAPS[abs(column)]) * np.exp(-0.5 * distance)
            total += weight[..., None] * _shifted(light, *shift)
            weights += weight
    return np.asarray(total / weights[..., None], dtype=np.float32)


def _shifted(values: Float32Array, rows: int, columns: int) -> Float32Array:
    """The values ``(H, W, C)`` at so many rows down and columns right; at the rim the rim's."""
    height, width = values.shape[:2]
    down = np.clip(np.arange(height) + rows, 0, height - 1)
    right = np.clip(np.arange(width) + columns, 0, width - 1)
    return values[down[:, None], right[None, :]]
