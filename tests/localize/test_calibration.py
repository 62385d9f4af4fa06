"""Forecasts against what came true: drawn from known probabilities, and by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.localize.calibration import (
    bin_sums,
    brier_score,
    error_of_sums,
    expected_calibration_error,
    reliability,
    wilson_interval,
)


def drawn(truth_of_forecast: float, count: int = 20_000) -> tuple[FloatArray, BoolArray]:
    """Forecasts all over 0 to 1 that come true so much less often than they say."""
    rng = np.random.default_rng(0)
    forecasts = rng.random(count)
    return forecasts, rng.random(count) < truth_of_forecast * forecasts


def test_forecasts_that_come_true_as_often_as_they_say_have_no_error() -> None:
    forecasts, outcomes = drawn(1.0)
    assert expected_calibration_error(forecasts, outcomes) < 0.02
    # The mean of p (1 - p) over all p.
    assert brier_score(forecasts, outcomes) == pytest.approx(1.0 / 6.0, abs=0.01)
    inside = [item.interval[0] <= item.mean <= item.interval[1] for item in reliability(*drawn(1))]
    assert sum(inside) >= 8


def test_the_error_of_those_that_are_too_sure_is_the_gap() -> None:
    forecasts, outcomes = drawn(0.6)
    # 0.4 p on average.
    assert expected_calibration_error(forecasts, outcomes) == pytest.approx(0.2, abs=0.01)
    always = np.full(1000, 0.95)
    half = np.arange(1000) % 2 == 0
    assert expected_calibration_error(always, half) == pytest.approx(0.45)
    assert brier_score(always, half) == pytest.approx(0.5 * (0.05**2 + 0.95**2))


def test_bins_are_those_by_hand() -> None:
    forecasts = np.array([0.0, 0.05, 0.1, 0.95, 1.0, 1.0])
    outcomes = np.array([False, False, True, True, True, False])
    bins = reliability(forecasts, outcomes)
    assert [item.forecasts for item in bins] == [2, 1, 0, 0, 0, 0, 0, 0, 0, 3]
    assert [item.hits for item in bins] == [0, 1, 0, 0, 0, 0, 0, 0, 0, 2]
    assert bins[0].mean == pytest.approx(0.025)
    assert bins[-1].share == pytest.approx(2.0 / 3.0)
    error = 2 * 0.025 + 1 * 0.9 + 3 * (2.95 / 3 - 2 / 3)
    assert expected_calibration_error(forecasts, outcomes) == pytest.approx(error / 6)


def test_an_empty_bin_claims_nothing() -> None:
    empty = reliability(np.array([0.95]), np.array([True]))[0]
    assert math.isnan(empty.mean)
    assert math.isnan(empty.share)
    assert empty.interval == (0.0, 1.0)
    assert empty.to_dict()["share"] is None
    nothing, none = np.empty(0), np.empty(0, dtype=np.bool_)
    assert math.isnan(expected_calibration_error(nothing, none))
    assert math.isnan(brier_score(nothing, none))
    assert sum(item.forecasts for item in reliability(nothing, none)) == 0
    assert sum(item.forecasts for item in reliability(nothing, none, equal_mass=True)) == 0


def test_bins_of_equal_mass_hold_as_many_each_and_part_no_equals() -> None:
    forecasts = np.random.default_rng(1).random(1000) ** 4
    counts = [
        item.forecasts for item in reliability(forecasts, forecasts > 0.5, bins=5, equal_mass=True)
    ]
    assert sum(counts) == 1000
    assert max(counts) - min(counts) <= 2
    tied = np.array([0.2] * 50 + [0.9] * 50)
    bins = reliability(tied, tied > 0.5, equal_mass=True)
    assert sum(item.forecasts for item in bins) == 100
    assert len(bins) <= 2
    (same,) = reliability(np.full(4, 0.3), np.ones(4, dtype=np.bool_), equal_mass=True)
    assert (same.forecasts, same.hits) == (4, 4)


@given(st.integers(1, 300), st.data())
def test_the_interval_is_wilsons(trials: int, data: st.DataObject) -> None:
    hits = data.draw(st.integers(0, trials))
    expected = binomtest(hits, trials).proportion_ci(0.95, method="wilson")
    found = wilson_interval(hits, trials)
    assert found == pytest.approx((expected.low, expected.high), abs=1e-9)
    assert wilson_interval(0, 0) == (0.0, 1.0)


def test_sums_of_parts_are_those_of_the_whole() -> None:
    forecasts, outcomes = drawn(0.8, 500)
    parts = [bin_sums(forecasts[i::3], outcomes[i::3]) for i in range(3)]
    whole = expected_calibration_error(forecasts, outcomes)
    assert error_of_sums(np.sum(parts, axis=0)) == pytest.approx(whole)


@pytest.mark.parametrize("forecast", [-0.1, 1.1, math.nan])
def test_what_is_no_probability_is_refused(forecast: float) -> None:
    with pytest.raises(OptionError, match="outside 0 to 1"):
        reliability(np.array([forecast]), np.array([True]))
    with pytest.raises(OptionError, match="with"):
        bin_sums(np.array([0.5]), np.array([True, False]))
    with pytest.raises(OptionError, match="0 bins"):
        reliability(np.array([0.5]), np.array([True]), bins=0)
