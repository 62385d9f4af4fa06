"""Local contrast against a slow version, and how pictures of it correlate."""

import numpy as np
import pytest

from pipelines.dock.fine_alignment import correlation
from pipelines.geometry.camera import Intrinsics
from pipelines.localize.observation import Observation
from pipelines.render.channels import LUMA, SCALE, SMALLEST_SPREAD, WINDOW, ZERO, channel_image
from pipelines.render.choices import Channels
from pipelines.render.renderer import RenderingWithSurface

PINHOLE = Intrinsics(24, 18, 20.0, 20.0, 11.5, 8.5)


def picture(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(0.0, 255.0, (18, 24, 3)).astype(np.float32)


def contrast_of(image: np.ndarray) -> Observation:
    return Observation(image, PINHOLE).in_channels(Channels.CONTRAST)


def test_it_is_the_difference_from_the_neighbourhood_over_its_spread() -> None:
    image, shown = picture(), np.ones((18, 24), dtype=np.bool_)
    shown[4:7, 5:9] = False
    found = channel_image(image, Channels.CONTRAST, shown)
    half = WINDOW // 2
    for y in range(half, 18 - half):
        for x in range(half, 24 - half):
            if not shown[y, x]:
                continue
            part = (slice(y - half, y + half + 1), slice(x - half, x + half + 1))
            near = image[part].astype(np.float64)[shown[part]]
            spread = np.hypot((near @ LUMA).std(), SMALLEST_SPREAD)
            expected = ZERO + SCALE * (image[y, x] - near.mean(axis=0)) / spread
            np.testing.assert_allclose(found[y, x], np.clip(expected, 0.0, 255.0), atol=0.05)


def test_a_soft_reflection_does_not_matter() -> None:
    image, shown = picture(), np.ones((18, 24), dtype=np.bool_)
    x = np.linspace(-1.0, 1.0, 24)
    reflection = 60.0 * np.exp(-(x**2))[None, :, None]
    with_it = (image + reflection).astype(np.float32)
    plain = channel_image(image, Channels.CONTRAST, shown)
    other = channel_image(with_it, Channels.CONTRAST, shown)
    assert np.abs(with_it - image).mean() > 40.0
    assert np.abs(other - plain).mean() < 0.05 * SCALE


def view_of(observation: Observation, covered: np.ndarray) -> RenderingWithSurface:
    rgba = np.concatenate(
        [observation.image, 255.0 * covered[..., None].astype(np.float32)], axis=2
    )
    return RenderingWithSurface(rgba, np.ones(covered.shape, dtype=np.float32))


def test_the_same_picture_correlates_whatever_its_brightness() -> None:
    image = picture()
    view = view_of(contrast_of(image), np.ones((18, 24), dtype=np.bool_))
    brighter = contrast_of((1.3 * image + 10.0).astype(np.float32))
    assert correlation(view, brighter) > 0.9 * correlation(view, contrast_of(image))
    other = correlation(view, contrast_of(picture(1)))
    assert abs(other) < 0.2 * correlation(view, brighter)


def test_what_the_map_does_not_show_counts_as_no_correlation() -> None:
    image = picture()
    covered = np.ones((18, 24), dtype=np.bool_)
    whole = correlation(view_of(contrast_of(image), covered), contrast_of(image))
    covered[:, :12] = False
    half = correlation(view_of(contrast_of(image), covered), contrast_of(image))
    assert half == pytest.approx(0.5 * whole, rel=0.15)


def test_pixels_that_are_not_to_be_compared_are_left_out() -> None:
    image = picture()
    image[:, :12] = np.nan
    contrast = contrast_of(image)
    assert np.isnan(contrast.image[:, :12]).all()
    assert np.isfinite(contrast.image[:, 12:]).all()
    view = view_of(contrast_of(picture()), np.ones((18, 24), dtype=np.bool_))
    assert np.isfinite(correlation(view, contrast))
