"""Whatever a program hands over: what comes back is a result or an ``LfnavError`` of one line.

Each argument of each public function is replaced, one at a time, by things that it is not.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfnav
from tests.dock_samples import PaintedRobot
from tests.localize_samples import curved_path, frame_record, run_along
from tests.reconstruct_samples import small_reconstruction
from tests.report_samples import CAMERA, MOUNT, WALL, facing_wall, photo, wall_scene

JUNK: dict[str, Any] = {
    "None": None,
    "a truth value": True,
    "a number": -1.5,
    "a huge number": 10**400,
    "NaN": float("nan"),
    "infinity": float("inf"),
    "a text": "\x1b[2J junk\n",
    "no text": "",
    "a zero byte": "a\0b",
    "bytes": b"junk",
    "an object": object(),
    "a class": Path,
    "nothing": [],
    "a ragged list": [[1.0], [1.0, 2.0]],
    "texts": ["a", "b", "c"],
    "a dictionary": {"a": 1},
    "numbers of another shape": np.zeros((2, 5)),
    "a pose of NaN": np.full((4, 4), np.nan),
    "a pose that is stretched": np.diag([2.0, 2.0, 2.0, 1.0]),
    "three NaN": np.full(3, np.nan),
    "three infinities": (np.inf, np.inf, np.inf),
    "complex numbers": np.zeros(3, dtype=np.complex128),
    "objects": np.array([None, "a", 3], dtype=object),
    "a small image": np.zeros((3, 4, 3), dtype=np.uint8),
    "colours from 0 to 1": np.zeros((CAMERA.height, CAMERA.width, 3)),
    "a grey image": np.zeros((CAMERA.height, CAMERA.width), dtype=np.uint8),
}
SETTINGS = lfnav.LocalizerSettings(particles=20, start_particles=40, threads=1)


@dataclass(frozen=True)
class Call:
    """A function and arguments with which it works."""

    function: Callable[..., Any]
    good: dict[str, Any]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene, a data set, a run and a reconstruction."""
    folder = tmp_path_factory.mktemp("calls")
    scene = wall_scene()
    lfnav.save_scene(folder / "scene.h5", scene)
    lfnav.save_run(folder / "run.h5", run_along(curved_path(3), curved_path(3)))
    (folder / "data" / "rgb").mkdir(parents=True)
    for index, image in enumerate(scene.encoded_images):
        (folder / "data" / "rgb" / f"{index}.png").write_bytes(image)
    lines = [f"{index}.0 rgb/{index}.png" for index in range(len(scene))]
    (folder / "data" / "rgb.txt").write_text("\n".join(lines) + "\n")
    poses = [f"{index}.0 {index - 1}.0 -2.0 0 0 0 0.70710678 0.70710678" for index in range(3)]
    (folder / "data" / "odometry.txt").write_text("\n".join(poses) + "\n")
    params = ", ".join(map(str, CAMERA.params))
    (folder / "data" / "camera.toml").write_text(
        f'model = "{CAMERA.model}"\nwidth = {CAMERA.width}\nheight = {CAMERA.height}\n'
        f"params = [{params}]\n[mount]\nx = 0.0\ny = 0.0\nz = 1.0\n"
        "roll = 0.0\npitch = 0.0\nyaw = 0.0\n"
    )
    return folder


def of_settings(kind: type[Any], **needed: Any) -> dict[str, Any]:
    """All fields of a settings class with their defaults."""
    made = kind(**needed)
    return {field.name: getattr(made, field.name) for field in fields(kind)}


