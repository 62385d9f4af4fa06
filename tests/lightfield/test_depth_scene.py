"""Scenes with depth maps: given or computed, judged by photos they do not hold, and bad depth."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipelines.artifacts.stages import no_progress
from pipelines.lightfield import depth_maps
from pipelines.lightfield.scene_file import load_scene
from pipelines.lightfield.stage import ModelSettings, model
from pipelines.lightfield.stereo_depth import estimate_depth
from pipelines.render.held_out import lie_amid_others
from pipelines.render.image_quality import psnr, ssim
from tests.chain_samples import lfnav, succeed
from tests.depth_samples import MAP_PLACES, TEST_PLACES, seen, write_dataset


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
    assert found is not None
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
    monkeypatch.setattr(depth_maps, "processor_count", lambda: 1)
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
    before = sorted(tmp_path.rglob("*"))
    outcome = lfnav("model", reconstruction, "-o", output, *options)
    assert outcome.code == 1
    assert len(outcome.err.strip().splitlines()) == 1
    assert reason in outcome.err
    assert sorted(tmp_path.rglob("*")) == before


def test_quality_needs_depth_maps(reconstruction: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scene.h5"
    succeed("model", reconstruction, "-o", scene, "--plane", "0,1,0,0")
    outcome = lfnav("evaluate", scene, "--leave-one-out", "--quality", "fine")
    assert outcome.code == 1
    assert "needs depth maps" in outcome.err
    outcome = lfnav("evaluate", scene, "--leave-one-out", "--interior")
    assert outcome.code == 1
    assert "no view was taken amid the others" in outcome.err
    assert lfnav("evaluate", scene, "--interior", "--dataset", tmp_path / "map").code == 2
    for options in ([], ["--leave-one-out", "--dataset", tmp_path / "map"], ["--estimate", "mode"]):
        assert lfnav("evaluate", scene, *options).code == 2


def test_only_views_amid_the_others_are_left_out_if_asked(tmp_path: Path) -> None:
    corners = [[x, y, 1.0] for x in (-0.6, 0.6) for y in (-4.2, -3.6)]
    data = write_dataset(tmp_path / "map", [*corners, [0.1, -3.9, 1.0]])
    poses = data / "groundtruth.txt"
    succeed("reconstruct", data, "-o", tmp_path / "r", "--method", "poses", "--poses", poses)
    scene = tmp_path / "scene.h5"
    succeed("model", tmp_path / "r", "-o", scene, "--plane", "0,1,0,0")
    every = evaluated(scene, "--leave-one-out")
    interior = evaluated(scene, "--leave-one-out", "--interior")
    assert every["frames"] == 5
    assert interior["frames"] == 1
    assert interior["psnr_db"]["per_frame"] == every["psnr_db"]["per_frame"][4:]
    assert "1 interior views of 5" in interior["against"]


def test_positions_amid_the_others() -> None:
    turn = Rotation.from_euler("xyz", [0.3, -0.8, 1.1]).as_matrix()
    grid = np.array([[x, y, 0.0] for x in range(5) for y in range(4)], dtype=np.float64)
    inside = (grid[:, 0] % 4 != 0) & (grid[:, 1] % 3 != 0)
    wobble = np.random.default_rng(0).normal(0.0, 0.002, grid.shape)
    for places in (grid, grid + wobble):
        found = lie_amid_others(places @ turn.T + [5.0, -3.0, 1.0])
        np.testing.assert_array_equal(found, inside)
    line = np.outer([0.0, 3.0, 1.0, 4.0, 0.001], [1.0, 2.0, -1.0])
    assert lie_amid_others(line).tolist() == [False, True, True, False, False]
    box = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
    found = lie_amid_others(np.vstack([box, [[0.5, 0.4, 0.6], [0.5, 0.5, 1.0]]]))
    assert found.tolist() == [False] * 8 + [True, False]
    assert not lie_amid_others(np.ones((3, 3))).any()
    assert not lie_amid_others(np.zeros((1, 3))).any()


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
