"""Can a run be trusted? Its status and confidence, compared with the ground truth.

A robot acts on frames whose status is ``tracking``. Such a frame is **right** where the estimate is
within 0.3 m and 10 degrees of the truth: the place is the right one. It is **wrong** where it is
not, or where there is no truth at all since the images show another place. All other frames are
**silent**: the filter searches, is lost, sees nothing, or the image is a stale one.

The confidence forecasts that an estimate is within 0.1 m and 3 degrees. A frame without an estimate
counts as one where that did not come true.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.localize.calibration import (
    Bin,
    bin_sums,
    brier_score,
    error_of_sums,
    expected_calibration_error,
    reliability,
)
from pipelines.localize.consistency import Consistency, consistency_of
from pipelines.localize.run import STAND_INS, Run
from pipelines.localize.state_space import known_states, state_errors

# Beyond these a place that is tracked is another one.
WRONG_POSITION_M, WRONG_HEADING_DEG = 0.3, 10.0
# What the confidence is the probability of.
CLOSE_POSITION_M, CLOSE_HEADING_DEG = 0.1, 3.0
SURE = 0.9
END_FRAMES = 10


@dataclass(frozen=True)
class Trust:
    """The frames of one run or of several that can be judged.

    Attributes:
        tracked: ``(N,)`` whether the status is ``tracking`` and there is an estimate.
        position_errors: ``(N,)`` metres; NaN where there is no estimate, or no truth since the
            images show another place.
        heading_errors: ``(N,)`` degrees; NaN where the position's error is.
        has_estimate: ``(N,)`` whether there is an estimate.
        confidence: ``(N,)`` as stated.
        squared_errors: ``(n,)`` normalised (NEES) errors of the tracked frames with a truth.
        degrees_of_freedom: of a state.
        runs: how many there are.
        runs_wrong_at_the_end: how many have a wrong frame among their last ten.
    """

    tracked: BoolArray
    position_errors: FloatArray
    heading_errors: FloatArray
    has_estimate: BoolArray
    confidence: FloatArray
    squared_errors: FloatArray
    degrees_of_freedom: int
    runs: int
    runs_wrong_at_the_end: int

    def __len__(self) -> int:
        return len(self.tracked)

    @property
    def right(self) -> BoolArray:
        """``(N,)`` frames that track the right place."""
        close = _within(self, WRONG_POSITION_M, WRONG_HEADING_DEG)
        return np.asarray(self.tracked & close, dtype=np.bool_)

    @property
    def wrong(self) -> BoolArray:
        """``(N,)`` frames that track another place than the right one."""
        return np.asarray(self.tracked & ~self.right, dtype=np.bool_)

    @property
    def silent(self) -> BoolArray:
        """``(N,)`` frames that do not track."""
        return np.asarray(~self.tracked, dtype=np.bool_)

    @property
    def close(self) -> BoolArray:
        """``(N,)`` frames with an estimate within 0.1 m and 3 degrees of the truth."""
        return _within(self, CLOSE_POSITION_M, CLOSE_HEADING_DEG)

    @property
    def sure(self) -> BoolArray:
        """``(N,)`` frames with a confidence of 0.9 or more."""
        return np.asarray(self.confidence >= SURE, dtype=np.bool_)

    @property
    def calibration_error(self) -> float:
        """ECE of the confidence over all frames; NaN where there are none."""
        return expected_calibration_error(self.confidence, self.close)

    @property
    def calibration_error_of_estimates(self) -> float:
        """ECE of the confidence over the frames that have an estimate."""
        chosen = self.has_estimate
        return expected_calibration_error(self.confidence[chosen], self.close[chosen])

    @property
    def brier_score(self) -> float:
        """Brier score of the confidence over all frames; NaN where there are none."""
        return brier_score(self.confidence, self.close)

    @property
    def sure_not_close(self) -> float:
        """Share of the sure frames that are not close; NaN where none is sure."""
        return _share(~self.close, self.sure)

    @property
    def sure_wrong(self) -> float:
        """Share of the sure frames that are wrong; NaN where none is sure."""
        return _share(self.wrong, self.sure)

    @property
    def in_region(self) -> float:
        """Share of the tracked frames with the truth in the stated 95 % region; NaN without any."""
        if len(self.squared_errors) == 0:
            return math.nan
        return Consistency(self.squared_errors, self.degrees_of_freedom).in_region

    @property
    def median_errors_of_right(self) -> tuple[float, float]:
        """Metres and degrees; NaN where no frame is right."""
        if not np.any(self.right):
            return math.nan, math.nan
        position, heading = self.position_errors[self.right], self.heading_errors[self.right]
        return float(np.median(position)), float(np.median(heading))

    def share(self, frames: BoolArray) -> float:
        """Share that some of the frames ``(N,)`` have in all; NaN where there are none."""
        return float(np.mean(frames)) if len(frames) else math.nan

    def reliability(self, *, equal_mass: bool = False) -> tuple[Bin, ...]:
        """Data of the reliability diagram of the confidence over all frames.

        Args:
            equal_mass: whether the bins hold about as many frames each, and not ranges of
                confidence of the same width.
        """
        return reliability(self.confidence, self.close, equal_mass=equal_mass)

    def confidence_sums(self) -> FloatArray:
        """``(BINS, 3)`` of each bin of confidence: frames, sum of confidences, close frames."""
        return bin_sums(self.confidence, self.close)

    def rows(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        counts = [int(np.count_nonzero(kind)) for kind in (self.right, self.silent, self.wrong)]
        sure = int(np.count_nonzero(self.sure))
        far, wrong = (int(np.count_nonzero(self.sure & kind)) for kind in (~self.close, self.wrong))
        return [
            ("frames right, silent, wrong", ", ".join(map(str, counts))),
            (
                f"wrong frames among the last {END_FRAMES}",
                "yes" if self.runs_wrong_at_the_end else "no",
            ),
            ("confidence: calibration error (ECE)", f"{self.calibration_error:.3f}"),
            ("confidence: Brier score", f"{self.brier_score:.3f}"),
            (
                f"confidence {SURE:g} or more",
                f"{sure} frames, {far} not within {CLOSE_POSITION_M:g} m and "
                f"{CLOSE_HEADING_DEG:g} deg, {wrong} wrong",
            ),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; what is unknown is null."""
        position, heading = self.median_errors_of_right
        figures = {
            "calibration_error": self.calibration_error,
            "calibration_error_of_estimates": self.calibration_error_of_estimates,
            "brier_score": self.brier_score,
            "sure_not_close": self.sure_not_close,
            "sure_wrong": self.sure_wrong,
            "in_95_region": self.in_region,
            "median_position_error_of_right_m": position,
            "median_heading_error_of_right_deg": heading,
        }
        return {
            "frames": len(self),
            "frames_right": int(np.count_nonzero(self.right)),
            "frames_silent": int(np.count_nonzero(self.silent)),
            "frames_wrong": int(np.count_nonzero(self.wrong)),
            "frames_close": int(np.count_nonzero(self.close)),
            "frames_with_estimate": int(np.count_nonzero(self.has_estimate)),
            "frames_sure": int(np.count_nonzero(self.sure)),
            "runs": self.runs,
            "runs_wrong_at_the_end": self.runs_wrong_at_the_end,
            **{name: None if math.isnan(value) else value for name, value in figures.items()},
            "reliability": [item.to_dict() for item in self.reliability()],
        }