def calls_of_values() -> dict[str, Call]:
    """What needs no scene."""
    frame = frame_record(0.0, {"mode": np.array([1.0, 2.0, 0.5])})
    run = run_along(curved_path(3), curved_path(3))
    pose = np.eye(4)
    trajectory = lfnav.Trajectory(np.arange(3.0), np.stack([pose] * 3))
    calls = {
        "Camera": Call(lfnav.Camera, of_settings(lfnav.Camera, **vars(CAMERA))),
        "Camera.rays": Call(CAMERA.rays, {"pixels": np.zeros((2, 2))}),
        "Intrinsics": Call(lfnav.Intrinsics, vars(CAMERA.intrinsics)),
        "Intrinsics.resized": Call(CAMERA.intrinsics.resized, {"width": 8, "height": 6}),
        "Plane": Call(lfnav.Plane, vars(WALL)),
        "Plane.signed_distance": Call(WALL.signed_distance, {"points": np.zeros((2, 3))}),
        "Plane.facing": Call(WALL.facing, {"points": np.zeros((2, 3))}),
        "plane_from_coefficients": Call(
            lfnav.plane_from_coefficients, {"coefficients": (0.0, 1.0, 0.0, 0.0)}
        ),
        "Trajectory": Call(lfnav.Trajectory, vars(trajectory)),
        "Trajectory.nearest": Call(
            trajectory.nearest, {"timestamps": np.arange(2.0), "tolerance": 0.1}
        ),
        "base_from_camera_mount": Call(
            lfnav.base_from_camera_mount,
            {"position": (0.0, 0.0, 1.0), "roll_pitch_yaw_deg": (0.0, 0.0, 0.0)},
        ),
        "world_from_base_planar": Call(lfnav.world_from_base_planar, {"states": np.zeros(3)}),
        "planar_state_of": Call(lfnav.planar_state_of, {"world_from_base": pose}),
        "likelihood_named": Call(lfnav.likelihood_named, {"name": "squared"}),
        "strategy_defaults": Call(lfnav.strategy_defaults, {"strategy": "mixture"}),
        "FrameRecord": Call(lfnav.FrameRecord, vars(frame)),
        "Run": Call(lfnav.Run, vars(run)),
        "Run.estimated_states": Call(run.estimated_states, {"estimate": "mode"}),
        "save_run": Call(partial(lfnav.save_run, overwrite=True), {"path": "other.h5", "run": run}),
        "evaluate_run": Call(
            lfnav.evaluate_run, {"run": run, "groundtruth": trajectory, "estimate": "mode"}
        ),
        "estimated_trajectory": Call(lfnav.estimated_trajectory, {"run": run, "estimate": "mode"}),
        "export_trajectory": Call(
            lfnav.export_trajectory, {"run": run, "format_name": "tum", "estimate": "mode"}
        ),
        "Goal": Call(lfnav.Goal, {"pose": (0.0, -1.0, 1.5)}),
        "Goal.view": Call(lfnav.Goal, {"view": 1}),
        "Goal.image": Call(lfnav.Goal, {"image": Path("a.png")}),
    }
    for name, space in (("PLANAR", lfnav.PLANAR), ("SPATIAL", lfnav.SPATIAL)):
        calls[f"{name}.poses"] = Call(space.poses, {"states": np.zeros(space.dimension)})
        calls[f"{name}.states"] = Call(space.states, {"poses": pose})
        calls[f"{name}.increment"] = Call(space.increment, {"before": pose, "after": pose})
    for kind, needed in (
        (lfnav.LocalizerSettings, {}),
        (lfnav.MotionModel, {}),
        (lfnav.Likelihood, vars(lfnav.likelihood_named("squared"))),
        (lfnav.ReconstructSettings, {"method": "sfm"}),
        (lfnav.ModelSettings, {}),
        (lfnav.DockSettings, {}),
        (lfnav.RobotOptions, {}),
        (lfnav.MotionNoise, {}),
        (lfnav.SensorNoise, {}),
        (lfnav.ReportSettings, {}),
    ):
        calls[kind.__name__] = Call(kind, of_settings(kind, **needed))
    return calls


VALUES = calls_of_values()


