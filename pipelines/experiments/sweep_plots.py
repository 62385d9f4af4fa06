"""Figures of a sweep: a measure over the number of particles, one panel a data set and odometry."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.markers import CARETUP
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from pipelines.experiments.sweep_tables import Line

# Colours of Okabe and Ito (2008), and markers for print in grey. No marker looks like the arrow of
# values beyond the axis.
SERIES_STYLES = (
    ("#0072B2", "o"),
    ("#D55E00", "s"),
    ("#009E73", "D"),
    ("#CC79A7", "P"),
    ("#E69F00", "X"),
    ("#56B4E9", "p"),
    ("#000000", "*"),
)
# All series together are spread over this share of the distance between two ticks.
SPREAD = 0.5
PANEL_WIDTH, PANEL_HEIGHT, PANELS_A_ROW = 3.6, 2.9, 4

Span = tuple[float, float, float]


@dataclass(frozen=True)
class Plot:
    """A figure.

    Attributes:
        name: name of its file, without suffix.
        label: label of the y axis.
        span: from a line of the table to its low, middle and high value.
        is_logarithmic: whether the y axis is.
        top: upper end of the y axis; None: by the data.
    """

    name: str
    label: str
    span: Callable[[Line], Span]
    is_logarithmic: bool = False
    top: float | None = None


def _quantiles(measure: str, factor: float = 1.0) -> Callable[[Line], Span]:
    """10, 50 and 90 % quantile of a measure, multiplied by a factor."""

    def span(line: Line) -> Span:
        low, middle, high = (factor * line.quantile(measure, share) for share in (0.1, 0.5, 0.9))
        return low, middle, high

    return span


def _success(line: Line) -> Span:
    """Success rate in its interval, percent."""
    low, high = line.interval
    return 100.0 * low, 100.0 * line.success_rate, 100.0 * high


PLOTS = (
    Plot("success", "runs that succeed (%)\nwith 95 % interval", _success, top=103.0),
    Plot(
        "position-error",
        "position error (cm)\nmedian, 10 to 90 % of runs",
        _quantiles("position_error_m", 100.0),
        is_logarithmic=True,
    ),
    Plot(
        "heading-error",
        "heading error (deg)\nmedian, 10 to 90 % of runs",
        _quantiles("heading_error_deg"),
        is_logarithmic=True,
    ),
    Plot(
        "convergence",
        "frames until converged\nmedian, 10 to 90 % of runs",
        _quantiles("frames_until_converged"),
    ),
    Plot(
        "seconds",
        "CPU seconds a frame\nmedian, 10 to 90 % of runs",
        _quantiles("cpu_seconds_per_frame"),
        is_logarithmic=True,
    ),
)


def write_plots(folder: Path, lines: Sequence[Line]) -> None:
    """Writes a PNG for each of ``PLOTS`` into a folder."""
    # Names come from users' files: "$" must not start a formula in them.
    with mpl.rc_context(
        {"font.family": ["DejaVu Sans"], "font.size": 9.0, "text.parse_math": False}
    ):
        for plot in PLOTS:
            figure_of(plot, lines).savefig(folder / f"{plot.name}.png", dpi=120)


def figure_of(plot: Plot, lines: Sequence[Line]) -> Figure:
    """The figure of a measure over all lines of the table.

    Infinite values (runs that never converged, or have no estimate) are arrows at the top.
    """
    panels = list(dict.fromkeys(_panel_of(line) for line in lines))
    columns = min(len(panels), PANELS_A_ROW)
    rows = math.ceil(len(panels) / columns)
    size = (PANEL_WIDTH * columns + 0.6, PANEL_HEIGHT * rows + 0.5)
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(rows, columns, sharey=True, squeeze=False)
    limits = _limits(plot, lines)
    for axes, panel in zip(grid.flat, panels, strict=False):
        if plot.is_logarithmic:
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_ylim(*limits)
        _draw(axes, plot, panel, lines)
        axes.set_title("\n".join(panel))
    for axes in grid.flat[len(panels) :]:
        axes.remove()
    for axes in grid[:, 0]:
        axes.set_ylabel(plot.label)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    return figure


def _draw(axes: Axes, plot: Plot, panel: tuple[str, str], lines: Sequence[Line]) -> None:
    """Draws one panel; all panels have the same series and numbers of particles."""
    series = list(dict.fromkeys(_series_of(line) for line in lines))
    numbers = sorted({n for line in lines if (n := line.setup.particles) is not None})
    top = axes.get_ylim()[1]
    for place, name in enumerate(series):
        colour, marker = SERIES_STYLES[place % len(SERIES_STYLES)]
        offset = SPREAD * ((place + 0.5) / len(series) - 0.5)
        own = [line for line in lines if _panel_of(line) == panel and _series_of(line) == name]
        if all(line.setup.particles is None for line in own):
            _draw_across(axes, [plot.span(line) for line in own], colour, name)
            continue
        own.sort(key=lambda line: line.setup.particles or 0)
        x = np.array([numbers.index(line.setup.particles or 0) + offset for line in own])
        spans = np.array([plot.span(line) for line in own]).reshape(-1, 3)
        low, middle, high = np.where(np.isposinf(spans), top, spans).T
        axes.vlines(x, low, high, color=colour)
        middle = np.where(np.isposinf(spans[:, 1]), np.nan, middle)
        axes.plot(x, middle, color=colour, marker=marker, linestyle=":", linewidth=0.8, label=name)
        for beyond in x[np.isposinf(spans[:, 2])]:
            axes.plot([beyond], [top], color=colour, marker=CARETUP, linestyle="", clip_on=False)
    axes.set_xticks(range(len(numbers)), [str(number) for number in numbers])
    axes.set_xlim(-0.6, len(numbers) - 0.4)
    axes.set_xlabel("particles")
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", linewidth=0.4, alpha=0.6)


def _draw_across(axes: Axes, spans: Sequence[Span], colour: str, name: str) -> None:
    """Draws a method without particles as a horizontal line with a band."""
    top = axes.get_ylim()[1]
    for low, middle, high in spans or [(math.nan, math.nan, math.nan)]:
        if math.isfinite(low):
            axes.axhspan(low, min(high, top), color=colour, alpha=0.15, linewidth=0.0)
        axes.axhline(min(middle, top), color=colour, linestyle="--", linewidth=1.0, label=name)


def _limits(plot: Plot, lines: Sequence[Line]) -> tuple[float, float]:
    """Limits of the y axis: all finite values with a margin."""
    values = np.array([plot.span(line) for line in lines])
    known = values[np.isfinite(values)]
    if plot.is_logarithmic:
        known = known[known > 0.0]
        if len(known) == 0:
            return 0.1, 1.0
        return float(known.min()) / 1.4, 1.4 * float(known.max())
    highest = max(float(known.max(initial=0.0)), 1.0)
    top = plot.top or 1.1 * highest
    # Room for markers at zero.
    return -0.03 * top, top


def _panel_of(line: Line) -> tuple[str, str]:
    return line.setup.dataset, line.setup.odometry


def _series_of(line: Line) -> str:
    likelihood = line.setup.likelihood
    return line.setup.contender + ("" if likelihood is None else f", {likelihood}")
