"""The figure of a docking: path over ground, and distance to the goal with the belief's bound."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import FuncFormatter, NullFormatter

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.localize.docking_record import DockingRecord
from pipelines.localize.run import Run
from pipelines.report import style
from pipelines.report.surroundings import Surroundings
from pipelines.report.top_view import arrow_marker, box_limits, draw_place
from pipelines.report.tracks import Tracks
from pipelines.report.verdict import Verdict, length_text

WIDTH, HEIGHT = 14.0, 5.2
# Bounds are stated with this many standard deviations.
SIGMAS = 2.0
# Name of the estimate that docking acted on.
DOCKING_ESTIMATE = "docking"
# A robot truly farther from the goal than this is not docked, whatever the outcome, metres.
LARGEST_TRUE_ERROR = 0.05
STATE_SHADE = {
    "searching": "#FAF0CC",
    "waiting": "#F3DCE6",
    "route": "#EDE6F5",
    "staging": "#E3EEF7",
    "approach": "#D5EBDD",
    "alignment": "#C3DDCB",
}
CAPTION = (
    "Left, the place from above: the goal (star), the staging pose behind it (square), the path by "
    "the estimate and, where it is known, by ground truth; grey dots are obstacle points, "
    "circles a robot whose radius was given. Right, the distance to the goal at each "
    "step on a logarithmic scale; the band is the estimated distance plus and minus two standard "
    "deviations. Shades are the states of docking."
)
ANIMATION_CAPTION = "The docking step by step: from above, and what the camera saw."


def record_of(run: Run) -> DockingRecord:
    """The docking record of a run.

    Raises:
        OptionError: the run is no docking.
    """
    if run.docking is None:
        raise OptionError("the run is no docking")
    return run.docking


def acted_on(run: Run) -> FloatArray:
    """``(N, 3)`` the states that the docking acted on; NaN where it knew none."""
    if DOCKING_ESTIMATE not in run.estimate_names:
        return np.full((len(run.frames), 3), np.nan)
    return run.estimated_states(DOCKING_ESTIMATE)


def docking_figure(run: Run, surroundings: Surroundings, tracks: Tracks) -> Figure:
    """Path over ground, and distance to the goal over the steps."""
    figure = Figure(figsize=(WIDTH, HEIGHT), facecolor="white")
    above = figure.add_axes((0.05, 0.11, 0.42, 0.8))
    limits = box_limits(surroundings.extent, 0.42 * WIDTH / (0.8 * HEIGHT))
    draw_place(above, surroundings, limits)
    draw_goal(above, record_of(run))
    if tracks.groundtruth is not None:
        above.plot(
            *tracks.groundtruth[:, :2].T, color=style.TRUTH, linewidth=4.0, alpha=0.45,
            label="true path", zorder=3.0,
        )  # fmt: skip
    above.plot(
        *acted_on(run)[:, :2].T, color=style.ESTIMATE, linewidth=1.4, marker="o", markersize=3.0,
        label="estimated path", zorder=3.4,
    )  # fmt: skip
    draw_robot(above, run)
    above.legend(loc="best", framealpha=0.9)
    _draw_distances(figure.add_axes((0.55, 0.11, 0.43, 0.8)), run)
    return figure


def draw_robot(axes: Axes, run: Run) -> None:
    """The circle that a robot of known size fills, at every step."""
    radius = float(record_of(run).settings.get("robot_radius", 0.0))
    paths = [acted_on(run)] if run.groundtruth is None else [run.groundtruth]
    for place in [place for path in paths for place in path[:, :2] if radius > 0.0]:
        if np.all(np.isfinite(place)):
            axes.add_patch(
                Circle(
                    (float(place[0]), float(place[1])), radius, fill=False, linewidth=0.6,
                    edgecolor=style.TRUTH if run.groundtruth is not None else style.ESTIMATE,
                    alpha=0.5, zorder=2.5,
                )
            )  # fmt: skip


def draw_goal(axes: Axes, record: DockingRecord) -> None:
    """The goal and the staging pose, with the heading that the robot has to have there."""
    for state, marker, size, label in (
        (record.staging, "s", 9.0, "staging pose"),
        (record.goal, "*", 17.0, "goal"),
    ):
        axes.plot(
            state[0], state[1], linestyle="none", marker=marker, markersize=size,
            markerfacecolor=style.MODE, markeredgecolor="white", label=label, zorder=4.5,
        )  # fmt: skip
    tip = record.goal[:2] + 0.25 * np.array([np.cos(record.goal[2]), np.sin(record.goal[2])])
    axes.plot(*np.stack([record.goal[:2], tip]).T, color=style.MODE, linewidth=2.0, zorder=4.4)


def draw_pose(axes: Axes, state: FloatArray, colour: str) -> None:
    """A robot's pose ``(3,)`` as an arrow head."""
    axes.plot(
        state[0], state[1], linestyle="none", marker=arrow_marker(float(state[2])),
        markersize=14.0, markerfacecolor=colour, markeredgecolor="white", zorder=5.0,
    )  # fmt: skip


