"""An alignment with a prior: between both, with the posterior's covariance."""

from dataclasses import replace

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.alignment import Prior, align
from pipelines.localize.observation import Observation, Observer
from pipelines.localize.state_space import PLANAR, SPATIAL, StateSpace
from pipelines.render.renderer import Renderer
from tests.report_samples import CAMERA, MOUNT, facing_wall, photo, smooth, wall_scene

FLOOR_TRUTH = facing_wall(-0.4, 1.7, 0.15)
SEEN = Observer(CAMERA, [24, 48])(photo(FLOOR_TRUTH, paint=smooth)).by_width
IMAGES = [SEEN[24], SEEN[48]]
both = pytest.mark.parametrize("space", [PLANAR, SPATIAL], ids=lambda space: space.name)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer.of_scene(wall_scene(smooth), threads=1)


def truth_in(space: StateSpace) -> FloatArray:
    return FLOOR_TRUTH if space is PLANAR else space.states(PLANAR.poses(FLOOR_TRUTH))


def information(space: StateSpace, position: float, angle: float) -> FloatArray:
    return np.diag([position**-2.0] * space.positions + [angle**-2.0] * space.angles)


@both
def test_a_strong_prior_keeps_the_state_and_is_the_posterior(
    space: StateSpace, renderer: Renderer
) -> None:
    offset = np.full(space.dimension, 0.03)
    believed = space.moved(truth_in(space), offset)
    prior = Prior(believed, information(space, 1e-6, 1e-6), 4.0)
    found = align(renderer, space, believed, MOUNT, IMAGES, prior=prior)
    assert np.abs(space.difference(found.state, believed)).max() < 1e-4
    np.testing.assert_allclose(np.diag(found.covariance), 1e-12, rtol=0.02)


@both
def test_a_weak_prior_changes_nothing(space: StateSpace, renderer: Renderer) -> None:
    start = space.moved(truth_in(space), np.full(space.dimension, 0.02))
    elsewhere = space.moved(truth_in(space), np.full(space.dimension, -0.3))
    alone = align(renderer, space, start, MOUNT, IMAGES)
    prior = Prior(elsewhere, information(space, 1e4, 1e4), 4.0)
    found = align(renderer, space, start, MOUNT, IMAGES, prior=prior)
    np.testing.assert_allclose(space.difference(found.state, alone.state), 0.0, atol=1e-6)
    assert found.error == pytest.approx(alone.error, rel=1e-6)


def noisy(seed: int) -> list[Observation]:
    """Both sizes of the image with independent noise in every pixel."""
    rng = np.random.default_rng(seed)
    return [
        replace(own, image=(own.image + rng.normal(0.0, 8.0, own.image.shape)).astype(np.float32))
        for own in IMAGES
    ]


def test_where_it_ends_is_where_gaussian_information_adds_up(renderer: Renderer) -> None:
    """The image's information from a prior that says nothing; then one that is as sharp as it."""
    for seed in range(4):
        images = noisy(seed)[1:]
        nothing = Prior(FLOOR_TRUTH, information(PLANAR, 1e4, 1e4), 1.0)
        alone = align(renderer, PLANAR, FLOOR_TRUTH, MOUNT, images, 20, nothing)
        # How far errors of tiles are alike is asked where an alignment begins: at the same place.
        alone = align(renderer, PLANAR, alone.state, MOUNT, images, 20, nothing)
        own = np.asarray(np.linalg.inv(alone.covariance), dtype=np.float64)
        # Ten times as far as the image is sharp, along its own worst direction.
        values, vectors = np.linalg.eigh(alone.covariance)
        believed = PLANAR.moved(alone.state, 10.0 * np.sqrt(values[-1]) * vectors[:, -1])
        found = align(renderer, PLANAR, alone.state, MOUNT, images, 20, Prior(believed, own, 1.0))
        moved = PLANAR.difference(found.state, alone.state)
        expected = 0.5 * PLANAR.difference(believed, alone.state)
        # Half-way, and half the variance.
        assert np.linalg.norm(moved - expected) < 0.35 * np.linalg.norm(expected)
        ratio = np.trace(np.linalg.solve(alone.covariance, found.covariance)) / 3.0
        assert ratio == pytest.approx(0.5, abs=0.1)


def test_a_doubted_image_moves_a_state_less(renderer: Renderer) -> None:
    believed = PLANAR.moved(FLOOR_TRUTH, np.array([0.04, 0.0, 0.02]))
    moved, spread = [], []
    for inflation in (1.0, 5.0, 25.0):
        prior = Prior(believed, information(PLANAR, 0.02, 0.01), inflation)
        found = align(renderer, PLANAR, believed, MOUNT, noisy(1), 20, prior)
        moved.append(float(np.linalg.norm(PLANAR.difference(found.state, believed))))
        spread.append(float(np.trace(found.covariance)))
        # Never less sure than before.
        assert np.linalg.eigvalsh(np.linalg.inv(prior.information) - found.covariance).min() > -1e-9
    assert moved[0] > moved[1] > moved[2]
    assert spread[0] < spread[1] < spread[2]
