"""The reliability diagram of the study of trust."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipelines.experiments.trust_study import Row
from pipelines.localize.calibration import Bin

# Colours of Okabe and Ito (2008), and markers for print in grey.
WIDTH_STYLE = ("#0072B2", "o")
MASS_STYLE = ("#D55E00", "s")
PANEL_WIDTH, HEIGHT = 3.6, 4.6


def write_reliability(path: Path, rows: Sequence[Row]) -> None:
    """Writes a reliability diagram: for each row, how often each confidence is right.

    Args:
        path: of the PNG.
        rows: rows of the table, at least one.
    """
    # Names come from users' files: "$" must not start a formula in them.
    with mpl.rc_context(
        {"font.family": ["DejaVu Sans"], "font.size": 9.0, "text.parse_math": False}
    ):
        reliability_figure(rows).savefig(path, dpi=120)


def reliability_figure(rows: Sequence[Row]) -> Figure:
    """The figure: reliability above, numbers of frames below."""
    figure = Figure(figsize=(PANEL_WIDTH * len(rows) + 0.4, HEIGHT), layout="constrained")
    grid = figure.subplots(2, len(rows), squeeze=False, sharex=True, height_ratios=[3.0, 1.0])
    for (upper, lower), row in zip(grid.T, rows, strict=True):
        bins = row.trust.reliability()
        upper.plot([0.0, 1.0], [0.0, 1.0], color="grey", linewidth=0.8)
        _draw(upper, bins, "bins of equal width", WIDTH_STYLE)
        _draw(upper, row.trust.reliability(equal_mass=True), "of equal mass", MASS_STYLE)
        upper.set_title(
            f"{row.name}, {row.method}\n{len(row.trust)} frames, "
            f"ECE {row.trust.calibration_error:.3f}"
        )
        upper.set_xlim(-0.02, 1.02)
        upper.set_ylim(-0.02, 1.02)
        lower.stairs(
            [item.forecasts for item in bins],
            [*(item.low for item in bins), bins[-1].high],
            fill=True,
            color=WIDTH_STYLE[0],
        )
        lower.set_xlabel("confidence")
        for axes in (upper, lower):
            axes.spines[["top", "right"]].set_visible(False)
    grid[0, 0].set_ylabel("frames within 0.1 m and 3 degrees\n(share, with 95 % interval)")
    grid[0, 0].legend(loc="upper left", frameon=False)
    grid[1, 0].set_ylabel("frames")
    return figure


def _draw(axes: Axes, bins: Sequence[Bin], label: str, style: tuple[str, str]) -> None:
    """Draws the bins that hold frames, each at its mean confidence."""
    colour, marker = style
    known = [item for item in bins if item.forecasts]
    values = np.array([[item.mean, item.share, *item.interval] for item in known]).reshape(-1, 4)
    mean, share, low, high = values.T
    axes.vlines(mean, low, high, color=colour, linewidth=0.8)
    axes.plot(
        mean,
        share,
        color=colour,
        marker=marker,
        markersize=4.0,
        linestyle=":",
        linewidth=0.8,
        label=label,
    )