def calls_of_scenes(folder: Path) -> dict[str, Call]:
    """What needs a scene, a data set, a run or a reconstruction."""
    scene = lfnav.load_scene(folder / "scene.h5")
    data = lfnav.load_dataset(folder / "data")
    renderer = lfnav.Renderer.of_scene(scene, threads=1)
    pinhole, pose = CAMERA.intrinsics, scene.world_from_camera[0]
    view = {"world_from_camera": pose, "intrinsics": pinhole}
    image = photo(facing_wall(0.0, 2.0))
    model = lfnav.MeasurementModel.of_scene(scene, MOUNT, SETTINGS)
    observer = lfnav.Observer(CAMERA, SETTINGS.widths)
    observation = observer(image).by_width[SETTINGS.fine_width]
    states = facing_wall(0.0, 2.0)[None]
    localizer = lfnav.Localizer(scene, CAMERA, MOUNT, SETTINGS, model=model)
    source = small_reconstruction(folder / "reconstruction")
    files = {"scene": folder / "scene.h5", "dataset": folder / "data"}
    return {
        "load_dataset": Call(
            lfnav.load_dataset,
            {"root": folder / "data", "odometry": None, "groundtruth": None, "mask": None},
        ),
        "Dataset.read_image": Call(data.read_image, {"index": 0}),
        "Dataset.read_image_bytes": Call(data.read_image_bytes, {"index": 0}),
        "Dataset.image_path": Call(data.image_path, {"index": 0}),
        "read_tum": Call(lfnav.read_tum, {"path": folder / "data" / "odometry.txt"}),
        "load_scene": Call(lfnav.load_scene, {"path": folder / "scene.h5"}),
        "save_scene": Call(
            partial(lfnav.save_scene, overwrite=True), {"path": "other.h5", "scene": scene}
        ),
        "load_run": Call(lfnav.load_run, {"path": folder / "run.h5"}),
        "load_reconstruction": Call(lfnav.load_reconstruction, {"path": folder / "none"}),
        "Scene.image": Call(scene.image, {"index": 0}),
        "Scene.camera_of": Call(scene.camera_of, {"index": 0}),
        "Renderer": Call(
            lfnav.Renderer,
            {
                "views": renderer.views,
                "plane": WALL,
                "blending": lfnav.Blending.UNSTRUCTURED,
                "quality": lfnav.Quality.PLANE,
                "threads": 1,
            },
        ),
        "Renderer.of_scene": Call(
            lfnav.Renderer.of_scene, {"scene": scene, "largest_side": 20, "threads": 1}
        ),
        "renderer_of_scene": Call(
            lfnav.renderer_of_scene,
            {"scene": scene, "largest_side": 20, "device": lfnav.Device.CPU},
        ),
        "Renderer.render": Call(renderer.render, view),
        "Renderer.render_with_surface": Call(renderer.render_with_surface, view),
        "Renderer.render_many": Call(
            renderer.render_many, {"world_from_camera": pose[None], "intrinsics": pinhole}
        ),
        "Renderer.costs": Call(
            renderer.costs,
            {
                "world_from_camera": pose[None],
                "intrinsics": pinhole,
                "query": image,
                "cost": lfnav.likelihood_named("squared").cost,
                "fit_gain": True,
            },
        ),
        "Renderer.without_view": Call(renderer.without_view, {"index": 0}),
        "MeasurementModel.of_scene": Call(
            lfnav.MeasurementModel.of_scene,
            {"scene": scene, "body_from_camera": MOUNT, "settings": SETTINGS},
        ),
        "MeasurementModel.evidence": Call(
            model.evidence, {"states": states, "observation": observation, "pixel_subsampling": 1}
        ),
        "MeasurementModel.log_likelihoods": Call(
            model.log_likelihoods, {"states": states, "observation": observation}
        ),
        "MeasurementModel.explained": Call(
            model.explained, {"state": states[0], "observation": observation}
        ),
        "Observer": Call(
            lfnav.Observer, {"camera": CAMERA, "widths": SETTINGS.widths, "mask": None}
        ),
        "Observer()": Call(observer, {"image": image}),
        "Localizer": Call(
            lfnav.Localizer,
            {
                "scene": scene,
                "camera": CAMERA,
                "body_from_camera": MOUNT,
                "settings": SETTINGS,
                "rng": np.random.default_rng(0),
                "model": model,
                "mask": None,
            },
        ),
        "Localizer.of_dataset": Call(
            lfnav.Localizer.of_dataset,
            {"scene": scene, "dataset": data, "settings": SETTINGS, "seed": 0, "model": model},
        ),
        "Localizer.step": Call(
            localizer.step,
            {
                "image": image,
                "odometry_increment": np.zeros(3),
                "timestamp": 0.0,
                "image_name": "a.png",
                "hypotheses": None,
            },
        ),
        "localize_dataset": Call(
            partial(lfnav.localize_dataset, settings=SETTINGS), {"scene": scene, "dataset": data}
        ),
        "localize": Call(
            lambda **given: lfnav.localize(lfnav.LocalizeRequest(**given, overwrite=True)),
            {
                **files,
                "output": "run.h5",
                "settings": SETTINGS,
                "seed": 0,
                "odometry": None,
                "mask": None,
            },
        ),
        "reconstruct": Call(
            partial(lfnav.reconstruct, overwrite=True),
            {
                "dataset": folder / "data",
                "output": "recon",
                "settings": lfnav.ReconstructSettings(method="odometry"),
            },
        ),
        "model": Call(
            lfnav.model,
            {"reconstruction": folder / "none", "output": "scene.h5", "settings": None},
        ),
        "open_world": Call(lfnav.open_world, {"path": folder / "none", "memory": 100.0}),
        "build_scene": Call(
            lfnav.build_scene, {"source": source, "settings": lfnav.ModelSettings()}
        ),
        "report": Call(
            lfnav.report, {"run_path": folder / "none.h5", "output": "page", "settings": None}
        ),
        "dock": Call(
            lfnav.dock,
            {
                "scene": scene,
                "robot": PaintedRobot(),
                "goal": facing_wall(0.3, 1.2),
                "settings": lfnav.DockSettings(max_steps=1),
                "filter_settings": SETTINGS,
                "seed": 0,
            },
        ),
        "robot_named": Call(
            lfnav.robot_named,
            {
                "name": f"model:{folder / 'scene.h5'}",
                "scene": scene,
                "options": lfnav.RobotOptions(),
                "seed": 0,
            },
        ),
    }


