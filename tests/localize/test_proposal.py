"""The Gaussian mixture that particles are drawn from, and that drawing from it changes nothing."""

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.belief import normalise_log_weights, region_of_area
from pipelines.localize.prediction import Prediction
from pipelines.localize.proposal import Proposal
from pipelines.localize.state_space import PLANAR, SPATIAL, StateSpace

SHARES = np.array([0.7, 0.3])
both = pytest.mark.parametrize("space", [PLANAR, SPATIAL], ids=lambda space: space.name)


def proposal(space: StateSpace, seed: int = 0) -> Proposal:
    """Two components with full covariances, one of them across the jump of the heading."""
    rng = np.random.default_rng(seed)
    means = np.zeros((2, space.dimension))
    means[0, 0], means[0, -1] = 1.0, np.pi - 0.05
    means[1, 1], means[1, -1] = -2.0, 0.4
    factors = 0.1 * rng.standard_normal((2, space.dimension, space.dimension))
    covariances = factors @ factors.transpose(0, 2, 1) + 0.002 * np.eye(space.dimension)
    return Proposal(space, means, covariances, np.log(SHARES))


@both
def test_the_density_is_scipys_in_the_tangent_spaces(space: StateSpace) -> None:
    mixture = proposal(space)
    states = mixture.sample(300, np.random.default_rng(1))
    expected = sum(
        share
        * multivariate_normal(np.zeros(space.dimension), covariance).pdf(
            space.difference(states, mean)
        )
        for share, mean, covariance in zip(SHARES, mixture.means, mixture.covariances, strict=True)
    )
    np.testing.assert_allclose(np.exp(mixture.log_density(states)), expected, rtol=1e-9)


@both
def test_samples_have_the_components_moments_and_shares(space: StateSpace) -> None:
    mixture, count = proposal(space), 40_000
    states = mixture.sample(count, np.random.default_rng(2))
    # The components lie far apart: a sample's nearest mean is its own.
    own = np.argmin(
        [np.linalg.norm(states[:, :2] - mean[:2], axis=1) for mean in mixture.means], axis=0
    )
    np.testing.assert_allclose(np.bincount(own) / count, SHARES, atol=2e-4)
    for index, (mean, covariance) in enumerate(
        zip(mixture.means, mixture.covariances, strict=True)
    ):
        offsets = space.difference(states[own == index], mean)
        scale = np.sqrt(np.diag(covariance))
        limit = 5.0 / math.sqrt(len(offsets))
        assert np.all(np.abs(offsets.mean(axis=0)) < limit * scale)
        found = np.cov(offsets.T) / np.outer(scale, scale)
        np.testing.assert_allclose(found, covariance / np.outer(scale, scale), atol=1.5 * limit)


def functions(states: FloatArray) -> FloatArray:
    """``(3, M)`` values of three functions whose means are compared."""
    x, y, heading = states.T
    return np.stack([np.sin(heading), x * y, x])


def test_samples_follow_the_density() -> None:
    mixture, count = proposal(PLANAR), 50_000
    states = mixture.sample(count, np.random.default_rng(3))
    low, high = np.array([-1.5, -4.0]), np.array([3.0, 1.5])
    uniform = PLANAR.uniform(low, high, 6 * count, np.random.default_rng(4))
    volume = float(np.prod(high - low)) * 2.0 * np.pi
    weights = np.exp(mixture.log_density(uniform)) * volume
    assert weights.mean() == pytest.approx(1.0, abs=5.0 * weights.std() / math.sqrt(len(weights)))
    for sampled, wide in zip(functions(states), functions(uniform), strict=True):
        integrated = weights * wide
        error = math.hypot(
            sampled.std() / math.sqrt(count), integrated.std() / math.sqrt(len(uniform))
        )
        assert abs(sampled.mean() - integrated.mean()) < 5.0 * error


