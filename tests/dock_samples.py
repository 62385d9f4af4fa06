"""Robots in front of the painted wall, good ones and bad ones."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.array_types import FloatArray, ImageArray
from pipelines.dock.dock import Report, dock, equipment_of
from pipelines.dock.logbook import Docking, Origin, run_of
from pipelines.dock.robot import CheckedRobot, Movement
from pipelines.dock.robots.actuation import MotionNoise, SimulatedMotion
from pipelines.dock.settings import DockSettings
from pipelines.lightfield.bundle import save_scene
from pipelines.localize.run import Run
from pipelines.localize.settings import LocalizerSettings
from tests.report_samples import CAMERA, MOUNT, facing_wall, photo, wall_scene

GOAL = facing_wall(0.3, 1.2)
START = facing_wall(-0.4, 2.3, 0.2)
EXACT = MotionNoise(0.0, 0.0, 0.0)
FILTER = LocalizerSettings(particles=100, start_particles=600, threads=1)


class PaintedRobot:
    """Its images are computed ray by ray, so that its world is not our own renderer's."""

    def __init__(self, start: FloatArray = START, noise: MotionNoise | None = None) -> None:
        self.camera = CAMERA
        self.base_from_camera = MOUNT
        self.motion = SimulatedMotion(
            start, noise if noise is not None else MotionNoise(), np.random.default_rng(5)
        )
        self.is_stopped = False
        self.commands: list[tuple[float, float, float]] = []

    def take_image(self) -> ImageArray:
        """The wall; grey where the camera looks past it."""
        state = self.motion.state
        if math.sin(float(state[2])) < math.sin(math.radians(50.0)):
            return np.full((CAMERA.height, CAMERA.width, 3), 128, dtype=np.uint8)
        return photo(state)

    def move(self, forward: float, left: float, turn: float) -> Any:
        """See ``Robot.move``."""
        self.commands.append((forward, left, turn))
        measured = self.motion.move(Movement(forward, left, turn))
        return measured.forward, measured.left, measured.turn

    def stop(self) -> None:
        """Remembers that it was called."""
        self.is_stopped = True

    def true_state(self) -> FloatArray:
        """See ``KnowsTruth``."""
        return self.motion.state


class NoMove:
    """A robot without ``move``."""

    camera, base_from_camera = CAMERA, MOUNT

    def take_image(self) -> ImageArray:
        """See ``Robot.take_image``."""
        return photo(START)

    def stop(self) -> None:
        """See ``Robot.stop``."""


class WrongSize(PaintedRobot):
    """A robot whose images are of another size than its camera says."""

    def take_image(self) -> ImageArray:
        """See ``Robot.take_image``."""
        return np.zeros((10, 20, 3), dtype=np.uint8)


class NoNumbers(PaintedRobot):
    """A robot whose odometry is not finite."""

    def move(self, forward: float, left: float, turn: float) -> Any:
        """See ``Robot.move``."""
        return forward, math.nan, turn


class Raising:
    """A robot that cannot be made."""

    def __init__(self) -> None:
        raise OSError("no such device: /dev/ttyUSB0")


def docked(
    robot: Any,
    settings: DockSettings,
    goal: FloatArray = GOAL,
    listener: Callable[[Report], None] = lambda report: None,
) -> tuple[Docking, Run]:
    """The docking of a robot in front of the wall, and its run."""
    checked = CheckedRobot(robot)
    rng = np.random.default_rng(1)
    equipment = equipment_of(wall_scene(), checked, goal, settings, FILTER, rng)
    docking = dock(equipment, listener)
    origin = Origin(wall_scene().identifier, "scene.h5", "painted", 1)
    run = run_of(docking, checked, FILTER, settings, origin)
    if run is None:
        raise ValueError("not a single image was taken")
    return docking, run


def written_scene(folder: Path) -> Path:
    """The wall's scene as a file."""
    path = folder / "scene.h5"
    save_scene(path, wall_scene(), overwrite=False)
    return path
