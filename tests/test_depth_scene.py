"""Scenes with depth maps: given or computed, judged by photos they do not hold, and bad depth."""

import json
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pipelines.artifacts.array_types import FloatArray, ImageArray
from pipelines.artifacts.progress import no_progress
from pipelines.dataset.images import encode_png
from pipelines.geometry.trajectory import Trajectory, format_tum
from pipelines.lightfield import depth_maps
from pipelines.lightfield.bundle import load_scene
from pipelines.lightfield.depth import estimate_depth
from pipelines.lightfield.image_quality import psnr, ssim
from pipelines.lightfield.stage import ModelSettings, model
from tests.chain_samples import lfnav, succeed
from tests.lightfield_samples import looking, pinhole, pinhole_rays, pixels_of, waves

CAMERA = pinhole(96, 72, 84.0)
# A board stands 1.2 m before the wall y = 0 and hides a part of it, another one from every place.
BOARD_Y, BOARD_LEFT, BOARD_RIGHT = -1.2, -0.5, 0.4
MAP_PLACES = [[x, -4.0 + 0.3 * (i % 2), 1.0] for i, x in enumerate(np.linspace(-1.0, 1.0, 7))]
TEST_PLACES = [[-0.45, -3.7, 1.05], [0.2, -3.9, 0.95]]


def seen(pose: FloatArray) -> tuple[ImageArray, FloatArray]:
    """Photo and depth (metres along z) of the wall and the board, ray by ray."""
    rays = pinhole_rays(CAMERA, pixels_of(CAMERA)) @ pose[:3, :3].T
    to_board = (BOARD_Y - pose[1, 3]) / rays[..., 1]
    x = pose[0, 3] + to_board * rays[..., 0]
    on_board = (x > BOARD_LEFT) & (x < BOARD_RIGHT)
    depth = np.where(on_board, to_board, -pose[1, 3] / rays[..., 1])
    points = pose[:3, 3] + depth[..., None] * rays
    # The board has a finer texture of its own.
    colours = np.where(on_board[..., None], waves(3.0 * points + 5.0), waves(2.0 * points))
    return np.rint(colours).astype(np.uint8), depth


def write_dataset(root: Path, places: list[list[float]]) -> Path:
    """A data set of body = camera with exact poses and depth images."""
    poses = np.array([looking(place, [place[0] * 0.3, 0.0, 1.0]) for place in places])
    (root / "rgb").mkdir(parents=True)
    (root / "depth").mkdir()
    for index, pose in enumerate(poses):
        image, depth = seen(pose)
        (root / f"rgb/{index}.png").write_bytes(encode_png(image))
        levels = np.rint(depth * 5000.0).astype(np.uint16)
        (root / f"depth/{index}.png").write_bytes(cv2.imencode(".png", levels)[1].tobytes())
    for kind in ("rgb", "depth"):
        lines = [f"{index}.0 {kind}/{index}.png" for index in range(len(poses))]
        (root / f"{kind}.txt").write_text("\n".join(lines) + "\n")
    times = np.arange(len(poses), dtype=np.float64)
    (root / "groundtruth.txt").write_text(format_tum(Trajectory(times, poses)))
    (root / "camera.toml").write_text(
        f'model = "PINHOLE"\nwidth = {CAMERA.width}\nheight = {CAMERA.height}\n'
        f"params = {CAMERA.vector().tolist()}\ndepth_scale = 5000\n"
    )
    return root


@pytest.fixture
def reconstruction(tmp_path: Path) -> Path:
    data = write_dataset(tmp_path / "map", MAP_PLACES)
    poses = data / "groundtruth.txt"
    succeed("reconstruct", data, "-o", tmp_path / "r", "--method", "poses", "--poses", poses)
    return tmp_path / "r"


def evaluated(scene: Path, *options: str | Path) -> dict[str, Any]:
    result = json.loads(succeed("evaluate", scene, *options, "--json"))
    assert isinstance(result, dict)
    return result


