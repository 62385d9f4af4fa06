"""A picture of a world: where its photos were taken, and which area is whose neighbour."""

import textwrap
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.atomic import check_output, write_bytes
from pipelines.lightfield.world_file import World, load_world
from pipelines.report import style
from pipelines.report.area_view import COLOURS
from pipelines.report.figures import png_of

WIDTH, SMALLEST_HEIGHT, LARGEST_HEIGHT = 12.0, 3.0, 12.0
MARGIN = 0.6
MARKERS = ("o", "s", "^", "D", "v")
NAME_WIDTH = 18


def draw_world(path: Path, picture: Path, overwrite: bool) -> None:
    """Writes the picture of a world as PNG.

    Args:
        path: the folder of the world.
        picture: the file to be written.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: the world cannot be used, or the picture not be written.
    """
    check_output(picture, overwrite)
    world = load_world(path)
    with style.figure_style():
        write_bytes(picture, png_of(world_figure(world)), overwrite)


def world_figure(world: World) -> Figure:
    """The floor from above: positions by area, rectangles, names, recorded paths, neighbours."""
    positions = world.world_from_camera[:, :2, 3]
    corners = np.array([area.rectangle for area in world.areas])
    low = np.minimum(positions.min(axis=0), corners[:, [0, 2]].min(axis=0)) - MARGIN
    high = np.maximum(positions.max(axis=0), corners[:, [1, 3]].max(axis=0)) + MARGIN
    aspect = (high[1] - low[1]) / (high[0] - low[0])
    height = float(np.clip(WIDTH * aspect, SMALLEST_HEIGHT, LARGEST_HEIGHT))
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    axes = figure.add_subplot()
    paths = positions[world.links]
    axes.add_collection(LineCollection(list(paths), colors=style.SURFACE_BACK, linewidths=0.6))
    homeless = positions[world.home < 0]
    axes.plot(*homeless.T, "x", color=style.FAINT, markersize=4)
    for number, (colour, marker) in enumerate(_looks(len(world.areas))):
        _draw_area(axes, world, number, colour, marker)
    _draw_neighbours(axes, world)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set_xlabel("x in m")
    axes.set_ylabel("y in m")
    return figure


def _looks(count: int) -> list[tuple[str, str]]:
    """Colour and marker of each area."""
    colours = cycle(COLOURS)
    return [(next(colours), MARKERS[(k // len(COLOURS)) % len(MARKERS)]) for k in range(count)]


def _draw_area(axes: Axes, world: World, number: int, colour: str, marker: str) -> None:
    area = world.areas[number]
    own = world.world_from_camera[world.home == number, :2, 3]
    axes.plot(*own.T, marker, color=colour, markersize=3.5, markeredgewidth=0.0, zorder=3)
    others = area.views[world.home[area.views] != number]
    # Rings around photos of neighbours: the overlap.
    axes.plot(
        *world.world_from_camera[others, :2, 3].T,
        "o",
        markersize=7.0,
        markerfacecolor="none",
        markeredgecolor=colour,
        markeredgewidth=0.5,
        zorder=2,
    )
    left, right, bottom, top = area.rectangle
    axes.add_patch(
        Rectangle((left, bottom), right - left, top - bottom, edgecolor=colour, facecolor="none")
    )
    x, y = _middle(area.rectangle).tolist()
    axes.text(
        x,
        y,
        "\n".join(textwrap.wrap(area.name, NAME_WIDTH)) + f"\n{len(area.views)} views",
        ha="center",
        va="center",
        weight="bold",
        color=style.TEXT,
        zorder=5,
        bbox={"facecolor": "white", "edgecolor": colour, "alpha": 0.85, "pad": 2.5},
    )


def _draw_neighbours(axes: Axes, world: World) -> None:
    """A line through the place where one area is left for the other."""
    middles = {area.name: _middle(area.rectangle) for area in world.areas}
    number_of = {area.name: number for number, area in enumerate(world.areas)}
    positions = world.world_from_camera[:, :2, 3]
    ends = world.home[world.links]
    for area in world.areas:
        for name in area.neighbours:
            first, second = number_of[area.name], number_of[name]
            between = np.all(np.sort(ends, axis=1) == [first, second], axis=1)
            if first > second or not np.any(between):
                continue
            crossings = positions[world.links[between]].mean(axis=1)
            # Of several doorways the line takes one, and not the wall between them.
            off = np.linalg.norm(crossings - crossings.mean(axis=0), axis=1)
            crossing = crossings[np.argmin(off)]
            line = np.array([middles[area.name], crossing, middles[name]])
            axes.plot(*line.T, "--", color=style.SURFACE, linewidth=1.0, zorder=4)


def _middle(rectangle: FloatArray) -> FloatArray:
    return np.array([rectangle[:2].mean(), rectangle[2:].mean()])
