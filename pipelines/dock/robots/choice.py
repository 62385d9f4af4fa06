"""Robots by name: ``model:``, ``replay:``, ``sim:``, or a class of the user."""

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
from pipelines.dock.robots.world_model import WorldModelRobot
from pipelines.geometry.camera import Camera, Undistorter
from pipelines.lightfield.open_world import OpenWorld
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_part, load_scene
from pipelines.lightfield.world_file import area_path, load_world

SIMULATED = ("model", "replay", "sim")


@dataclass(frozen=True)
class RobotOptions:
    """Options of a simulated robot.

    Attributes:
        true_start: x, y (metres) and heading (radians) of its true start; None: drawn from the
            scene's bounds.
        camera: a ``camera.toml``; None: the scene's first camera at ``camera_width``.
        camera_width: width of its images where ``camera`` is None, pixels.
        motion: errors of movements and odometry.
        sensor: errors of images.
        tracing: how a ``sim:`` robot renders images.
        fault: kind of a fault and the step at which it begins; None: no fault.
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


def robot_named(
    name: str, scene: Scene | OpenWorld, options: RobotOptions, seed: int
) -> CheckedRobot:
    """The robot that a name stands for, checked.

    Args:
        name: ``model:SCENE.h5``, ``model:WORLD``, ``replay:DATASET``, ``sim:SCENE.xml`` or
            ``package.module:Class``.
        scene: scene or world in which it will be docked. A simulated robot starts in its bounds and
            has its camera unless ``options`` say otherwise.
        options: options of a simulated robot.
        seed: seed of a simulated robot's errors.

    Raises:
        InputError: a file that the robot needs cannot be used.
        OptionError: the name has another form, or an argument is of another type.
        RobotError: a class of the user violates the robot protocol.
        StageError: the simulator is not installed.
    """
    checked_instance(name, "robot", str)
    if not isinstance(scene, OpenWorld):
        checked_instance(scene, "the scene", Scene)
    checked_instance(options, "robot options", RobotOptions)
    checked_number(seed, "seed", 0, whole=True)
    kind, colon, rest = name.partition(":")
    if not colon or not rest:
        raise OptionError(
            f"robot {quoted(name)} is none of model:SCENE.h5, model:WORLD, replay:DATASET, "
            "sim:SCENE.xml, package.module:Class"
        )
    if kind not in SIMULATED:
        return CheckedRobot(_user_robot(kind, rest))
    robot = _simulated(kind, Path(rest), scene, options, seed)
    return CheckedRobot(robot if options.fault is None else FaultyRobot(robot, *options.fault))


def _simulated(
    kind: str, path: Path, scene: Scene | OpenWorld, options: RobotOptions, seed: int
) -> Robot:
    """A simulated robot of one of the kinds ``SIMULATED``."""
    # One stream for each purpose: other camera noise does not change the motion.
    placing, moving, seeing = (np.random.default_rng([seed, part]) for part in (1, 2, 3))
    start = options.true_start
    state = _random_state(scene, placing) if start is None else np.array(start)
    motion = SimulatedMotion(state, options.motion, moving)
    if kind == "replay":
        return ReplayRobot(load_dataset(path), motion)
    if kind == "model" and path.is_dir():
        index = load_world(path)
        first = load_part(area_path(path, index.areas[0].name), [0])
        return WorldModelRobot(
            path, index, *_camera(first, options), motion, options.sensor, seeing
        )
    if kind == "model":
        world = load_scene(path)
        camera, mount = _camera(world, options)
        return ModelRobot(world, camera, mount, motion, options.sensor, seeing)
    first = scene.outlines[0] if isinstance(scene, OpenWorld) else scene
    camera, mount = _camera(first, options)
    return SimulatorRobot(path, camera, mount, motion, options.sensor, options.tracing, seeing)


def _random_state(scene: Scene | OpenWorld, rng: np.random.Generator) -> FloatArray:
    """A state ``(3,)`` drawn from a scene's free ground or bounds."""
    if scene.ground is not None:
        x, y = scene.ground.sample(1, rng)[0]
        return np.array([x, y, rng.uniform(-math.pi, math.pi)])
    x_min, x_max, y_min, y_max = scene.bounds
    return np.array(
        [rng.uniform(x_min, x_max), rng.uniform(y_min, y_max), rng.uniform(-math.pi, math.pi)]
    )


def _camera(world: Scene, options: RobotOptions) -> tuple[Camera, FloatArray]:
    """Camera and mount ``(4, 4)`` of a simulated robot."""
    if options.camera is not None:
        content = read_camera_file(options.camera)
        if content.base_from_camera is None:
            raise InputError(
                options.camera, "has no [mount], which says where the camera sits on the robot"
            )
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


def _user_robot(module_name: str, class_name: str) -> Any:
    """A robot of the user's class, constructed without arguments.

    Raises:
        RobotError: the class cannot be imported or constructed.
    """
    # Modules in the current folder can be imported, as with "python -m".
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