def trust_of(run: Run, truth: FloatArray, estimate: str | None = None) -> Trust:
    """Judges a run by true states.

    Args:
        run: the run.
        truth: ``(N, D)``, NaN where unknown: such frames do not count.
        estimate: name of the estimate that is judged; None for the run's default and its fallback.

    Raises:
        OptionError: the run has no estimate of this name, or truth of another shape.
    """
    if truth.shape != (len(run.frames), run.space.dimension):
        raise OptionError(f"ground truth {truth.shape} for {len(run.frames)} frames")
    states = _estimated(run, estimate)
    distances, angles = state_errors(run.space, states, truth)
    judged = known_states(truth)
    tracked = _is_tracked(run) & known_states(states)
    squared = _squared_errors(run, estimate, truth, tracked & judged)
    return _trust(run, judged, states, distances, np.degrees(angles), squared)


def trust_elsewhere(run: Run, estimate: str | None = None) -> Trust:
    """Judges a run whose images show another place than its scene: whatever it tracks is wrong.

    Args:
        run: the run; a ground truth that it carries is one of another world, and not used.
        estimate: name of the estimate that is judged; None for the run's default and its fallback.

    Raises:
        OptionError: the run has no estimate of this name.
    """
    unknown = np.full(len(run.frames), np.nan)
    everywhere = np.ones(len(run.frames), dtype=np.bool_)
    return _trust(run, everywhere, _estimated(run, estimate), unknown, unknown, np.empty(0))


