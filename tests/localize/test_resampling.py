"""Resampling: every scheme is unbiased and survives the weights that break naive ones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError, StageError
from pipelines.localize.resampling import SCHEMES, resample

all_schemes = pytest.mark.parametrize("scheme", list(SCHEMES))


LARGEST_DRAW = float(np.nextafter(1.0, 0.0))


class FixedGenerator(np.random.Generator):
    """Draws the same number each time."""

    def __init__(self, value: float) -> None:
        super().__init__(np.random.PCG64(0))
        self.value = value

    def random(self, size: int | None = None, *args: object, **kwargs: object) -> FloatArray:  # type: ignore[override]
        return np.full(() if size is None else size, self.value)


def log_of(weights: FloatArray | list[float]) -> FloatArray:
    with np.errstate(divide="ignore"):
        return np.log(np.asarray(weights, dtype=np.float64))


@all_schemes
@pytest.mark.parametrize(("count", "rounds"), [(4, 10_000), (11, 3_000)])
def test_unbiased_over_ten_thousand_draws(scheme: str, count: int, rounds: int) -> None:
    weights = np.array([0.05, 0.3, 0.0, 0.15, 0.4, 0.1])
    rng = np.random.default_rng(11)
    totals = np.zeros(6)
    for _ in range(rounds):
        totals += np.bincount(resample(log_of(weights), count, scheme, rng), minlength=6)
    # Five standard errors of the multinomial scheme; the others vary less.
    limit = 5.0 * np.sqrt(count * weights * (1.0 - weights) / rounds)
    assert np.all(np.abs(totals / rounds - count * weights) <= limit)


@pytest.mark.parametrize("scheme", ["systematic", "residual"])
def test_low_variance_schemes_draw_at_least_the_whole_part(scheme: str) -> None:
    rng = np.random.default_rng(12)
    weights = rng.random(50)
    weights /= weights.sum()
    for _ in range(50):
        counts = np.bincount(resample(log_of(weights), 400, scheme, rng), minlength=50)
        assert np.all(counts >= np.floor(400 * weights - 1e-9))


def test_systematic_draws_at_most_one_more_than_the_whole_part() -> None:
    rng = np.random.default_rng(13)
    weights = rng.random(50)
    weights /= weights.sum()
    counts = np.bincount(resample(log_of(weights), 400, "systematic", rng), minlength=50)
    assert np.all(counts <= np.ceil(400 * weights + 1e-9))


@all_schemes
def test_no_index_past_the_end_when_the_sum_ends_below_one(scheme: str) -> None:
    # Ten times 0.1 adds up to 0.9999999999999999, and the draws go up to that.
    weights = np.full(10, 0.1)
    assert np.cumsum(weights)[-1] < 1.0
    for count in (1, 3, 10, 1000):
        indices = resample(log_of(weights), count, scheme, FixedGenerator(LARGEST_DRAW))
        assert indices.shape == (count,)
        assert indices.min() >= 0
        assert indices.max() <= 9


@all_schemes
def test_the_last_particle_with_weight_is_the_last_that_can_be_drawn(scheme: str) -> None:
    weights = np.concatenate([np.full(10, 0.1), np.zeros(5)])
    indices = resample(log_of(weights), 1000, scheme, FixedGenerator(LARGEST_DRAW))
    assert indices.max() == 9


@all_schemes
def test_a_draw_of_zero_goes_to_the_first_particle_with_weight(scheme: str) -> None:
    indices = resample(log_of([0.0, 0.0, 0.3, 0.7]), 1, scheme, FixedGenerator(0.0))
    assert indices.tolist() == [2]


@all_schemes
def test_one_particle_takes_all(scheme: str) -> None:
    log_weights = np.full(20, -1e6)
    log_weights[13] = -3.0
    indices = resample(log_weights, 50, scheme, np.random.default_rng(14))
    np.testing.assert_array_equal(indices, 13)


@all_schemes
def test_particles_of_weight_zero_are_never_drawn(scheme: str) -> None:
    weights = np.tile([0.0, 1.0, 0.0], 40)
    rng = np.random.default_rng(15)
    for count in (1, 40, 5000):
        assert np.all(resample(log_of(weights), count, scheme, rng) % 3 == 1)


@given(
    arrays(
        np.float64,
        st.integers(1, 30),
        elements=st.one_of(st.floats(-800.0, 800.0), st.just(-np.inf)),
    ),
    st.integers(1, 60),
    st.sampled_from(list(SCHEMES)),
    st.integers(0, 2**32),
)
def test_any_weights_any_count(log_weights: FloatArray, count: int, scheme: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    if not np.any(np.isfinite(log_weights)):
        with pytest.raises(StageError, match="no particle has any weight"):
            resample(log_weights, count, scheme, rng)
        return
    indices = resample(log_weights, count, scheme, rng)
    assert indices.shape == (count,)
    assert indices.dtype == np.int64
    assert np.all(np.isfinite(log_weights[indices]))


@all_schemes
def test_the_common_offset_of_the_weights_does_not_matter(scheme: str) -> None:
    log_weights = log_of([0.2, 0.5, 0.3])
    drawn = [
        resample(log_weights + offset, 64, scheme, np.random.default_rng(16))
        for offset in (0.0, -50000.0)
    ]
    np.testing.assert_array_equal(drawn[0], drawn[1])


def test_what_cannot_be_resampled_is_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(OptionError, match="'best'; known are multinomial"):
        resample([0.0], 1, "best", rng)
    for count in (0, -1):
        with pytest.raises(OptionError, match="at least 1"):
            resample([0.0], count, "systematic", rng)
    for bad in ([np.nan, 0.0], [np.inf, 0.0], []):
        with pytest.raises(StageError, match="cannot resample"):
            resample(bad, 3, "systematic", rng)
