"""The stage ``dock``: a scene model, a robot and a goal in, a robot that stands there and a run."""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.atomic import check_output
from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.provenance import provenance
from pipelines.dataset.mask import Mask, read_mask
from pipelines.dock.dock import Listener, equipment_of
from pipelines.dock.docking_log import Docking, Origin
from pipelines.dock.goals import Goal, goal_state
from pipelines.dock.planar_motion import distance_between, yaw_between
from pipelines.dock.program import docked
from pipelines.dock.robot import STANDSTILL, CheckedRobot
from pipelines.dock.robots.choice import RobotOptions, robot_named
from pipelines.dock.settings import DockSettings
from pipelines.dock.states import OutcomeKind
from pipelines.lightfield.open_world import scene_or_world
from pipelines.localize.run import save_run
from pipelines.localize.scene_of_run import relative_scene_path
from pipelines.localize.settings import LocalizerSettings
from pipelines.render.devices import resolved_device


@dataclass(frozen=True)
class DockSummary:
    """How a docking went."""

    path: Path
    docking: Docking
    note: str = ""
    notes: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """Of the command."""
        return self.docking.outcome.kind.value

    @property
    def true_error(self) -> tuple[float, float] | None:
        """Metres and radians between where the robot really is and the goal; None: unknown."""
        entries = self.docking.entries
        if not entries or entries[-1].true_state is None:
            return None
        state, goal = entries[-1].true_state, self.docking.goal
        return distance_between(state, goal), abs(yaw_between(state, goal))

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        docking = self.docking
        steps = max(1, len(docking.entries))
        total = max(docking.seconds["total"], 1e-9)
        shares = {name: docking.seconds[name] / total for name in ("robot", "filter")}
        rest = 1.0 - sum(shares.values())
        rows: list[tuple[str, ...]] = [
            ("outcome", docking.outcome.kind.word),
            ("because", docking.outcome.reason),
            ("goal", _pose_text(docking.goal)),
            ("steps", f"{len(docking.entries)}, {docking.attempts} attempts"),
            ("seconds", f"{total:.1f}, {total / steps:.2f} a step"),
            (
                "share of the time",
                f"robot {shares['robot']:.0%}, filter {shares['filter']:.0%}, rest {rest:.0%}",
            ),
        ]
        if self.note:
            rows.append(("robot", self.note))
        if self.true_error is not None:
            metres, radians = self.true_error
            text = f"{100.0 * metres:.1f} cm, {math.degrees(radians):.2f} deg"
            rows.append(("true distance to the goal", text))
        rows.extend(("note", note) for note in self.notes)
        rows.append(("run", str(self.path)))
        return rows

    def to_dict(self) -> dict[str, Any]:
        """The same for programs."""
        docking, error = self.docking, self.true_error
        return {
            "kind": "docking",
            "path": str(self.path),
            "outcome": docking.outcome.kind.word,
            "exit_code": self.exit_code,
            "reason": docking.outcome.reason,
            "goal": {
                "x_m": float(docking.goal[0]),
                "y_m": float(docking.goal[1]),
                "heading_deg": math.degrees(float(docking.goal[2])),
            },
            "steps": len(docking.entries),
            "attempts": docking.attempts,
            "robot": self.note,
            "notes": list(self.notes),
            "seconds": docking.seconds,
            "true_error": None
            if error is None
            else {"position_m": error[0], "heading_deg": math.degrees(error[1])},
        }


@dataclass(frozen=True)
class DryRunSummary:
    """What a robot is like that was only looked at."""

    name: str
    robot: CheckedRobot
    facts: dict[str, str] = field(default_factory=dict)

    exit_code = 0

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        return [("robot", self.name), *self.facts.items(), ("in order", "yes")]

    def to_dict(self) -> dict[str, Any]:
        """The same for programs."""
        return {"kind": "robot", "name": self.name, "in_order": True, **self.facts}


@dataclass(frozen=True)
class DockRequest:
    """Which robot is to be docked where.

    Attributes:
        scene: scene model, or the folder of a world of several.
        robot: see ``robots.choice.robot_named``.
        goal: where to; None: nowhere, for a robot that is only looked at.
        filter_settings: of the filter.
        settings: of the docking.
        robot_options: of a simulated robot.
        seed: of the filter's and a simulated robot's random numbers, not negative.
        mask: file that says where images of the robot's camera are not to be used.
        memory: megabytes that localizing and docking in a world may take; None: 1000. A scene is in
            memory as a whole.

    Raises:
        OptionError: a negative seed, or settings of a filter that does not drive.
    """

    scene: Path
    robot: str
    goal: Goal | None
    filter_settings: LocalizerSettings = field(default_factory=LocalizerSettings)
    settings: DockSettings = field(default_factory=DockSettings)
    robot_options: RobotOptions = field(default_factory=RobotOptions)
    seed: int = 0
    mask: Path | None = None
    memory: float | None = None

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise OptionError(f"seed {self.seed} is negative")
        if self.filter_settings.uses_pnp:
            raise OptionError(
                "docking goes by the filter alone: leave out method pnp, with_pnp and proposal"
            )


