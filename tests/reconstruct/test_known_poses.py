"""Camera poses from odometry and from files: right where known, absent where not."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from lfnav_cli.common import run_command
from lfnav_cli.main import main
from lfnav_cli.reconstruct import command
from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, OptionError
from pipelines.artifacts.provenance import sha256_of_file
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.dataset import load_dataset
from pipelines.geometry.pose import world_from_base_planar
from pipelines.geometry.trajectory import Trajectory, format_tum, read_tum
from pipelines.reconstruct.reconstruction import load_reconstruction
from pipelines.reconstruct.settings import ReconstructSettings
from pipelines.reconstruct.stage import reconstruct
from tests.reconstruct_samples import SAMPLES, part_of

ELEVATORS = SAMPLES / "elevators" / "map"
ODOMETRY = ReconstructSettings("odometry")


def run(dataset: Path, output: Path, settings: ReconstructSettings = ODOMETRY) -> None:
    reconstruct(dataset, output, settings, overwrite=False, progress=no_progress)


def test_odometry_and_the_mount_give_the_camera(tmp_path: Path) -> None:
    run(ELEVATORS, tmp_path / "r")
    found = load_reconstruction(tmp_path / "r")
    truth = read_tum(ELEVATORS / "groundtruth.txt").poses
    assert len(found.image_names) == 28
    assert found.scale_source == "odometry"
    assert found.image_root == ELEVATORS.resolve()
    assert found.image_hashes[3] == sha256_of_file(ELEVATORS / found.image_names[3])
    # The mount is a metre above the base, and its camera looks along the base's x axis.
    camera = found.world_from_camera
    errors = np.linalg.norm(camera[:, :3, 3] - truth[:, :3, 3] - [0.0, 0.0, 1.0], axis=1)
    assert 0.001 < errors.max() < 0.03
    np.testing.assert_allclose(camera[:, :3, 2], truth[:, :3, 0], atol=0.02)
    np.testing.assert_allclose(camera[:, :3, 1], np.tile([0.0, 0.0, -1.0], (28, 1)), atol=1e-6)


def test_given_poses_are_taken_as_they_are(tmp_path: Path) -> None:
    truth_path = ELEVATORS / "groundtruth.txt"
    run(ELEVATORS, tmp_path / "r", ReconstructSettings("poses", poses=truth_path))
    found = load_reconstruction(tmp_path / "r")
    assert found.scale_source == "given poses"
    expected = read_tum(truth_path).poses[:, :3, 3] + [0.0, 0.0, 1.0]
    np.testing.assert_allclose(found.world_from_camera[:, :3, 3], expected, atol=1e-12)


def test_an_image_without_a_pose_is_dropped_with_a_reason(tmp_path: Path) -> None:
    lines = (ELEVATORS / "groundtruth.txt").read_text(encoding="utf-8").splitlines()
    del lines[6]  # a comment line comes first
    (tmp_path / "poses.txt").write_text("\n".join(lines), encoding="utf-8")
    run(ELEVATORS, tmp_path / "r", ReconstructSettings("poses", poses=tmp_path / "poses.txt"))
    found = load_reconstruction(tmp_path / "r")
    assert len(found.image_names) == 27
    assert list(found.dropped) == ["rgb/0005.jpg"]
    assert "lies in a gap of poses.txt of 1.000 s" in found.dropped["rgb/0005.jpg"]
    assert "rgb/0005.jpg" not in found.image_names
    truth = read_tum(ELEVATORS / "groundtruth.txt").poses[6, :3, 3]
    np.testing.assert_allclose(found.world_from_camera[5, :2, 3], truth[:2], atol=1e-12)


def test_poses_of_another_time_pair_with_nothing(tmp_path: Path) -> None:
    (tmp_path / "poses.txt").write_text("500.0 0 0 0 0 0 0 1\n", encoding="utf-8")
    with pytest.raises(
        InputError, match=r"poses\.txt: none of its poses .*the poses' from 500\.000"
    ):
        run(ELEVATORS, tmp_path / "r", ReconstructSettings("poses", poses=tmp_path / "poses.txt"))
    assert not (tmp_path / "r").exists()


def test_given_poses_need_neither_odometry_nor_truth(tmp_path: Path) -> None:
    part_of(ELEVATORS, tmp_path / "d", range(3), ["camera.toml"])
    for name in ("odometry.txt", "groundtruth.txt"):
        (tmp_path / "d" / name).write_text("nonsense\n", encoding="utf-8")
    settings = ReconstructSettings("poses", poses=ELEVATORS / "groundtruth.txt")
    run(tmp_path / "d", tmp_path / "r", settings)
    assert len(load_reconstruction(tmp_path / "r").image_names) == 3


def test_a_map_from_poses_at_30_hz_is_the_one_from_exact_poses(tmp_path: Path) -> None:
    # A robot that drives curves at 1 m/s; its odometry ticks beside the images.
    def along(times: FloatArray) -> FloatArray:
        states = np.stack([np.sin(times), 0.5 * np.cos(1.5 * times), np.sin(0.7 * times)], axis=-1)
        return world_from_base_planar(states)

    images = load_dataset(ELEVATORS).timestamps
    found = {}
    for name, rate in (("poses_30_hz", 30.0), ("odometry_10_hz", 10.0), ("exact", 0.0)):
        times = images if rate == 0.0 else np.arange(-0.0165, images[-1] + 0.2, 1.0 / rate)
        path = tmp_path / f"{name}.txt"
        path.write_text(format_tum(Trajectory(times, along(times))), encoding="utf-8")
        run(ELEVATORS, tmp_path / name, ReconstructSettings("poses", poses=path))
        found[name] = load_reconstruction(tmp_path / name).world_from_camera
    for name, most in (("poses_30_hz", 0.0003), ("odometry_10_hz", 0.002)):
        away = np.linalg.norm((found[name] - found["exact"])[:, :3, 3], axis=1)
        assert away.max() < most


def test_an_image_that_is_named_again_is_in_the_map_once(tmp_path: Path) -> None:
    part_of(ELEVATORS, tmp_path / "d", range(3), ["camera.toml", "odometry.txt"])
    names = ["0000", "0000", "0001", "0000"]
    lines = [f"{0.5 * index} rgb/{name}.jpg\n" for index, name in enumerate(names)]
    (tmp_path / "d" / "rgb.txt").write_text("".join(lines), encoding="utf-8")
    run(tmp_path / "d", tmp_path / "r")
    found = load_reconstruction(tmp_path / "r")
    assert found.image_names == ("rgb/0000.jpg", "rgb/0001.jpg")
    assert found.timestamps.tolist() == [0.0, 1.0]
    assert found.dropped == {
        f"rgb/0000.jpg at {time:.6f}": "is the image of 0.000000 once more" for time in (0.5, 1.5)
    }


def test_what_a_method_needs_is_named_where_it_is_missing(tmp_path: Path) -> None:
    part_of(ELEVATORS, tmp_path / "still", range(3), ["camera.toml"])
    with pytest.raises(InputError, match=r"odometry\.txt: does not exist, and --method odometry"):
        run(tmp_path / "still", tmp_path / "r")
    part_of(ELEVATORS, tmp_path / "blind", range(3), ["odometry.txt"])
    with pytest.raises(InputError, match=r"camera\.toml: does not exist, and known poses need"):
        run(tmp_path / "blind", tmp_path / "r")
    assert not (tmp_path / "r").exists()


def test_a_damaged_image_is_an_error_and_not_half_a_result(tmp_path: Path) -> None:
    part_of(ELEVATORS, tmp_path / "d", range(3), ["camera.toml", "odometry.txt"])
    image = tmp_path / "d" / "rgb" / "0001.jpg"
    content = image.read_bytes()
    image.unlink()
    image.write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match=r"0001\.jpg: "):
        run(tmp_path / "d", tmp_path / "r")
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"method": "guess"}, "unknown method"),
        ({"method": "poses"}, "needs --poses"),
        ({"method": "sfm", "poses": Path("x")}, "--poses goes with"),
        ({"method": "odometry", "scale": 2.0}, "--scale goes with --method sfm"),
        ({"method": "sfm", "scale": 0.0}, "not a positive number"),
        ({"method": "sfm", "scale": float("nan")}, "not a positive number"),
        ({"method": "sfm", "seed": -1}, "--seed"),
        ({"method": "sfm", "max_features": 1}, "--max-features"),
        ({"method": "sfm", "max_size": 10**6}, "--max-size"),
        ({"method": "sfm", "matcher": "best"}, "unknown matcher"),
    ],
)
def test_impossible_settings_are_refused(values: dict[str, object], text: str) -> None:
    with pytest.raises(OptionError, match=text):
        ReconstructSettings(**values)  # type: ignore[arg-type]


def test_the_command_prints_a_table_and_refuses_to_overwrite(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [str(ELEVATORS), "-o", str(tmp_path / "r"), "--method", "odometry"]
    result = CliRunner().invoke(command, arguments)
    assert result.exit_code == 0, result.output
    assert "28 of 28" in result.stdout
    assert run_command(main, ["reconstruct", *arguments]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert run_command(main, ["reconstruct", *arguments, "--overwrite", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
