"""Confidence as a probability, against random numbers and closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr
from scipy.stats import chi2

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.localize.confidence import (
    ANGLE_BOUND,
    POSITION_BOUND,
    confidence,
    share_within,
)

GOOD = np.diag([0.02**2, 0.02**2, 0.005**2])


def random_covariance(dimension: int, rng: np.random.Generator) -> FloatArray:
    """About as wide as the bounds, and correlated."""
    positions = dimension - (1 if dimension == 3 else 3)
    scale = np.array([POSITION_BOUND] * positions + [ANGLE_BOUND] * (dimension - positions))
    factor = 0.6 * rng.standard_normal((dimension, dimension)) * scale[:, None]
    return np.asarray(factor @ factor.T / dimension)


def by_random_numbers(covariance: FloatArray, count: int = 100_000) -> float:
    """The share of random errors within the bounds."""
    dimension = len(covariance)
    positions = 2 if dimension == 3 else 3
    errors = np.random.default_rng(0).multivariate_normal(np.zeros(dimension), covariance, count)
    metres = np.sqrt(np.sum(errors[:, :positions] ** 2, axis=1))
    radians = np.sqrt(np.sum(errors[:, positions:] ** 2, axis=1))
    return float(np.mean((metres <= 0.1) & (np.degrees(radians) <= 3.0)))


@pytest.mark.parametrize(("dimension", "tolerance"), [(3, 0.02), (6, 0.03)])
def test_the_share_is_that_of_random_errors(dimension: int, tolerance: float) -> None:
    rng = np.random.default_rng(dimension)
    found = []
    for factor in np.geomspace(0.2, 5.0, 12):
        covariance = factor**2 * random_covariance(dimension, rng)
        found.append(share_within(covariance))
        assert found[-1] == pytest.approx(by_random_numbers(covariance), abs=tolerance)
    # From hardly ever to nearly always.
    assert min(found) < 0.3
    assert max(found) > 0.9


def test_the_share_is_that_of_closed_forms() -> None:
    for sigma in (0.03, 0.05, 0.1):
        place = np.diag([sigma**2, sigma**2, 0.0])
        assert share_within(place) == pytest.approx(chi2(2).cdf((0.1 / sigma) ** 2), abs=0.01)
    for degrees in (1.0, 2.0, 4.0):
        turn = np.diag([0.0, 0.0, math.radians(degrees) ** 2])
        assert share_within(turn) == pytest.approx(1.0 - 2.0 * ndtr(-3.0 / degrees), abs=0.01)


@given(
    st.floats(0.0, 1.0),
    st.floats(0.0, 10.0),
    st.floats(0.0, 3.0),
    st.floats(-1.0, 1.0),
)
def test_confidence_lies_between_zero_and_the_places_probability(
    probability: float, position: float, heading: float, correlation: float
) -> None:
    covariance = np.diag([position**2, position**2, heading**2])
    covariance[0, 2] = covariance[2, 0] = correlation * position * heading
    assert 0.0 <= confidence(probability, covariance) <= probability


def test_confidence_is_high_when_all_is_well_and_any_single_reason_lowers_it() -> None:
    assert confidence(1.0, GOOD) > 0.98
    assert confidence(0.4, GOOD) == pytest.approx(0.4 * confidence(1.0, GOOD))
    assert confidence(0.0, GOOD) == 0.0
    assert confidence(1.0, np.diag([0.5**2, 0.5**2, 0.005**2])) < 0.1
    assert confidence(1.0, np.diag([0.02**2, 0.02**2, 0.5**2])) < 0.1
    # Wider is never surer.
    found = [share_within(np.diag([s**2, s**2, s**2])) for s in np.geomspace(1e-4, 10.0, 40)]
    assert found == sorted(found, reverse=True)
    assert (found[0], found[-1]) == (1.0, 0.0)


def test_an_error_along_one_line_is_counted_as_it_lies() -> None:
    # The same variance, along the axes and across them: a circle has no corners.
    for angle in np.linspace(0.0, math.pi, 7):
        line = np.array([math.cos(angle), math.sin(angle), 0.0])
        expected = 1.0 - 2.0 * ndtr(-0.1 / 0.08)
        assert share_within(0.08**2 * np.outer(line, line)) == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("probability", [-0.1, 1.1, math.nan, math.inf])
def test_what_is_no_probability_is_refused(probability: float) -> None:
    with pytest.raises(OptionError, match="probability"):
        confidence(probability, GOOD)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_covariance_that_is_not_finite_is_refused(value: float) -> None:
    covariance = GOOD.copy()
    covariance[1, 1] = value
    with pytest.raises(OptionError, match="not finite"):
        confidence(1.0, covariance)
