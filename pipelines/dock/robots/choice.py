"""The robot that a name stands for: ``model:``, ``replay:``, ``sim:``, or a class of the user's."""

import importlib
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arguments import check_fields, checked_instance, checked_number
from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, OptionError, quoted
from pipelines.dataset.camera_file import read_camera_file
from pipelines.dataset.dataset import CAMERA_FILE, load_dataset
from pipelines.dock.robot import CheckedRobot, Robot, RobotError
from pipelines.dock.robots.faults import FaultyRobot
from pipelines.dock.robots.model import ModelRobot
from pipelines.dock.robots.noise import MotionNoise, SensorNoise, SimulatedMotion
from pipelines.dock.robots.replay import ReplayRobot
from pipelines.dock.robots.simulator import PathTracing, SimulatorRobot
from pipelines.geometry.camera import Camera, Undistorter
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene

SIMULATED = ("model", "replay", "sim")


@dataclass(frozen=True)
class RobotOptions:
    """Of a simulated robot.

    Attributes:
        true_start: ``(x, y, heading)`` where it stands; None: anywhere in the scene's bounds.
        camera: a ``camera.toml``; None: the scene's first camera, ``camera_width`` pixels across.
        camera_width: pixels.
        motion: errors of movements and odometry.
        sensor: errors of images.
        tracing: how ``sim:`` makes images.
        fault: kind and step of something that goes wrong, or None.
    """

    true_start: tuple[float, float, float] | None = None
    camera: Path | None = None
    camera_width: int = 240
    motion: MotionNoise = field(default_factory=MotionNoise)
    sensor: SensorNoise = field(default_factory=SensorNoise)
    tracing: PathTracing = field(default_factory=PathTracing)
    fault: tuple[str, int] | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if not 16 <= self.camera_width <= 8192:
            raise OptionError(f"camera width {self.camera_width} is not between 16 and 8192")


def robot_named(name: str, scene: Scene, options: RobotOptions, seed: int) -> CheckedRobot:
    """The robot of a name, checked.

    Args:
        name: ``model:SCENE.h5``, ``replay:DATASET``, ``sim:SCENE.xml`` or ``package.module:Class``.
        scene: in which it will be docked; simulated robots start in its bounds and take over its
            camera where nothing else is said.
        options: of a simulated robot.
        seed: of its errors.

    Raises:
        InputError: a file of the robot's that cannot be used.
        OptionError: no such kind, or an argument of another type.
        RobotError: a class of the user's that is no robot.
        StageError: the simulator is not installed.
    """
    checked_instance(name, "robot", str)
    checked_instance(scene, "the scene", Scene)
    checked_instance(options, "robot options", RobotOptions)
    checked_number(seed, "seed", 0, whole=True)
    kind, colon, rest = name.partition(":")
    if not colon or not rest:
        raise OptionError(
            f"robot {quoted(name)} is none of model:SCENE.h5, replay:DATASET, sim:SCENE.xml, "
            "package.module:Class"
        )
    if kind not in SIMULATED:
        return CheckedRobot(_users(kind, rest))
    robot = _simulated(kind, Path(rest), scene, options, seed)
    return CheckedRobot(robot if options.fault is None else FaultyRobot(robot, *options.fault))


def _simulated(kind: str, path: Path, scene: Scene, options: RobotOptions, seed: int) -> Robot:
    # Streams of their own: another camera noise does not move the robot elsewhere.
    placing, moving, seeing = (np.random.default_rng([seed, part]) for part in (1, 2, 3))
    start = options.true_start
    where = _anywhere(scene, placing) if start is None else np.array(start)
    motion = SimulatedMotion(where, options.motion, moving)
    if kind == "replay":
        return ReplayRobot(load_dataset(path), motion)
    world = load_scene(path) if kind == "model" else scene
    camera, mount = _camera(world, options)
    if kind == "model":
        return ModelRobot(world, camera, mount, motion, options.sensor, seeing)
    return SimulatorRobot(path, camera, mount, motion, options.sensor, options.tracing, seeing)


def _anywhere(scene: Scene, rng: np.random.Generator) -> FloatArray:
    x_min, x_max, y_min, y_max = scene.bounds
    return np.array(
        [rng.uniform(x_min, x_max), rng.uniform(y_min, y_max), rng.uniform(-math.pi, math.pi)]
    )


def _camera(world: Scene, options: RobotOptions) -> tuple[Camera, FloatArray]:
    if options.camera is not None:
        content = read_camera_file(options.camera)
        if content.base_from_camera is None:
            raise InputError(options.camera, "has no [mount]: where does the robot carry it?")
        return content.camera, content.base_from_camera
    if world.base_from_camera is None:
        raise OptionError(
            "the scene was not made by a robot, so that the camera's mount is unknown; give a "
            f"{CAMERA_FILE} with --camera"
        )
    own = Undistorter(world.camera_of(0)).intrinsics
    height = max(1, round(own.height * options.camera_width / own.width))
    small = own.resized(options.camera_width, height)
    params = (small.fx, small.fy, small.cx, small.cy)
    return Camera("PINHOLE", small.width, small.height, params), world.base_from_camera


def _users(module_name: str, class_name: str) -> Any:
    """A robot of the user's, made without arguments."""
    # What lies in the current folder can be imported, as with "python -m".
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        module = importlib.import_module(module_name)
    except Exception as error:
        raise RobotError(
            f"robot {module_name}:{class_name}: {module_name} cannot be imported "
            f"({type(error).__name__}: {error})"
        ) from error
    made = getattr(module, class_name, None)
    if not callable(made):
        raise RobotError(f"robot {module_name}:{class_name}: {module_name} has no {class_name}")
    try:
        return made()
    except Exception as error:
        raise RobotError(
            f"robot {module_name}:{class_name}: {class_name}() raised "
            f"{type(error).__name__}: {error}"
        ) from error
