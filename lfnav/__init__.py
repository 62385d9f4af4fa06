"""lfnav for programs: maps from photos, localization with one camera, rendering, docking.

Everything that a program needs is imported from here, ``from lfnav import Localizer, load_scene``;
``docs/library.md`` shows how. The names stay; what is behind them, in ``pipelines``, may move.

A name is loaded when it is first asked for: ``import lfnav`` alone loads no other module. What a
caller can mend is raised as an ``LfnavError``, whose text is one line.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pipelines.artifacts.errors import InputError as InputError
    from pipelines.artifacts.errors import LfnavError as LfnavError
    from pipelines.artifacts.errors import OptionError as OptionError
    from pipelines.artifacts.errors import StageError as StageError
    from pipelines.artifacts.stages import Progress as Progress
    from pipelines.artifacts.stages import no_progress as no_progress
    from pipelines.dataset.dataset import Dataset as Dataset
    from pipelines.dataset.dataset import load_dataset as load_dataset
    from pipelines.dock.goals import Goal as Goal
    from pipelines.dock.program import DockingResult as DockingResult
    from pipelines.dock.program import dock as dock
    from pipelines.dock.robot import Robot as Robot
    from pipelines.dock.robot import RobotError as RobotError
    from pipelines.dock.robots.choice import RobotOptions as RobotOptions
    from pipelines.dock.robots.choice import robot_named as robot_named
    from pipelines.dock.robots.noise import MotionNoise as MotionNoise
    from pipelines.dock.robots.noise import SensorNoise as SensorNoise
    from pipelines.dock.settings import DockSettings as DockSettings
    from pipelines.dock.states import Outcome as Outcome
    from pipelines.dock.states import OutcomeKind as OutcomeKind
    from pipelines.geometry.camera import Camera as Camera
    from pipelines.geometry.camera import Intrinsics as Intrinsics
    from pipelines.geometry.plane import Plane as Plane
    from pipelines.geometry.plane import plane_from_coefficients as plane_from_coefficients
    from pipelines.geometry.pose import base_from_camera_mount as base_from_camera_mount
    from pipelines.geometry.pose import planar_state_of as planar_state_of
    from pipelines.geometry.pose import world_from_base_planar as world_from_base_planar
    from pipelines.geometry.trajectory import Trajectory as Trajectory
    from pipelines.geometry.trajectory import read_tum as read_tum
    from pipelines.lightfield.open_world import OpenWorld as OpenWorld
    from pipelines.lightfield.open_world import open_world as open_world
    from pipelines.lightfield.scene import Scene as Scene
    from pipelines.lightfield.scene_file import load_scene as load_scene
    from pipelines.lightfield.scene_file import save_scene as save_scene
    from pipelines.lightfield.stage import ModelSettings as ModelSettings
    from pipelines.lightfield.stage import build_scene as build_scene
    from pipelines.lightfield.stage import model as model
    from pipelines.localize.evaluation import RunEvaluation as RunEvaluation
    from pipelines.localize.evaluation import evaluate_run as evaluate_run
    from pipelines.localize.likelihood import Likelihood as Likelihood
    from pipelines.localize.likelihood import likelihood_named as likelihood_named
    from pipelines.localize.localizer import Localizer as Localizer
    from pipelines.localize.measurement_model import MeasurementModel as MeasurementModel
    from pipelines.localize.observation import Observer as Observer
    from pipelines.localize.run import FrameRecord as FrameRecord
    from pipelines.localize.run import Run as Run
    from pipelines.localize.run import load_run as load_run
    from pipelines.localize.run import save_run as save_run
    from pipelines.localize.settings import LocalizerSettings as LocalizerSettings
    from pipelines.localize.settings import MotionModel as MotionModel
    from pipelines.localize.settings import strategy_defaults as strategy_defaults
    from pipelines.localize.stage import LocalizeRequest as LocalizeRequest
    from pipelines.localize.stage import RunOrigin as RunOrigin
    from pipelines.localize.stage import localize as localize
    from pipelines.localize.stage import localize_dataset as localize_dataset
    from pipelines.localize.state_space import PLANAR as PLANAR
    from pipelines.localize.state_space import SPATIAL as SPATIAL
    from pipelines.localize.state_space import StateSpace as StateSpace
    from pipelines.localize.trajectory_export import estimated_trajectory as estimated_trajectory
    from pipelines.localize.trajectory_export import export_trajectory as export_trajectory
    from pipelines.reconstruct.reconstruction import Reconstruction as Reconstruction
    from pipelines.reconstruct.reconstruction import load_reconstruction as load_reconstruction
    from pipelines.reconstruct.settings import ReconstructSettings as ReconstructSettings
    from pipelines.reconstruct.stage import reconstruct as reconstruct
    from pipelines.render.choices import Blending as Blending
    from pipelines.render.choices import Quality as Quality
    from pipelines.render.devices import Device as Device
    from pipelines.render.renderer import Renderer as Renderer
    from pipelines.render.renderer import Rendering as Rendering
    from pipelines.render.renderer_choice import renderer_of_scene as renderer_of_scene
    from pipelines.report.stage import ReportSettings as ReportSettings
    from pipelines.report.stage import report as report

# Name -> the module that it comes from; the imports above say the same to type checkers.
_HOMES = {
    "Blending": "pipelines.render.choices",
    "Camera": "pipelines.geometry.camera",
    "Dataset": "pipelines.dataset.dataset",
    "Device": "pipelines.render.devices",
    "DockSettings": "pipelines.dock.settings",
    "DockingResult": "pipelines.dock.program",
    "FrameRecord": "pipelines.localize.run",
    "Goal": "pipelines.dock.goals",
    "InputError": "pipelines.artifacts.errors",
    "Intrinsics": "pipelines.geometry.camera",
    "LfnavError": "pipelines.artifacts.errors",
    "Likelihood": "pipelines.localize.likelihood",
    "LocalizeRequest": "pipelines.localize.stage",
    "Localizer": "pipelines.localize.localizer",
    "LocalizerSettings": "pipelines.localize.settings",
    "MeasurementModel": "pipelines.localize.measurement_model",
    "ModelSettings": "pipelines.lightfield.stage",
    "MotionModel": "pipelines.localize.settings",
    "MotionNoise": "pipelines.dock.robots.noise",
    "Observer": "pipelines.localize.observation",
    "OpenWorld": "pipelines.lightfield.open_world",
    "OptionError": "pipelines.artifacts.errors",
    "Outcome": "pipelines.dock.states",
    "OutcomeKind": "pipelines.dock.states",
    "PLANAR": "pipelines.localize.state_space",
    "Plane": "pipelines.geometry.plane",
    "Progress": "pipelines.artifacts.stages",
    "Quality": "pipelines.render.choices",
    "ReconstructSettings": "pipelines.reconstruct.settings",
    "Reconstruction": "pipelines.reconstruct.reconstruction",
    "Renderer": "pipelines.render.renderer",
    "Rendering": "pipelines.render.renderer",
    "ReportSettings": "pipelines.report.stage",
    "Robot": "pipelines.dock.robot",
    "RobotError": "pipelines.dock.robot",
    "RobotOptions": "pipelines.dock.robots.choice",
    "Run": "pipelines.localize.run",
    "RunEvaluation": "pipelines.localize.evaluation",
    "RunOrigin": "pipelines.localize.stage",
    "SPATIAL": "pipelines.localize.state_space",
    "Scene": "pipelines.lightfield.scene",
    "SensorNoise": "pipelines.dock.robots.noise",
    "StageError": "pipelines.artifacts.errors",
    "StateSpace": "pipelines.localize.state_space",
    "Trajectory": "pipelines.geometry.trajectory",
    "base_from_camera_mount": "pipelines.geometry.pose",
    "build_scene": "pipelines.lightfield.stage",
    "dock": "pipelines.dock.program",
    "estimated_trajectory": "pipelines.localize.trajectory_export",
    "evaluate_run": "pipelines.localize.evaluation",
    "export_trajectory": "pipelines.localize.trajectory_export",
    "likelihood_named": "pipelines.localize.likelihood",
    "load_dataset": "pipelines.dataset.dataset",
    "load_reconstruction": "pipelines.reconstruct.reconstruction",
    "load_run": "pipelines.localize.run",
    "load_scene": "pipelines.lightfield.scene_file",
    "localize": "pipelines.localize.stage",
    "localize_dataset": "pipelines.localize.stage",
    "model": "pipelines.lightfield.stage",
    "no_progress": "pipelines.artifacts.stages",
    "open_world": "pipelines.lightfield.open_world",
    "planar_state_of": "pipelines.geometry.pose",
    "plane_from_coefficients": "pipelines.geometry.plane",
    "read_tum": "pipelines.geometry.trajectory",
    "reconstruct": "pipelines.reconstruct.stage",
    "renderer_of_scene": "pipelines.render.renderer_choice",
    "report": "pipelines.report.stage",
    "robot_named": "pipelines.dock.robots.choice",
    "save_run": "pipelines.localize.run",
    "save_scene": "pipelines.lightfield.scene_file",
    "strategy_defaults": "pipelines.localize.settings",
    "world_from_base_planar": "pipelines.geometry.pose",
}

__all__ = sorted(_HOMES)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    """The public object of a name, loaded when it is first asked for (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(_HOMES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    """The public names, loaded or not."""
    return sorted({*globals(), *_HOMES})
