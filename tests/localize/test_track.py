"""The track: against random samples, the textbook's Kalman filter, and what it must not do."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.alignment import Alignment
from pipelines.localize.state_space import PLANAR, SPATIAL, StateSpace
from pipelines.localize.track import GATE, Track

both = pytest.mark.parametrize("space", [PLANAR, SPATIAL], ids=lambda space: space.name)


def covariance_of(space: StateSpace, seed: int, position: float, angle: float) -> FloatArray:
    """Any covariance, with about these standard deviations."""
    mixing = np.random.default_rng(seed).standard_normal((space.dimension, space.dimension))
    scale = np.array([position] * space.positions + [angle] * space.angles)
    mixing = scale[:, None] * (np.eye(space.dimension) + 0.3 * mixing)
    return np.asarray(mixing @ mixing.T)


def state_of(space: StateSpace, seed: int) -> FloatArray:
    offset = np.random.default_rng(seed).uniform(-1.0, 1.0, space.dimension)
    return np.asarray(space.moved(np.zeros(space.dimension), offset))


def aligned_at(state: FloatArray, covariance: FloatArray, **changes: Any) -> Alignment:
    chosen = {"error": 1.0, "converged": True, **changes}
    return Alignment(state, covariance, np.eye(len(state)), **chosen)


@both
@pytest.mark.parametrize("seed", range(3))
def test_what_is_predicted_is_what_samples_do(space: StateSpace, seed: int) -> None:
    rng = np.random.default_rng(seed)
    state, covariance = state_of(space, seed), covariance_of(space, seed, 0.03, 0.02)
    motion = rng.uniform(-0.4, 0.4, space.dimension)
    sigmas = np.array([0.02] * space.positions + [0.01] * space.angles)
    found = Track(state, covariance, 2, state).predicted(space, motion, sigmas)
    np.testing.assert_allclose(found.state, space.composed(state[None], motion)[0], atol=1e-12)
    count = 100_000
    errors = rng.multivariate_normal(np.zeros(space.dimension), covariance, count)
    there = space.composed(space.moved(np.repeat(state[None], count, axis=0), errors), motion)
    there = space.moved(there, sigmas * rng.standard_normal(there.shape))
    sampled = np.cov(space.difference(there, found.state).T)
    scale = np.sqrt(np.diag(sampled))
    np.testing.assert_allclose(
        found.covariance / np.outer(scale, scale), sampled / np.outer(scale, scale), atol=0.03
    )
    # A prediction is no measurement, and forgets none that was left out.
    assert (found.measured, found.rejected) == (None, 2)


@both
def test_an_update_is_the_textbooks_where_all_is_linear(space: StateSpace) -> None:
    # Turns so small that a state is a vector.
    own, image = (covariance_of(space, seed, 1e-2, 1e-5) for seed in (4, 5))
    before = np.zeros(space.dimension)
    offset = np.random.default_rng(6).multivariate_normal(before, own + image)
    track = Track(before, own, 3)
    inflation = 2.5
    found = track.updated(space, aligned_at(space.moved(before, offset), image), inflation)
    information = np.linalg.inv(own) + np.linalg.inv(inflation * image)
    expected = np.linalg.solve(information, np.linalg.solve(inflation * image, offset))
    np.testing.assert_allclose(space.difference(found.state, before), expected, atol=1e-7)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(information), rtol=1e-6, atol=1e-16)
    assert found.rejected == 0
    assert found.measured is not None
    np.testing.assert_allclose(space.difference(found.measured, before), offset, atol=1e-9)


@both
def test_the_gate_lets_through_as_many_right_alignments_as_it_says(space: StateSpace) -> None:
    rng = np.random.default_rng(1)
    own, image = (covariance_of(space, seed, 0.01, 0.005) for seed in (1, 2))
    truth, inflation, count = state_of(space, 3), 4.0, 20_000
    errors = rng.multivariate_normal(np.zeros(space.dimension), own + inflation * image, count)
    track = Track(truth, own)
    left_out = sum(
        not track.accepts(space, aligned_at(space.moved(truth, error), image), inflation)
        for error in errors
    )
    expected = (1.0 - GATE) * count
    assert abs(left_out - expected) < 5.0 * math.sqrt(expected)
    # Along one axis it is where the quantile is.
    edge = math.sqrt(chi2.ppf(GATE, space.dimension) * (own + inflation * image)[0, 0])
    own_axis = np.zeros_like(own)
    np.fill_diagonal(own_axis, np.diag(own))
    image_axis = np.diag(np.diag(image))
    for factor, is_accepted in ((0.999, True), (1.001, False)):
        offset = np.zeros(space.dimension)
        offset[0] = factor * edge
        there = aligned_at(space.moved(truth, offset), image_axis)
        assert Track(truth, own_axis).accepts(space, there, inflation) is is_accepted


def test_headings_go_round() -> None:
    track = Track(np.array([0.0, 0.0, math.pi - 0.01]), 1e-4 * np.eye(3))
    there = aligned_at(np.array([0.0, 0.0, -math.pi + 0.01]), 1e-4 * np.eye(3))
    assert track.accepts(PLANAR, there, 1.0)
    assert abs(track.updated(PLANAR, there, 1.0).state[2]) == pytest.approx(math.pi, abs=1e-9)


def test_an_alignment_that_was_held_by_its_prior_counts_as_left_out() -> None:
    track = Track(np.zeros(3), 1e-4 * np.eye(3), 1)
    posterior = 0.5e-4 * np.eye(3)
    found = track.held(PLANAR, aligned_at(np.array([0.005, 0.0, 0.0]), posterior))
    np.testing.assert_array_equal(found.state, [0.005, 0.0, 0.0])
    np.testing.assert_array_equal(found.covariance, posterior)
    assert (found.rejected, found.measured) == (2, None)


@pytest.mark.parametrize("why", ["far", "not converged"])
def test_what_even_its_prior_does_not_hold_changes_nothing_but_the_count(why: str) -> None:
    track = Track(np.zeros(3), 1e-4 * np.eye(3), 1)
    offset = 0.1 if why == "far" else 0.0
    there = aligned_at(np.array([offset, 0.0, 0.0]), np.eye(3), converged=why == "far")
    found = track.held(PLANAR, there)
    np.testing.assert_array_equal(found.state, track.state)
    np.testing.assert_array_equal(found.covariance, track.covariance)
    assert (found.rejected, found.measured) == (2, None)


def test_a_prior_says_what_the_track_does() -> None:
    covariance = covariance_of(PLANAR, 7, 0.1, 0.05)
    prior = Track(np.array([1.0, 2.0, 0.5]), covariance).prior(3.0)
    np.testing.assert_array_equal(prior.state, [1.0, 2.0, 0.5])
    np.testing.assert_allclose(prior.information @ covariance, np.eye(3), atol=1e-9)
    assert prior.inflation == 3.0
