"""Local contrast against a slow version, and the alignment that uses it against true poses."""

import numpy as np
import pytest

from pipelines.dock.local_contrast import (
    GREY_LEVELS,
    SMALLEST_SPREAD,
    WINDOW,
    ContrastRenderer,
    contrast_of,
    correlation,
    local_contrast,
)
from pipelines.geometry.camera import Intrinsics
from pipelines.lightfield.renderer import RenderingWithSurface
from pipelines.localize.observation import Observation

PINHOLE = Intrinsics(24, 18, 20.0, 20.0, 11.5, 8.5)


def picture(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(0.0, 255.0, (18, 24, 3)).astype(np.float32)


def test_it_is_the_difference_from_the_neighbourhood_over_its_spread() -> None:
    image, shown = picture(), np.ones((18, 24), dtype=np.bool_)
    shown[4:7, 5:9] = False
    found = local_contrast(image, shown)
    half = WINDOW // 2
    for y in range(half, 18 - half):
        for x in range(half, 24 - half):
            part = (slice(y - half, y + half + 1), slice(x - half, x + half + 1))
            grey = image[part].astype(np.float64).mean(axis=2)[shown[part]]
            own = image[y, x].astype(np.float64).mean()
            expected = GREY_LEVELS * (own - grey.mean()) / np.hypot(grey.std(), SMALLEST_SPREAD)
            assert found[y, x, 0] == pytest.approx(expected if shown[y, x] else 0.0, abs=0.02)


def test_a_soft_reflection_does_not_matter() -> None:
    image, shown = picture(), np.ones((18, 24), dtype=np.bool_)
    x = np.linspace(-1.0, 1.0, 24)
    reflection = 60.0 * np.exp(-(x**2))[None, :, None]
    with_it = (image + reflection).astype(np.float32)
    plain, other = local_contrast(image, shown), local_contrast(with_it, shown)
    assert np.abs(with_it - image).mean() > 40.0
    assert np.abs(other - plain).mean() < 0.05 * GREY_LEVELS


class Fixed:
    """Shows the same picture from everywhere."""

    def __init__(self, image: np.ndarray) -> None:
        self._image = image

    def render_with_surface(self, pose: np.ndarray, pinhole: Intrinsics) -> RenderingWithSurface:
        covered = np.ones((*self._image.shape[:2], 1), dtype=np.float32)
        rgba = np.concatenate([self._image, covered], axis=2)
        return RenderingWithSurface(rgba, np.ones(covered.shape[:2], dtype=np.float32))


def test_the_same_picture_correlates_whatever_its_brightness() -> None:
    image = picture()
    view = ContrastRenderer(Fixed(image)).render_with_surface(np.eye(4), PINHOLE)
    brighter = contrast_of(Observation((1.3 * image + 10.0).astype(np.float32), PINHOLE))
    other = contrast_of(Observation(picture(1), PINHOLE))
    assert correlation(view, brighter) > 0.9
    assert abs(correlation(view, other)) < 0.2


def test_pixels_that_are_not_to_be_compared_are_left_out() -> None:
    image = picture()
    image[:, :12] = np.nan
    contrast = contrast_of(Observation(image, PINHOLE))
    assert np.isnan(contrast.image[:, :12]).all()
    assert np.isfinite(contrast.image[:, 12:]).all()
