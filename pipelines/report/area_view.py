"""The areas of a world in a top view and over time: where they are, and how probable each is."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from pipelines.artifacts.arrays import FloatArray
from pipelines.lightfield.area_map import AreaMap
from pipelines.localize.run import Run

# Okabe and Ito; areas are told apart by their names too, so that colours may come again.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#8C6D1F", "#5B3A8C")
# An area that is less probable is not named.
NAMED = 0.01


def colour_of(area: int) -> str:
    """The colour of an area."""
    return COLOURS[area % len(COLOURS)]


def draw_places(axes: Axes, areas: AreaMap) -> None:
    """Draws where photos were taken, in the colours of their areas."""
    for area in range(len(areas)):
        axes.plot(
            *areas.places[areas.home == area].T,
            linestyle="none",
            marker=".",
            markersize=2.5,
            color=colour_of(area),
            alpha=0.6,
            zorder=1.3,
        )


def draw_belief(axes: Axes, areas: AreaMap, belief: FloatArray) -> None:
    """Draws the areas as rectangles around their photos, filled as much as they are believed.

    Args:
        axes: with the limits of the top view.
        areas: of the world.
        belief: ``(A,)`` probability of each.
    """
    for area, probability in enumerate(belief.tolist()):
        own = areas.places[areas.home == area]
        if len(own) == 0:
            continue
        low, high = own.min(axis=0), own.max(axis=0)
        size = high - low
        colour = colour_of(area)
        axes.add_patch(
            Rectangle(
                (float(low[0]), float(low[1])),
                float(size[0]),
                float(size[1]),
                facecolor=(colour, 0.3 * probability),
                edgecolor=colour,
                linewidth=1.0,
                zorder=1.1,
            )
        )
        if probability >= NAMED:
            axes.annotate(
                f"{areas.names[area]} {probability:.0%}",
                (float(low[0]), float(high[1])),
                xytext=(1.0, 2.0),
                textcoords="offset points",
                fontsize=8.0,
                color=colour,
                weight="bold",
                annotation_clip=True,
                zorder=5.9,
            )


def draw_belief_over_time(axes: Axes, run: Run) -> None:
    """Draws the probabilities of a run's areas over its frames, one above the other."""
    if run.areas is None:
        return
    belief = np.stack([f.area_belief for f in run.frames if f.area_belief is not None])
    ever = [area for area in range(len(run.areas)) if belief[:, area].max() >= NAMED]
    bottom = np.zeros(len(belief))
    for area in ever:
        axes.bar(
            np.arange(len(belief)),
            belief[:, area],
            bottom=bottom,
            width=1.0,
            color=colour_of(area),
            label=run.areas.names[area],
        )
        bottom = bottom + belief[:, area]
    axes.set_ylim(0.0, 1.02)
    axes.set_yticks([0.0, 0.5, 1.0])
    axes.set_ylabel("area\n0 … 1")