def try_junk(call: Call) -> list[str]:
    """Calls that ended neither with a result nor with an error of one line."""
    failures = []
    for name in call.good:
        for what, junk in JUNK.items():
            try:
                call.function(**{**call.good, name: junk})
            except lfnav.LfnavError as error:
                if not str(error).isprintable() or len(str(error)) > 1000:
                    failures.append(f"{name} = {what}: {error!r}")
            except Exception as error:  # noqa: BLE001
                failures.append(f"{name} = {what}: {type(error).__name__}: {error}"[:200])
    return failures


@pytest.mark.parametrize("name", VALUES)
def test_values_that_make_no_sense_are_refused_in_one_line(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert try_junk(VALUES[name]) == []


@pytest.fixture(scope="module")
def scenes(folder: Path) -> dict[str, Call]:
    return calls_of_scenes(folder)


SCENES = [
    "load_dataset",
    "Dataset.read_image",
    "Dataset.read_image_bytes",
    "Dataset.image_path",
    "read_tum",
    "load_scene",
    "save_scene",
    "load_run",
    "load_reconstruction",
    "Scene.image",
    "Scene.camera_of",
    "Renderer",
    "Renderer.of_scene",
    "renderer_of_scene",
    "Renderer.render",
    "Renderer.render_with_surface",
    "Renderer.render_many",
    "Renderer.costs",
    "Renderer.without_view",
    "MeasurementModel.of_scene",
    "MeasurementModel.evidence",
    "MeasurementModel.log_likelihoods",
    "MeasurementModel.explained",
    "Observer",
    "Observer()",
    "Localizer",
    "Localizer.of_dataset",
    "Localizer.step",
    "localize_dataset",
    "localize",
    "reconstruct",
    "model",
    "open_world",
    "build_scene",
    "report",
    "dock",
    "robot_named",
]


@pytest.mark.parametrize("name", SCENES)
def test_arguments_that_make_no_sense_are_refused_in_one_line(
    name: str, scenes: dict[str, Call], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert try_junk(scenes[name]) == []


def test_all_calls_with_scenes_are_tried(scenes: dict[str, Call]) -> None:
    assert set(scenes) == set(SCENES)


def test_the_good_arguments_are_good(
    scenes: dict[str, Call], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    # These have to fail later than at their arguments: there is nothing to work on.
    fails = {"load_reconstruction", "model", "open_world", "report", "build_scene"}
    for name, call in {**VALUES, **scenes}.items():
        if name not in fails:
            call.function(**call.good)


def test_all_public_functions_are_tried() -> None:
    tried = {name.split(".")[0].removesuffix("()") for name in [*VALUES, *SCENES]}
    # What is only handed back, named in annotations, or raised.
    handed_back = {
        "DockingResult",
        "OpenWorld",
        "Outcome",
        "Rendering",
        "Reconstruction",
        "RunEvaluation",
    }
    named = {
        "Blending",
        "Device",
        "LocalizeRequest",
        "OutcomeKind",
        "Progress",
        "Quality",
        "Robot",
        "RunOrigin",
        "StateSpace",
    }
    raised = {"InputError", "LfnavError", "OptionError", "RobotError", "StageError"}
    assert set(lfnav.__all__) - tried == handed_back | named | raised | {"no_progress"}


def test_an_image_of_another_size_leaves_no_trace(folder: Path) -> None:
    scene = lfnav.load_scene(folder / "scene.h5")
    image = photo(facing_wall(0.0, 2.0))
    records = []
    for spoilt in (False, True):
        localizer = lfnav.Localizer(scene, CAMERA, MOUNT, SETTINGS, np.random.default_rng(3))
        if spoilt:
            for junk in JUNK.values():
                with pytest.raises(lfnav.OptionError):
                    localizer.step(junk)
        records.append(localizer.step(image))
    assert np.array_equal(records[0].particles, records[1].particles)


def test_a_robot_of_ones_own_is_docked(folder: Path) -> None:
    steps: list[Any] = []
    robot = PaintedRobot()
    result = lfnav.dock(
        wall_scene(),
        robot,
        facing_wall(0.3, 1.2),
        replace(lfnav.DockSettings(), max_steps=2),
        SETTINGS,
        listener=steps.append,
    )
    assert result.outcome.kind is lfnav.OutcomeKind.TIMED_OUT
    assert robot.is_stopped
    assert result.run is not None
    assert result.run.docking is not None
    assert len(result.run.frames) == len(steps) > 1


def test_a_measurement_model_is_for_the_filter_alone(folder: Path) -> None:
    scene, data = lfnav.load_scene(folder / "scene.h5"), lfnav.load_dataset(folder / "data")
    model = lfnav.MeasurementModel.of_scene(scene, np.eye(4), SETTINGS)
    features = lfnav.LocalizerSettings(method="pnp")
    with pytest.raises(lfnav.OptionError, match="to the filter alone"):
        lfnav.localize_dataset(scene, data, features, model=model)
