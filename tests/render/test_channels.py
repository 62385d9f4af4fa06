"""Channels against plain loops, and that another light hardly changes them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray
from pipelines.lightfield.views import build_views
from pipelines.render.channels import (
    COLOURFULNESS,
    LUMA,
    SCALE,
    SMALLEST_BRIGHTNESS,
    SMALLEST_SLOPE,
    SMALLEST_SPREAD,
    WINDOW,
    ZERO,
    channel_image,
    views_in_channels,
)
from pipelines.render.choices import Channels
from tests.lightfield_samples import looking, pinhole
from tests.report_samples import facing_wall, photo

# CHROMA bears a gain, but no offset.
LIGHTPROOF = (Channels.CONTRAST, Channels.GRADIENT, Channels.MIXED)
MADE = (*LIGHTPROOF, Channels.CHROMA)
every_channel = pytest.mark.parametrize("channels", MADE)
every_lightproof_channel = pytest.mark.parametrize("channels", LIGHTPROOF)


def random_image(seed: int, height: int = 14, width: int = 19) -> Float32Array:
    generator = np.random.default_rng(seed)
    return generator.uniform(0.0, 255.0, (height, width, 3)).astype(np.float32)


def around(index: int, size: int) -> list[int]:
    """The window's indices, mirrored at the borders without the border twice."""
    reach = WINDOW // 2
    mirrored = [abs(i) for i in range(index - reach, index + reach + 1)]
    return [i if i < size else 2 * (size - 1) - i for i in mirrored]


def contrast_by_hand(image: FloatArray, shown: BoolArray) -> FloatArray:
    """Pixel by pixel: the difference from the window's mean over the spread of its greys."""
    height, width = shown.shape
    grey = image @ LUMA.astype(float)
    result = np.full(image.shape, ZERO)
    for row, column in np.argwhere(shown):
        window = [
            (y, x)
            for y in around(int(row), height)
            for x in around(int(column), width)
            if shown[y, x]
        ]
        colours = np.array([image[place] for place in window])
        greys = np.array([grey[place] for place in window])
        spread = np.sqrt(greys.var() + SMALLEST_SPREAD**2)
        result[row, column] += SCALE * (image[row, column] - colours.mean(axis=0)) / spread
    return np.asarray(np.clip(result, 0.0, 255.0))


@pytest.mark.parametrize("hidden", [0.0, 0.3, 0.9])
def test_contrast_is_its_formula(hidden: float) -> None:
    for seed in range(3):
        image = random_image(seed)
        shown = np.random.default_rng(seed).uniform(size=image.shape[:2]) >= hidden
        found = channel_image(image, Channels.CONTRAST, shown)
        expected = contrast_by_hand(image.astype(float), shown)
        np.testing.assert_allclose(found, expected, atol=0.02)


def test_gradients_are_differences_over_the_steepness_around() -> None:
    image = random_image(4)
    grey = np.pad(image.astype(float) @ LUMA.astype(float), 1, mode="edge")
    across = (grey[1:-1, 2:] - grey[1:-1, :-2]) / 2.0
    down = (grey[2:, 1:-1] - grey[:-2, 1:-1]) / 2.0
    steep = np.empty_like(across)
    for row, column in np.ndindex(*across.shape):
        window = np.ix_(around(row, across.shape[0]), around(column, across.shape[1]))
        squares = across[window] ** 2 + down[window] ** 2
        steep[row, column] = np.sqrt(squares.mean() + SMALLEST_SLOPE**2)
    slopes = np.stack([across, down, np.hypot(across, down)], axis=2) / steep[..., None]
    expected = np.clip(ZERO + SCALE * slopes, 0.0, 255.0)
    np.testing.assert_allclose(channel_image(image, Channels.GRADIENT), expected, atol=0.02)


def test_mixed_is_the_contrast_of_the_greys_and_their_slopes() -> None:
    image = random_image(8)
    shown = np.random.default_rng(8).uniform(size=image.shape[:2]) >= 0.2
    grey = np.repeat((image @ LUMA)[..., None], 3, axis=2).astype(float)
    found = channel_image(image, Channels.MIXED, shown)
    np.testing.assert_allclose(found[..., 0], contrast_by_hand(grey, shown)[..., 0], atol=0.02)
    slopes = channel_image(image, Channels.GRADIENT, shown)
    np.testing.assert_array_equal(found[..., 1:], slopes[..., :2])


