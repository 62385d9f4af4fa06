"""Likelihoods: settings, annealed weights, how well a view explains an image."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipelines.artifacts.array_types import FloatArray
from pipelines.artifacts.errors import OptionError, StageError
from pipelines.lightfield.comparison import Cost
from pipelines.lightfield.renderer import Renderer
from pipelines.localize.belief import effective_sample_size, normalise_log_weights
from pipelines.localize.likelihood import (
    LIKELIHOODS,
    Comparison,
    Likelihood,
    likelihood_named,
    tempered,
)
from pipelines.localize.observation import Observation, Observer
from pipelines.localize.state_space import PLANAR
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


@pytest.mark.parametrize("sharpness", [0.0, -1.0, np.nan, np.inf])
def test_impossible_sharpness_is_refused(sharpness: float) -> None:
    with pytest.raises(OptionError, match="sharpness"):
        Likelihood(Cost.SQUARED, sharpness)


def test_impossible_shares_of_the_pixels_are_refused() -> None:
    for step in (0, -1, 4, 7):
        with pytest.raises(OptionError, match="one pixel in"):
            Likelihood(Cost.ROBUST, 80.0, one_pixel_in=step)
    with pytest.raises(OptionError, match="neighbouring pixels"):
        Likelihood(Cost.GRADIENT, 60.0, one_pixel_in=5)


def test_likelihoods_have_names() -> None:
    assert set(LIKELIHOODS) == {"squared", "robust", "zncc", "gradient"}
    assert likelihood_named("squared").cost is Cost.SQUARED
    with pytest.raises(OptionError, match=r"'sqared' is none of squared, robust"):
        likelihood_named("sqared")


# --- against the images of a painted wall ------------------------------------------------------

# Between two recordings, nearer than they are, and turned: no view shows exactly this.
TRUTH = facing_wall(-0.4, 1.7, 0.15)
WRONG = facing_wall(1.3, 1.7, -0.3)
BACK_TO_THE_WALL = facing_wall(0.0, 1.7, np.pi)


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    renderer = Renderer.of_scene(wall_scene(), threads=1)
    return Comparison(renderer, PLANAR, MOUNT, LIKELIHOODS["squared"])


def observation_at(state: FloatArray) -> Observation:
    return Observer(CAMERA, [24])(photo(state)).by_width[24]


def test_the_true_view_explains_the_image_and_others_do_not(comparison: Comparison) -> None:
    observation = observation_at(TRUTH)
    assert comparison.match(TRUTH[None], observation) > 0.98
    assert comparison.match(WRONG[None], observation) < 0.5
    assert comparison.match(BACK_TO_THE_WALL[None], observation) == 0.0


def test_the_match_is_the_correlation_of_the_pixels(comparison: Comparison) -> None:
    near = TRUTH + np.array([0.5, 0.1, -0.05])
    observation = observation_at(TRUTH)
    from_base = np.eye(4)
    from_base[:2, :2] = [[np.cos(near[2]), -np.sin(near[2])], [np.sin(near[2]), np.cos(near[2])]]
    from_base[:2, 3] = near[:2]
    rendering = comparison.renderer.render(from_base @ MOUNT, observation.intrinsics)
    assert rendering.coverage == 1.0
    rendered, taken = rendering.image.reshape(-1), observation.image.reshape(-1)
    correlation = np.corrcoef(rendered.astype(float), taken.astype(float))[0, 1]
    # The rendered image is rounded to whole grey levels here and not in the comparison.
    match = comparison.match(near[None], observation)
    assert match == pytest.approx(correlation, abs=2e-3)
    assert 0.3 < match < 0.95


def test_opposite_brightness_matches_as_little_as_a_blank_image(comparison: Comparison) -> None:
    observation = observation_at(TRUTH)
    negative = Observation(255.0 - observation.image, observation.intrinsics)
    black = Observation(np.zeros_like(observation.image), observation.intrinsics)
    assert comparison.match(TRUTH[None], negative) == 0.0
    assert comparison.match(TRUTH[None], black) == 0.0


def test_a_darker_exposure_matches_as_well(comparison: Comparison) -> None:
    observation = observation_at(TRUTH)
    darker = Observation((0.6 * observation.image).astype(np.float32), observation.intrinsics)
    assert comparison.match(TRUTH[None], darker) > 0.98


@pytest.mark.parametrize("name", sorted(LIKELIHOODS))
def test_every_likelihood_prefers_the_truth(name: str, comparison: Comparison) -> None:
    states = np.stack([WRONG, TRUTH, BACK_TO_THE_WALL, TRUTH + np.array([0.3, 0.0, 0.0])])
    likelihood = LIKELIHOODS[name]
    judge = Comparison(comparison.renderer, PLANAR, MOUNT, likelihood)
    costs = -judge.log_likelihoods(states, observation_at(TRUTH)) / likelihood.sharpness
    assert np.all((costs >= 0.0) & (costs <= 1.0))
    assert int(np.argmin(costs)) == 1
    # Looking at nothing never wins, not even against a wrong view of something.
    assert costs[2] > costs[3]


def test_the_match_of_several_states_is_that_of_the_best(comparison: Comparison) -> None:
    observation = observation_at(TRUTH)
    states = np.stack([WRONG, TRUTH, BACK_TO_THE_WALL])
    assert comparison.match(states, observation) == comparison.match(TRUTH[None], observation)


def test_pixels_that_do_not_show_the_scene_do_not_count(comparison: Comparison) -> None:
    observation = observation_at(TRUTH)
    hidden = observation.image.copy()
    hidden[10:, 4:20] = 255.0
    masked = hidden.copy()
    masked[10:, 4:20] = np.nan
    dirty, left_out = (Observation(image, observation.intrinsics) for image in (hidden, masked))
    assert comparison.match(TRUTH[None], dirty) < 0.9
    assert comparison.match(TRUTH[None], left_out) > 0.98
    states = np.stack([TRUTH, WRONG])
    right, wrong = comparison.log_likelihoods(states, left_out)
    assert right > wrong
    assert right == pytest.approx(comparison.log_likelihoods(states, observation)[0], abs=0.5)


def test_a_fifth_of_the_pixels_says_the_same_on_average() -> None:
    """Over the turns of all lattices: each pixel has one."""
    camera = CAMERA.intrinsics
    poses = PLANAR.poses(TRUTH + np.array([[0.0, 0.0, 0.0], [0.1, -0.1, 0.03]])) @ MOUNT
    image = photo(TRUTH).astype(np.float32)
    renderer = Renderer.of_scene(wall_scene(), threads=1)
    whole = renderer.costs(poses, camera, image, Cost.ROBUST, False)
    parts = []
    for number in range(5):
        query = Observation(image, camera, number).thinned(5)
        count = np.isfinite(query[..., 0]).sum()
        parts.append(count * renderer.costs(poses, camera, query, Cost.ROBUST, False))
    np.testing.assert_allclose(np.sum(parts, axis=0) / image[..., 0].size, whole, rtol=1e-5)
    spread = np.std(np.array(parts) / (image[..., 0].size / 5.0), axis=0)
    assert np.all(spread > 1e-4 * whole)
