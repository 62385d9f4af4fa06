"""Docking from a program: a scene and a robot in memory in, what happened and its run out."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pipelines.artifacts.arguments import checked_instance, checked_number
from pipelines.artifacts.arrays import BoolArray, checked_array
from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.provenance import provenance
from pipelines.dock.dock import Listener, Report, equipment_of
from pipelines.dock.dock import dock as dock_equipped
from pipelines.dock.docking_log import Docking, Origin, run_of
from pipelines.dock.goals import Goal, goal_state
from pipelines.dock.robot import CheckedRobot, Robot
from pipelines.dock.settings import DockSettings
from pipelines.dock.states import Outcome
from pipelines.lightfield.open_world import OpenWorld, checked_scene
from pipelines.lightfield.scene import Scene
from pipelines.localize.run import Run
from pipelines.localize.settings import LocalizerSettings
from pipelines.render.devices import resolved_device


@dataclass(frozen=True)
class DockingResult:
    """A docking that has ended.

    Attributes:
        docking: what happened, step by step, how it ended, and how long it took.
        run: the same as a run, for ``save_run`` and ``evaluate_run``; None where the robot failed
            before its first image.
        notes: what a person should know of it, a line each.
    """

    docking: Docking
    run: Run | None
    notes: tuple[str, ...] = ()

    @property
    def outcome(self) -> Outcome:
        """How it ended, and why: ``outcome.kind``, ``outcome.reason``."""
        return self.docking.outcome


def dock(
    scene: Scene | OpenWorld,
    robot: Robot | CheckedRobot,
    goal: Goal | ArrayLike,
    settings: DockSettings | None = None,
    filter_settings: LocalizerSettings | None = None,
    *,
    seed: int = 0,
    listener: Listener | None = None,
    mask: BoolArray | None = None,
    scene_path: Path | str = "",
) -> DockingResult:
    """Drives a robot to a place by what its camera sees, and stops it there.

    A loop: localize with the particle filter (Heigl, Denzler, Niemann 2001), move, localize again;
    near the goal the camera image is also aligned with the view that the light field shows there.
    ``docs/docking.md`` describes its states and when it ends.

    Args:
        scene: the light field, or a world of several.
        robot: an object with the members of ``Robot``, or what ``robot_named`` returned.
        goal: ``(3,)`` x, y in metres and heading in radians, in the scene's world; or a ``Goal``.
        settings: of the docking: drive, area, tolerances; None: the defaults.
        filter_settings: of the filter; its start and area are taken from ``settings``; None: the
            defaults.
        seed: of the filter's random numbers, not negative.
        listener: told of every step: ``listener(step)`` with ``step.state``, ``step.status``,
            ``step.estimate``, ``step.distance`` and others; None: nobody is.
        mask: ``(height, width)``, True where images of the robot's camera are to be used; None:
            everywhere.
        scene_path: how the run refers to its scene: from the folder in which the run is stored.

    Returns:
        What happened, however it ended: docked, lost, blocked, ..., also when the robot's driver
        raised or Ctrl-C was pressed. The robot is stopped in every case.

    Raises:
        RobotError: the robot lacks a member, or its camera or mount are not what they should be.
        OptionError: a goal where no robot can be or whose view the map does not show, an area
            outside of the scene, or an argument of another type or shape.
        InputError: a goal's image that is unreadable or not found in the scene.
    """
    settings = DockSettings() if settings is None else settings
    chosen = LocalizerSettings() if filter_settings is None else filter_settings
    checked_scene(scene)
    checked_instance(settings, "settings", DockSettings)
    checked_instance(chosen, "filter settings", LocalizerSettings)
    checked_number(seed, "seed", 0, whole=True)
    if listener is not None and not callable(listener):
        raise OptionError("the listener cannot be called")
    if not isinstance(goal, Goal):
        x, y, heading = checked_array(goal, "the goal", (3,)).tolist()
        goal = Goal(pose=(x, y, heading))
    checked = robot if isinstance(robot, CheckedRobot) else CheckedRobot(robot)
    # The run says where it was computed: another device rounds differently.
    chosen = replace(chosen, device=resolved_device(chosen.device))
    record = provenance(
        "dock",
        {**settings.to_dict(), "robot": checked.name, "seed": seed},
        {"scene": scene.identifier},
    )
    origin = Origin(scene.identifier, str(scene_path), checked.name, seed, record)
    return docked(scene, checked, goal, settings, chosen, origin, listener or _nobody, mask)


def docked(
    scene: Scene | OpenWorld,
    robot: CheckedRobot,
    goal: Goal,
    settings: DockSettings,
    filter_settings: LocalizerSettings,
    origin: Origin,
    listener: Listener,
    mask: BoolArray | None = None,
) -> DockingResult:
    """Docks a robot.

    Args:
        scene: the light field, or a world of several.
        robot: checked.
        goal: where to.
        settings: of the docking.
        filter_settings: of the filter; its device is not ``AUTO``.
        origin: what the run says about where it comes from; its seed is that of the filter.
        listener: told of every step.
        mask: ``(height, width)``, True where images of the robot's camera are to be used; None:
            everywhere.

    Raises:
        OptionError: a goal where no robot can be or whose view the map does not show, or an area
            outside of the scene.
        InputError: a goal's image that is unreadable or not found in the scene.
    """
    place = goal_state(goal, scene, robot, filter_settings, origin.seed, mask)
    rng = np.random.default_rng(origin.seed)
    equipment = equipment_of(scene, robot, place, settings, filter_settings, rng, mask)
    docking = dock_equipped(equipment, listener)
    run = run_of(docking, robot, filter_settings, equipment.settings, origin, equipment.areas)
    return DockingResult(docking, run, equipment.notes)


def _nobody(step: Report) -> None:
    """The listener that does not listen."""