def pooled(parts: Sequence[Trust]) -> Trust:
    """Several runs as one set of frames.

    Raises:
        OptionError: there are none, or their states differ in degrees of freedom.
    """
    freedoms = {part.degrees_of_freedom for part in parts}
    if len(freedoms) != 1:
        raise OptionError(f"runs with {sorted(freedoms)} degrees of freedom cannot be pooled")
    return Trust(
        tracked=np.concatenate([part.tracked for part in parts]),
        position_errors=np.concatenate([part.position_errors for part in parts]),
        heading_errors=np.concatenate([part.heading_errors for part in parts]),
        has_estimate=np.concatenate([part.has_estimate for part in parts]),
        confidence=np.concatenate([part.confidence for part in parts]),
        squared_errors=np.concatenate([part.squared_errors for part in parts]),
        degrees_of_freedom=parts[0].degrees_of_freedom,
        runs=sum(part.runs for part in parts),
        runs_wrong_at_the_end=sum(part.runs_wrong_at_the_end for part in parts),
    )


def pooled_calibration_error(sums: Sequence[FloatArray]) -> float:
    """ECE of several runs from their ``confidence_sums``; NaN where there are no frames."""
    return error_of_sums(np.sum(sums, axis=0)) if sums else math.nan


def _trust(
    run: Run,
    judged: BoolArray,
    states: FloatArray,
    position_errors: FloatArray,
    heading_errors: FloatArray,
    squared_errors: FloatArray,
) -> Trust:
    """The judged frames of a run; of its last ten as far as they are among them."""
    has_estimate = known_states(states)
    found = Trust(
        tracked=(_is_tracked(run) & has_estimate)[judged],
        position_errors=position_errors[judged],
        heading_errors=heading_errors[judged],
        has_estimate=has_estimate[judged],
        confidence=np.array([frame.confidence for frame in run.frames])[judged],
        squared_errors=squared_errors,
        degrees_of_freedom=run.space.dimension,
        runs=1,
        runs_wrong_at_the_end=0,
    )
    at_the_end = np.flatnonzero(judged) >= len(run.frames) - END_FRAMES
    return replace(found, runs_wrong_at_the_end=int(np.any(found.wrong & at_the_end)))


def _estimated(run: Run, estimate: str | None) -> FloatArray:
    """``(N, D)`` estimates, NaN where there is none; a run may have none at all."""
    if estimate is None and not run.own_estimate_names:
        return np.full((len(run.frames), run.space.dimension), np.nan)
    return run.estimated_states(estimate)


def _is_tracked(run: Run) -> BoolArray:
    return np.array([frame.status == "tracking" for frame in run.frames], dtype=np.bool_)


def _squared_errors(
    run: Run, estimate: str | None, truth: FloatArray, followed: BoolArray
) -> FloatArray:
    """NEES of the tracked frames; an estimate and its fallback have their own covariances."""
    if not np.any(followed):
        return np.empty(0)
    name = run.default_estimate if estimate is None else estimate
    # PnP beside the filter has no covariance in the file.
    if name not in run.own_estimate_names:
        return np.empty(0)
    own = np.array([name in frame.estimates for frame in run.frames])
    parts = [consistency_of(run, name, truth, followed & own)]
    if estimate is None and name in STAND_INS:
        parts.append(consistency_of(run, STAND_INS[name], truth, followed & ~own))
    known = [part.squared_errors for part in parts if part is not None]
    return np.concatenate(known) if known else np.empty(0)


def _within(trust: Trust, metres: float, degrees: float) -> BoolArray:
    # NaN is not within anything.
    close = (trust.position_errors <= metres) & (trust.heading_errors <= degrees)
    return np.asarray(close, dtype=np.bool_)


def _share(kind: BoolArray, among: BoolArray) -> float:
    return float(np.mean(kind[among])) if np.any(among) else math.nan
