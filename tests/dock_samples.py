"""Robots in front of the painted wall, good ones and bad ones."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.dataset.images import encode_png
from pipelines.dock.dock import Report, dock, equipment_of
from pipelines.dock.docking_log import Docking, Origin, run_of
from pipelines.dock.robot import CheckedRobot, Movement
from pipelines.dock.robots.noise import MotionNoise, SimulatedMotion
from pipelines.dock.settings import DockSettings
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import world_from_base_planar
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import identifier_of, save_scene
from pipelines.localize.run import Run, save_run
from pipelines.localize.settings import LocalizerSettings
from tests.report_samples import CAMERA, MOUNT, Files, facing_wall
from tests.report_samples import wall_scene as smooth_wall_scene

GOAL = facing_wall(0.3, 1.2)
START = facing_wall(-0.4, 2.3, 0.2)
EXACT = MotionNoise(0.0, 0.0, 0.0)
FILTER = LocalizerSettings(particles=100, start_particles=600, threads=1)

# Tiles are so wide, metres, and of colours that differ by so many grey levels.
TILE, TILE_LEVELS = 0.25, 45.0
TILES = np.random.default_rng(7).uniform(-1.0, 1.0, (64, 64, 3)) * TILE_LEVELS


def photo(state: FloatArray, camera: Camera = CAMERA) -> ImageArray:
    """What the robot's camera at ``state`` sees of a wall with tiles, computed ray by ray.

    What robots are docked by has edges, as walls have where they are worth docking at: the filter
    compares local contrast, and there is none in colours that hardly change from pixel to pixel.
    """
    pose, fine = world_from_base_planar(state) @ MOUNT, 3
    rows, columns = (np.mgrid[0 : fine * camera.height, 0 : fine * camera.width] + 0.5) / fine - 0.5
    pinhole = camera.intrinsics
    rays = np.stack(
        [
            (columns - pinhole.cx) / pinhole.fx,
            (rows - pinhole.cy) / pinhole.fy,
            np.ones(rows.shape),
        ],
        axis=-1,
    )
    rays = rays @ pose[:3, :3].T
    reach = -pose[1, 3] / rays[..., 1]
    x, z = pose[0, 3] + reach * rays[..., 0], pose[2, 3] + reach * rays[..., 2]
    smooth = np.stack([np.sin(2 * x), np.cos(x + 2 * z), np.sin(3 * z)], axis=-1)
    row, column = (np.floor(value / TILE).astype(int) % 64 for value in (z, x))
    sharp = 128.0 + 60.0 * smooth + TILES[row, column]
    shape = (camera.height, fine, camera.width, fine, 3)
    averaged = np.clip(sharp, 0.0, 255.0).reshape(shape).mean(axis=(1, 3))
    return np.asarray(np.rint(averaged), dtype=np.uint8)


def wall_scene(camera: Camera = CAMERA) -> Scene:
    """Three views of that wall from two metres away: they show it from x = -3 to 3."""
    scene = smooth_wall_scene()
    images = tuple(encode_png(photo(facing_wall(x, 2.0), camera)) for x in (-1.0, 0.0, 1.0))
    poses, index = scene.world_from_camera, scene.camera_index
    identifier = identifier_of(images, (camera,), index, poses, scene.surface, MOUNT)
    return replace(scene, encoded_images=images, cameras=(camera,), identifier=identifier)


class PaintedRobot:
    """Its images are computed ray by ray, so that its world is not our own renderer's.

    They have a little noise, as a sensor's: images without any are those of a camera that hangs.
    """

    def __init__(self, start: FloatArray = START, noise: MotionNoise | None = None) -> None:
        self.camera = CAMERA
        self.base_from_camera = MOUNT
        self.motion = SimulatedMotion(
            start, noise if noise is not None else MotionNoise(), np.random.default_rng(5)
        )
        self.rng = np.random.default_rng(11)
        self.is_stopped = False
        self.commands: list[tuple[float, float, float]] = []

    def take_image(self) -> ImageArray:
        """The wall; grey where the camera looks past it."""
        state = self.motion.state
        if math.sin(float(state[2])) < math.sin(math.radians(50.0)):
            return np.full((CAMERA.height, CAMERA.width, 3), 128, dtype=np.uint8)
        noisy = photo(state) + self.rng.normal(0.0, 1.0, (CAMERA.height, CAMERA.width, 3))
        return np.rint(np.clip(noisy, 0.0, 255.0)).astype(np.uint8)

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
    **changes: Any,
) -> tuple[Docking, Run]:
    """The docking of a robot in front of the wall, and its run; ``changes`` are of the filter."""
    filter_settings = replace(FILTER, **{"start": tuple(START), **changes})
    checked = CheckedRobot(robot)
    rng = np.random.default_rng(1)
    equipment = equipment_of(wall_scene(), checked, goal, settings, filter_settings, rng)
    docking = dock(equipment, listener)
    origin = Origin(wall_scene().identifier, "scene.h5", "painted", 1)
    run = run_of(docking, checked, filter_settings, settings, origin)
    if run is None:
        raise ValueError("not a single image was taken")
    return docking, run


def written_scene(folder: Path) -> Path:
    """The wall's scene as a file."""
    path = folder / "scene.h5"
    save_scene(path, wall_scene(), overwrite=False)
    return path


def written(folder: Path, run: Run) -> Files:
    """The run beside that scene, on disk."""
    files = Files(folder / "run.h5", written_scene(folder))
    save_run(files.run, run, overwrite=False)
    return files
