"""One frame seen from above: particles, paths, poses, uncertainty, the mapped surface."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.markers import MarkerStyle
from matplotlib.patches import Ellipse, Polygon
from matplotlib.path import Path as MarkerPath
from matplotlib.ticker import MultipleLocator
from matplotlib.transforms import Affine2D

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.localize.run import FrameRecord, Run
from pipelines.report import style
from pipelines.report.area_view import draw_belief, draw_places
from pipelines.report.surroundings import Surface, Surroundings
from pipelines.report.tracks import Tracks

# Quantile 0.95 of the chi-squared distribution with two degrees of freedom.
ELLIPSE_95 = 5.991464547107979
# A particle this many times less likely than the best one is drawn in the lightest tone.
WEIGHT_RANGE = 1e4
# More dots than this only cover each other: half of them are the best particles, the others are
# evenly chosen.
MAX_DOTS = 20_000
# A mode with a smaller share of the weight is not shown: it is noise of the clustering.
MIN_MODE_SHARE = 0.05
PARTICLE_TONES = ListedColormap(
    np.linspace((0.80, 0.80, 0.80, 1.0), (0.10, 0.10, 0.10, 1.0), 32), name="lfnav particles"
)
# A close-up is at least this wide, metres, and at most this share of the whole view.
MIN_CLOSE_UP = 0.6
MAX_CLOSE_UP_SHARE = 0.6

# An arrow head along +x; its notch marks the position.
_ARROW = MarkerPath(
    [(1.3, 0.0), (-0.8, 0.75), (-0.35, 0.0), (-0.8, -0.75), (1.3, 0.0)],
    [MarkerPath.MOVETO, *[MarkerPath.LINETO] * 3, MarkerPath.CLOSEPOLY],
)


def box_limits(extent: FloatArray, aspect: float) -> FloatArray:
    """The extent ``(4,)`` widened to the shape of a box with ``aspect`` = width / height."""
    width, height = extent[1] - extent[0], extent[3] - extent[2]
    more_x = max(0.0, height * aspect - width) / 2.0
    more_y = max(0.0, width / aspect - height) / 2.0
    return np.asarray(extent + np.array([-more_x, more_x, -more_y, more_y]))


def close_up_extent(
    record: FrameRecord, tracks: Tracks, index: int, surroundings: Surroundings
) -> FloatArray | None:
    """The extent ``(4,)`` around a frame's estimate; None where it would be most of the whole view.

    Args:
        record: the frame.
        tracks: the run's paths.
        index: number of the frame.
        surroundings: the fixed part of the top view.
    """
    state = tracks.estimated[index]
    if not np.all(np.isfinite(state)):
        return None
    points = [state[:2]]
    if len(record.modes):
        spread = np.sqrt(ELLIPSE_95 * np.clip(np.diag(record.covariance)[:2], 0.0, None))
        points += [record.modes[0, :2] - spread, record.modes[0, :2] + spread]
    whole = surroundings.extent
    widest = MAX_CLOSE_UP_SHARE * max(whole[1] - whole[0], whole[3] - whole[2])
    for path in (tracks.groundtruth, tracks.odometry):
        if path is not None and np.linalg.norm(path[index, :2] - state[:2]) < widest / 2.0:
            points.append(path[index, :2])
    stacked = np.array(points)
    low, high = stacked.min(axis=0), stacked.max(axis=0)
    centre, side = (low + high) / 2.0, max(MIN_CLOSE_UP, 1.35 * float((high - low).max()))
    if side > widest:
        return None
    half = side / 2.0
    return np.array([centre[0] - half, centre[0] + half, centre[1] - half, centre[1] + half])


def draw_top_view(
    axes: Axes,
    surroundings: Surroundings,
    run: Run,
    tracks: Tracks,
    index: int,
    limits: FloatArray,
    *,
    detail: bool = False,
) -> None:
    """Draws frame ``index`` into ``axes``, whose box must have the shape of ``limits``.

    Args:
        axes: empty axes.
        surroundings: the fixed part of the top view.
        run: the run that the frame belongs to.
        tracks: the run's paths.
        index: number of the frame; the estimated path is drawn up to it.
        limits: ``(4,)`` x_min, x_max, y_min, y_max in metres.
        detail: whether this is a close-up, with larger symbols.
    """
    record = run.frames[index]
    size = 1.35 if detail else 1.0
    draw_place(axes, surroundings, limits, size)
    if run.areas is not None and record.area_belief is not None:
        draw_belief(axes, run.areas, record.area_belief)
    _draw_particles(axes, record, size)
    _draw_paths(axes, run, tracks, index, size)
    # In a close-up the ellipse shows the main cluster, and a diamond would hide its particles.
    _draw_modes(axes, record, first=1 if detail else 0)
    _draw_ellipse(axes, record)
    _draw_poses(axes, tracks, index, record.status == "tracking", size)
    if tracks.pnp is not None:
        axes.plot(*tracks.pnp[index, :2], **pnp_symbol(size), zorder=5.3)


def draw_place(
    axes: Axes, surroundings: Surroundings, limits: FloatArray, size: float = 1.0
) -> None:
    """Draws the fixed part: axes, mapped surface, obstacle points, recording positions.

    Args:
        axes: empty axes.
        surroundings: the fixed part of the top view.
        limits: ``(4,)`` x_min, x_max, y_min, y_max in metres.
        size: factor of the symbols' size.
    """
    _draw_axes(axes, limits)
    if surroundings.surface is not None:
        _draw_surface(axes, surroundings.surface, limits)
    if surroundings.obstacles is not None:
        axes.plot(
            *surroundings.obstacles.T, ".", color=style.FAINT, markersize=1.6 * size, zorder=1.2,
            label="obstacle points",
        )  # fmt: skip
    if surroundings.areas is None:
        _draw_recordings(axes, surroundings.recordings, limits, size)
    else:
        draw_places(axes, surroundings.areas)


def _draw_axes(axes: Axes, limits: FloatArray) -> None:
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlim(limits[0], limits[1])
    axes.set_ylim(limits[2], limits[3])
    axes.set_xlabel("x in m", labelpad=1.0)
    axes.set_ylabel("y in m", labelpad=1.0)
    # The same step in both directions, so that the grid has squares.
    step = tick_step(float(limits[1] - limits[0]))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(step))
    axes.grid(True, color="#E6E6E6", linewidth=0.6, zorder=0)
    axes.set_axisbelow(True)
    axes.tick_params(length=3.0, width=0.8)


def tick_step(span: float) -> float:
    """A step of 1, 2 or 5 times a power of ten that divides ``span`` into three to seven parts."""
    decade = 10.0 ** np.floor(np.log10(span))
    return float(next(s for s in (0.1, 0.2, 0.5, 1.0, 2.0) if span / (s * decade) < 7.5) * decade)


def _draw_surface(axes: Axes, surface: Surface, limits: FloatArray) -> None:
    if not surface.is_wall:
        area = Polygon(
            surface.outline, closed=True, facecolor="#F2F2F2", edgecolor=style.SURFACE, zorder=0.5
        )
        axes.add_patch(area)
        return
    depth = 0.03 * (limits[3] - limits[2])
    back = surface.outline[::-1] + depth * surface.away
    band = Polygon(
        np.concatenate([surface.outline, back]),
        closed=True,
        facecolor=style.SURFACE_BACK,
        edgecolor="#8C8C8C",
        hatch="////",
        linewidth=0.0,
        zorder=0.6,
    )
    axes.add_patch(band)
    axes.plot(
        *surface.outline.T, color=style.SURFACE, linewidth=3.0, solid_capstyle="butt", zorder=2.0
    )


def _draw_recordings(axes: Axes, recordings: FloatArray, limits: FloatArray, size: float) -> None:
    length = 0.035 * (limits[1] - limits[0])
    tips = recordings[:, :2] + length * np.column_stack(
        [np.cos(recordings[:, 2]), np.sin(recordings[:, 2])]
    )
    ticks = np.stack([recordings[:, :2], tips], axis=1)
    axes.add_collection(
        LineCollection(list(ticks), colors=style.RECORDING, linewidths=1.1 * size, zorder=2.4),
        autolim=False,
    )
    axes.plot(
        *recordings[:, :2].T,
        linestyle="none",
        marker="o",
        markersize=3.6 * size,
        markerfacecolor="white",
        markeredgecolor=style.RECORDING,
        markeredgewidth=1.1,
        zorder=2.5,
    )


def particle_tones(log_weights: FloatArray) -> FloatArray:
    """Darkness of each particle, ``(M,)``: 1 for the best, 0 from ``WEIGHT_RANGE`` below it."""
    best = float(log_weights.max())
    return np.asarray(np.clip(1.0 + (log_weights - best) / np.log(WEIGHT_RANGE), 0.0, 1.0))


def _shown(log_weights: FloatArray) -> BoolArray:
    """Which particles ``(M,)`` are drawn: all up to ``MAX_DOTS``, then the best and every k-th."""
    count = len(log_weights)
    if count <= MAX_DOTS:
        return np.ones(count, dtype=np.bool_)
    shown = np.zeros(count, dtype=np.bool_)
    shown[np.argsort(-log_weights, kind="stable")[: MAX_DOTS // 2]] = True
    rest = np.flatnonzero(~shown)
    shown[rest[:: -(-len(rest) // (MAX_DOTS // 2))]] = True
    return shown


def _draw_particles(axes: Axes, record: FrameRecord, size: float) -> None:
    shown = _shown(record.log_weights)
    particles, log_weights = record.particles[shown], record.log_weights[shown]
    order = np.argsort(log_weights, kind="stable")
    many = len(order) > 2000
    axes.scatter(
        particles[order, 0],
        particles[order, 1],
        c=particle_tones(log_weights)[order],
        cmap=PARTICLE_TONES,
        vmin=0.0,
        vmax=1.0,
        s=(2.0 if many else 7.0) * size**2,
        linewidths=0.0,
        zorder=1.5,
        rasterized=True,
    )


def _draw_paths(axes: Axes, run: Run, tracks: Tracks, index: int, size: float) -> None:
    if tracks.groundtruth is not None:
        axes.plot(
            *tracks.groundtruth[:, :2].T,
            color=style.TRUTH,
            linewidth=4.0 * size,
            alpha=0.45,
            solid_capstyle="round",
            zorder=3.0,
        )
    if tracks.odometry is not None:
        axes.plot(
            *tracks.odometry[: index + 1, :2].T,
            color=style.ODOMETRY,
            linewidth=1.5 * size,
            linestyle=(0, (4.0, 1.6)),
            zorder=3.2,
        )
    # While the filter is searching its estimates jump: a line between them would be no path.
    known = np.array([frame.status == "tracking" for frame in run.frames[: index + 1]])
    path = np.where(known[:, None], tracks.estimated[: index + 1, :2], np.nan)
    axes.plot(
        *path.T,
        color=style.ESTIMATE,
        linewidth=1.4 * size,
        marker="o",
        markersize=2.6 * size,
        zorder=3.4,
    )


def _draw_modes(axes: Axes, record: FrameRecord, first: int) -> None:
    modes = record.modes[record.modes[:, -1] >= MIN_MODE_SHARE]
    if len(modes) < 2:
        return
    for x, y, share in modes[first:][:, [0, 1, -1]]:
        axes.plot(
            x,
            y,
            linestyle="none",
            marker="D",
            markersize=9.0,
            markerfacecolor="none",
            markeredgecolor=style.MODE,
            markeredgewidth=1.8,
            zorder=4.0,
            clip_on=True,
        )
        axes.annotate(
            f"{share:.0%}",
            (x, y),
            xytext=(9.0, 5.0),
            textcoords="offset points",
            fontsize=9.0,
            annotation_clip=True,
            clip_on=True,
            bbox={"boxstyle": "round,pad=0.1", "facecolor": "white", "alpha": 0.8, "linewidth": 0},
            zorder=6.0,
        )


def covariance_ellipse(covariance: FloatArray) -> tuple[float, float, float]:
    """Width, height (metres) and angle (degrees) of the 95 % ellipse of x and y.

    Args:
        covariance: ``(D, D)``, x and y first.
    """
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    width, height = 2.0 * np.sqrt(ELLIPSE_95 * np.clip(values[::-1], 0.0, None))
    return float(width), float(height), float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))


def _draw_ellipse(axes: Axes, record: FrameRecord) -> None:
    if len(record.modes) == 0 or not np.all(np.isfinite(record.covariance)):
        return
    width, height, angle = covariance_ellipse(record.covariance)
    for colour, line in (("white", 3.0), (style.ESTIMATE, 1.3)):
        outline = Ellipse(
            (float(record.modes[0, 0]), float(record.modes[0, 1])),
            width,
            height,
            angle=angle,
            facecolor="none",
            edgecolor=colour,
            linewidth=line,
            zorder=4.2,
        )
        axes.add_patch(outline)


def pnp_symbol(size: float = 1.0) -> dict[str, Any]:
    """Style of the mark of a pose by features: small, so that it hides no other pose."""
    return {
        "linestyle": "none",
        "marker": "x",
        "color": style.PNP,
        "markersize": 8.0 * size,
        "markeredgewidth": 2.0,
    }


def arrow_marker(heading: float) -> MarkerStyle:
    """An arrow head of fixed size along ``heading`` (radians)."""
    return MarkerStyle(_ARROW.transformed(Affine2D().rotate(heading)))


def _draw_poses(axes: Axes, tracks: Tracks, index: int, tracking: bool, size: float) -> None:
    for path, colour, order in (
        (tracks.odometry, style.ODOMETRY, 5.0),
        (tracks.groundtruth, style.TRUTH, 5.1),
        (tracks.estimated, style.ESTIMATE, 5.2),
    ):
        if path is None or not np.all(np.isfinite(path[index])):
            continue
        x, y, heading = path[index]
        hollow = path is tracks.estimated and not tracking
        axes.plot(
            x,
            y,
            linestyle="none",
            marker=arrow_marker(float(heading)),
            markersize=13.0 * size,
            markerfacecolor="white" if hollow else colour,
            markeredgecolor=colour if hollow else "white",
            markeredgewidth=1.4 if hollow else 1.0,
            zorder=order,
        )
