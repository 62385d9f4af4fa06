"""The result of a sweep's run: a few numbers about its errors against ground truth and its time."""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from types import MappingProxyType
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.json_fields import JsonFields
from pipelines.localize.calibration import BINS
from pipelines.localize.evaluation import RunEvaluation, evaluate_run
from pipelines.localize.run import BY_ODOMETRY, Run
from pipelines.localize.state_space import known_states
from pipelines.localize.trust import trust_of

# A run has settled from this frame on, counted from 0.
SETTLED = 4
# From this frame on, frames with smaller errors than these are close: metres and degrees.
CLOSE_FROM, CLOSE_POSITION_M, CLOSE_HEADING_DEG = 10, 0.1, 3.0


@dataclass(frozen=True)
class RunResult:
    """Numbers about a run.

    Attributes:
        success: whether errors, averaged over the last five frames, are below 0.15 m and 3 degrees.
        position_error_m: mean over the last five frames; None without an estimate there.
        heading_error_deg: mean over the last five frames; None without an estimate there.
        median_position_error_m: median over the frames that have an estimate.
        median_heading_error_deg: median over the frames that have an estimate.
        settled_position_error_m: median over the frames from the fifth on, infinite where a frame
            has no estimate; None where the median is infinite or there are no such frames.
        settled_heading_error_deg: median over the same frames, None in the same cases.
        close_share: share of the frames from the eleventh on within 10 cm and 3 degrees; None where
            there are no such frames.
        frames_until_converged: frames before convergence; None where the run never converged.
        frames_to_recover: length of the longest run of worse frames after the first good one; 0
            where there is none; None where the last frame is not good.
        frames: number of frames with ground truth.
        in_95_region: share of the frames after convergence whose true pose lies in the region that
            the filter states for 95 %; None where unknown.
        frames_blind: number of frames with the status "blind".
        confidence_blind: highest confidence in these frames; None where there are none.
        confidence: median confidence of the frames with an image to compare; None where there are
            none.
        cpu_seconds_per_frame: processor time of the run over its number of frames. On a busy
            machine this is the only time that can be compared. (In a process that executes several
            runs at once, as Dask's workers may, it includes all of them.)
        seconds_per_frame: wall time, mean over all frames.
        seconds_while_searching: wall time, mean over the frames of the global search: those with
            the status "global", and the first where the start is unknown; None without such frames.
        seconds_while_tracking: wall time, mean over the other frames with the status "tracking";
            None without such frames.
        frames_right: frames with ground truth that track the right place (``localize.trust``).
        frames_silent: frames with ground truth that track no place.
        frames_wrong: frames with ground truth that track a wrong place.
        wrong_at_the_end: whether one of the last ten frames is wrong.
        confidence_sums: for each bin of confidence: the number of frames with ground truth, the sum
            of their confidences, and the number of those within the errors that confidence is about
            (0.1 m and 3 degrees).
    """

    success: bool
    position_error_m: float | None
    heading_error_deg: float | None
    median_position_error_m: float | None
    median_heading_error_deg: float | None
    settled_position_error_m: float | None
    settled_heading_error_deg: float | None
    close_share: float | None
    frames_until_converged: int | None
    frames_to_recover: int | None
    frames: int
    in_95_region: float | None
    frames_blind: int
    confidence_blind: float | None
    confidence: float | None
    cpu_seconds_per_frame: float
    seconds_per_frame: float
    seconds_while_searching: float | None
    seconds_while_tracking: float | None
    frames_right: int
    frames_silent: int
    frames_wrong: int
    wrong_at_the_end: bool
    confidence_sums: tuple[tuple[float, ...], ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        return asdict(self)

    @classmethod
    def of_json(cls, values: JsonFields) -> "RunResult":
        """The result that ``to_dict`` returned.

        Raises:
            InputError: a key is missing or holds something else.
        """
        return cls(
            **{field.name: _READERS[field.type](values, field.name) for field in fields(cls)}
        )


def judged(run: Run, cpu_seconds: float) -> RunResult:
    """The result of a run; a run without any estimate is no success.

    Args:
        run: the run, with ground truth.
        cpu_seconds: its processor time.

    Raises:
        InputError: the run has no ground truth.
    """
    evaluation = evaluate_run(run) if _has_estimate(run) else None
    position = heading = None
    errors = np.full((2, len(run.frames)), np.inf)
    if evaluation is not None:
        position = evaluation.errors.position_error_m
        heading = evaluation.errors.heading_error_deg
        errors = np.nan_to_num([position.per_frame, heading.per_frame], nan=np.inf)
    has_truth = _has_truth(run)
    trust = trust_of(run, _truth(run))
    settled = _medians(errors[:, SETTLED:][:, has_truth[SETTLED:]])
    blind = [frame.confidence for frame in run.frames if frame.status == "blind"]
    seeing = [frame.confidence for frame in run.frames if frame.status not in BY_ODOMETRY]
    seconds = np.array([sum(frame.seconds.values()) for frame in run.frames])
    statuses = np.array([frame.status for frame in run.frames])
    searched = statuses == "global"
    # With an unknown start the first frame is a global search, whatever its status.
    searched[0] |= run.settings.get("start") is None
    return RunResult(
        success=evaluation is not None and evaluation.success,
        position_error_m=None if position is None else position.last5_mean,
        heading_error_deg=None if heading is None else heading.last5_mean,
        median_position_error_m=None if position is None else position.median,
        median_heading_error_deg=None if heading is None else heading.median,
        settled_position_error_m=settled[0],
        settled_heading_error_deg=settled[1],
        close_share=_close_share(errors[:, CLOSE_FROM:][:, has_truth[CLOSE_FROM:]]),
        frames_until_converged=None if evaluation is None else evaluation.frames_until_converged,
        frames_to_recover=_frames_to_recover(evaluation),
        frames=int(np.count_nonzero(has_truth)),
        in_95_region=_share_in_region(evaluation),
        frames_blind=len(blind),
        confidence_blind=max(blind, default=None),
        confidence=float(np.median(seeing)) if seeing else None,
        cpu_seconds_per_frame=cpu_seconds / len(run.frames),
        seconds_per_frame=float(np.mean(seconds)),
        seconds_while_searching=_mean(seconds[searched]),
        seconds_while_tracking=_mean(seconds[(statuses == "tracking") & ~searched]),
        frames_right=int(np.count_nonzero(trust.right)),
        frames_silent=int(np.count_nonzero(trust.silent)),
        frames_wrong=int(np.count_nonzero(trust.wrong)),
        wrong_at_the_end=trust.runs_wrong_at_the_end > 0,
        confidence_sums=tuple(tuple(sums) for sums in trust.confidence_sums().tolist()),
    )


def _sums(values: JsonFields, key: str) -> tuple[tuple[float, ...], ...]:
    """``(BINS, 3)`` finite numbers."""
    rows = values.get(key, list)
    try:
        table = np.array(rows, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(values.path, f"{key} holds something else than numbers") from error
    if table.shape != (BINS, 3) or not np.all(np.isfinite(table)):
        raise InputError(values.path, f"{key} is not a table of {BINS} rows of 3 numbers")
    return tuple(tuple(row) for row in table.tolist())


# How to read a value of each type that ``RunResult`` has.
_READERS: Mapping[Any, Callable[[JsonFields, str], Any]] = MappingProxyType(
    {
        bool: lambda values, key: values.get(key, bool),
        int: lambda values, key: values.get(key, int),
        float: JsonFields.number,
        int | None: lambda values, key: _or_none(values, key, lambda: values.get(key, int)),
        float | None: lambda values, key: _or_none(values, key, lambda: values.number(key)),
        tuple[tuple[float, ...], ...]: _sums,
    }
)


def _or_none(values: JsonFields, key: str, read: Callable[[], Any]) -> Any:
    """A value that may be null, but not missing."""
    return None if values.values.get(key, 0) is None else read()


def _medians(errors: FloatArray) -> list[float | None]:
    """Median of each row ``(2, N)``; None where it is infinite or there are no columns."""
    if errors.shape[1] == 0:
        return [None, None]
    # Not the mean of the middle two values, one of which may be infinite.
    medians = np.quantile(errors, 0.5, axis=1, method="inverted_cdf")
    return [float(value) if math.isfinite(value) else None for value in medians]


def _close_share(errors: FloatArray) -> float | None:
    """Share of frames whose errors, metres and degrees ``(2, N)``, are close; None without any."""
    if errors.shape[1] == 0:
        return None
    return float(np.mean((errors[0] < CLOSE_POSITION_M) & (errors[1] < CLOSE_HEADING_DEG)))


def _frames_to_recover(evaluation: RunEvaluation | None) -> int | None:
    """The longest recovery of a run; None where it never converged."""
    if evaluation is None or evaluation.frames_until_converged is None:
        return None
    return max(evaluation.frames_to_recover, default=0)


def _has_estimate(run: Run) -> bool:
    """Whether a frame with ground truth has an estimate; True without any ground truth."""
    has_truth = _has_truth(run)
    if not np.any(has_truth):
        return True
    if not run.estimate_names:
        return False
    return bool(np.any(has_truth & np.all(np.isfinite(run.estimated_states()), axis=1)))


def _has_truth(run: Run) -> BoolArray:
    """Frames ``(N,)`` with ground truth."""
    return known_states(_truth(run))


def _truth(run: Run) -> FloatArray:
    """True states ``(N, D)``; NaN where they are unknown."""
    if run.groundtruth is None:
        return np.full((len(run.frames), run.space.dimension), np.nan)
    return run.groundtruth


def _share_in_region(evaluation: RunEvaluation | None) -> float | None:
    if evaluation is None or evaluation.consistency is None:
        return None
    share = evaluation.consistency.in_region
    return share if math.isfinite(share) else None


def _mean(values: FloatArray) -> float | None:
    return float(np.mean(values)) if len(values) else None