@pytest.mark.parametrize(("source", "best"), [("given", 30.0), ("photos", 25.0)])
def test_depth_renders_parallax_that_a_plane_cannot(
    reconstruction: Path, tmp_path: Path, source: str, best: float
) -> None:
    scene = tmp_path / "scene.h5"
    options = ["--geometry", "depth", "--depth", source, "--plane", "0,1,0,0"]
    succeed("model", reconstruction, "-o", scene, *options)
    test = write_dataset(tmp_path / "test", TEST_PLACES)
    found = evaluated(scene, "--dataset", test)
    for measure in ("psnr_db", "ssim", "coverage"):
        assert len(found[measure]["per_frame"]) == len(TEST_PLACES)
        assert found[measure]["min"] <= found[measure]["mean"]
    assert found["psnr_db"]["mean"] > best
    assert found["psnr_db"]["mean"] > found["baselines"]["plane"]["psnr_db"]["mean"] + 4.0
    assert found["ssim"]["mean"] > found["baselines"]["plane"]["ssim"]["mean"]
    assert found["psnr_db"]["mean"] > found["baselines"]["nearest_photo"]["psnr_db"]["mean"] + 4.0
    assert found["coverage"]["mean"] > 0.95
    # The quality in between, and the whole scene against itself.
    plane = evaluated(scene, "--dataset", test, "--quality", "plane")
    assert plane["psnr_db"] == found["baselines"]["plane"]["psnr_db"]
    left_out = evaluated(scene, "--leave-one-out")
    assert left_out["frames"] == len(MAP_PLACES)
    assert left_out["psnr_db"]["mean"] > left_out["baselines"]["plane"]["psnr_db"]["mean"] + 2.0


def test_given_depth_is_kept_to_the_precision_of_the_file(
    reconstruction: Path, tmp_path: Path
) -> None:
    path = tmp_path / "scene.h5"
    options = ["--geometry", "depth", "--depth", "given", "--plane", "0,1,0,0"]
    succeed("model", reconstruction, "-o", path, *options)
    scene = load_scene(path)
    for stored, pose in zip(scene.depth, scene.world_from_camera, strict=True):
        _, depth = seen(pose)
        assert np.abs(stored.inverse_depth * depth - 1.0).max() < 1e-3
        assert stored.confident.all()
    assert "96x72" in succeed("info", path)
    copy = tmp_path / "copy.h5"
    succeed("model", reconstruction, "-o", copy, *options)
    assert load_scene(copy).identifier == scene.identifier
    assert copy.read_bytes() == path.read_bytes()


def test_the_plane_comes_from_given_depth_where_there_are_no_points(
    reconstruction: Path, tmp_path: Path
) -> None:
    scene = tmp_path / "scene.h5"
    succeed("model", reconstruction, "-o", scene, "--geometry", "depth", "--depth", "given")
    found = load_scene(scene).surface
    assert found.method == "points"
    # The wall y = 0, of which the board hides a third.
    assert np.degrees(np.arccos(-found.plane.normal[1])) < 0.2
    assert abs(found.plane.offset) < 0.01


