"""``lfnav dock`` from the command line: robots by name, exit codes, one line for bad input."""

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from lfnav_cli import common
from lfnav_cli.main import main
from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import StageError
from pipelines.artifacts.provenance import sha256_of_file
from pipelines.dataset.images import encode_png
from pipelines.dock.robots.noise import MotionNoise, SensorNoise, SimulatedMotion
from pipelines.dock.robots.replay import ReplayRobot
from pipelines.dock.robots.simulator import (
    VARIANTS,
    PathTracing,
    SimulatorRobot,
    developed,
    imported_mitsuba,
)
from pipelines.geometry.camera import Camera
from pipelines.localize.run import load_run
from tests.dock_samples import EXACT, GOAL, START, photo, written_scene
from tests.report_samples import MOUNT

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data" / "elevators"


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written_scene(tmp_path_factory.mktemp("scene"))


def pose(state: FloatArray) -> str:
    return f"{state[0]},{state[1]},{math.degrees(state[2])}"


def near_wall(scene: Path, output: Path, *more: str) -> list[str]:
    return [
        "dock", str(scene), "-o", str(output), "--threads", "1", "--camera-width", "48",
        "--start", pose(START), "--true-start", pose(START), "--least-distance", "0.4",
        "--staging-distance", "0.5", *more,
    ]  # fmt: skip


def run(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    code = common.run_command(main, arguments)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def check_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str], *words: str) -> None:
    code, out, err = run(arguments, capsys)
    assert code == 1
    assert out == ""
    assert err.count("\n") == 1
    assert "internal error" not in err
    for word in words:
        assert word in err


