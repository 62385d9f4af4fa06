"""Calibration of probabilities: do forecasts come true as often as they state?

Forecasts are put into bins, and in each bin the mean forecast is compared with the share of them
that came true: the reliability diagram (Murphy and Winkler 1977). The expected calibration error
(ECE; Naeini, Cooper and Hauskrecht 2015, *Obtaining well calibrated probabilities using Bayesian
binning*) is the mean distance between the two, weighted with the bins' forecasts. The Brier score
is the mean squared error of the forecasts; it also rewards those that tell cases apart.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.artifacts.errors import OptionError

BINS = 10
LEVEL = 0.95


@dataclass(frozen=True)
class Bin:
    """The forecasts of a range; the last range has its upper end in it.

    Attributes:
        low: lower end of the range.
        high: upper end of the range.
        forecasts: how many are in it.
        mean: mean of the forecasts; NaN where there are none.
        hits: how many of them came true.
    """

    low: float
    high: float
    forecasts: int
    mean: float
    hits: int

    @property
    def share(self) -> float:
        """Share of the forecasts that came true; NaN where there are none."""
        return self.hits / self.forecasts if self.forecasts else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval of the share, as if the forecasts were independent."""
        return wilson_interval(self.hits, self.forecasts)

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; what is unknown is null."""
        low, high = self.interval
        return {
            "low": self.low,
            "high": self.high,
            "forecasts": self.forecasts,
            "mean": _or_none(self.mean),
            "hits": self.hits,
            "share": _or_none(self.share),
            "share_low": low,
            "share_high": high,
        }


def wilson_interval(hits: int, trials: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a probability; 0 to 1 where there are no trials."""
    if trials == 0:
        return 0.0, 1.0
    z = float(scipy.special.ndtri(0.5 * (1.0 + LEVEL)))
    share, weight = hits / trials, z**2 / trials
    centre = (share + 0.5 * weight) / (1.0 + weight)
    half = z * math.sqrt((share * (1.0 - share) + 0.25 * weight) / trials) / (1.0 + weight)
    return max(0.0, centre - half), min(1.0, centre + half)


def reliability(
    forecasts: FloatArray, outcomes: BoolArray, *, bins: int = BINS, equal_mass: bool = False
) -> tuple[Bin, ...]:
    """The data of a reliability diagram.

    Args:
        forecasts: ``(N,)`` probabilities.
        outcomes: ``(N,)`` what came true.
        bins: how many there are, at least one.
        equal_mass: whether the bins hold about as many forecasts each, and not ranges of the same
            width. Equal forecasts are never parted, so that there may be fewer bins then.

    Returns:
        The bins, rising; empty ones too.

    Raises:
        OptionError: no bins, forecasts outside of 0 to 1, or not as many outcomes.
    """
    _check(forecasts, outcomes, bins)
    edges = np.linspace(0.0, 1.0, bins + 1)
    if equal_mass and len(forecasts):
        edges = np.unique(np.quantile(forecasts, edges, method="inverted_cdf"))
        if len(edges) == 1:
            edges = np.repeat(edges, 2)
    counts, totals, hits = _sums(forecasts, outcomes, edges).T
    return tuple(
        Bin(
            low=float(edges[number]),
            high=float(edges[number + 1]),
            forecasts=int(counts[number]),
            mean=float(totals[number] / counts[number]) if counts[number] else math.nan,
            hits=int(hits[number]),
        )
        for number in range(len(edges) - 1)
    )


def bin_sums(forecasts: FloatArray, outcomes: BoolArray) -> FloatArray:
    """What ``error_of_sums`` needs; sums of several sets of forecasts are those of all of them.

    Args:
        forecasts: ``(N,)`` probabilities.
        outcomes: ``(N,)`` what came true.

    Returns:
        ``(BINS, 3)`` of each bin: number of forecasts, their sum, how many came true.

    Raises:
        OptionError: forecasts outside of 0 to 1, or not as many outcomes.
    """
    _check(forecasts, outcomes, BINS)
    return _sums(forecasts, outcomes, np.linspace(0.0, 1.0, BINS + 1))


def error_of_sums(sums: FloatArray) -> float:
    """The expected calibration error of ``bin_sums``; NaN where there are no forecasts."""
    counts, totals, hits = sums.T
    number = float(counts.sum())
    return float(np.abs(totals - hits).sum()) / number if number else math.nan


def expected_calibration_error(forecasts: FloatArray, outcomes: BoolArray) -> float:
    """The expected calibration error of ``(N,)`` forecasts and outcomes, over ten equal bins."""
    return error_of_sums(bin_sums(forecasts, outcomes))


def brier_score(forecasts: FloatArray, outcomes: BoolArray) -> float:
    """Mean squared difference between forecasts ``(N,)`` and outcomes ``(N,)``; NaN without any."""
    if len(forecasts) == 0:
        return math.nan
    return float(np.mean((forecasts - outcomes) ** 2))


def _sums(forecasts: FloatArray, outcomes: BoolArray, edges: FloatArray) -> FloatArray:
    number = len(edges) - 1
    index = np.clip(np.searchsorted(edges, forecasts, side="right") - 1, 0, number - 1)
    columns = (np.ones(len(forecasts)), forecasts, outcomes.astype(np.float64))
    sums = [np.bincount(index, weights, minlength=number) for weights in columns]
    return np.stack(sums, axis=1)


def _check(forecasts: FloatArray, outcomes: BoolArray, bins: int) -> None:
    if bins < 1:
        raise OptionError(f"{bins} bins hold no forecasts; give at least 1")
    if forecasts.shape != outcomes.shape or forecasts.ndim != 1:
        raise OptionError(f"{forecasts.shape} forecasts with {outcomes.shape} outcomes")
    if not np.all((forecasts >= 0.0) & (forecasts <= 1.0)):
        raise OptionError("a forecast lies outside 0 to 1")


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value
