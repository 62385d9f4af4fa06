"""The table of a sweep: a line for each setup, over all of its seeds; as CSV, JSON and Markdown."""

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

# The share of runs that are no worse.
QUANTILES = (0.1, 0.5, 0.9)
# Measures of which the table has these quantiles: attribute of ``RunResult``, unit of the columns.
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
# Measures of which it has the mean over the runs.
MEANS = ("in_95_region", "close_share", "frames_blind", "confidence", "confidence_blind")

# Frames that track the right place, none, or another one.
KINDS = ("right", "silent", "wrong")


@dataclass(frozen=True)
class Line:
    """What the runs of a setup came to.

    Attributes:
        setup: what they have in common.
        results: of those that came to an end.
        broken: how many did not.
    """

    setup: Setup
    results: tuple[RunResult, ...]
    broken: int

    @property
    def successes(self) -> int:
        """How many runs succeeded."""
        return sum(result.success for result in self.results)

    @property
    def success_rate(self) -> float:
        """Share of the runs that came to an end; NaN where none did."""
        return self.successes / len(self.results) if self.results else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval of the success rate; 0 to 1 where there are no runs."""
        return wilson_interval(self.successes, len(self.results))

    def quantile(self, measure: str, share: float) -> float:
        """The value that this share of the runs does not exceed.

        It is that of one of the runs. A run without an estimate is infinitely wrong, one that never
        converged takes infinitely long; a time of something that never happened does not count. NaN
        where no run has a value.
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
        """How many runs were good in their last frame: found again, if they were ever lost."""
        return sum(result.frames_to_recover is not None for result in self.results)

    @property
    def wrong_at_the_end(self) -> int:
        """How many runs have a wrong frame among their last ten."""
        return sum(result.wrong_at_the_end for result in self.results)

    def frame_share(self, kind: str) -> float:
        """Share of the frames with a truth that are ``right``, ``silent`` or ``wrong``; or NaN."""
        frames = sum(result.frames for result in self.results)
        found = sum(int(getattr(result, f"frames_{kind}")) for result in self.results)
        return found / frames if frames else math.nan

    @property
    def calibration_error(self) -> float:
        """ECE of the confidence over the frames of all runs; NaN where there are none."""
        return pooled_calibration_error(
            [np.array(result.confidence_sums) for result in self.results]
        )

    def mean(self, measure: str) -> float:
        """Mean over the runs that have a value; NaN where none has."""
        values = [getattr(result, measure) for result in self.results]
        known = [float(value) for value in values if value is not None]
        return float(np.mean(known)) if known else math.nan

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; what is unknown or infinite is null."""
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
        outcomes: of all runs; None for one that broke.
    """
    groups: dict[Setup, list[RunResult | None]] = {}
    for setup, result in outcomes:
        groups.setdefault(setup, []).append(result)
    return tuple(
        Line(setup, tuple(item for item in group if item is not None), group.count(None))
        for setup, group in groups.items()
    )


def as_csv(lines: Sequence[Line]) -> str:
    """One row a line, all figures."""
    rows = [line.to_dict() for line in lines]
    file = io.StringIO()
    writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return file.getvalue()


def as_json(lines: Sequence[Line], failures: Sequence[str]) -> str:
    """The same, and the runs that broke."""
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
    """The most telling figures, a row a line, headings first."""
    return [HEADINGS, *(_row(line) for line in lines)]


def as_markdown(lines: Sequence[Line], failures: Sequence[str]) -> str:
    """The same as a table, with an explanation, and the runs that broke."""
    text = [*_markdown_table(rows_for_people(lines), texts=4), "", EXPLANATION]
    blind = [_blind_row(line) for line in lines if line.mean("frames_blind") > 0.0]
    if blind:
        text += ["", *_markdown_table([BLIND_HEADINGS, *blind], texts=3)]
        text += ["", "How many images were found to show nothing: means of the runs."]
    if failures:
        text += ["", f"Runs that broke: {len(failures)}.", "", *(f"- {item}" for item in failures)]
    return "\n".join(text) + "\n"


def _row(line: Line) -> tuple[str, ...]:
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
        ", ".join(_figure(100.0 * line.frame_share(kind), 0) for kind in KINDS),
        f"{line.wrong_at_the_end} of {runs}",
        _figure(line.calibration_error, 2),
        _figure(line.quantile("cpu_seconds_per_frame", 0.5), 3),
    )


def _blind_row(line: Line) -> tuple[str, ...]:
    setup = line.setup
    return (
        setup.dataset,
        setup.odometry,
        setup.contender,
        _figure(line.mean("frames_blind"), 1),
        _figure(line.mean("confidence_blind"), 2),
        _figure(line.mean("confidence"), 2),
    )


def _share(value: float) -> str:
    return "-" if math.isnan(value) else f"{100.0 * value:.0f} %"


def _two(line: Line, measure: str, factor: float, digits: int) -> str:
    """Median and 90th percentile."""
    values = (factor * line.quantile(measure, share) for share in (0.5, 0.9))
    return ", ".join(_figure(value, digits) for value in values)


def _figure(value: float, digits: int) -> str:
    if math.isnan(value):
        return "-"
    return "never" if math.isinf(value) else f"{value:.{digits}f}"


def _markdown_table(rows: Sequence[tuple[str, ...]], texts: int) -> list[str]:
    """Lines of a table whose first columns hold texts, the others numbers; headings first."""
    alignment = ("---",) * texts + ("---:",) * (len(rows[0]) - texts)
    return [_markdown_row(row) for row in (rows[0], alignment, *rows[1:])]


def _markdown_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"