def test_a_model_robot_is_docked(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "run.h5"
    robot = ["--robot", f"model:{scene}", "--goal", pose(GOAL), "--json"]
    code, out, err = run(near_wall(scene, output, *robot), capsys)
    assert code == 0
    summary = json.loads(out)
    assert summary["outcome"] == "docked"
    assert summary["true_error"]["position_m"] < 0.03
    # A line a step.
    assert len(err.splitlines()) == summary["steps"] == len(load_run(output).frames)
    assert "staging" in err


def test_another_ending_has_its_exit_code_and_keeps_the_run(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "run.h5"
    robot = ["--robot", f"model:{scene}", "--goal-view", "1", "--fault", "blocked:3"]
    code, out, err = run(near_wall(scene, output, "--quiet", *robot), capsys)
    assert code == 11
    # Quiet or not: a robot that is not docked is told of, with the reason, in one line.
    assert out == ""
    assert err.startswith("lfnav: blocked: ")
    assert "did not happen" in err
    assert err.count("\n") == 1
    record = load_run(output).docking
    assert record is not None
    # View 1 was taken straight in front of the wall, from two metres away.
    np.testing.assert_allclose(record.goal, [0.0, -2.0, math.pi / 2.0], atol=1e-9)


def test_the_goal_is_where_an_image_was_taken(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image = tmp_path / "goal.png"
    image.write_bytes(encode_png(photo(GOAL)))
    output = tmp_path / "run.h5"
    robot = ["--robot", f"model:{scene}", "--goal-image", str(image), "--max-steps", "1"]
    code, _, _ = run(near_wall(scene, output, *robot), capsys)
    assert code == 13
    record = load_run(output).docking
    assert record is not None
    assert np.linalg.norm(record.goal[:2] - GOAL[:2]) < 0.03
    image.write_bytes(encode_png(np.zeros((10, 20, 3), np.uint8)))
    check_one_line(
        near_wall(scene, tmp_path / "b.h5", *robot), capsys, "20x10 pixels", "camera 48x36"
    )


def test_a_robot_of_the_users_own_is_looked_at(
    scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["dock", str(scene), "--dry-run", "--robot", "tests.dock_samples:PaintedRobot"]
    code, out, _ = run(arguments, capsys)
    assert code == 0
    assert "SIMPLE_PINHOLE 48x36" in out


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("tests.dock_samples:NoMove", ["lacks move"]),
        ("tests.dock_samples:WrongSize", ["20x10", "48x36"]),
        ("tests.dock_samples:NoNumbers", ["three finite numbers"]),
        ("tests.dock_samples:Raising", ["OSError: no such device: /dev/ttyUSB0"]),
        ("tests.dock_samples:Nobody", ["has no Nobody"]),
        ("no.such.module:Robot", ["cannot be imported", "ModuleNotFoundError"]),
        ("robot", ["none of model:SCENE.h5"]),
        ("model:missing.h5", ["missing.h5"]),
        ("replay:missing", ["missing", "does not exist"]),
    ],
)
def test_a_robot_that_is_none(
    scene: Path, capsys: pytest.CaptureFixture[str], name: str, words: list[str]
) -> None:
    check_one_line(["dock", str(scene), "--dry-run", "--robot", name], capsys, *words)


def test_a_goal_outside_writes_nothing(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "run.h5"
    robot = ["--robot", f"model:{scene}"]
    outside = near_wall(scene, output, *robot, "--goal", "9,9,90")
    check_one_line(outside, capsys, "outside of the allowed area")
    check_one_line(near_wall(scene, output, *robot), capsys, "give one goal")
    view = near_wall(scene, output, *robot, "--goal-view", "7")
    check_one_line(view, capsys, "has no view 7", "0 to 2")
    assert not output.exists()


def test_a_mask_goes_with_the_robots_camera(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mask = tmp_path / "bumper.png"
    grey = np.full((36, 48), 255, dtype=np.uint8)
    grey[27:] = 0
    mask.write_bytes(encode_png(grey))
    robot = ["--robot", f"model:{scene}", "--goal", pose(GOAL), "--mask", str(mask)]
    output = tmp_path / "run.h5"
    assert run(near_wall(scene, output, *robot), capsys)[0] == 0
    assert load_run(output).provenance["inputs"]["mask"] == sha256_of_file(mask)
    looked = ["dock", str(scene), "--dry-run", "--robot", "tests.dock_samples:PaintedRobot"]
    assert "25 % of the image left out" in run([*looked, "--mask", str(mask)], capsys)[1]
    # Refused before anything moves.
    mask.write_bytes(encode_png(grey[:30]))
    for arguments in (near_wall(scene, tmp_path / "b.h5", *robot), [*looked, "--mask", str(mask)]):
        check_one_line(arguments, capsys, f"{mask}: is 48x30 pixels", "robot's camera is 48x36")
    missing = near_wall(scene, tmp_path / "b.h5", *robot[:-1], str(tmp_path / "none.png"))
    check_one_line(missing, capsys, "none.png: cannot be read")
    assert not (tmp_path / "b.h5").exists()


def test_a_replay_shows_the_nearest_frame() -> None:
    from pipelines.dataset.dataset import load_dataset

    dataset = load_dataset(SAMPLE / "test")
    assert dataset.groundtruth is not None
    robot = ReplayRobot(dataset, SimulatedMotion(np.array([-1.1, -1.6, 1.5]), EXACT, _rng()))
    np.testing.assert_array_equal(robot.take_image(), dataset.read_image(len(dataset) - 1))
    before = robot.true_state()
    forward, left, turn = robot.move(-0.6, 0.3, 0.1)
    after = robot.true_state()
    assert math.isclose(math.hypot(forward, left), float(np.linalg.norm((after - before)[:2])))
    assert math.isclose(turn, float(after[2] - before[2]), abs_tol=1e-9)


# --- the path-traced simulator ------------------------------------------------------------------


def test_without_mitsuba_the_error_says_how_to_install_it(
    scene: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    name = f"sim:{SAMPLE / 'scene' / 'scene.xml'}"
    arguments = ["dock", str(scene), "--dry-run", "--robot", name]
    check_one_line(arguments, capsys, "not installed", "pip install 'lfnav[sim]'")


def test_a_mitsuba_scene_that_does_not_load(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mitsuba")
    broken = tmp_path / "broken.xml"
    broken.write_text('<scene version="3.0.0"><shape type="no such shape"/></scene>')
    arguments = ["dock", str(scene), "--dry-run", "--robot", f"sim:{broken}"]
    check_one_line(arguments, capsys, "broken.xml", "no scene that Mitsuba can load")
    arguments[-1] = f"sim:{tmp_path / 'missing.xml'}"
    check_one_line(arguments, capsys, "missing.xml", "does not exist")


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_simulator_sees_what_the_photos_show(variant: str) -> None:
    pytest.importorskip("mitsuba")
    if variant.startswith("llvm") and not has_llvm():
        pytest.skip("the library LLVM is not there")
    from pipelines.dataset.dataset import load_dataset
    from pipelines.geometry.pose import planar_state_of

    dataset = load_dataset(SAMPLE / "map")
    assert dataset.groundtruth is not None
    state = planar_state_of(dataset.groundtruth.poses)[3]
    camera = Camera("PINHOLE", 40, 30, (577.295282 / 16, 577.295282 / 16, 19.5, 14.5))
    motion = SimulatedMotion(state, MotionNoise(), _rng())
    path = SAMPLE / "scene" / "scene.xml"
    tracing = PathTracing(64, False, variant)
    robot = SimulatorRobot(path, camera, MOUNT, motion, SensorNoise(0, 0), tracing, _rng())
    assert variant in robot.note
    image = robot.take_image().astype(np.float64)
    recorded = dataset.read_image(3).reshape(30, 16, 40, 16, 3).mean(axis=(1, 3))
    shifted = np.roll(recorded, 4, axis=1)
    assert np.corrcoef(image.ravel(), recorded.ravel())[0, 1] > 0.92
    assert np.abs(image - recorded).mean() < 0.5 * np.abs(image - shifted).mean()


def test_the_fastest_variant_is_one_that_loads(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mitsuba")
    monkeypatch.setattr("drjit.has_backend", lambda backend: False)
    assert imported_mitsuba().variant() == "scalar_rgb"
    with pytest.raises(StageError, match="libllvm"):
        imported_mitsuba("llvm_ad_rgb")


def test_the_response_is_that_of_the_photos() -> None:
    # x = L (1 + L / 9) / (1 + L) * 1.35, then sRGB: 0.5 gives 0.475 and 183.25 of 255.
    radiance = np.array([[[0.0, 0.5, 50.0]]], dtype=np.float32)
    np.testing.assert_array_equal(developed(radiance), [[[0, 183, 255]]])


def has_llvm() -> bool:
    try:
        imported_mitsuba("llvm_ad_rgb")
    except StageError:
        return False
    return True


def _rng() -> np.random.Generator:
    return np.random.default_rng(0)