def test_chroma_is_the_contrast_of_the_greys_and_colours_over_the_brightness_around() -> None:
    image = random_image(9)
    shown = np.random.default_rng(9).uniform(size=image.shape[:2]) >= 0.2
    grey = np.repeat((image @ LUMA)[..., None], 3, axis=2).astype(float)
    found = channel_image(image, Channels.CHROMA, shown)
    np.testing.assert_allclose(found[..., 0], contrast_by_hand(grey, shown)[..., 0], atol=0.02)
    height, width = shown.shape
    expected = np.full((height, width, 2), ZERO)
    for row, column in np.argwhere(shown):
        near = [
            grey[y, x, 0]
            for y in around(int(row), height)
            for x in around(int(column), width)
            if shown[y, x]
        ]
        red, green, blue = map(float, image[row, column])
        scale = SCALE * COLOURFULNESS / (np.mean(near) + SMALLEST_BRIGHTNESS)
        colours = np.array([red - green, (red + green) / 2.0 - blue])
        expected[row, column] += scale * colours
    np.testing.assert_allclose(found[..., 1:], np.clip(expected, 0.0, 255.0), atol=0.02)


def test_only_chroma_tells_even_surfaces_of_different_paint_apart() -> None:
    paints = ((150.0, 90.0, 80.0), (80.0, 110.0, 150.0), (100.0, 100.0, 100.0))
    for channels in MADE:
        images = [
            channel_image(np.full((9, 7, 3), paint, dtype=np.float32), channels) for paint in paints
        ]
        differences = [np.abs(images[i] - images[i - 1]).max() for i in range(len(images))]
        if channels is Channels.CHROMA:
            assert min(differences) > SCALE / 2.0
        else:
            assert max(differences) < 0.5


def test_colours_stay_as_they_are() -> None:
    image = random_image(0)
    np.testing.assert_array_equal(channel_image(image, Channels.COLOUR), image)


# --- another light -----------------------------------------------------------------------------


@every_lightproof_channel
@given(st.floats(0.3, 3.0), st.floats(-60.0, 60.0), st.integers(0, 5))
def test_gain_and_offset_change_nothing_above_the_noise_floor(
    channels: Channels, gain: float, offset: float, seed: int
) -> None:
    # Strong texture: neighbourhoods spread far more than the floor.
    image = random_image(seed)
    plain = channel_image(image, channels)
    lit = channel_image((gain * image + offset).astype(np.float32), channels)
    # Of a spread s the floor f takes away a share of about f^2 / 2 s^2.
    floor = max(SMALLEST_SPREAD, SMALLEST_SLOPE)
    grey = image @ LUMA
    bound = 127.0 * (floor / (min(gain, 1.0) * grey.std() * 0.5)) ** 2 / 2.0 + 0.1
    assert np.abs(lit - plain).max() < bound
    assert np.abs(plain - ZERO).mean() > 10.0 * np.abs(lit - plain).mean()


@given(st.floats(0.5, 2.0), st.integers(0, 5))
def test_a_gain_changes_chroma_little(gain: float, seed: int) -> None:
    image = random_image(seed)
    plain = channel_image(image, Channels.CHROMA)
    lit = channel_image((gain * image).astype(np.float32), Channels.CHROMA)
    assert np.abs(lit - plain).mean() < 0.1 * np.abs(plain - ZERO).mean()


@every_lightproof_channel
def test_an_offset_changes_nothing_at_all(channels: Channels) -> None:
    image = random_image(1)
    lit = channel_image(image + np.float32(40.0), channels)
    np.testing.assert_allclose(lit, channel_image(image, channels), atol=0.02)


