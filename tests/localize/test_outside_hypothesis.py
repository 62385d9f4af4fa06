"""Whether the camera sees what the map shows: against Bayes' rule for two states."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipelines.localize.outside_hypothesis import (
    FIRST_INSIDE,
    LEAVING,
    RETURNING,
    OutsideHypothesis,
)

rows = st.lists(st.floats(-20.0, 20.0), max_size=30)


def by_bayes(log_evidence: list[float]) -> float:
    """The forward algorithm of a hidden Markov model with two states."""
    inside, outside = FIRST_INSIDE, 1.0 - FIRST_INSIDE
    for number, value in enumerate(log_evidence):
        if number > 0:
            inside, outside = (
                inside * (1.0 - LEAVING) + outside * RETURNING,
                inside * LEAVING + outside * (1.0 - RETURNING),
            )
        inside *= math.exp(value)
        inside, outside = inside / (inside + outside), outside / (inside + outside)
    return inside


def by_filter(log_evidence: list[float]) -> OutsideHypothesis:
    hypothesis = OutsideHypothesis()
    for number, value in enumerate(log_evidence):
        hypothesis = (hypothesis.predicted() if number else hypothesis).updated(value)
    return hypothesis


@given(rows)
def test_it_is_the_forward_algorithm(log_evidence: list[float]) -> None:
    found = by_filter(log_evidence).inside
    assert found == pytest.approx(by_bayes(log_evidence), rel=1e-6, abs=1e-12)


def test_a_prediction_is_a_step_of_the_chain_by_exact_fractions() -> None:
    leaving, returning = Fraction(LEAVING), Fraction(RETURNING)
    for inside in (0.0, 0.25, 0.5, 1.0):
        exact = Fraction(inside) * (1 - leaving) + (1 - Fraction(inside)) * returning
        assert OutsideHypothesis(inside).predicted().inside == pytest.approx(
            float(exact), rel=1e-12
        )


@given(rows, st.floats(-5.0, 5.0), st.floats(0.01, 5.0))
def test_more_evidence_for_the_map_makes_it_more_probable(
    before: list[float], value: float, more: float
) -> None:
    hypothesis = by_filter(before)
    assert hypothesis.updated(value + more).inside >= hypothesis.updated(value).inside
    assert hypothesis.updated(0.0).inside == pytest.approx(hypothesis.inside, abs=1e-12)


@pytest.mark.parametrize("value", [1e6, -1e6, math.inf, -math.inf])
def test_extremes_stay_probabilities_and_can_be_taken_back(value: float) -> None:
    hypothesis = OutsideHypothesis()
    for _ in range(1000):
        hypothesis = hypothesis.updated(value)
        assert 0.0 < hypothesis.inside < 1.0
    for _ in range(1000):
        hypothesis = hypothesis.predicted().updated(value)
        assert 0.0 < hypothesis.inside < 1.0
    assert (hypothesis.inside > 0.5) is (value > 0.0)
    # A few images of the opposite turn it round.
    for _ in range(6):
        hypothesis = hypothesis.predicted().updated(-30.0 * np.sign(value))
    assert (hypothesis.inside > 0.5) is (value < 0.0)


def test_without_evidence_it_drifts_to_how_often_robots_leave_and_return() -> None:
    hypothesis = OutsideHypothesis(0.999)
    for _ in range(2000):
        hypothesis = hypothesis.predicted()
    assert hypothesis.inside == pytest.approx(RETURNING / (RETURNING + LEAVING), rel=1e-9)
