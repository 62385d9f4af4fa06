"""Beliefs: normalisation, effective sample size, starts."""

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError, StageError
from pipelines.localize.belief import (
    Belief,
    Region,
    effective_sample_size,
    gaussian_belief,
    log_sum,
    normalise_log_weights,
    region_of_area,
    uniform_belief,
)
from pipelines.localize.state_space import PLANAR, SPATIAL
from tests.localize_samples import weighted

# Down to where exp underflows and far beyond it, with weights of zero among them.
LOG_VALUES = st.one_of(st.floats(-1e5, 1e5), st.just(-np.inf))
log_weight_vectors = arrays(np.float64, st.integers(1, 40), elements=LOG_VALUES)


@given(log_weight_vectors)
def test_normalised_weights_add_up_to_one_and_keep_their_ratios(values: FloatArray) -> None:
    normalised, ok = normalise_log_weights(values)
    assert np.sum(np.exp(normalised)) == pytest.approx(1.0, abs=1e-9)
    assert ok == bool(np.any(np.isfinite(values)))
    if ok:
        finite = np.isfinite(values)
        np.testing.assert_array_equal(np.isneginf(normalised), ~finite)
        shift = normalised[finite] - values[finite]
        np.testing.assert_allclose(shift, shift[0], atol=1e-9)


@given(arrays(np.float64, st.tuples(st.integers(1, 9), st.integers(1, 5)), elements=LOG_VALUES))
def test_logarithms_of_sums_are_those_of_scipy(values: FloatArray) -> None:
    expected = scipy.special.logsumexp(values, axis=0)
    np.testing.assert_allclose(log_sum(values), expected, rtol=1e-14, atol=1e-14)
    assert log_sum(values[:, 0]) == pytest.approx(expected[0], rel=1e-14, abs=1e-14)


def test_likelihoods_that_would_underflow_still_count() -> None:
    normalised, ok = normalise_log_weights([-90000.0, -90000.0 + np.log(3.0), -np.inf])
    assert ok
    np.testing.assert_allclose(np.exp(normalised), [0.25, 0.75, 0.0], atol=1e-9)


def test_weights_that_are_all_zero_are_reported() -> None:
    normalised, ok = normalise_log_weights(np.full(8, -np.inf))
    assert not ok
    np.testing.assert_allclose(np.exp(normalised), 0.125)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_nan_and_infinite_weights_are_errors(bad: float) -> None:
    with pytest.raises(StageError, match="1 of 3 log-weights"):
        normalise_log_weights([0.0, bad, -np.inf])


def test_no_weights_are_an_error() -> None:
    with pytest.raises(OptionError, match="M > 0"):
        normalise_log_weights([])


@pytest.mark.parametrize(
    ("weights", "expected"),
    [([1.0] * 7, 7.0), ([1.0, 0.0, 0.0], 1.0), ([0.5, 0.25, 0.25], 1.0 / 0.375)],
)
def test_effective_sample_size(weights: list[float], expected: float) -> None:
    belief = weighted(np.zeros((len(weights), 3)).tolist(), weights)
    assert effective_sample_size(belief.log_weights) == pytest.approx(expected)
    # A common offset, even one beyond the range of exp, changes nothing.
    assert effective_sample_size(belief.log_weights - 5000.0) == pytest.approx(expected)


def test_effective_sample_size_of_nothing_is_zero() -> None:
    assert effective_sample_size(np.full(4, -np.inf)) == 0.0


def test_uniform_start_fills_area_and_circle_evenly() -> None:
    belief = uniform_belief(
        PLANAR, region_of_area((-2.0, 6.0, 1.0, 3.0)), 40000, np.random.default_rng(3)
    )
    low, high = np.array([-2.0, 1.0, -np.pi]), np.array([6.0, 3.0, np.pi])
    assert np.all(belief.states >= low)
    assert np.all(belief.states <= high)
    for dimension in range(3):
        unit = (belief.states[:, dimension] - low[dimension]) / (high - low)[dimension]
        counts, _ = np.histogram(unit, bins=10, range=(0.0, 1.0))
        # 4000 expected in each; six standard deviations of a binomial count are 360.
        assert np.all(np.abs(counts - 4000) < 360)
    np.testing.assert_allclose(belief.weights, 1.0 / 40000)


def test_gaussian_start_has_the_moments_asked_for_across_the_jump_of_the_heading() -> None:
    belief = gaussian_belief(PLANAR, (1.0, -2.0, np.pi), 0.3, 0.1, 50000, np.random.default_rng(4))
    headings = belief.states[:, 2]
    assert np.all((headings > -np.pi) & (headings <= np.pi))
    assert np.min(headings) < -3.0 < 3.0 < np.max(headings)
    deviation = belief.states - [1.0, -2.0, np.pi]
    deviation[:, 2] = np.angle(np.exp(1j * deviation[:, 2]))
    np.testing.assert_allclose(deviation.mean(axis=0), 0.0, atol=0.01)
    np.testing.assert_allclose(deviation.std(axis=0), [0.3, 0.3, 0.1], rtol=0.02)


