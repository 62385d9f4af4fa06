"""Structure from motion from images to a metric reconstruction, and how it fails aloud."""

import contextlib
import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lfnav_cli.common import run_command
from lfnav_cli.main import main
from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, OptionError, StageError
from pipelines.artifacts.provenance import sha256_of_file
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.dataset import load_dataset
from pipelines.dataset.images import decode_image, encode_png
from pipelines.geometry.pose import inverse, rotation_angle
from pipelines.geometry.trajectory import read_tum
from pipelines.reconstruct import sfm
from pipelines.reconstruct.colmap_model import read_model, write_model
from pipelines.reconstruct.connectivity import FIRM_SHARED_POINTS, firm_pieces, restrict
from pipelines.reconstruct.reconstruction import (
    Reconstruction,
    load_reconstruction,
    save_reconstruction,
)
from pipelines.reconstruct.settings import ReconstructSettings
from pipelines.reconstruct.stage import reconstruct
from tests.reconstruct_samples import (
    SAMPLES,
    SHARED,
    part_of,
    small_reconstruction,
    texture,
    turning_camera,
)

WORKSHOP = SAMPLES / "workshop" / "map"
LUND = SHARED / "lund_door"
QUICK = ReconstructSettings("sfm", max_features=1500, max_size=480)


def run(dataset: Path, output: Path, settings: ReconstructSettings) -> Reconstruction:
    reconstruct(dataset, output, settings, overwrite=False, progress=no_progress)
    return load_reconstruction(output)


def similarity_errors(found: FloatArray, truth: FloatArray) -> FloatArray:
    """Distances ``(N,)`` of points ``(N, 3)`` after the best similarity (Umeyama 1991)."""
    found_centre, truth_centre = found.mean(axis=0), truth.mean(axis=0)
    source, target = found - found_centre, truth - truth_centre
    left, values, right = np.linalg.svd(target.T @ source)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = left @ np.diag(signs) @ right
    scale = float((values * signs).sum() / (source**2).sum())
    return np.asarray(np.linalg.norm(scale * source @ rotation.T - target, axis=1))


