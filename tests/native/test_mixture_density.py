"""Densities of mixtures in C++ against SciPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import logsumexp

from pipelines import native
from pipelines.artifacts.arrays import FloatArray

SIGMAS = (0.07, 0.04)


def slow_density(
    positions: FloatArray, centres: FloatArray, angles: FloatArray, log_weights: FloatArray
) -> FloatArray:
    squared = ((positions[:, None] - centres[None]) ** 2).sum(axis=2)
    exponents = log_weights - 0.5 * squared / SIGMAS[0] ** 2 - 0.5 * angles**2 / SIGMAS[1] ** 2
    return np.asarray(logsumexp(exponents, axis=1))


def sample(
    places: int, count: int, dimensions: int, seed: int, spread: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    log_weights = rng.normal(-5.0, 4.0, count)
    log_weights[rng.random(count) < 0.2] = -np.inf
    return (
        rng.normal(0.0, spread, (places, dimensions)),
        rng.normal(0.0, spread, (count, dimensions)),
        rng.normal(0.0, spread, (places, count)),
        log_weights,
    )


@given(
    st.integers(0, 5),
    st.integers(1, 100),
    st.integers(1, 3),
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 0.01, 0.3, 20.0]),
)
def test_densities_are_scipys(
    places: int, count: int, dimensions: int, seed: int, spread: float
) -> None:
    arguments = sample(places, count, dimensions, seed, spread)
    found = native.log_mixture_density(*arguments, *SIGMAS)
    assert found.shape == (places,)
    np.testing.assert_allclose(found, slow_density(*arguments), rtol=1e-13, atol=1e-13)


def test_without_weight_there_is_no_density() -> None:
    positions, centres, angles, log_weights = sample(3, 40, 2, 0, 0.1)
    found = native.log_mixture_density(
        positions, centres, angles, np.full_like(log_weights, -np.inf), *SIGMAS
    )
    assert np.all(found == -np.inf)
    nothing = np.zeros((0, 2))
    found = native.log_mixture_density(
        positions, nothing, np.zeros((3, 0)), log_weights[:0], *SIGMAS
    )
    assert np.all(found == -np.inf)
    assert native.log_mixture_density(nothing, centres, angles[:0], log_weights, *SIGMAS).size == 0


def test_what_is_no_number_counts_as_no_weight() -> None:
    positions, centres, angles, log_weights = sample(4, 70, 3, 1, 0.1)
    known = np.arange(70) % 3 > 0
    expected = native.log_mixture_density(
        positions,
        centres[known],
        np.ascontiguousarray(angles[:, known]),
        log_weights[known],
        *SIGMAS,
    )
    for name in ("centres", "angles", "log_weights"):
        wild = {
            "centres": centres.copy(),
            "angles": angles.copy(),
            "log_weights": log_weights.copy(),
        }
        np.moveaxis(wild[name], int(name == "angles"), 0)[~known] = np.nan
        found = native.log_mixture_density(
            positions, wild["centres"], wild["angles"], wild["log_weights"], *SIGMAS
        )
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    positions[:] = np.nan
    found = native.log_mixture_density(positions, centres, angles, log_weights, *SIGMAS)
    assert np.all(found == -np.inf)


@pytest.mark.parametrize(
    ("position", "value", "message"),
    [
        (0, np.zeros(4), "positions: shape"),
        (0, np.zeros((3, 1)), r"centres: shape \(\*, 1\) expected, got \(40, 2\)"),
        (1, np.zeros((40, 2), np.float32), "centres: an array of float64"),
        (2, np.zeros((40, 3)), r"angles: shape \(3, 40\) expected, got \(40, 3\)"),
        (3, np.zeros(39), "log_weights: shape"),
        (4, 0.0, "position_sigma: a number above 0"),
        (5, np.nan, "angle_sigma: a finite number"),
    ],
)
def test_other_arguments_are_one_line(position: int, value: object, message: str) -> None:
    arguments: list[object] = [*sample(3, 40, 2, 0, 0.1), *SIGMAS]
    arguments[position] = value
    with pytest.raises((TypeError, ValueError), match=f"^{message}") as caught:
        native.log_mixture_density(*arguments)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)
