"""The table of a sweep: a line for each setup, over all of its seeds; as CSV, JSON and Markdown."""

import csv
import io
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.stats import binomtest

from pipelines.experiments.sweep_run import RunResult, Setup

CONFIDENCE = 0.95
# The share of runs that are no worse.
QUANTILES = (0.1, 0.5, 0.9)
# Measures of which the table has these quantiles: attribute of ``RunResult``, unit of the columns.
MEASURES = (
    "position_error_m",
    "heading_error_deg",
    "frames_until_converged",
    "cpu_seconds_per_frame",
    "seconds_per_frame",
    "seconds_while_searching",
    "seconds_while_tracking",
)


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
        if not self.results:
            return 0.0, 1.0
        test = binomtest(self.successes, len(self.results))
        interval = test.proportion_ci(CONFIDENCE, method="wilson")
        return float(interval.low), float(interval.high)

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
    def in_95_region(self) -> float:
        """Mean over the runs of the share of frames with the truth in the stated region."""
        shares = [result.in_95_region for result in self.results]
        known = [share for share in shares if share is not None]
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
            "in_95_region": self.in_95_region,
        }
        return {
            **asdict(self.setup),
            "runs": len(self.results),
            "broken": self.broken,
            "successes": self.successes,
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
    "strategy",
    "likelihood",
    "particles",
    "success",
    "95 % interval",
    "position (cm)",
    "heading (deg)",
    "frames until converged",
    "CPU s a frame",
)


def rows_for_people(lines: Sequence[Line]) -> list[tuple[str, ...]]:
    """The most telling figures, a row a line, headings first."""
    return [HEADINGS, *(_row(line) for line in lines)]


def as_markdown(lines: Sequence[Line], failures: Sequence[str]) -> str:
    """The same as a table, with an explanation, and the runs that broke."""
    alignment = ["---"] * 4 + ["---:"] * (len(HEADINGS) - 4)
    rows = rows_for_people(lines)
    text = [_markdown_row(rows[0]), _markdown_row(alignment), *map(_markdown_row, rows[1:])]
    text += [
        "",
        "A run succeeds when its errors, averaged over the last five frames, are below 0.15 m and "
        "3 degrees; the interval is Wilson's. Position and heading: such an average, as median and "
        "90th percentile of the runs. Converged: frames before the first from which the estimate "
        "stays within these bounds, likewise. CPU seconds: processor time of all, median of the "
        "runs.",
    ]
    if failures:
        text += ["", f"Runs that broke: {len(failures)}.", "", *(f"- {item}" for item in failures)]
    return "\n".join(text) + "\n"


def _row(line: Line) -> tuple[str, ...]:
    low, high = line.interval
    setup = line.setup
    success = f"{line.successes} of {len(line.results)}"
    if line.broken:
        success += f" ({line.broken} broke)"
    return (
        setup.dataset,
        setup.odometry,
        setup.strategy,
        setup.likelihood,
        str(setup.particles),
        success,
        f"{100.0 * low:.0f} to {100.0 * high:.0f} %",
        _two(line, "position_error_m", 100.0, 1),
        _two(line, "heading_error_deg", 1.0, 2),
        _two(line, "frames_until_converged", 1.0, 0),
        _figure(line.quantile("cpu_seconds_per_frame", 0.5), 3),
    )


def _two(line: Line, measure: str, factor: float, digits: int) -> str:
    """Median and 90th percentile."""
    values = (factor * line.quantile(measure, share) for share in (0.5, 0.9))
    return ", ".join(_figure(value, digits) for value in values)


def _figure(value: float, digits: int) -> str:
    if math.isnan(value):
        return "-"
    return "never" if math.isinf(value) else f"{value:.{digits}f}"


def _markdown_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"
