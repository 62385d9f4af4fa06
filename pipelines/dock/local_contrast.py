"""Images without their brightness: what is left are edges, wherever they are equally strong.

A reflection in polished steel is large and soft, and lies over whatever the surface itself shows.
Each pixel's difference from its neighbourhood's mean, divided by the spread there, takes it away
and keeps the surface's own edges, strong or faint. The mean product of two such images is the mean
of the correlations in all neighbourhoods (zero-mean normalised cross-correlation).
"""

import cv2
import numpy as np

from pipelines.artifacts.array_types import BoolArray, Float32Array, FloatArray
from pipelines.geometry.camera import Intrinsics
from pipelines.lightfield.renderer import RenderingWithSurface
from pipelines.localize.observation import Observation
from pipelines.localize.refinement import SurfaceRenderer

# Width of the neighbourhood, pixels.
WINDOW = 5
# Spreads below this are noise and not blown up, grey levels.
SMALLEST_SPREAD = 3.0
# One standard deviation of a neighbourhood becomes so many grey levels.
GREY_LEVELS = 20.0


def local_contrast(image: Float32Array, shown: BoolArray) -> Float32Array:
    """The contrast ``(H, W, 3)`` of an image ``(H, W, 3)``, three times the same.

    Args:
        image: RGB.
        shown: ``(H, W)`` pixels that show something; zero elsewhere.
    """
    window = (WINDOW, WINDOW)
    grey = np.where(shown, image.mean(axis=2), np.float32(0.0)).astype(np.float32)
    share = np.maximum(cv2.blur(shown.astype(np.float32), window), np.float32(1e-3))
    mean = cv2.blur(grey, window) / share
    variance = np.maximum(cv2.blur(grey * grey, window) / share - mean * mean, np.float32(0.0))
    contrast = GREY_LEVELS * (grey - mean) / np.sqrt(variance + np.float32(SMALLEST_SPREAD**2))
    return np.repeat(np.where(shown, contrast, 0.0).astype(np.float32)[..., None], 3, axis=2)


def contrast_of(observation: Observation) -> Observation:
    """A camera image's local contrast; NaN where the image is."""
    shown = ~np.isnan(observation.image[..., 0])
    contrast = local_contrast(np.nan_to_num(observation.image), shown)
    return Observation(
        np.where(shown[..., None], contrast, np.float32(np.nan)), observation.intrinsics
    )


class ContrastRenderer:
    """Renders the local contrast of views.

    Args:
        renderer: of the views.
    """

    def __init__(self, renderer: SurfaceRenderer) -> None:
        self._renderer = renderer

    def render_with_surface(
        self, world_from_camera: FloatArray, intrinsics: Intrinsics
    ) -> RenderingWithSurface:
        """See ``Renderer.render_with_surface``."""
        view = self._renderer.render_with_surface(world_from_camera, intrinsics)
        contrast = local_contrast(view.image, view.covered)
        rgba = np.concatenate([contrast, view.rgba[..., 3:]], axis=2)
        return RenderingWithSurface(rgba, view.inverse_depth)


def correlation(view: RenderingWithSurface, observation: Observation) -> float:
    """Mean correlation of the neighbourhoods of two contrasts; uncovered pixels count as 0.

    Args:
        view: rendered by a ``ContrastRenderer``.
        observation: see ``contrast_of``.
    """
    products = view.image[..., 0] * observation.image[..., 0]
    return float(np.nanmean(products)) / GREY_LEVELS**2
