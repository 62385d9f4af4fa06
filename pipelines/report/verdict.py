"""The verdict, the first line of a report: whether the run succeeded."""

from collections.abc import Sequence
from dataclasses import dataclass

from pipelines.localize.evaluation import LAST_FRAMES, TrackEvaluation
from pipelines.localize.run import BY_ODOMETRY, Run


@dataclass(frozen=True)
class Verdict:
    """The verdict on a run.

    Attributes:
        kind: "good", "bad" or "unknown".
        sentence: the verdict as text.
    """

    kind: str
    sentence: str


def verdict_of(run: Run, errors: TrackEvaluation | None) -> Verdict:
    """Judges a run by its last frames.

    Args:
        run: the run.
        errors: errors of the run's estimate; None where they are unknown.
    """
    last = run.frames[-1]
    known = "" if errors is None else _errors_text(errors, len(run.frames))
    addition = f" Its estimates, for what they are worth: {known}." if known else ""
    if last.status == "lost":
        sentence = "Lost: at the last frame the filter says that it does not know the pose."
        return Verdict("bad", sentence + addition)
    if last.status == "global":
        sentence = "Not localized: at the last frame the filter was still searching."
        return Verdict("bad", sentence + addition + _lost_text(run))
    if last.status in BY_ODOMETRY:
        sentence = (
            "By odometry alone: the last image shows nothing that the filter could compare with "
            "the model."
            if last.status == "blind"
            else "By odometry alone: the last image is one from before, although the robot moved."
        )
        kind = "unknown" if errors is None else "good" if errors.success else "bad"
        return Verdict(kind, sentence + addition + _lost_text(run))
    if errors is None:
        return Verdict(
            "unknown",
            f"Tracking at the last frame with confidence {last.confidence:.2f}; whether the pose "
            "is right is unknown, since there is no ground truth to compare it with."
            + _lost_text(run),
        )
    if errors.success:
        return Verdict("good", f"Localized: {known}.{_lost_text(run)}")
    return Verdict("bad", f"Failed, although the filter says tracking: {known}.{_lost_text(run)}")


def _errors_text(errors: TrackEvaluation, frames: int) -> str:
    position, heading = errors.position_error_m.last5_mean, errors.heading_error_deg.last5_mean
    counted = min(LAST_FRAMES, frames, len(errors.position_error_m.known))
    return f"mean error over the last {counted} frames {length_text(position)} and {heading:.1f}°"


def _lost_text(run: Run) -> str:
    lost = [index for index, frame in enumerate(run.frames) if frame.status == "lost"]
    return f" It was lost in between, at {frame_ranges(lost)}." if lost else ""


def frame_ranges(indices: Sequence[int]) -> str:
    """Sorted frame numbers as text: "frame 4", "frames 2 to 5, 9"."""
    ranges: list[list[int]] = []
    for index in indices:
        if ranges and index == ranges[-1][-1] + 1:
            ranges[-1] = [ranges[-1][0], index]
        else:
            ranges.append([index])
    parts = [str(r[0]) if len(r) == 1 or r[0] == r[-1] else f"{r[0]} to {r[-1]}" for r in ranges]
    return ("frame " if len(indices) == 1 else "frames ") + ", ".join(parts)


def length_text(metres: float) -> str:
    """A length with a sensible unit: 3.2 cm, 1.24 m."""
    return f"{100.0 * metres:.1f} cm" if abs(metres) < 1.0 else f"{metres:.2f} m"
