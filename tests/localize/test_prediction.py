"""The prior as a density: against a mixture written by hand, and that its samples follow it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize import prediction as prediction_module
from pipelines.localize.belief import Region, normalise_log_weights, region_of_area
from pipelines.localize.prediction import Prediction
from pipelines.localize.state_space import PLANAR, SPATIAL

FLOOR = region_of_area((-2.0, 2.0, -1.5, 1.5))
CENTRES = np.array([[-0.5, 0.2, 0.3], [0.4, -0.1, 3.1], [0.5, 0.5, -1.0]])
WEIGHTS = np.array([0.5, 0.3, 0.2])


def prediction(anywhere_share: float = 0.0) -> Prediction:
    return Prediction(PLANAR, CENTRES, np.log(WEIGHTS), 0.15, 0.12, FLOOR, anywhere_share)


def by_hand(states: FloatArray, anywhere_share: float) -> FloatArray:
    """The mixture, its headings wrapped round the circle three times."""
    covariance = np.diag([0.15**2, 0.15**2, 0.12**2])
    turns = [np.array([0.0, 0.0, 2.0 * np.pi * k]) for k in (-1, 0, 1)]
    near = sum(
        weight * multivariate_normal(centre + turn, covariance).pdf(states)
        for weight, centre in zip(WEIGHTS, CENTRES, strict=True)
        for turn in turns
    )
    inside = (np.abs(states[:, 0]) <= 2.0) & (np.abs(states[:, 1]) <= 1.5)
    anywhere = inside / (4.0 * 3.0 * 2.0 * np.pi)
    return np.asarray((1.0 - anywhere_share) * near + anywhere_share * anywhere)


@pytest.mark.parametrize("share", [0.0, 0.05, 0.6, 1.0])
def test_the_density_is_that_of_the_mixture(share: float) -> None:
    states = PLANAR.uniform(FLOOR.low - 0.5, FLOOR.high + 0.5, 500, np.random.default_rng(0))
    states[:200] = prediction().sample(200, "multinomial", np.random.default_rng(1))
    found = np.exp(prediction(share).log_density(states))
    expected = by_hand(states, share)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-12)
    assert np.any(expected == 0.0) or share < 1.0


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_the_density_integrates_to_one(share: float) -> None:
    x = np.linspace(-2.0, 2.0, 80, endpoint=False) + 0.025
    y = np.linspace(-1.5, 1.5, 60, endpoint=False) + 0.025
    heading = np.linspace(-np.pi, np.pi, 90, endpoint=False)
    grid = np.stack(np.meshgrid(x, y, heading, indexing="ij"), axis=-1).reshape(-1, 3)
    volume = 0.05 * 0.05 * (2.0 * np.pi / 90)
    total = float(np.exp(prediction(share).log_density(grid)).sum()) * volume
    assert total == pytest.approx(1.0, abs=2e-3)


def functions(states: FloatArray) -> FloatArray:
    """``(3, M)`` values of three functions whose means are compared."""
    x, y, heading = states.T
    return np.stack([np.cos(heading), x * np.sin(heading), x**2 + y])


@pytest.mark.parametrize("share", [0.0, 0.25])
def test_samples_follow_the_density(share: float) -> None:
    count = 40_000
    states = prediction(share).sample(count, "multinomial", np.random.default_rng(2))
    assert states.shape == (count, 3)
    # The mean of any function of the samples is its integral: here of three smooth ones, the
    # integral from uniform states weighted with the density.
    uniform = PLANAR.uniform(FLOOR.low, FLOOR.high, count, np.random.default_rng(3))
    density = np.exp(prediction(share).log_density(uniform)) * 4.0 * 3.0 * 2.0 * np.pi
    for sampled, wide in zip(functions(states), functions(uniform), strict=True):
        integrated = density * wide
        error = math.hypot(sampled.std(), integrated.std()) / math.sqrt(count)
        assert abs(sampled.mean() - integrated.mean()) < 5.0 * error


def test_the_uniform_part_gets_its_share_exactly() -> None:
    far = replace(prediction(0.25), region=region_of_area((50.0, 51.0, 50.0, 51.0)))
    for count in (8, 101, 1000):
        states = far.sample(count, "systematic", np.random.default_rng(4))
        assert np.count_nonzero(states[:, 0] > 40.0) == round(0.25 * count)
    assert np.all(replace(far, anywhere_share=1.0).sample(9, "systematic",
                  np.random.default_rng(5))[:, 0] > 40.0)  # fmt: skip


def test_a_spatial_prior_integrates_to_one_and_is_centred() -> None:
    centre = np.array([1.0, 2.0, 0.5, 0.2, -0.4, 1.5])
    region = Region(np.array([0.0, 1.0, 0.0]), np.array([2.0, 3.0, 1.0]))
    prior = Prediction(SPATIAL, centre[None], np.zeros(1), 0.2, 0.15, region, 0.0)
    # Drawn from a wider distribution of known density, in the same frame.
    rng = np.random.default_rng(6)
    sigmas = np.array([0.3] * 3 + [0.22] * 3)
    offsets = sigmas * rng.standard_normal((60_000, 6))
    drawn = multivariate_normal(np.zeros(6), np.diag(sigmas**2)).logpdf(offsets)
    ratios = np.exp(prior.log_density(SPATIAL.moved(centre, offsets)) - drawn)
    assert ratios.mean() == pytest.approx(1.0, abs=5.0 * ratios.std() / math.sqrt(60_000))
    deviation = SPATIAL.difference(prior.sample(20_000, "systematic", rng), centre)
    np.testing.assert_allclose(deviation.std(axis=0), [0.2] * 3 + [0.15] * 3, rtol=0.03)
    anywhere = replace(prior, anywhere_share=1.0).log_density(centre[None])
    assert anywhere[0] == pytest.approx(-math.log(4.0 * 8.0 * np.pi**2))


def test_many_pairs_are_worked_on_in_blocks_with_the_same_result(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(prediction_module, "PAIRS_IN_A_CHUNK", 250)
    rng = np.random.default_rng(7)
    centres = PLANAR.uniform(FLOOR.low, FLOOR.high, 100, rng)
    log_weights, _ = normalise_log_weights(np.zeros(len(centres)))
    prior = Prediction(PLANAR, centres, log_weights, 0.5, 0.5, FLOOR, 0.0)
    states = PLANAR.uniform(FLOOR.low, FLOOR.high, 5, rng)
    together = prior.log_density(states)
    single = np.concatenate([prior.log_density(state[None]) for state in states])
    np.testing.assert_allclose(together, single, rtol=1e-12)


def test_exact_odometry_is_still_a_density() -> None:
    exact = replace(prediction(), position_sigma=0.0, angle_sigma=0.0)
    states = exact.sample(50, "systematic", np.random.default_rng(8))
    assert np.all(np.isfinite(exact.log_density(states)))
    assert np.all(np.isin(states[:, 0], CENTRES[:, 0]))


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_no_states_have_no_densities(share: float) -> None:
    assert prediction(share).log_density(np.empty((0, 3))).shape == (0,)
