"""Curves over the frames: errors with standard deviations, particles, confidence, time."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullFormatter

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.run import Run
from pipelines.localize.state_space import state_errors
from pipelines.report import style
from pipelines.report.area_view import draw_belief_over_time
from pipelines.report.tracks import Tracks

FIGURE_WIDTH = 13.0
PANEL_HEIGHT = 1.75
# From this ratio of the largest value to the median on, the axis is logarithmic.
LOG_RATIO = 12.0
# A bar this many times longer than the second longest is cut off: for example the first frame's,
# which searches the whole map.
TOWERING = 4.0
# Smaller errors than this are rounding: metres or radians.
SAME_PLACE = 1e-6


@dataclass(frozen=True)
class _Curve:
    """Values ``(N,)`` in metres or radians, and how to draw them."""

    values: FloatArray
    label: str
    colour: str
    line: str
    marker: str


def time_figure(run: Run, tracks: Tracks, indices: Sequence[int]) -> Figure:
    """All curves of a run below each other, over one common frame axis.

    Args:
        run: run of at least one frame.
        tracks: the run's paths.
        indices: numbers of the frames that other figures show; marked by thin vertical lines.
    """
    count = 5 if run.areas is None else 6
    figure = Figure(figsize=(FIGURE_WIDTH, count * PANEL_HEIGHT + 1.3))
    grid = figure.add_gridspec(
        count, 1, left=0.075, right=0.80, top=1 - 0.62 / figure.get_figheight(),
        bottom=0.6 / figure.get_figheight(), hspace=0.16,
    )  # fmt: skip
    panels = [figure.add_subplot(grid[row, 0]) for row in range(count)]
    _draw_deviation(panels[0], run, tracks, heading=False)
    _draw_deviation(panels[1], run, tracks, heading=True)
    _draw_particles(panels[2], run)
    _draw_confidence(panels[3], run)
    _draw_seconds(panels[4], run)
    if run.areas is not None:
        draw_belief_over_time(panels[5], run)
    for panel in panels:
        _finish_panel(panel, run, indices, bottom=panel is panels[-1])
    _add_time_axis(panels[0], run)
    figure.align_ylabels(panels)
    return figure


def claimed_sigmas(run: Run) -> tuple[FloatArray, FloatArray]:
    """The filter's own standard deviations, ``(N,)`` each: position in metres, angle in radians.

    Each is the root of the sum of the variances, along the axes of the position and over the angles
    of the orientation.
    """
    variances = np.array([np.diag(frame.covariance) for frame in run.frames])
    variances = np.clip(variances, 0.0, None)
    positions = run.space.positions
    return (
        np.sqrt(variances[:, :positions].sum(axis=1)),
        np.sqrt(variances[:, positions:].sum(axis=1)),
    )


def _draw_deviation(axes: Axes, run: Run, tracks: Tracks, *, heading: bool) -> None:
    """Draws errors against ground truth; without it, the difference of estimate and odometry."""
    frames = np.arange(len(run.frames))
    sigma = claimed_sigmas(run)[1 if heading else 0]
    curves = _deviations(run, tracks, heading)
    shown = np.concatenate([curve.values for curve in curves] or [sigma])
    scale, unit = _heading_unit() if heading else _length_unit(np.append(shown, sigma))
    for factor, alpha in ((2.0, 0.16), (1.0, 0.22)):
        axes.fill_between(
            frames,
            0.0,
            factor * sigma * scale,
            step="mid",
            color=style.ESTIMATE,
            alpha=alpha,
            linewidth=0.0,
            label=f"claimed by the filter: {factor:.0f} σ",
        )
    for curve in curves:
        axes.plot(
            frames,
            # Odometry starts at the true pose: its first error of zero is no measurement.
            np.where(curve.values > SAME_PLACE, curve.values * scale, np.nan),
            curve.line,
            color=curve.colour,
            marker=curve.marker,
            markersize=4.0,
            linewidth=1.6,
            label=curve.label,
        )
    axes.set_ylabel(_deviation_label(tracks, heading, unit))
    _scale_deviation(axes, shown[shown > SAME_PLACE] * scale)


def _deviations(run: Run, tracks: Tracks, heading: bool) -> list[_Curve]:
    """Errors of estimate and odometry; without ground truth, their difference."""
    curves = []
    for errors, label, colour, line, marker in (
        (tracks.estimate_errors, "estimate", style.ESTIMATE, "-", "o"),
        (tracks.odometry_errors, "odometry alone", style.ODOMETRY, "--", "^"),
        (tracks.pnp_errors, "pnp", style.PNP, ":", "x"),
    ):
        if errors is not None:
            degrees, metres = errors.heading_error_deg.per_frame, errors.position_error_m.per_frame
            values = np.radians(degrees) if heading else metres
            curves.append(_Curve(values, label, colour, line, marker))
    if not curves and tracks.odometry_states is not None:
        apart = state_errors(run.space, tracks.estimated_states, tracks.odometry_states)
        values = apart[1 if heading else 0]
        curves.append(_Curve(values, "estimate and odometry apart", style.FAINT, "-", "s"))
    return curves


def _deviation_label(tracks: Tracks, heading: bool, unit: str) -> str:
    what = "heading" if heading else "position"
    if tracks.evaluation is None:
        return f"{what} spread, {unit}\n(error unknown)"
    return f"{what} error\nin {unit}"


def _heading_unit() -> tuple[float, str]:
    return float(np.degrees(1.0)), "°"


def _length_unit(lengths: FloatArray) -> tuple[float, str]:
    """Factor and name: centimetres where most values are below a metre."""
    finite = lengths[np.isfinite(lengths)]
    if len(finite) == 0 or float(np.median(finite)) < 1.0:
        return 100.0, "cm"
    return 1.0, "m"


def _scale_deviation(axes: Axes, values: FloatArray) -> None:
    """Scales the axis: linear from zero, or logarithmic where a few values are far larger."""
    if len(values) == 0:
        axes.set_ylim(bottom=0.0)
        return
    if values.max() < LOG_RATIO * np.median(values):
        axes.set_ylim(0.0, 1.25 * values.max())
        return
    low = max(float(np.quantile(values, 0.1)) / 3.0, float(values.max()) * 1e-4)
    axes.set_yscale("log")
    axes.set_ylim(low, 2.5 * values.max())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _draw_particles(axes: Axes, run: Run) -> None:
    frames = np.arange(len(run.frames))
    numbers = np.array([len(frame.log_weights) for frame in run.frames])
    effective = np.array([frame.effective_sample_size for frame in run.frames])
    axes.plot(
        frames,
        numbers,
        color="#4D4D4D",
        drawstyle="steps-mid",
        linewidth=1.6,
        label="number of particles",
    )
    axes.plot(
        frames, effective, color=style.MODE, marker="o", markersize=4.0, linewidth=1.4,
        label="effective sample size",
    )  # fmt: skip
    axes.set_yscale("log")
    finite = effective[np.isfinite(effective) & (effective > 0.0)]
    low = min(1.0, float(finite.min())) if len(finite) else 1.0
    axes.set_ylim(0.7 * low, 2.5 * max(float(numbers.max()), 10.0))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_ylabel("particles")


def _draw_confidence(axes: Axes, run: Run) -> None:
    confidence = np.array([frame.confidence for frame in run.frames])
    axes.plot(
        np.arange(len(run.frames)), confidence, color=style.TEXT, marker="o", markersize=4.0,
        linewidth=1.6, label="confidence",
    )  # fmt: skip
    axes.set_ylim(-0.05, 1.08)
    axes.set_yticks([0.0, 0.5, 1.0])
    axes.set_ylabel("confidence\n0 … 1")


def stage_seconds(run: Run) -> dict[str, FloatArray]:
    """Wall seconds ``(N,)`` of each stage, in the order in which they are stacked."""
    names = {name for frame in run.frames for name in frame.seconds}
    known = [name for name in style.STAGE_COLOURS if name in names]
    ordered = known + sorted(names - set(known))
    return {
        name: np.array([frame.seconds.get(name, 0.0) for frame in run.frames]) for name in ordered
    }


def _draw_seconds(axes: Axes, run: Run) -> None:
    stages = stage_seconds(run)
    frames, base = np.arange(len(run.frames)), np.zeros(len(run.frames))
    total = np.sum(list(stages.values()), axis=0) if stages else base
    scale, unit = (1000.0, "ms") if float(np.median(total)) < 1.0 else (1.0, "s")
    others = 0
    for name, seconds in stages.items():
        colour = style.STAGE_COLOURS.get(name)
        if colour is None:
            colour = style.OTHER_STAGE_COLOURS[others % len(style.OTHER_STAGE_COLOURS)]
            others += 1
        # matplotlib leaves labels that begin with an underscore out of legends.
        axes.bar(
            frames, seconds * scale, 0.8, bottom=base, color=colour, linewidth=0.0,
            label=name.lstrip("_") or "stage",
        )  # fmt: skip
        base = base + seconds * scale
    _limit_bars(axes, base, unit)
    axes.set_ylabel(f"time a frame\nin {unit}")


def _limit_bars(axes: Axes, heights: FloatArray, unit: str) -> None:
    """Cuts off a bar far longer than all others, and writes its height beside it."""
    ordered = np.sort(heights)
    longest = float(ordered[-1])
    second = float(ordered[-2]) if len(ordered) > 1 else longest
    if second <= 0.0 or longest <= TOWERING * second:
        axes.set_ylim(0.0, 1.15 * max(longest, 1e-9))
        return
    axes.set_ylim(0.0, 1.6 * second)
    index = int(np.argmax(heights))
    right = index > len(heights) // 2
    axes.annotate(
        f"{longest:,.0f} {unit}, cut off here",
        (index - 0.4 if right else index + 0.4, 1.6 * second),
        xytext=(-4.0 if right else 4.0, -4.0),
        textcoords="offset points",
        ha="right" if right else "left",
        va="top",
        fontsize=9.0,
    )


def _finish_panel(axes: Axes, run: Run, indices: Sequence[int], *, bottom: bool) -> None:
    count = len(run.frames)
    axes.set_xlim(-0.5, count - 0.5)
    axes.xaxis.set_major_locator(MaxNLocator(nbins=12, integer=True, min_n_ticks=1))
    axes.grid(True, axis="y", color="#E6E6E6", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(length=3.0)
    statuses = _shade_statuses(axes, run)
    for index in indices:
        axes.axvline(index, color=style.FAINT, linewidth=0.8, linestyle=":", zorder=0.8)
    handles, labels = axes.get_legend_handles_labels()
    if axes.get_ylabel().startswith("confidence"):
        handles, labels = [*handles, *statuses], [*labels, *(str(s.get_label()) for s in statuses)]
    axes.legend(
        handles, labels, loc="upper left", bbox_to_anchor=(1.008, 1.04), frameon=False,
        borderaxespad=0.0, handlelength=1.8,
    )  # fmt: skip
    if bottom:
        axes.set_xlabel("frame (dotted lines: the frames shown in the pictures)")
    else:
        axes.tick_params(labelbottom=False)


def _shade_statuses(axes: Axes, run: Run) -> list[Patch]:
    """Shades what is not tracking behind the curves; returns legend patches."""
    patches: dict[str, Patch] = {}
    start = 0
    for status, group in groupby(frame.status for frame in run.frames):
        end = start + len(list(group))
        colour, hatch = style.STATUS_SHADE.get(status, style.UNKNOWN_STATUS_SHADE)
        meaning = style.STATUS_MEANING.get(status, status)
        edge = style.HATCH_COLOUR if hatch else style.FAINT
        patches[status] = Patch(
            facecolor=colour, edgecolor=edge, hatch=hatch, linewidth=0.6, label=meaning
        )
        if status != "tracking":
            span = axes.axvspan(start - 0.5, end - 0.5, facecolor=colour, edgecolor=edge)
            span.set(hatch=hatch, linewidth=0.0, zorder=0.1)
        start = end
    return list(patches.values())


def _add_time_axis(axes: Axes, run: Run) -> None:
    """Seconds since the first frame above the panel, at the frame axis' own ticks."""
    start = run.frames[0].timestamp
    low, high = axes.get_xlim()
    ticks = [int(t) for t in axes.get_xticks() if low <= t <= high and t == int(t)]
    ticks = [tick for tick in ticks if 0 <= tick < len(run.frames)]
    times = [f"{run.frames[tick].timestamp - start:g}" for tick in ticks]
    top = axes.secondary_xaxis("top")
    top.xaxis.set_major_locator(FixedLocator([float(tick) for tick in ticks]))
    top.set_xticks([float(tick) for tick in ticks], times)
    top.tick_params(length=3.0)
    top.set_xlabel("time since the first frame in s")
