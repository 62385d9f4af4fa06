"""A room is proven by images that agree with it nearly everywhere."""

import numpy as np
import pytest

from pipelines.artifacts.arrays import Float32Array
from pipelines.localize.area_proof import PROVING_AGREEMENT, agreement

SHAPE = (48, 64, 3)


@pytest.fixture
def image() -> Float32Array:
    noise = np.random.default_rng(3).normal(0.0, 40.0, SHAPE)
    return (128.0 + noise).astype(np.float32)


def everywhere(shape: tuple[int, ...] = SHAPE) -> np.ndarray:
    return np.ones(shape[:2], dtype=np.bool_)


def test_an_image_agrees_with_itself(image: Float32Array) -> None:
    assert agreement(image, image, everywhere()) == pytest.approx(1.0)


def test_contrast_is_worth_little(image: Float32Array) -> None:
    dimmer = 128.0 + np.float32(0.8) * (image - 128.0)
    assert agreement(image, dimmer, everywhere()) > 0.99


def test_another_picture_on_the_wall_is_seen(image: Float32Array) -> None:
    twin = image.copy()
    twin[:, :24] = 256.0 - twin[:, :24]
    assert agreement(image, twin, everywhere()) < PROVING_AGREEMENT
    shown = everywhere()
    shown[:, :24] = False
    assert agreement(image, twin, shown) == pytest.approx(1.0)


def test_blank_images_agree_in_nothing() -> None:
    blank = np.full(SHAPE, 128.0, dtype=np.float32)
    assert agreement(blank, blank, everywhere()) == 0.0
    assert agreement(blank, blank, ~everywhere()) == 0.0


def test_what_shows_nothing_has_no_say(image: Float32Array) -> None:
    half = image.copy()
    half[:, 32:] = 128.0
    assert agreement(half, half, everywhere()) == pytest.approx(1.0)