def root_mean_square(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def true_cameras(found: Reconstruction, dataset: Path) -> FloatArray:
    truth = read_tum(dataset / "groundtruth.txt")
    return truth.poses[truth.nearest(found.timestamps, 1e-3)]


@pytest.fixture(scope="module")
def workshop_part(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("workshop")
    part_of(
        WORKSHOP, folder / "d", range(10, 18), ["camera.toml", "odometry.txt", "groundtruth.txt"]
    )
    # As people type it: paths from where they are, which is not where the worker is.
    with contextlib.chdir(folder):
        run(Path("d"), Path("r"), QUICK)
    return folder


def test_eight_views_become_metric_and_upright(workshop_part: Path) -> None:
    found = load_reconstruction(workshop_part / "r")
    truth = true_cameras(found, WORKSHOP)
    assert len(found.image_names) == 8
    assert found.scale_source == "odometry"
    centres = found.world_from_camera[:, :3, 3]
    assert root_mean_square(similarity_errors(centres, truth[:, :3, 3])) < 0.01
    # As delivered, without any alignment to the truth.
    assert root_mean_square(np.linalg.norm(centres - truth[:, :3, 3], axis=1)) < 0.035
    assert np.degrees(rotation_angle(inverse(truth) @ found.world_from_camera)).max() < 0.6
    # Between the cameras, where no alignment matters.
    turns = inverse(found.world_from_camera[:-1]) @ found.world_from_camera[1:]
    true_turns = inverse(truth[:-1]) @ truth[1:]
    assert np.degrees(rotation_angle(inverse(true_turns) @ turns)).max() < 0.3


def test_points_project_where_they_were_observed(workshop_part: Path) -> None:
    found = load_reconstruction(workshop_part / "r")
    camera_from_world = inverse(found.world_from_camera)[found.observations[:, 1]]
    points = found.points[found.observations[:, 0]]
    local = np.einsum("nij,nj->ni", camera_from_world[:, :3, :3], points)
    local += camera_from_world[:, :3, 3]
    intrinsics = found.cameras[0].intrinsics
    assert intrinsics.cx == 319.5  # the camera of camera.toml, in its own pixel convention
    pixels = local[:, :2] / local[:, 2:] * intrinsics.vector()[:2] + intrinsics.vector()[2:]
    errors = pixels - found.observed_pixels
    assert np.linalg.norm(errors, axis=1).mean() < 0.8
    # Half a pixel lost on the way would not spread the errors but shift them.
    assert np.abs(errors.mean(axis=0)).max() < 0.05
    assert found.statistics["mean_reprojection_error_px"] < 0.8


def test_the_statistics_tell_how_it_went(workshop_part: Path) -> None:
    description = json.loads((workshop_part / "r" / "reconstruction.json").read_text())
    statistics = description["statistics"]
    assert statistics["registered"] == statistics["images"] == 8
    assert statistics["median_triangulation_angle_deg"] > 3.0
    assert statistics["alignment_position_rmse_m"] < 0.03
    assert statistics["mean_track_length"] > 2.0
    assert statistics["pairs_by_rotation_share"] == 0.0
    assert description["provenance"]["settings"]["seed"] == 0
    assert {"images", "camera.toml", "odometry.txt"} <= set(description["provenance"]["inputs"])


def test_no_features_are_taken_where_the_mask_says_so(workshop_part: Path, tmp_path: Path) -> None:
    part_of(WORKSHOP, tmp_path / "d", range(10, 18), ["camera.toml", "odometry.txt"])
    mask = np.full((480, 640), 255, dtype=np.uint8)
    mask[:, :200] = 0
    (tmp_path / "d" / "mask.png").write_bytes(encode_png(mask))
    # Features are sought in smaller images: their places must be compared in the full size.
    found = run(tmp_path / "d", tmp_path / "r", QUICK)
    pixels = load_reconstruction(workshop_part / "r").observed_pixels
    masked = found.observed_pixels
    assert pixels is not None
    assert masked is not None
    assert np.count_nonzero(pixels[:, 0] < 199.0) > 100
    assert masked[:, 0].min() > 198.5
    assert np.count_nonzero(masked[:, 0] < 215.0) > 20
    description = json.loads((tmp_path / "r" / "reconstruction.json").read_text())
    digest = sha256_of_file(tmp_path / "d" / "mask.png")
    assert description["provenance"]["inputs"]["mask.png"] == digest


def test_scale_and_odometry_exclude_each_other(workshop_part: Path, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="gives the scale already"):
        run(workshop_part / "d", tmp_path / "r", dataclasses.replace(QUICK, scale=2.0))


@pytest.mark.parametrize("with_camera", [True, False])
def test_a_camera_that_only_turns_is_refused(tmp_path: Path, with_camera: bool) -> None:
    turning_camera(tmp_path / "d", 5, with_camera=with_camera)
    settings = ReconstructSettings("sfm", max_features=600)
    with pytest.raises(
        StageError, match=r"/d: no parallax: 100 % of the image pairs.*not turn on the spot"
    ):
        run(tmp_path / "d", tmp_path / "r", settings)
    assert not (tmp_path / "r").exists()


def test_blurred_images_are_refused_and_nothing_is_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    turning_camera(tmp_path / "d", 4, with_camera=False)
    for path in (tmp_path / "d").glob("*.png"):
        image = decode_image(path.read_bytes(), path)
        path.write_bytes(encode_png(np.asarray(cv2.GaussianBlur(image, (0, 0), 12), np.uint8)))
    arguments = ["reconstruct", str(tmp_path / "d"), "-o", str(tmp_path / "r"), "--method", "sfm"]
    assert run_command(main, arguments) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "too few features" in error
    assert ".png" in error
    assert [path.name for path in tmp_path.iterdir()] == ["d"]


def test_images_of_different_places_are_refused(tmp_path: Path) -> None:
    (tmp_path / "d").mkdir()
    for index in range(3):
        cv2.imwrite(str(tmp_path / "d" / f"{index}.png"), texture(240, 320, seed=index))
    with pytest.raises(StageError, match="no two of the 3 images show the same features"):
        run(tmp_path / "d", tmp_path / "r", ReconstructSettings("sfm", max_features=300))


def test_two_images_are_too_few(tmp_path: Path) -> None:
    turning_camera(tmp_path / "d", 2, with_camera=False)
    with pytest.raises(InputError, match="holds 2 images; structure from motion needs 3"):
        run(tmp_path / "d", tmp_path / "r", QUICK)


def test_a_truncated_image_is_named(tmp_path: Path) -> None:
    turning_camera(tmp_path / "d", 3, with_camera=False)
    path = tmp_path / "d" / "1.png"
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(InputError, match=r"1\.png: "):
        run(tmp_path / "d", tmp_path / "r", QUICK)


@pytest.mark.parametrize(
    ("program", "text"),
    [
        ("import os; os.abort()", r"crashed \(SIGABRT\)"),
        ("raise RuntimeError('no memory left')", r"crashed \(exit code 1\): .*no memory left"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", r"SIGKILL, out of memory\?"),
        ("print('hello')", r"said 'hello"),
    ],
)
def test_a_crash_of_the_worker_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, text: str
) -> None:
    turning_camera(tmp_path / "d", 3, with_camera=False)
    monkeypatch.setattr(sfm, "WORKER_COMMAND", (sys.executable, "-c", program))
    with pytest.raises(StageError, match=text) as caught:
        run(tmp_path / "d", tmp_path / "r", QUICK)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "r").exists()


def test_the_worker_dies_with_its_parent(tmp_path: Path) -> None:
    request = tmp_path / "request.json"
    request.write_text("{}", encoding="utf-8")
    # A worker that has read its request and hangs in a library, and a parent that is killed.
    program = (
        "import time\n"
        "from pipelines.reconstruct import sfm_worker\n"
        "sfm_worker._die_with_parent()\n"
        "print('ready', flush=True)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as worker:
        assert worker.stdout is not None
        assert worker.stdin is not None
        assert worker.stdout.readline() == b"ready\n"
        worker.stdin.close()
        assert worker.wait(timeout=10) != 0


def test_the_parent_never_imports_pycolmap(workshop_part: Path) -> None:
    program = (
        "import sys\n"
        "import pipelines.reconstruct.stage, pipelines.reconstruct.sfm_worker\n"
        "sys.exit('pycolmap' in sys.modules)\n"
    )
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0


def test_a_piece_that_hangs_by_few_points_is_cut_off(tmp_path: Path) -> None:
    bridge = FIRM_SHARED_POINTS - 1
    groups = [(0, 1, 2)] * 50 + [(2, 3)] * bridge + [(3, 4)] * 50
    rows = [(point, image) for point, group in enumerate(groups) for image in group]
    base = small_reconstruction(tmp_path, images=5, points=len(groups))
    content = dataclasses.replace(
        base,
        observations=np.array(rows, dtype=np.int64),
        observed_pixels=np.zeros((len(rows), 2)),
    )
    save_reconstruction(tmp_path / "r", content, {}, overwrite=False)
    model = read_model(tmp_path / "r" / "sparse")
    assert firm_pieces(model) == [[0, 1, 2], [3, 4]]
    part = restrict(model, [0, 1, 2])
    assert [image.name for image in part.images] == list(content.image_names[:3])
    assert len(part.points.positions) == 50
    # It is consistent with itself, so that it can be written and read.
    (tmp_path / "part").mkdir()
    write_model(tmp_path / "part", part)
    assert len(read_model(tmp_path / "part").points.tracks) == 150


@pytest.mark.slow
def test_the_whole_workshop(tmp_path: Path) -> None:
    found = run(WORKSHOP, tmp_path / "r", ReconstructSettings("sfm"))
    truth = true_cameras(found, WORKSHOP)
    assert len(found.image_names) >= 39
    centres = found.world_from_camera[:, :3, 3]
    assert root_mean_square(similarity_errors(centres, truth[:, :3, 3])) <= 0.01
    assert root_mean_square(np.linalg.norm(centres - truth[:, :3, 3], axis=1)) <= 0.035
    assert (
        root_mean_square(np.degrees(rotation_angle(inverse(truth) @ found.world_from_camera)))
        <= 0.3
    )


@pytest.mark.slow
def test_the_same_seed_gives_the_same_model(workshop_part: Path, tmp_path: Path) -> None:
    run(workshop_part / "d", tmp_path / "r", QUICK)
    for name in ("images.bin", "points3D.bin", "cameras.bin"):
        again = (tmp_path / "r" / "sparse" / name).read_bytes()
        assert again == (workshop_part / "r" / "sparse" / name).read_bytes()


@pytest.mark.slow
@pytest.mark.skipif(not LUND.exists(), reason="public test data is not there")
def test_lund_door_with_an_unknown_camera(tmp_path: Path) -> None:
    found = run(LUND / "images", tmp_path / "r", ReconstructSettings("sfm"))
    truth_file = LUND / "groundtruth_colmap_full_resolution" / "images.txt"
    lines = truth_file.read_text(encoding="utf-8").splitlines()
    lines = [line for line in lines if not line.startswith("#")][::2]
    truth = {}
    for fields in (line.split() for line in lines):
        values = [float(value) for value in fields[1:8]]
        rotation = Rotation.from_quat([*values[1:4], values[0]]).as_matrix()
        truth[fields[9].lower()] = -rotation.T @ np.array(values[4:])
    assert len(found.image_names) == 12
    assert found.scale_source == "arbitrary"
    expected = np.array([truth[name.lower()] for name in found.image_names])
    extent = np.linalg.norm(np.ptp(expected, axis=0))
    errors = similarity_errors(found.world_from_camera[:, :3, 3], expected)
    assert root_mean_square(errors) <= 0.005 * extent
    assert found.cameras[0].intrinsics.fx == pytest.approx(2435.38 / 2, rel=0.005)


@pytest.mark.slow
@pytest.mark.skipif(not (SHARED / "hololens").exists(), reason="public test data is not there")
def test_a_walk_that_falls_to_pieces_says_so(tmp_path: Path) -> None:
    dataset = SHARED / "hololens" / "map"
    assert load_dataset(dataset).odometry is None
    with pytest.raises(StageError, match="fall into pieces"):
        run(dataset, tmp_path / "r", ReconstructSettings("sfm"))
