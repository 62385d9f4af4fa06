"""What a run of a sweep came to: held against the truth, a few figures."""

import math
from dataclasses import asdict, dataclass
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

# A drive has settled from this frame on, counted from 0.
SETTLED = 4
# Frames from this one on are counted as close or not: metres and degrees.
CLOSE_FROM, CLOSE_POSITION_M, CLOSE_HEADING_DEG = 10, 0.1, 3.0


@dataclass(frozen=True)
class RunResult:
    """What comes out of a run.

    Attributes:
        success: the last five frames are on average within 0.15 m and 3 degrees.
        position_error_m: mean over the last five frames; None where there was no estimate.
        heading_error_deg: likewise.
        median_position_error_m: median over the frames that have an estimate.
        median_heading_error_deg: likewise.
        settled_position_error_m: median over the frames from the fifth on, those without an
            estimate being infinitely wrong; None where it is infinite, or there are no such frames.
        settled_heading_error_deg: likewise.
        close_share: of the frames after the tenth, how many are within 10 cm and 3 degrees; None
            where there are no such frames.
        frames_until_converged: None where it never did.
        frames_to_recover: length of the longest stretch of worse frames after the first good one; 0
            where there is none; None where the last frame is not good.
        frames: how many have a truth.
        in_95_region: share of the frames after convergence with the truth in the stated region.
        frames_blind: how many images were found to show nothing.
        confidence_blind: the highest that was stated there; None where there are none.
        confidence: the median over the other frames; likewise.
        cpu_seconds_per_frame: processor time of the whole run over the number of frames; on a
            busy machine the one figure that can be compared. (A process that makes several runs at
            once, as Dask's workers may, counts them all in each.)
        seconds_per_frame: wall time, mean over all frames.
        seconds_while_searching: mean over the frames of the global search: the first, where the
            start is anywhere, and those whose status is "global"; None where there are none.
        seconds_while_tracking: mean over the others in which one mode was followed; likewise.
        frames_right: frames with a truth that track the right place (``localize.trust``).
        frames_silent: those that track none.
        frames_wrong: those that track another one.
        wrong_at_the_end: whether one of the last ten frames is wrong.
        confidence_sums: for each bin of confidence the number of frames with a truth, the sum of
            their confidences, and how many have an estimate as close as the confidence speaks of.
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
        """What ``to_dict`` wrote.

        Raises:
            InputError: a key is missing or holds something else.
        """
        return cls(
            success=values.get("success", bool),
            position_error_m=_number(values, "position_error_m"),
            heading_error_deg=_number(values, "heading_error_deg"),
            median_position_error_m=_number(values, "median_position_error_m"),
            median_heading_error_deg=_number(values, "median_heading_error_deg"),
            settled_position_error_m=_number(values, "settled_position_error_m"),
            settled_heading_error_deg=_number(values, "settled_heading_error_deg"),
            close_share=_number(values, "close_share"),
            frames_until_converged=_count(values, "frames_until_converged"),
            frames_to_recover=_count(values, "frames_to_recover"),
            frames=values.get("frames", int),
            in_95_region=_number(values, "in_95_region"),
            frames_blind=values.get("frames_blind", int),
            confidence_blind=_number(values, "confidence_blind"),
            confidence=_number(values, "confidence"),
            cpu_seconds_per_frame=values.number("cpu_seconds_per_frame"),
            seconds_per_frame=values.number("seconds_per_frame"),
            seconds_while_searching=_number(values, "seconds_while_searching"),
            seconds_while_tracking=_number(values, "seconds_while_tracking"),
            frames_right=values.get("frames_right", int),
            frames_silent=values.get("frames_silent", int),
            frames_wrong=values.get("frames_wrong", int),
            wrong_at_the_end=values.get("wrong_at_the_end", bool),
            confidence_sums=_sums(values, "confidence_sums"),
        )


def judged(run: Run, cpu_seconds: float) -> RunResult:
    """Holds a run against its ground truth; one that never had an estimate is no success.

    Args:
        run: with ground truth.
        cpu_seconds: processor time that it took.

    Raises:
        InputError: the run carries no ground truth.
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
    # Found at once or not: nobody knew where to look.
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


def _number(values: JsonFields, key: str) -> float | None:
    return None if values.values.get(key, 0) is None else values.number(key)


def _count(values: JsonFields, key: str) -> int | None:
    return None if values.values.get(key, 0) is None else values.get(key, int)


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


def _medians(errors: FloatArray) -> list[float | None]:
    """Median of each row ``(2, N)``; None where it is infinite, or there are no columns."""
    if errors.shape[1] == 0:
        return [None, None]
    # Not the mean of the middle two, which infinity may be one of.
    medians = np.quantile(errors, 0.5, axis=1, method="inverted_cdf")
    return [float(value) if math.isfinite(value) else None for value in medians]


def _close_share(errors: FloatArray) -> float | None:
    if errors.shape[1] == 0:
        return None
    return float(np.mean((errors[0] < CLOSE_POSITION_M) & (errors[1] < CLOSE_HEADING_DEG)))


def _frames_to_recover(evaluation: RunEvaluation | None) -> int | None:
    if evaluation is None or evaluation.frames_until_converged is None:
        return None
    return max(evaluation.frames_to_recover, default=0)


def _has_estimate(run: Run) -> bool:
    """Whether a frame whose truth is known has an estimate; True where no truth is known."""
    has_truth = _has_truth(run)
    if not np.any(has_truth):
        return True
    if not run.estimate_names:
        return False
    return bool(np.any(has_truth & np.all(np.isfinite(run.estimated_states()), axis=1)))


def _has_truth(run: Run) -> BoolArray:
    """Frames ``(N,)`` whose truth is known."""
    return known_states(_truth(run))


def _truth(run: Run) -> FloatArray:
    """True states ``(N, D)``, NaN where they are unknown."""
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