def dock_robot(
    request: DockRequest, output: Path, *, overwrite: bool, listener: Listener
) -> DockSummary:
    """Docks a robot and writes the run, however it ended.

    Args:
        request: which robot, and where.
        output: the file to be written.
        overwrite: whether an existing file may be replaced.
        listener: told of every step.

    Raises:
        InputError: an input cannot be used, or the output not be written.
        OptionError: settings that make no sense, a goal where no robot can be or whose view the map
            does not show.
        RobotError: the robot is none.
    """
    check_output(output, overwrite)
    if request.goal is None:
        raise OptionError("there is no goal")
    settings, seed = request.settings, request.seed
    scene = scene_or_world(request.scene, request.memory)
    # The run says where it was computed: another device rounds differently.
    device = resolved_device(request.filter_settings.device)
    filter_settings = replace(request.filter_settings, device=device)
    robot = robot_named(request.robot, scene, request.robot_options, seed)
    seen = _mask_of(robot, request.mask)
    used = None if seen is None else seen.used
    inputs = {"scene": scene.identifier}
    if seen is not None:
        inputs["mask"] = seen.sha256
    record = provenance(
        "dock", {**settings.to_dict(), "robot": request.robot, "seed": seed}, inputs
    )
    scene_path = relative_scene_path(request.scene, output)
    origin = Origin(scene.identifier, scene_path, request.robot, seed, record)
    result = docked(scene, robot, request.goal, settings, filter_settings, origin, listener, used)
    docking = result.docking
    if result.run is not None:
        save_run(output, result.run, overwrite)
    elif docking.outcome.kind is OutcomeKind.ROBOT_FAILED:
        # Not a single image: there is nothing that a run could hold.
        raise OptionError(f"{docking.outcome.reason}; no run was written")
    return DockSummary(output, docking, robot.note, result.notes)


def dry_run(request: DockRequest) -> DryRunSummary:
    """Looks whether a robot is in order: takes an image, moves by nothing, stops.

    Args:
        request: which robot, and where, if that is to be looked at too.

    Raises:
        InputError, OptionError, RobotError, StageError: it is not, or cannot be docked there.
    """
    goal, filter_settings, seed = request.goal, request.filter_settings, request.seed
    scene = scene_or_world(request.scene, request.memory)
    robot = robot_named(request.robot, scene, request.robot_options, seed)
    seen = _mask_of(robot, request.mask)
    notes: tuple[str, ...] = ()
    if goal is not None:
        used = None if seen is None else seen.used
        place = goal_state(goal, scene, robot, filter_settings, seed, used)
        rng = np.random.default_rng(seed)
        equipment = equipment_of(scene, robot, place, request.settings, filter_settings, rng, used)
        notes = equipment.notes
    try:
        image = robot.take_image()
        measured = robot.move(STANDSTILL)
    finally:
        robot.stop()
    x, y, z = robot.base_from_camera[:3, 3]
    facts = {
        "camera": f"{robot.camera.model} {robot.camera.width}x{robot.camera.height}",
        "camera's place": f"x {x:.3f} m, y {y:.3f} m, z {z:.3f} m",
        "image": f"mean {image.mean():.0f} of 255, contrast {image.std():.0f}",
        "odometry standing still": f"{measured.distance:.4f} m, "
        f"{math.degrees(measured.turn):.3f} deg",
        "seconds for these": f"{robot.seconds:.3f}",
    }
    if seen is not None:
        facts["mask"] = seen.text
    if robot.note:
        facts = {"camera images": robot.note, **facts}
    if goal is not None:
        facts["goal"] = "; ".join(notes) or "the map shows what the camera sees there"
    return DryRunSummary(request.robot, robot, facts)


def _mask_of(robot: CheckedRobot, path: Path | None) -> Mask | None:
    size = (robot.camera.width, robot.camera.height)
    return None if path is None else read_mask(path, size, "the robot's camera is")


def _pose_text(state: FloatArray) -> str:
    return f"x {state[0]:.3f} m, y {state[1]:.3f} m, heading {math.degrees(state[2]):.1f} deg"