@every_channel
def test_light_that_falls_off_across_the_image_changes_little(channels: Channels) -> None:
    image = photo(facing_wall(-0.4, 1.7, 0.15)).astype(np.float32)
    height, width = image.shape[:2]
    rows, columns = np.indices((height, width))
    for slope_x, slope_y in ((0.6, 0.0), (0.0, -0.5), (0.3, 0.4)):
        light = 1.0 + slope_x * (columns / width - 0.5) + slope_y * (rows / height - 0.5)
        lit = (image * light[..., None]).astype(np.float32)
        plain = channel_image(image, channels) - ZERO
        other = channel_image(lit, channels) - ZERO
        # In colours most of the difference is the light; in channels hardly any of it.
        correlation = np.corrcoef(plain.ravel(), other.ravel())[0, 1]
        assert correlation > 0.98
        assert np.abs(lit - image).mean() > 10.0
        assert np.abs(other - plain).mean() < 0.2 * np.abs(plain).mean()


@every_channel
@pytest.mark.parametrize("level", [0.0, 77.0, 255.0])
def test_an_even_image_shows_nothing(channels: Channels, level: float) -> None:
    image = np.full((9, 7, 3), level, dtype=np.float32)
    np.testing.assert_allclose(channel_image(image, channels), ZERO, atol=0.5)


@every_channel
def test_noise_below_the_floor_is_not_blown_up(channels: Channels) -> None:
    noise = 0.3 * np.random.default_rng(0).standard_normal((40, 50, 3))
    values = channel_image((120.0 + noise).astype(np.float32), channels) - ZERO
    assert np.abs(values).mean() < 0.25 * SCALE


# --- what is not shown -------------------------------------------------------------------------


@every_channel
def test_hidden_pixels_are_in_no_neighbourhood(channels: Channels) -> None:
    generator = np.random.default_rng(5)
    image = random_image(5)
    shown = generator.uniform(size=image.shape[:2]) > 0.3
    spoilt = np.where(shown[..., None], image, generator.uniform(0.0, 255.0, image.shape))
    nan = np.where(shown[..., None], image, np.nan)
    expected = channel_image(image, channels, shown)
    for other in (spoilt, nan):
        found = channel_image(other.astype(np.float32), channels, shown)
        np.testing.assert_array_equal(found[shown], expected[shown])
    assert np.isfinite(expected).all()


@every_channel
def test_nothing_shown_and_single_pixels_are_finite(channels: Channels) -> None:
    for shape in ((1, 1), (1, 4), (2, 1), (3, 3)):
        image = random_image(6, *shape)
        for shown in (None, np.zeros(shape, dtype=np.bool_), np.ones(shape, dtype=np.bool_)):
            found = channel_image(image, channels, shown)
            assert np.isfinite(found).all()
            assert found.shape == (*shape, 3)


@every_channel
@given(st.integers(0, 1000))
def test_channels_are_bytes(channels: Channels, seed: int) -> None:
    generator = np.random.default_rng(seed)
    image = 255.0 * (generator.uniform(size=(9, 11, 3)) < generator.uniform())
    found = channel_image(image.astype(np.float32), channels)
    assert found.dtype == np.float32
    assert found.min() >= 0.0
    assert found.max() <= 255.0


# --- views -------------------------------------------------------------------------------------


@every_channel
def test_each_level_of_a_photos_pyramid_has_channels_of_its_own(channels: Channels) -> None:
    generator = np.random.default_rng(7)
    sizes = ((64, 48), (21, 15), (5, 3))
    intrinsics = [pinhole(width, height, 0.8 * width) for width, height in sizes]
    images = [
        generator.integers(0, 256, (height, width, 3)).astype(np.uint8) for width, height in sizes
    ]
    poses = np.array([looking([0.1 * i, -3.0, 1.0], [0.0, 0.0, 1.0]) for i in range(3)])
    views = build_views(images, intrinsics, poses)
    before = views.arrays.texels.copy()
    made = views_in_channels(views, channels)
    for view in range(3):
        for level in range(views.arrays.level_start.shape[1]):
            expected = np.rint(channel_image(views.level(view, level), channels))
            np.testing.assert_array_equal(made.level(view, level), expected)
            assert made.level(view, level).dtype == np.uint8
    # All else stays, what was handed in too.
    np.testing.assert_array_equal(views.arrays.texels, before)
    np.testing.assert_array_equal(made.arrays.texels[:, 3:], before[:, 3:])
    assert made.intrinsics == views.intrinsics
    for name in ("level_start", "level_size", "rays", "centres"):
        np.testing.assert_array_equal(getattr(made.arrays, name), getattr(views.arrays, name))
    assert views_in_channels(views, Channels.COLOUR) is views
