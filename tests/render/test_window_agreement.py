"""Images agree window by window, and photos of a map as well as the map is good."""

import numpy as np
import pytest

from pipelines.artifacts.arrays import Float32Array
from pipelines.lightfield.views import build_views
from pipelines.render.channels import views_in_channels
from pipelines.render.choices import Channels
from pipelines.render.pixel_evidence import poses_of
from pipelines.render.renderer import Renderer
from pipelines.render.window_agreement import agreement, usual_agreement
from tests.lightfield_samples import WALL
from tests.render.test_pixel_evidence import wall_views

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
    assert agreement(image, twin, everywhere()) < 0.75
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


def test_photos_of_a_wall_agree_with_each_other_and_not_where_their_poses_are_wrong() -> None:
    views = wall_views(8)
    shown = views_in_channels(views, Channels.CONTRAST)
    right = usual_agreement(views, Channels.CONTRAST, 48, Renderer(shown, WALL))
    assert right > 0.8
    images = [views.level(view, 0) for view in range(len(views))]
    order = [4, 0, 6, 2, 7, 1, 5, 3]
    poses = poses_of(views)[order]
    mixed = build_views(images, views.intrinsics, poses)
    wrong = Renderer(views_in_channels(mixed, Channels.CONTRAST), WALL)
    assert usual_agreement(mixed, Channels.CONTRAST, 48, wrong) < 0.5 * right


def test_a_single_photo_agrees_with_no_other() -> None:
    views = wall_views(1)
    renderer = Renderer(views_in_channels(views, Channels.CONTRAST), WALL)
    assert usual_agreement(views, Channels.CONTRAST, 48, renderer) == 0.0
