"""Whether stated covariances fit the errors: on errors drawn from known ones."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from pipelines.localize.consistency import (
    Consistency,
    consistency_of,
    frames_to_recover,
    frames_until_converged,
)
from tests.localize_samples import spatial_path, spatial_run


def drawn(scale: float, dimension: int, count: int = 4000) -> Consistency:
    """Errors ``scale`` times as large as the covariances say."""
    errors = scale * np.random.default_rng(0).standard_normal((count, dimension))
    return Consistency(np.sum(errors**2, axis=1), dimension)


@pytest.mark.parametrize("dimension", [3, 6])
def test_right_covariances_hold_the_truth_in_their_region_as_often_as_they_say(
    dimension: int,
) -> None:
    right = drawn(1.0, dimension)
    assert right.in_region == pytest.approx(0.95, abs=0.012)
    assert right.bounds[0] < right.mean < right.bounds[1]
    assert right.mean == pytest.approx(dimension, rel=0.05)
    sure, humble = drawn(2.0, dimension), drawn(0.5, dimension)
    assert sure.in_region < 0.7
    assert sure.mean > sure.bounds[1]
    assert humble.in_region > 0.999
    assert humble.mean < humble.bounds[0]


def test_each_estimate_is_held_against_its_own_covariance() -> None:
    run, truth = spatial_run(4), spatial_path(4)
    truth[:, 0] += 0.02
    truth[3] = np.nan
    followed = np.array([False, True, True, True])
    refined = consistency_of(run, "refined", truth, followed)
    mode = consistency_of(run, "mode", truth, followed)
    assert refined is not None
    assert mode is not None
    # 2 cm with a standard deviation of 1 cm, and of 10 cm.
    np.testing.assert_allclose(refined.squared_errors, [4.0, 4.0], rtol=1e-6)
    np.testing.assert_allclose(mode.squared_errors, [0.04, 0.04], rtol=1e-6)
    assert consistency_of(run, "mode", truth, np.zeros(4, dtype=np.bool_)) is None
    without = replace(run.frames[1], refined_covariance=None)
    part = replace(run, frames=(run.frames[0], without, *run.frames[2:]))
    fewer = consistency_of(part, "refined", truth, followed)
    assert fewer is not None
    assert len(fewer.squared_errors) == 1


@pytest.mark.parametrize(
    ("good", "converged", "recoveries"),
    [
        ("+++", 0, []),
        ("--++", 2, []),
        ("-+--++-++", 7, [2, 1]),
        ("++-", None, []),
        ("---", None, []),
        ("", None, []),
    ],
)
def test_frames_until_converged_and_to_recover(
    good: str, converged: int | None, recoveries: list[int]
) -> None:
    flags = np.array([letter == "+" for letter in good], dtype=np.bool_)
    assert frames_until_converged(flags) == converged
    assert frames_to_recover(flags) == recoveries


def test_bounds_are_those_of_the_chi_square_distribution() -> None:
    for count, dimension in ((1, 3), (20, 3), (7, 6)):
        errors = Consistency(np.full(count, 1.0), dimension)
        expected = chi2.ppf([0.025, 0.975], count * dimension) / count
        np.testing.assert_allclose(errors.bounds, expected, rtol=1e-12)
        limit = float(chi2.ppf(0.95, dimension))
        border = Consistency(np.array([limit - 1e-6, limit + 1e-6]), dimension)
        assert border.in_region == 0.5
