"""The number of particles and their spreading: the KLD bound, its limits, moments of the noise."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.pose import wrap_angle
from pipelines.localize.belief import Belief, gaussian_belief, region_of_area, uniform_belief
from pipelines.localize.kld_sampling import (
    CELL_HEADING,
    CELL_POSITION,
    KLD_ERROR,
    KLD_QUANTILE,
    kld_count,
    next_count,
    roughened,
)
from pipelines.localize.state_space import PLANAR
from tests.localize_samples import weighted


@pytest.mark.parametrize("cells", [2, 3, 5, 10, 30, 100, 1000, 20_000])
def test_the_kld_count_is_the_quantile_that_it_approximates(cells: int) -> None:
    # Fox 2003, equation 7; equation 12, which is used, is its Wilson-Hilferty approximation.
    exact = float(chi2.ppf(KLD_QUANTILE, cells - 1)) / (2.0 * KLD_ERROR)
    assert kld_count(cells) == pytest.approx(exact, rel=0.04, abs=1.0)


def test_the_kld_count_of_one_cell_is_one_particle() -> None:
    assert kld_count(0) == kld_count(1) == 1


def test_the_kld_count_grows_with_the_cells() -> None:
    counts = [kld_count(cells) for cells in range(1, 500)]
    assert counts == sorted(set(counts))


def spread_over(cells: int, copies: int = 1) -> Belief:
    """``copies`` equally weighted particles in the middle of each of ``cells`` places."""
    states = np.zeros((cells, 3))
    states[:, 0] = (np.arange(cells) + 0.5) * CELL_POSITION
    states[:, 1:] = 0.5 * CELL_POSITION, 0.5 * CELL_HEADING
    states = np.repeat(states, copies, axis=0)
    return Belief(states, np.full(len(states), -math.log(len(states))))


def test_the_next_count_is_what_the_occupied_cells_ask_for() -> None:
    assert next_count(spread_over(20, copies=100), 10, 0.0) == kld_count(20)


def test_headings_are_counted_too() -> None:
    states = np.zeros((1000, 3))
    states[:, 2] = wrap_angle(CELL_HEADING * (np.arange(1000) % 24 + 0.5))
    belief = Belief(states, np.full(1000, -math.log(1000)))
    assert next_count(belief, 1, 0.0) == kld_count(24)


def test_full_turns_do_not_make_cells() -> None:
    states = np.zeros((1000, 3))
    states[:, 2] = 0.1 + 2.0 * np.pi * (np.arange(1000) % 5)
    belief = Belief(states, np.full(1000, -math.log(1000)))
    assert next_count(belief, 1, 0.0) == 1


def test_cells_of_negligible_weight_do_not_count() -> None:
    belief = spread_over(30, copies=100)
    weights = np.where(np.arange(len(belief)) < 1000, 1.0, 1e-9)
    assert next_count(weighted(belief.states.tolist(), weights.tolist()), 10, 0.0) == kld_count(10)


@given(
    count=st.integers(1, 300),
    smallest=st.integers(1, 400),
    factor=st.floats(0.0, 1.0),
    spread=st.floats(0.0, 10.0),
)
def test_the_next_count_stays_in_its_bounds(
    count: int, smallest: int, factor: float, spread: float
) -> None:
    belief = gaussian_belief(
        PLANAR, (1.0, 2.0, 3.0), spread, spread, count, np.random.default_rng(0)
    )
    chosen = next_count(belief, smallest, factor)
    assert chosen >= smallest
    assert chosen <= max(count, smallest)
    assert chosen >= min(count, factor * count)


def test_a_narrow_belief_shrinks_no_faster_than_it_may() -> None:
    count, counts = 20_000, []
    for _ in range(12):
        states = np.full((count, 3), 0.05)
        count = next_count(Belief(states, np.full(count, -math.log(count))), 195, 0.6)
        counts.append(count)
    assert counts[:3] == [12_000, 7200, 4320]
    assert counts[-1] == 195


def test_a_belief_that_is_everywhere_keeps_its_particles() -> None:
    belief = uniform_belief(
        PLANAR, region_of_area([-5.0, 5.0, -5.0, 5.0]), 5000, np.random.default_rng(0)
    )
    assert next_count(belief, 195, 0.6) == 5000


# --- roughening --------------------------------------------------------------------------------


def particles(count: int, heading: float, seed: int) -> FloatArray:
    spread = np.array([0.5, 2.0, 0.3])
    draws = np.random.default_rng(1000 + seed).normal(size=(count, 3))
    return np.asarray(draws * spread + np.array([3.0, -1.0, heading]))


@pytest.mark.parametrize("heading", [0.0, 3.1])
@pytest.mark.parametrize("factor", [0.5, 1.0])
def test_roughening_has_the_moments_of_its_formula(heading: float, factor: float) -> None:
    count, seeds = 1000, 100
    expected = factor * np.array([0.5, 2.0, 0.3]) * count ** (-1.0 / 3.0)
    noises = []
    for seed in range(seeds):
        states = particles(count, heading, seed)
        states[:, 2] = wrap_angle(states[:, 2])
        noise = roughened(PLANAR, states, factor, np.random.default_rng(seed)) - states
        noise[:, 2] = wrap_angle(noise[:, 2])
        noises.append(noise)
    noise = np.concatenate(noises)
    # Five standard errors; the spread of the particles varies from seed to seed as well.
    assert np.all(np.abs(noise.mean(axis=0)) < 5.0 * expected / math.sqrt(count * seeds))
    np.testing.assert_allclose(noise.std(axis=0), expected, rtol=0.015)


def test_headings_on_both_sides_of_the_jump_are_close_together() -> None:
    # As plain numbers their spread would be pi, and half of the particles would turn round.
    states = np.zeros((200, 3))
    states[:, 2] = np.where(np.arange(200) % 2 == 0, np.pi - 0.01, -np.pi + 0.01)
    moved = roughened(PLANAR, states, 1.0, np.random.default_rng(0))
    assert np.all((moved[:, 2] > -np.pi) & (moved[:, 2] <= np.pi))
    assert np.abs(wrap_angle(moved[:, 2] - np.pi)).max() < 0.05
    assert np.any(moved[:, 2] > 0.0)
    assert np.any(moved[:, 2] < 0.0)


def test_uniform_headings_are_spread_by_a_finite_angle() -> None:
    states = np.zeros((1000, 3))
    states[:, 2] = wrap_angle(2.0 * np.pi * np.arange(1000) / 1000)
    noise = wrap_angle(
        roughened(PLANAR, states, 1.0, np.random.default_rng(0))[:, 2] - states[:, 2]
    )
    assert noise.std() == pytest.approx(0.1 * np.pi / math.sqrt(3.0), rel=0.1)


def test_no_factor_no_spread_and_nothing_in_place() -> None:
    states = particles(50, 0.0, 0)
    before = states.copy()
    np.testing.assert_allclose(
        roughened(PLANAR, states, 0.0, np.random.default_rng(0)), states, atol=1e-12
    )
    roughened(PLANAR, states, 1.0, np.random.default_rng(0))
    np.testing.assert_array_equal(states, before)


def test_a_single_particle_is_left_alone() -> None:
    state = np.array([[1.0, 2.0, 3.0]])
    moved = roughened(PLANAR, state, 1.0, np.random.default_rng(0))
    np.testing.assert_allclose(moved, state, atol=1e-6)


def test_the_draws_are_seeded() -> None:
    states = particles(20, 0.0, 0)
    first = roughened(PLANAR, states, 1.0, np.random.default_rng(3))
    assert first.tobytes() == roughened(PLANAR, states, 1.0, np.random.default_rng(3)).tobytes()
    assert first.tobytes() != roughened(PLANAR, states, 1.0, np.random.default_rng(4)).tobytes()