def test_draws_are_seeded() -> None:
    first = proposal(PLANAR).sample(20, np.random.default_rng(5))
    assert first.tobytes() == proposal(PLANAR).sample(20, np.random.default_rng(5)).tobytes()


# --- importance weights: the posterior stays what it is ----------------------------------------

FLOOR = region_of_area((-3.0, 3.0, -3.0, 3.0))
PRIOR = Prediction(
    PLANAR,
    np.array([[-0.6, 0.0, 0.2], [0.7, 0.3, -0.3]]),
    np.log([0.6, 0.4]),
    0.4,
    0.3,
    FLOOR,
    0.05,
)


def log_likelihoods(states: FloatArray) -> FloatArray:
    """Two peaks, one of which the prior hardly allows for."""
    near = multivariate_normal([0.3, 0.1, 0.1], np.diag([0.05, 0.03, 0.02])).logpdf(states)
    other = multivariate_normal([-1.2, 0.4, 0.4], np.diag([0.04, 0.04, 0.03])).logpdf(states)
    return np.asarray(np.logaddexp(near, other))


@pytest.fixture(scope="module")
def exact() -> FloatArray:
    """Posterior means of ``moments`` by summing over a fine grid."""
    place = np.linspace(-3.0, 3.0, 71)
    axes = [place, place, np.linspace(-np.pi, np.pi, 90, endpoint=False)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    weights = np.exp(normalise_log_weights(PRIOR.log_density(grid) + log_likelihoods(grid))[0])
    return np.asarray(weights @ moments(grid))


def moments(states: FloatArray) -> FloatArray:
    x, y, heading = states.T
    return np.stack([x, y, np.cos(heading), np.sin(heading), x * x, x * y, x > 0.0], axis=1)


def weighted_moments(seed: int, proposed_share: float, misplaced: float) -> FloatArray:
    """Posterior means from particles that a mixture of prior and proposal gave.

    The weights are written down as in a textbook: likelihood times prior over the density that was
    drawn from.
    """
    rng = np.random.default_rng(seed)
    count = 600
    means = np.array([[0.3, 0.1, 0.1], [-1.2, 0.4, 0.4]]) + misplaced
    covariances = np.stack([np.diag([0.08, 0.08, 0.05])] * 2)
    chosen = Proposal(PLANAR, means, covariances, np.log([0.8, 0.2]))
    proposed = round(proposed_share * count)
    states = PRIOR.sample(count - proposed, "systematic", rng)
    prior = np.exp(PRIOR.log_density(states))
    if proposed:
        states = np.concatenate([states, chosen.sample(proposed, rng)])
        prior = np.exp(PRIOR.log_density(states))
        drawn = np.exp(chosen.log_density(states))
        density = (1.0 - proposed / count) * prior + proposed / count * drawn
    else:
        density = prior
    weights = np.exp(log_likelihoods(states)) * prior / density
    return np.asarray(weights @ moments(states) / weights.sum())


@pytest.mark.parametrize(("share", "misplaced"), [(0.0, 0.0), (0.6, 0.0), (0.6, 0.3)])
def test_the_posterior_is_the_same_wherever_particles_are_drawn(
    share: float, misplaced: float, exact: FloatArray
) -> None:
    found = np.array([weighted_moments(seed, share, misplaced) for seed in range(60)])
    error = found.std(axis=0) / math.sqrt(len(found))
    # Five standard errors, and the bias of order 1 / count of a ratio of means.
    assert np.all(np.abs(found.mean(axis=0) - exact) < 5.0 * error + 0.01)
    assert np.all(error < 0.02)


def test_a_proposal_that_looks_at_the_image_needs_fewer_particles() -> None:
    plain = np.array([weighted_moments(seed, 0.0, 0.0) for seed in range(40)])
    informed = np.array([weighted_moments(seed, 0.6, 0.0) for seed in range(40)])
    assert np.median(informed.std(axis=0) / plain.std(axis=0)) < 0.8
