"""Likelihoods: settings, annealed weights, some of the pixels in the place of all."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError, StageError
from pipelines.localize.belief import effective_sample_size, normalise_log_weights
from pipelines.localize.likelihood import LIKELIHOODS, Likelihood, likelihood_named
from pipelines.localize.observation import Observation
from pipelines.localize.state_space import PLANAR
from pipelines.localize.tempering import tempered
from pipelines.render.choices import Channels, Cost
from pipelines.render.renderer import Renderer
from tests.report_samples import CAMERA, MOUNT, facing_wall, photo, wall_scene

log_likelihood_vectors = arrays(
    np.float64,
    st.integers(2, 60),
    elements=st.one_of(st.floats(-1e4, 0.0), st.just(-np.inf)),
)
shares = st.floats(0.0, 0.5)


def equal(count: int) -> FloatArray:
    return np.full(count, -np.log(count))


def random_prior(count: int, seed: int = 0) -> FloatArray:
    return normalise_log_weights(np.random.default_rng(seed).normal(0.0, 1.0, count))[0]


@given(log_likelihood_vectors, shares)
def test_tempered_weights_are_normalised_and_their_power_is_a_power(
    log_likelihoods: FloatArray, share: float
) -> None:
    count = len(log_likelihoods)
    log_weights, power = tempered(equal(count), log_likelihoods, share)
    assert 0.0 < power <= 1.0
    assert np.sum(np.exp(log_weights)) == pytest.approx(1.0, abs=1e-9)
    possible = np.isfinite(log_likelihoods)
    if possible.any():
        # However flat, an impossible state stays impossible.
        np.testing.assert_array_equal(np.isneginf(log_weights), ~possible)


@given(log_likelihood_vectors, shares)
def test_the_wanted_effective_sample_size_is_kept(
    log_likelihoods: FloatArray, share: float
) -> None:
    count = len(log_likelihoods)
    possible = int(np.count_nonzero(np.isfinite(log_likelihoods)))
    log_weights, _ = tempered(equal(count), log_likelihoods, share)
    # No power gives weight back to what is impossible.
    reachable = min(share * count, possible if possible else count)
    assert effective_sample_size(log_weights) >= reachable * (1.0 - 1e-4)


def test_a_sharp_likelihood_is_flattened_exactly_as_far_as_needed() -> None:
    log_likelihoods = -0.5 * np.linspace(0.0, 300.0, 1000) ** 2
    assert effective_sample_size(log_likelihoods) < 10.0
    log_weights, power = tempered(equal(1000), log_likelihoods, 0.1)
    assert power < 1.0
    assert effective_sample_size(log_weights) == pytest.approx(100.0, rel=1e-3)
    # What comes back is the posterior of that power, and not something else of that size.
    expected, _ = normalise_log_weights(power * log_likelihoods)
    np.testing.assert_allclose(log_weights, expected, atol=1e-9)


def test_where_it_is_not_needed_the_result_is_bayes() -> None:
    log_likelihoods = -np.random.default_rng(1).uniform(0.0, 2.0, 200)
    prior = random_prior(200)
    log_weights, power = tempered(prior, log_likelihoods, 0.1)
    assert power == 1.0
    weights = np.exp(prior) * np.exp(log_likelihoods)
    np.testing.assert_allclose(np.exp(log_weights), weights / weights.sum(), rtol=1e-12)


def test_a_share_of_zero_leaves_the_likelihood_as_sharp_as_it_is() -> None:
    log_likelihoods = np.array([-5000.0, 0.0, -9000.0])
    log_weights, power = tempered(equal(3), log_likelihoods, 0.0)
    assert power == 1.0
    np.testing.assert_array_equal(log_weights, [-5000.0, 0.0, -9000.0])


def test_tempering_asks_no_more_than_an_uneven_prior_can_give() -> None:
    prior, _ = normalise_log_weights(np.append(np.zeros(4), np.full(996, -50.0)))
    log_likelihoods = np.linspace(-30.0, 0.0, 1000)
    log_weights, power = tempered(prior, log_likelihoods, 0.1)
    assert effective_sample_size(log_weights) >= 0.5 * effective_sample_size(prior) - 1e-3
    assert 0.0 < power <= 1.0


def test_the_order_of_the_particles_survives_tempering() -> None:
    log_likelihoods = -(np.arange(50.0) ** 3)
    log_weights, _ = tempered(equal(50), log_likelihoods, 0.3)
    assert np.all(np.diff(log_weights) < 0.0)


def test_a_common_offset_of_the_log_likelihoods_changes_nothing() -> None:
    # Thousands of pixels make log-likelihoods whose exponentials all underflow.
    log_likelihoods = -np.random.default_rng(2).uniform(0.0, 400.0, 100)
    near, near_power = tempered(equal(100), log_likelihoods, 0.1)
    far, far_power = tempered(equal(100), log_likelihoods - 2.0**20, 0.1)
    assert far_power == pytest.approx(near_power, rel=1e-6)
    np.testing.assert_allclose(far, near, atol=1e-6)


def test_an_image_that_speaks_against_all_leaves_the_prior() -> None:
    prior = random_prior(30)
    log_weights, power = tempered(prior, np.full(30, -np.inf), 0.1)
    np.testing.assert_array_equal(log_weights, prior)
    assert power == 1.0


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_broken_comparison_is_an_error_and_no_weight(value: float) -> None:
    log_likelihoods = np.array([-1.0, value, -2.0])
    with pytest.raises(StageError, match="1 of 3 log-likelihoods"):
        tempered(equal(3), log_likelihoods, 0.1)


@pytest.mark.parametrize("inverse_temperature", [0.0, -1.0, np.nan, np.inf])
def test_an_impossible_inverse_temperature_is_refused(inverse_temperature: float) -> None:
    with pytest.raises(OptionError, match="inverse_temperature"):
        Likelihood(Cost.SQUARED, inverse_temperature)


def test_impossible_shares_of_the_pixels_are_refused() -> None:
    for step in (0, -1, 4, 7):
        with pytest.raises(OptionError, match="pixel_subsampling"):
            Likelihood(Cost.ROBUST, 80.0, pixel_subsampling=step)
    with pytest.raises(OptionError, match="neighbouring pixels"):
        Likelihood(Cost.GRADIENT, 60.0, pixel_subsampling=5)


def test_evidence_fits_no_gain() -> None:
    with pytest.raises(OptionError, match="fits no gain"):
        Likelihood(Cost.EVIDENCE, 150.0, fit_gain=True, channels=Channels.CONTRAST)


def test_likelihoods_have_names() -> None:
    assert set(LIKELIHOODS) == {"evidence", "squared", "robust", "zncc", "gradient"}
    assert likelihood_named("squared").cost is Cost.SQUARED
    with pytest.raises(OptionError, match=r"'sqared' is none of evidence, squared, robust"):
        likelihood_named("sqared")


# Between two recordings, nearer than they are, and turned: no view shows exactly this.
TRUTH = facing_wall(-0.4, 1.7, 0.15)


def test_a_fifth_of_the_pixels_says_the_same_on_average() -> None:
    """Over all shifts of the pattern: each pixel has one."""
    camera = CAMERA.intrinsics
    poses = PLANAR.poses(TRUTH + np.array([[0.0, 0.0, 0.0], [0.1, -0.1, 0.03]])) @ MOUNT
    image = photo(TRUTH).astype(np.float32)
    renderer = Renderer.of_scene(wall_scene(), threads=1)
    whole = renderer.costs(poses, camera, image, Cost.ROBUST, False)
    parts = []
    for number in range(5):
        query = Observation(image, camera, number).subsampled(5)
        count = np.isfinite(query[..., 0]).sum()
        parts.append(count * renderer.costs(poses, camera, query, Cost.ROBUST, False))
    np.testing.assert_allclose(np.sum(parts, axis=0) / image[..., 0].size, whole, rtol=1e-5)
    spread = np.std(np.array(parts) / (image[..., 0].size / 5.0), axis=0)
    assert np.all(spread > 1e-4 * whole)
