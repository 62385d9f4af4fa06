"""The legend of the top views and pictures."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.colors import to_hex
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pipelines.localize.run import Run
from pipelines.report import style
from pipelines.report.surroundings import Surroundings
from pipelines.report.top_view import MIN_MODE_SHARE, PARTICLE_TONES, arrow_marker, pnp_symbol
from pipelines.report.tracks import Tracks

# Frames with these statuses have hollow estimates, named so in the legend.
HOLLOW = {"global": "searching", "blind": "blind", "stale": "stale"}


def legend_entries(
    run: Run, tracks: Tracks, surroundings: Surroundings, indices: Sequence[int]
) -> tuple[list[Any], list[str], dict[type, HandlerTuple]]:
    """Handles, labels and handler map of a legend.

    Args:
        run: the run.
        tracks: the run's paths.
        surroundings: the fixed part of the top views.
        indices: numbers of the frames that the figure shows.

    Returns:
        A handle is an artist or, where a symbol consists of several, a tuple of artists.
    """
    statuses = {run.frames[i].status for i in indices}

    def dot(tone: float) -> Line2D:
        colour = to_hex(PARTICLE_TONES(tone))
        return Line2D([], [], linestyle="none", marker="o", color=colour, markersize=5.0)

    def pose(colour: str) -> Line2D:
        return Line2D(
            [], [], linestyle="none", marker=arrow_marker(0.0), color=colour, markersize=10.0
        )

    hollow = [word for status, word in HOLLOW.items() if status in statuses]
    entries: list[tuple[Artist | tuple[Artist, ...], str]] = [
        (tuple(dot(tone) for tone in (0.0, 0.5, 1.0)), "particles, dark: likelier"),
        (
            (Line2D([], [], color=style.ESTIMATE, linewidth=1.4), pose(style.ESTIMATE)),
            f"estimate (hollow: {' or '.join(hollow)})" if hollow else "estimate",
        ),
    ]
    ellipse = Line2D(
        [], [], linestyle="none", marker="o", markersize=10.0, markerfacecolor="none",
        markeredgecolor=style.ESTIMATE, markeredgewidth=1.3,
    )  # fmt: skip
    entries.append((ellipse, "95 % of the main cluster"))
    if tracks.odometry is not None:
        dashes = Line2D([], [], color=style.ODOMETRY, linewidth=1.5, linestyle=(0, (4.0, 1.6)))
        entries.append(((dashes, pose(style.ODOMETRY)), "odometry alone"))
    if tracks.groundtruth is not None:
        band = Line2D([], [], color=style.TRUTH, linewidth=4.0, alpha=0.45)
        entries.append(((band, pose(style.TRUTH)), "ground truth"))
    if tracks.pnp is not None and np.isfinite(tracks.pnp[list(indices), 0]).any():
        entries.append((Line2D([], [], **pnp_symbol()), "pnp, the pose by features"))
    if any(np.sum(run.frames[i].modes[:, -1] >= MIN_MODE_SHARE) > 1 for i in indices):
        mode = Line2D(
            [], [], linestyle="none", marker="D", markersize=8.0, markerfacecolor="none",
            markeredgecolor=style.MODE, markeredgewidth=1.8,
        )  # fmt: skip
        entries.append((mode, "cluster, share of the weight"))
    recording = Line2D(
        [], [], color=style.RECORDING, marker="o", markersize=4.0, markerfacecolor="white",
        linewidth=1.1, markevery=[0],
    )  # fmt: skip
    recording.set_data([0.0, 1.0], [0.0, 0.0])
    entries.append((recording, "recorded view"))
    if surroundings.surface is not None:
        wall = Line2D([], [], color=style.SURFACE, linewidth=3.0)
        flat = Patch(facecolor="#F2F2F2", edgecolor=style.SURFACE)
        entries.append((wall if surroundings.surface.is_wall else flat, "mapped surface"))
    striped = Patch(
        facecolor=_hex_of(style.UNCOVERED_LIGHT),
        edgecolor=_hex_of(style.UNCOVERED_DARK),
        hatch="//////",
    )
    entries.append((striped, "seen by no recorded view"))
    handles, labels = [entry[0] for entry in entries], [entry[1] for entry in entries]
    return handles, labels, {tuple: HandlerTuple(ndivide=None, pad=0.4)}


def _hex_of(colour: tuple[int, int, int]) -> str:
    return "#" + "".join(f"{part:02x}" for part in colour)
