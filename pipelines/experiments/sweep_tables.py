"""The table of a sweep: one line for each setup, over all seeds; as CSV, JSON and Markdown."""

import csv
import io
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pipelines.experiments.sweep_result import RunResult
from pipelines.experiments.sweep_run import Setup
from pipelines.localize.calibration import wilson_interval
from pipelines.localize.trust import pooled_calibration_error

# Shares of the runs that are no worse.
QUANTILES = (0.1, 0.5, 0.9)
# Attributes of ``RunResult`` of which the table has these quantiles.
MEASURES = (
    "position_error_m",
    "heading_error_deg",
    "settled_position_error_m",
    "settled_heading_error_deg",
    "frames_until_converged",
    "frames_to_recover",
    "cpu_seconds_per_frame",
    "seconds_per_frame",
    "seconds_while_searching",
    "seconds_while_tracking",
)
# Attributes of ``RunResult`` of which it has the mean over the runs.
MEANS = ("in_95_region", "close_share", "frames_blind", "confidence", "confidence_blind")

# Kinds of frames: tracking the right place, tracking none, tracking a wrong one.
KINDS = ("right", "silent", "wrong")


@dataclass(frozen=True)
class Line:
    """A line of the table: the runs of a setup.

    Attributes:
        setup: what the runs have in common.
        results: results of the runs that were executed to their end.
        broken: number of runs that failed.
    """

    setup: Setup
    results: tuple[RunResult, ...]
    broken: int

    @property
    def successes(self) -> int:
        """Number of successful runs."""
        return sum(result.success for result in self.results)

    @property
    def success_rate(self) -> float:
        """Share of successful runs among those with a result; NaN where there are none."""
        return self.successes / len(self.results) if self.results else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval of the success rate; 0 to 1 where there are no runs."""
        return wilson_interval(self.successes, len(self.results))

    def quantile(self, measure: str, share: float) -> float:
        """The value of a measure that a share of the runs does not exceed.

        It is the value of one of the runs, and NaN where no run has one. An unknown error, or an
        unknown number of frames, counts as infinite. An unknown time does not count.

        Args:
            measure: one of ``MEASURES``.
            share: of the runs, 0 to 1.
        """
        values = [getattr(result, measure) for result in self.results]
        if "seconds" in measure:
            known = [float(value) for value in values if value is not None]
        else:
            known = [math.inf if value is None else float(value) for value in values]
        if not known:
            return math.nan
        return float(np.quantile(known, share, method="inverted_cdf"))

    @property
    def good_at_the_end(self) -> int:
        """Number of runs whose last frame is good, recovered ones included."""
        return sum(result.frames_to_recover is not None for result in self.results)

    @property
    def wrong_at_the_end(self) -> int:
        """Number of runs with a wrong frame among their last ten."""
        return sum(result.wrong_at_the_end for result in self.results)

    def frame_share(self, kind: str) -> float:
        """Share of the frames with ground truth that are of a kind, one of ``KINDS``; or NaN."""
        frames = sum(result.frames for result in self.results)
        found = sum(int(getattr(result, f"frames_{kind}")) for result in self.results)
        return found / frames if frames else math.nan

    @property
    def calibration_error(self) -> float:
        """Expected calibration error of the confidence over all frames; NaN without any."""
        return pooled_calibration_error(
            [np.array(result.confidence_sums) for result in self.results]
        )

    def mean(self, measure: str) -> float:
        """Mean of one of ``MEANS`` over the runs that have a value; NaN where none has."""
        values = [getattr(result, measure) for result in self.results]
        known = [float(value) for value in values if value is not None]
        return float(np.mean(known)) if known else math.nan

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; unknown and infinite values are null."""
        low, high = self.interval
        figures = {
            "success_rate": self.success_rate,
            "success_low": low,
            "success_high": high,
            **{
                f"{measure}_q{100.0 * share:.0f}": self.quantile(measure, share)
                for measure in MEASURES
                for share in QUANTILES
            },
            **{measure: self.mean(measure) for measure in MEANS},
            **{f"{kind}_share": self.frame_share(kind) for kind in KINDS},
            "calibration_error": self.calibration_error,
        }
        return {
            **asdict(self.setup),
            "runs": len(self.results),
            "broken": self.broken,
            "successes": self.successes,
            "good_at_the_end": self.good_at_the_end,
            "wrong_at_the_end": self.wrong_at_the_end,
            **{name: value if math.isfinite(value) else None for name, value in figures.items()},
        }


def lines_of(outcomes: Iterable[tuple[Setup, RunResult | None]]) -> tuple[Line, ...]:
    """The lines of the table, in the order in which their setups first appear.

    Args:
        outcomes: setup and result of each run; None for a run that failed.
    """
    groups: dict[Setup, list[RunResult | None]] = {}
    for setup, result in outcomes:
        groups.setdefault(setup, []).append(result)
    return tuple(
        Line(setup, tuple(item for item in group if item is not None), group.count(None))
        for setup, group in groups.items()
    )


def as_csv(lines: Sequence[Line]) -> str:
    """The table as CSV, with all numbers."""
    rows = [line.to_dict() for line in lines]
    file = io.StringIO()
    writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return file.getvalue()


def as_json(lines: Sequence[Line], failures: Sequence[str]) -> str:
    """The table as JSON, with all numbers and the failures."""
    content = {"lines": [line.to_dict() for line in lines], "failures": list(failures)}
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


