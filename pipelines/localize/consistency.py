"""Consistency: errors of the filter compared with the covariances that it states.

The normalised estimation error squared (NEES), e^T P^-1 e, of a consistent estimator is chi-square
distributed with as many degrees of freedom as a state has (Bar-Shalom, Li, Kirubarajan 2001,
*Estimation with Applications to Tracking and Navigation*, section 5.4): its mean over N frames lies
within bounds, and the truth lies in the stated 95 % region in 95 % of the frames. A filter that is
too sure of itself leaves the region too often; one that claims nothing never does.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.localize.run import Run

REGION = 0.95


def chi_square_quantile(level: float, degrees_of_freedom: int) -> float:
    """Below this a chi-square distributed number lies with probability ``level``."""
    return float(2.0 * scipy.special.gammaincinv(0.5 * degrees_of_freedom, level))


@dataclass(frozen=True)
class Consistency:
    """Normalised errors of the frames that were tracked and have a ground truth.

    Attributes:
        squared_errors: ``(n,)`` NEES of each such frame.
        degrees_of_freedom: numbers of a state.
    """

    squared_errors: FloatArray
    degrees_of_freedom: int

    @property
    def in_region(self) -> float:
        """Share of the frames with the truth inside the stated 95 % region."""
        limit = chi_square_quantile(REGION, self.degrees_of_freedom)
        return float(np.mean(self.squared_errors <= limit))

    @property
    def mean(self) -> float:
        """Mean NEES; the degrees of freedom where the covariances are right."""
        return float(np.mean(self.squared_errors))

    @property
    def bounds(self) -> tuple[float, float]:
        """Between these the mean lies with 95 % probability, were the frames independent."""
        total = self.degrees_of_freedom * len(self.squared_errors)
        tail = 0.5 * (1.0 - REGION)
        count = len(self.squared_errors)
        low, high = (chi_square_quantile(level, total) for level in (tail, 1.0 - tail))
        return low / count, high / count

    def rows(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        low, high = self.bounds
        return [
            ("truth in the stated 95 % region (%)", f"{100.0 * self.in_region:.0f}"),
            (f"mean NEES (consistent {low:.1f} to {high:.1f})", f"{self.mean:.2f}"),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "frames": len(self.squared_errors),
            "in_95_region": self.in_region,
            "nees_mean": self.mean,
            "nees_bounds": list(self.bounds),
            "nees_per_frame": self.squared_errors.tolist(),
        }


def consistency_of(
    run: Run, estimate: str, truth: FloatArray, followed: BoolArray
) -> Consistency | None:
    """Compares one kind of estimate with its stated covariance.

    Args:
        run: the run.
        estimate: its name; ``refined`` has a covariance of its own (``refined_covariance``), the
            others have that of the main mode.
        truth: ``(N, D)`` true states, NaN where unknown.
        followed: ``(N,)`` frames that count: those after convergence.

    Returns:
        None where no frame counts.
    """
    found = []
    for frame, true_state, counts in zip(run.frames, truth, followed, strict=True):
        state = frame.estimates.get(estimate)
        covariance = frame.covariance if estimate != "refined" else frame.refined_covariance
        if state is None or covariance is None or not counts or not np.all(np.isfinite(true_state)):
            continue
        offset = run.space.difference(state, true_state)
        # A belief that has collapsed to one particle claims to be exact; pinv keeps it finite.
        found.append(float(offset @ np.linalg.pinv(covariance, hermitian=True) @ offset))
    return Consistency(np.array(found), run.space.dimension) if found else None


def frames_until_converged(good: BoolArray) -> int | None:
    """Index of the first frame from which on all frames ``(N,)`` are good; None: not the last."""
    if len(good) == 0 or not good[-1]:
        return None
    bad = np.flatnonzero(~good)
    return int(bad[-1]) + 1 if len(bad) else 0


def frames_to_recover(good: BoolArray) -> list[int]:
    """How many frames it took each time to find the way back after the first good frame.

    Args:
        good: ``(N,)`` whether each frame's error is small.

    Returns:
        Length of every stretch of bad frames between good ones.
    """
    lengths: list[int] = []
    away = 0
    for is_good in good[int(np.argmax(good)) :] if np.any(good) else []:
        if is_good and away:
            lengths.append(away)
        away = 0 if is_good else away + 1
    return lengths