def test_finished_depth_maps_are_not_computed_again(
    reconstruction: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    computed: list[int] = []

    def until_killed(*arguments: Any) -> Any:
        computed.append(arguments[3])
        if len(computed) == 4:
            raise KeyboardInterrupt
        return estimate_depth(*arguments)

    def to_the_end(*arguments: Any) -> Any:
        computed.append(arguments[3])
        return estimate_depth(*arguments)

    settings = ModelSettings(geometry="depth", plane=(0.0, 1.0, 0.0, 0.0))
    path = tmp_path / "scene.h5"
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    monkeypatch.setattr(depth_maps, "estimate_depth", until_killed)
    with pytest.raises(KeyboardInterrupt):
        model(reconstruction, path, settings, overwrite=False, progress=no_progress)
    assert not path.exists()
    first = list(computed)
    monkeypatch.setattr(depth_maps, "estimate_depth", to_the_end)
    model(reconstruction, path, settings, overwrite=False, progress=no_progress)
    # Views 0 to 2 were done; those after the interrupted one may have been begun.
    assert set(computed[len(first) :]).isdisjoint({0, 1, 2})
    assert {3} <= set(computed[len(first) :])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["map", "r", "scene.h5"]
    again = tmp_path / "again.h5"
    monkeypatch.undo()
    model(reconstruction, again, settings, overwrite=False, progress=no_progress)
    assert load_scene(again).identifier == load_scene(path).identifier


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        ("size", "depth/2.png: is 48x36, its photo 96x72"),
        ("zeros", "depth/2.png: holds no depth"),
        ("missing", "depth.txt: is missing"),
        ("scale", "camera.toml: has no depth_scale"),
    ],
)
def test_bad_depth_is_one_line(
    reconstruction: Path, tmp_path: Path, damage: str, reason: str
) -> None:
    data = tmp_path / "map"
    if damage == "missing":
        (data / "depth.txt").unlink()
    elif damage == "scale":
        camera = (data / "camera.toml").read_text().replace("depth_scale = 5000\n", "")
        (data / "camera.toml").write_text(camera)
    else:
        shape = (36, 48) if damage == "size" else (72, 96)
        values = np.full(shape, 9000 if damage == "size" else 0, dtype=np.uint16)
        (data / "depth/2.png").write_bytes(cv2.imencode(".png", values)[1].tobytes())
    output = tmp_path / "scene.h5"
    options = ["--geometry", "depth", "--depth", "given", "--plane", "0,1,0,0"]
    outcome = lfnav("model", reconstruction, "-o", output, *options)
    assert outcome.code == 1
    assert len(outcome.err.strip().splitlines()) == 1
    assert reason in outcome.err
    assert not output.exists()


def test_quality_needs_depth_maps(reconstruction: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scene.h5"
    succeed("model", reconstruction, "-o", scene, "--plane", "0,1,0,0")
    outcome = lfnav("evaluate", scene, "--leave-one-out", "--quality", "fine")
    assert outcome.code == 1
    assert "needs depth maps" in outcome.err
    for options in ([], ["--leave-one-out", "--dataset", tmp_path / "map"], ["--estimate", "mode"]):
        assert lfnav("evaluate", scene, *options).code == 2


def test_psnr_and_ssim_by_their_formulas() -> None:
    generator = np.random.default_rng(3)
    recorded = generator.integers(20, 200, (40, 50, 3)).astype(np.uint8)
    covered = np.ones((40, 50), dtype=bool)
    assert psnr(recorded, recorded, covered) == 100.0
    assert ssim(recorded, recorded, covered) == pytest.approx(1.0)
    # One brightness factor does not count.
    darker = np.rint(recorded * 0.8).astype(np.uint8)
    assert psnr(darker, recorded, covered) > 50.0
    noise = generator.normal(0.0, 5.0, recorded.shape)
    noisy = np.clip(np.rint(recorded + noise), 0, 255).astype(np.uint8)
    assert psnr(noisy, recorded, covered) == pytest.approx(20 * np.log10(255 / 5.0), abs=0.2)
    # Variances: of the brightness of 181 equally likely levels a channel, and of the noise's.
    weights = 0.299**2 + 0.587**2 + 0.114**2
    signal, error = weights * (181.0**2 - 1.0) / 12.0, weights * 25.0
    expected = 2.0 * signal / (2.0 * signal + error)
    assert ssim(noisy, recorded, covered) == pytest.approx(expected, abs=1e-3)
    assert (
        abs(ssim(generator.integers(20, 200, recorded.shape).astype(np.uint8), recorded, covered))
        < 0.1
    )
    # Only covered pixels count.
    spoiled = recorded.copy()
    spoiled[:, 25:] = 0
    covered[:, 25:] = False
    assert psnr(spoiled, recorded, covered) == 100.0
    assert ssim(spoiled, recorded, covered) == pytest.approx(1.0)
    assert psnr(spoiled, recorded, np.zeros_like(covered)) == 0.0