def test_gaussian_start_without_spread_is_the_state() -> None:
    belief = gaussian_belief(PLANAR, (1.0, 2.0, 0.5), 0.0, 0.0, 3, np.random.default_rng(0))
    np.testing.assert_array_equal(belief.states, [[1.0, 2.0, 0.5]] * 3)


def test_same_seed_same_start() -> None:
    first = uniform_belief(PLANAR, region_of_area((0, 1, 0, 1)), 5, np.random.default_rng(9))
    second = uniform_belief(PLANAR, region_of_area((0, 1, 0, 1)), 5, np.random.default_rng(9))
    assert first.states.tobytes() == second.states.tobytes()


@pytest.mark.parametrize(
    "bounds", [(1.0, 1.0, 0.0, 1.0), (0.0, 1.0, 2.0, 1.0), (0.0, np.nan, 0.0, 1.0), (0.0, 1.0)]
)
def test_impossible_areas_are_refused(bounds: tuple[float, ...]) -> None:
    with pytest.raises(OptionError, match="area"):
        uniform_belief(PLANAR, region_of_area(bounds), 10, np.random.default_rng(0))


@pytest.mark.parametrize("count", [0, -5])
def test_zero_and_negative_particles_are_refused(count: int) -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(OptionError, match="at least 1"):
        uniform_belief(PLANAR, region_of_area((0, 1, 0, 1)), count, rng)
    with pytest.raises(OptionError, match="at least 1"):
        gaussian_belief(PLANAR, (0, 0, 0), 0.1, 0.1, count, rng)


@pytest.mark.parametrize(("position", "heading"), [(-0.1, 0.1), (0.1, -0.1), (np.nan, 0.1)])
def test_negative_spreads_are_refused(position: float, heading: float) -> None:
    with pytest.raises(OptionError, match="sigma"):
        gaussian_belief(PLANAR, (0, 0, 0), position, heading, 5, np.random.default_rng(0))


def test_a_belief_is_checked_when_it_is_made() -> None:
    states = np.zeros((2, 3))
    with pytest.raises(StageError, match="add up to 2"):
        Belief(states, np.zeros(2))
    with pytest.raises(StageError, match="nan"):
        Belief(states, np.array([np.nan, 0.0]))
    with pytest.raises(OptionError, match="log-weights of shape"):
        Belief(states, np.zeros(1))
    with pytest.raises(OptionError, match="not finite"):
        Belief(np.full((1, 3), np.nan), np.zeros(1))
    with pytest.raises(OptionError, match="M > 0"):
        Belief(np.zeros((0, 3)), np.zeros(0))


# --- regions -----------------------------------------------------------------------------------


def test_a_regions_density_is_one_over_its_volume() -> None:
    floor = region_of_area((-1.0, 3.0, 0.0, 2.0))
    assert floor.log_density(PLANAR) == pytest.approx(-np.log(8.0 * 2.0 * np.pi))
    room = Region(np.array([0.0, 0.0, 1.0]), np.array([2.0, 3.0, 1.5]))
    assert room.log_density(SPATIAL) == pytest.approx(-np.log(3.0 * 8.0 * np.pi**2))


def test_a_region_contains_what_lies_between_its_corners_in_any_orientation() -> None:
    floor = region_of_area((-1.0, 3.0, 0.0, 2.0))
    states = np.array([[3.0, 0.0, 9.0], [3.01, 1.0, 0.0], [0.0, -0.01, 0.0], [0.0, 2.0, -1.0]])
    np.testing.assert_array_equal(floor.contains(states), [True, False, False, True])
    room = Region(np.array([0.0, 0.0, 1.0]), np.array([2.0, 3.0, 1.5]))
    heights = np.array([[1.0, 1.0, z, 0.1, 0.2, 0.3] for z in (0.9, 1.0, 1.5, 1.6)])
    np.testing.assert_array_equal(room.contains(heights), [False, True, True, False])


@pytest.mark.parametrize(
    ("low", "high"),
    [((0.0, 0.0, 1.0), (1.0, 1.0, 1.0)), ((0.0, 2.0, 0.0), (1.0, 1.0, 1.0))],
)
def test_a_region_that_encloses_nothing_is_refused(
    low: tuple[float, ...], high: tuple[float, ...]
) -> None:
    with pytest.raises(OptionError, match=r"area x 0 to 1, y .* is empty"):
        Region(np.array(low), np.array(high))
    with pytest.raises(OptionError, match="finite"):
        Region(np.array(low), np.full(3, np.inf))


def test_a_spatial_start_has_the_moments_asked_for() -> None:
    centre = np.array([1.0, -2.0, 0.5, 0.4, -1.2, 2.0])
    belief = gaussian_belief(SPATIAL, centre, 0.3, 0.1, 50000, np.random.default_rng(4))
    deviation = SPATIAL.difference(belief.states, centre)
    np.testing.assert_allclose(deviation.mean(axis=0), 0.0, atol=0.006)
    np.testing.assert_allclose(deviation.std(axis=0), [0.3] * 3 + [0.1] * 3, rtol=0.02)


def test_states_of_four_numbers_are_no_belief() -> None:
    with pytest.raises(OptionError, match="4 numbers"):
        Belief(np.zeros((2, 4)), np.full(2, -np.log(2.0)))