HEADINGS = (
    "data set",
    "odometry",
    "method",
    "likelihood",
    "particles",
    "success",
    "95 % interval",
    "position (cm)",
    "heading (deg)",
    "settled (cm)",
    "settled (deg)",
    "frames until converged",
    "good at the end",
    "frames to recover",
    "in 95 % region",
    "right, silent, wrong (%)",
    "wrong at the end",
    "ECE",
    "CPU s a frame",
)
EXPLANATION = (
    "A run succeeds when its errors, averaged over the last five frames, are below 0.15 m and 3 "
    "degrees; the interval is Wilson's. Position and heading: such an average, as median and 90th "
    "percentile of the runs; settled: the median error from the fifth frame on, likewise. "
    "Converged: frames before the first from which the estimate stays within these bounds. Good "
    "at the end: within them in the last frame; to recover: how long the estimate was outside of "
    "them in between. In 95 % region: frames after convergence whose truth lies where the stated "
    "covariance says, mean of the runs. Right: frames of all runs with status tracking within "
    "0.3 m and 10 degrees; wrong: other frames with this status; silent: the rest. Wrong at the "
    "end: runs with a wrong frame among their last ten. ECE: expected calibration error of the "
    "confidence as the probability of being within 0.1 m and 3 degrees, frames of all runs. CPU "
    "seconds: processor time of all, median of the runs."
)
BLIND_HEADINGS = (
    "data set",
    "odometry",
    "method",
    "images that show nothing",
    "highest confidence there",
    "median confidence elsewhere",
)


def rows_for_people(lines: Sequence[Line]) -> list[tuple[str, ...]]:
    """The most important numbers, one row a line, headings first."""
    return [HEADINGS, *(_row(line) for line in lines)]


def as_markdown(lines: Sequence[Line], failures: Sequence[str]) -> str:
    """The most important numbers as a Markdown table, with an explanation and the failures."""
    text = [*markdown_table(rows_for_people(lines), texts=4), "", EXPLANATION]
    blind = [_blind_row(line) for line in lines if line.mean("frames_blind") > 0.0]
    if blind:
        text += ["", *markdown_table([BLIND_HEADINGS, *blind], texts=3)]
        text += ["", "How many images were found to show nothing: means of the runs."]
    if failures:
        text += ["", f"Runs that broke: {len(failures)}.", "", *(f"- {item}" for item in failures)]
    return "\n".join(text) + "\n"


def _row(line: Line) -> tuple[str, ...]:
    """A row of the table with ``HEADINGS``."""
    low, high = line.interval
    setup, runs = line.setup, len(line.results)
    success = f"{line.successes} of {runs}"
    if line.broken:
        success += f" ({line.broken} broke)"
    return (
        setup.dataset,
        setup.odometry,
        setup.contender,
        setup.likelihood or "-",
        "-" if setup.particles is None else str(setup.particles),
        success,
        f"{100.0 * low:.0f} to {100.0 * high:.0f} %",
        _two(line, "position_error_m", 100.0, 1),
        _two(line, "heading_error_deg", 1.0, 2),
        _two(line, "settled_position_error_m", 100.0, 1),
        _two(line, "settled_heading_error_deg", 1.0, 2),
        _two(line, "frames_until_converged", 1.0, 0),
        f"{line.good_at_the_end} of {runs}",
        _two(line, "frames_to_recover", 1.0, 0),
        _share(line.mean("in_95_region")),
        ", ".join(number_text(100.0 * line.frame_share(kind), 0) for kind in KINDS),
        f"{line.wrong_at_the_end} of {runs}",
        number_text(line.calibration_error, 2),
        number_text(line.quantile("cpu_seconds_per_frame", 0.5), 3),
    )


def _blind_row(line: Line) -> tuple[str, ...]:
    """A row of the table with ``BLIND_HEADINGS``."""
    setup = line.setup
    return (
        setup.dataset,
        setup.odometry,
        setup.contender,
        number_text(line.mean("frames_blind"), 1),
        number_text(line.mean("confidence_blind"), 2),
        number_text(line.mean("confidence"), 2),
    )


def _share(value: float) -> str:
    """A share in percent; "-" where it is unknown."""
    return "-" if math.isnan(value) else f"{100.0 * value:.0f} %"


def _two(line: Line, measure: str, factor: float, digits: int) -> str:
    """Median and 90th percentile."""
    values = (factor * line.quantile(measure, share) for share in (0.5, 0.9))
    return ", ".join(number_text(value, digits) for value in values)


def number_text(value: float, digits: int) -> str:
    """A number of a table: "-" where it is unknown, "never" where it is infinite."""
    if math.isnan(value):
        return "-"
    return "never" if math.isinf(value) else f"{value:.{digits}f}"


def markdown_table(rows: Sequence[tuple[str, ...]], texts: int) -> list[str]:
    """Lines of a Markdown table.

    Args:
        rows: headings first.
        texts: number of the first columns that hold text and are aligned left; the others hold
            numbers.
    """
    alignment = ("---",) * texts + ("---:",) * (len(rows[0]) - texts)
    return [
        f"| {' | '.join(cell.replace('|', '/') for cell in row)} |"
        for row in (rows[0], alignment, *rows[1:])
    ]