def _draw_distances(axes: Axes, run: Run) -> None:
    record, estimates = record_of(run), acted_on(run)
    steps = np.arange(len(run.frames))
    shade_states(axes, record.states)
    distance = np.linalg.norm(estimates[:, :2] - record.goal[:2], axis=1)
    reach = SIGMAS * _sigmas(run)
    known = np.isfinite(distance)
    low = np.maximum(distance - reach, 1e-4)
    axes.fill_between(
        steps, low, distance + reach, where=known.tolist(), color=style.ESTIMATE, alpha=0.2,
        linewidth=0.0, label="the belief's bound, two standard deviations",
    )  # fmt: skip
    axes.plot(
        steps, np.maximum(distance, 1e-4), color=style.ESTIMATE, marker="o", markersize=3.0,
        label="estimated",
    )  # fmt: skip
    if run.groundtruth is not None:
        truth = np.linalg.norm(run.groundtruth[:, :2] - record.goal[:2], axis=1)
        axes.plot(steps, truth, color=style.TRUTH, linewidth=3.0, alpha=0.6, label="true")
    axes.set_yscale("log")
    axes.set_ylim(bottom=1e-3)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: length_text(float(value))))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xlim(-0.5, len(steps) - 0.5)
    axes.set_xlabel("step")
    axes.set_ylabel("distance to the goal")
    axes.grid(True, color="#E6E6E6", linewidth=0.6)
    axes.legend(loc="lower left", framealpha=0.9)


def shade_states(axes: Axes, states: tuple[str, ...]) -> None:
    """Shades the background by the state of docking, and names each state once."""
    named: set[str] = set()
    for step, state in enumerate(states):
        axes.axvspan(
            step - 0.5, step + 0.5, color=STATE_SHADE.get(state, "#FFFFFF"), linewidth=0.0, zorder=0
        )
        if state not in named:
            named.add(state)
            axes.text(
                step - 0.4, 0.98, state, rotation=90, va="top", fontsize=8.5, color=style.FAINT,
                transform=axes.get_xaxis_transform(),
            )  # fmt: skip


def _sigmas(run: Run) -> FloatArray:
    """Standard deviations ``(N,)`` of the position along its least certain direction, metres."""
    sigmas = []
    for frame in run.frames:
        covariance = frame.covariance
        if frame.refined_covariance is not None:
            covariance = frame.refined_covariance
        sigmas.append(float(np.sqrt(max(0.0, np.linalg.eigvalsh(covariance[:2, :2])[-1]))))
    return np.array(sigmas)


def docking_verdict(run: Run) -> Verdict:
    """The verdict on a docking, by its outcome and by ground truth where it is known."""
    record = record_of(run)
    truth = ""
    kind = "good" if record.exit_code == 0 else "bad"
    if run.groundtruth is not None and np.all(np.isfinite(run.groundtruth[-1])):
        error = float(np.linalg.norm(run.groundtruth[-1, :2] - record.goal[:2]))
        yaw = run.groundtruth[-1, 2] - record.goal[2]
        degrees = abs(float(np.degrees(np.arctan2(np.sin(yaw), np.cos(yaw)))))
        truth = f" In truth the robot is {length_text(error)} and {degrees:.1f}° from the goal."
        if record.exit_code == 0 and error > LARGEST_TRUE_ERROR:
            kind = "bad"
    word = record.outcome.capitalize()
    steps = f"after {len(run.frames)} steps"
    return Verdict(kind, f"{word} {steps}: {record.reason}.{truth}")
