"""EuRoC, Record3D, Polycam and LLFF: points land on the pixels that the formats say."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.dataset import load_dataset
from pipelines.dataset.importers.settings import ImportSettings
from pipelines.geometry.pose import pose_from_rotation, quaternion_of, world_from_base_planar
from pipelines.reconstruct.import_description import ImportSummary
from pipelines.reconstruct.import_stage import import_source
from pipelines.reconstruct.reconstruction import load_reconstruction
from tests.import_samples import project, refusal, write_picture

COUNT = 4
# Cameras with z up in the world, the axes of OpenCV, and their pixels' centres at integers.
FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
POSES = world_from_base_planar(
    np.stack([[0.1 * k, 0.3 * k - 0.2, 0.2 * k] for k in range(COUNT)])
) @ pose_from_rotation(FORWARD, [0.0, 0.0, 1.2])
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
FOCAL, CENTRE, SIZE = (40.0, 42.0), (15.0, 11.5), (32, 24)
# x stays, z up becomes y up.
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 0], [0, 0, 0, 1.0]])
POINT = np.array([5.0, 0.5, 1.4])


def imported(source: Path, output: Path, **options: Any) -> ImportSummary:
    settings = ImportSettings(**options)
    return import_source(source, output, settings, overwrite=False, progress=no_progress)


def camera_matrix() -> list[list[float]]:
    # The formats' centres of pixels are at .5.
    return [[FOCAL[0], 0.0, CENTRE[0] + 0.5], [0.0, FOCAL[1], CENTRE[1] + 0.5], [0.0, 0.0, 1.0]]


def expected_pixel(pose: FloatArray) -> FloatArray:
    x, y, z = np.linalg.inv(pose)[:3] @ [*POINT, 1.0]
    return np.array([FOCAL[0] * x / z + CENTRE[0], FOCAL[1] * y / z + CENTRE[1]])


def check_reconstruction(output: Path) -> None:
    found = load_reconstruction(output / "reconstruction")
    assert len(found.image_names) == COUNT
    for pose, camera, mine in zip(found.world_from_camera, found.camera_index, POSES, strict=True):
        np.testing.assert_allclose(pose, mine, atol=1e-9)
        np.testing.assert_allclose(
            project(found.cameras[camera], pose, POINT), expected_pixel(mine), atol=1e-6
        )


# ------------------------------------------------------------------------- Record3D


def write_record3d(folder: Path, world: FloatArray, **changes: Any) -> Path:
    for number in range(COUNT):
        write_picture(folder / "rgb" / f"{number + 8}.jpg", number)
    exported = world @ POSES @ OPENGL
    rows = np.concatenate([quaternion_of(exported), exported[:, :3, 3]], axis=1)
    # Numbers before the first photo: natural order is not that of the names' letters.
    rows = np.concatenate([np.tile(rows[:1], (8, 1)), rows])
    content = {
        "w": SIZE[0],
        "h": SIZE[1],
        "K": np.array(camera_matrix()).T.ravel().tolist(),
        "fps": 20,
        "poses": rows.tolist(),
        **changes,
    }
    (folder / "metadata.json").write_text(json.dumps(content), encoding="utf-8-sig")
    return folder


@pytest.mark.parametrize("world", [np.eye(4), Y_UP], ids=["z up", "y up, as ARKit has it"])
def test_record3d(tmp_path: Path, world: FloatArray) -> None:
    summary = imported(write_record3d(tmp_path / "r3d", world), tmp_path / "out")
    assert (summary.kind, summary.evidence) == ("record3d", "metadata.json")
    check_reconstruction(tmp_path / "out")
    dataset = load_dataset(tmp_path / "out")
    assert dataset.image_names == ("rgb/8.jpg", "rgb/9.jpg", "rgb/10.jpg", "rgb/11.jpg")
    np.testing.assert_allclose(dataset.timestamps, [0.4, 0.45, 0.5, 0.55])


def test_record3d_of_other_versions(tmp_path: Path) -> None:
    rows = np.array(camera_matrix())
    rows[:2] *= 2.0
    write_record3d(
        tmp_path / "r3d",
        Y_UP,
        K=rows.ravel().tolist(),
        w=2 * SIZE[0],
        h=2 * SIZE[1],
        frameTimestamps=[100.0 + 0.1 * k for k in range(8 + COUNT)],
    )
    write_picture(tmp_path / "r3d" / "rgb" / "99.jpg", 1)
    summary = imported(tmp_path / "r3d", tmp_path / "out")
    assert "1 of 5 photos have no pose and are left out" in summary.notes
    check_reconstruction(tmp_path / "out")
    np.testing.assert_allclose(load_dataset(tmp_path / "out").timestamps[0], 100.8)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"poses": [[1.0] * 6]}, "poses is not made of 7 numbers each"),
        ({"poses": [[2.0, 0, 0, 0, 0, 0, 0]] * 12}, "the quaternion has length 2"),
        ({"poses": []}, "holds no photo 0.jpg, 1.jpg, ... that has a pose"),
        ({"K": [1.0] * 8}, "K is not made of 9 numbers"),
        ({"K": [0.0] * 9}, "metadata.json: "),
        ({"fps": -1}, "fps -1 is not positive"),
    ],
)
def test_record3d_that_is_damaged(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], changes: dict[str, Any], reason: str
) -> None:
    source = write_record3d(tmp_path / "r3d", Y_UP, **changes)
    assert reason in refusal([str(source)], tmp_path / "out", capfd)


# ------------------------------------------------------------------------- Polycam


def write_polycam(folder: Path, images: str = "images", cameras: str = "cameras") -> Path:
    for number, pose in enumerate(Y_UP @ POSES @ OPENGL):
        write_picture(folder / "keyframes" / images / f"{1000 + number}.jpg", number)
        (folder / "keyframes" / cameras).mkdir(parents=True, exist_ok=True)
        (fx, _, cx), (_, fy, cy), _ = camera_matrix()
        content = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": SIZE[0], "height": SIZE[1]}
        content |= {
            f"t_{row}{column}": pose[row, column] for row in range(3) for column in range(4)
        }
        (folder / "keyframes" / cameras / f"{1000 + number}.json").write_text(json.dumps(content))
    return folder


def test_polycam(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = write_polycam(tmp_path / "scan")
    write_picture(source / "keyframes" / "images" / "9999.jpg", 1)
    summary = imported(source, tmp_path / "out")
    assert (summary.kind, summary.evidence) == ("polycam", "keyframes/cameras/")
    assert "1 of 5 photos have no camera file and are left out" in summary.notes
    check_reconstruction(tmp_path / "out")
    # Adjusted ones win; the folder of the key frames will do.
    write_polycam(source, "corrected_images", "corrected_cameras")
    summary = imported(source / "keyframes", tmp_path / "adjusted")
    assert summary.evidence == "corrected_cameras/"
    damaged = source / "keyframes" / "corrected_cameras" / "1001.json"
    damaged.write_text("{}")
    said = refusal([str(source)], tmp_path / "refused", capfd)
    assert "1001.json: t_00 is not a number" in said


# ------------------------------------------------------------------------- LLFF


def write_llff(folder: Path, reduced: int = 1) -> Path:
    rows = []
    for number, pose in enumerate(POSES):
        write_picture(folder / "images" / f"IMG_{number}.jpg", number, 32 * reduced, 24 * reduced)
        down, right, back = pose[:3, 1], pose[:3, 0], -pose[:3, 2]
        hwf = [24.0 * reduced, 32.0 * reduced, 40.0 * reduced]
        matrix = np.stack([down, right, back, pose[:3, 3], hwf], axis=1)
        rows.append([*matrix.ravel(), 0.5 + number, 9.0])
    np.save(folder / "poses_bounds.npy", np.array(rows))
    return folder


def test_llff_is_turned_upright_and_has_units(tmp_path: Path) -> None:
    source = write_llff(tmp_path / "fern")
    summary = imported(source, tmp_path / "out")
    assert (summary.kind, summary.evidence) == ("llff", "poses_bounds.npy")
    assert not summary.is_metric
    assert dict(row for row in summary.table() if len(row) == 2)["poses"].count("units") == 1
    assert any("--scale 2.66667 gives the units of LLFF's own programs" in n for n in summary.notes)
    found = load_reconstruction(tmp_path / "out" / "reconstruction")
    assert found.scale_source == "arbitrary"
    # The same cameras, moved as a whole; the first stands at the origin, upright.
    moved = found.world_from_camera @ np.linalg.inv(POSES)
    np.testing.assert_allclose(moved, np.tile(moved[0], (COUNT, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(found.world_from_camera[0, :3, 3], 0.0, atol=1e-9)
    np.testing.assert_allclose(found.world_from_camera[:, 2, 1], -1.0, atol=1e-9)
    camera = found.cameras[0].intrinsics
    assert (camera.fx, camera.cx, camera.cy) == (40.0, 15.5, 11.5)
    scaled = imported(source, tmp_path / "scaled", scale=2.0)
    assert scaled.is_metric
    doubled = load_reconstruction(tmp_path / "scaled" / "reconstruction").world_from_camera
    np.testing.assert_allclose(doubled[:, :3, 3], 2.0 * found.world_from_camera[:, :3, 3])


def test_llff_with_smaller_photos(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = write_llff(tmp_path / "fern", reduced=4)
    (source / "images" / "IMG_3.jpg").unlink()
    said = refusal([str(source)], tmp_path / "refused", capfd)
    assert "poses_bounds.npy: has 4 poses, but there are photos: 3 in images" in said
    for number in range(COUNT):
        write_picture(source / "images_4" / f"{number}.png", number)
    imported(source, tmp_path / "out")
    (camera,) = load_reconstruction(tmp_path / "out" / "reconstruction").cameras
    assert (camera.width, camera.height, camera.intrinsics.fx) == (32, 24, 40.0)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda path: path.write_bytes(b"text"), "is no array of NumPy"),
        (lambda path: np.save(path, np.zeros((4, 15))), "has shape (4, 15) instead of"),
        (lambda path: np.save(path, np.full((4, 17), np.nan)), "not finite"),
        (lambda path: np.save(path, np.zeros((4, 17))), "singular"),
        (lambda path: np.save(path, np.array([{}]), allow_pickle=True), "is no array of NumPy"),
    ],
)
def test_llff_that_is_damaged(
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    damage: Callable[[Path], object],
    reason: str,
) -> None:
    source = write_llff(tmp_path / "fern")
    damage(source / "poses_bounds.npy")
    assert reason in refusal([str(source)], tmp_path / "out", capfd)


# ------------------------------------------------------------------------- EuRoC

START = 1403636579763555584
SENSOR = """%YAML:1.0
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [{pose}]
rate_hz: 20
resolution: [32, 24]
camera_model: pinhole
intrinsics: [40.0, 42.0, 15.0, 11.5] #fu, fv, cu, cv
distortion_model: {model}
distortion_coefficients: [{distortion}]
"""
BODY_FROM_CAMERA = pose_from_rotation(
    scipy.spatial.transform.Rotation.from_euler("xyz", [0.1, 0.2, 1.5]).as_matrix(),
    [-0.02, -0.06, 0.01],
)


def write_euroc(
    folder: Path, model: str = "radial-tangential", distortion: str = "0.0, 0.0, 0.0, 0.0"
) -> Path:
    camera = folder / "mav0" / "cam0"
    lines = ["#timestamp [ns],filename"]
    for number in range(COUNT):
        time = START + 50_000_000 * number
        write_picture(camera / "data" / f"{time}.png", number)
        lines.append(f"{time},{time}.png")
    (camera / "data.csv").write_text("\r\n".join(lines))
    values = [f"{value:.17g}" for value in BODY_FROM_CAMERA.ravel()]
    pose = ",\n         ".join(", ".join(values[k : k + 4]) for k in range(0, 16, 4))
    text = SENSOR.format(pose=pose, model=model, distortion=distortion)
    (camera / "sensor.yaml").write_text(text)
    return folder


def write_truth(folder: Path, columns: str, times: FloatArray, poses: FloatArray) -> None:
    """Poses of the body, w first, in nanoseconds after the start, with more columns behind."""
    path = folder / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    path.parent.mkdir()
    bodies = poses @ np.linalg.inv(BODY_FROM_CAMERA)
    lines = [columns]
    for time, pose, turned in zip(times, bodies, quaternion_of(bodies), strict=True):
        values = [*pose[:3, 3], *np.roll(turned, 1), 0.1, 0.2, 0.3]
        cells = [str(START + round(time * 1e9)), *(f"{value:.17g}" for value in values)]
        lines.append(",".join(cells))
    path.write_text("\n".join(lines))


COLUMNS = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [],"
    + (" q_RS_z [], v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1]")
)


@pytest.mark.parametrize("inside", [False, True])
def test_euroc(tmp_path: Path, inside: bool) -> None:
    source = write_euroc(tmp_path / "MH_01")
    # The truth begins after the first image.
    write_truth(source, COLUMNS, np.array([0.05, 0.1, 0.15]), POSES[1:])
    summary = imported(source / "mav0" if inside else source, tmp_path / "out")
    assert (summary.kind, summary.images) == ("euroc", COUNT - 1)
    assert "1 images before, after or in gaps of the truth are left out" in summary.notes
    dataset = load_dataset(tmp_path / "out")
    np.testing.assert_allclose(np.diff(dataset.timestamps), 0.05, atol=1e-6)
    assert dataset.timestamps[0] == pytest.approx(START / 1e9 + 0.05, abs=1e-6)
    assert dataset.groundtruth is not None
    assert dataset.camera is not None
    for pose, mine in zip(dataset.groundtruth.poses, POSES[1:], strict=True):
        np.testing.assert_allclose(pose, mine, atol=1e-6)
        np.testing.assert_allclose(
            project(dataset.camera, pose, POINT), expected_pixel(mine), atol=1e-3
        )
    assert "--method poses" in summary.next_command()


def test_euroc_without_list_sensor_or_truth(tmp_path: Path) -> None:
    source = write_euroc(tmp_path / "MH_01")
    (source / "mav0" / "cam0" / "data.csv").write_text("#timestamp [ns],filename\n")
    (source / "mav0" / "cam0" / "sensor.yaml").unlink()
    summary = imported(source, tmp_path / "out")
    assert summary.cameras == ()
    dataset = load_dataset(tmp_path / "out")
    np.testing.assert_allclose(np.diff(dataset.timestamps), 0.05, atol=1e-6)
    assert "--method sfm" in summary.next_command()


@pytest.mark.parametrize(
    ("model", "distortion", "expected"),
    [
        ("radial-tangential", "-0.28, 0.07, 0.0002, 1.8e-05", "OPENCV"),
        ("equidistant", "0.01, 0.02, 0.003, 0.0004", "OPENCV_FISHEYE"),
    ],
)
def test_euroc_cameras(tmp_path: Path, model: str, distortion: str, expected: str) -> None:
    (camera,) = imported(write_euroc(tmp_path / "a", model, distortion), tmp_path / "out").cameras
    assert camera.model == expected
    assert camera.params == (40.0, 42.0, 15.0, 11.5, *map(float, distortion.split(",")))


@pytest.mark.parametrize(
    ("name", "before", "after", "reason"),
    [
        ("cam0/sensor.yaml", "radial-tangential", "fov", "distortion_model 'fov' is unknown"),
        (
            "cam0/sensor.yaml",
            "intrinsics: [40.0,",
            "intrinsics: [a,",
            "intrinsics is not made of 4",
        ),
        ("cam0/sensor.yaml", "resolution", "size", "has no resolution"),
        ("cam0/data.csv", ".png", ".bmp", "is not there"),
        ("cam0/data.csv", f"{START},{START}", f"{START},../{START}", "leads out of"),
    ],
)
def test_euroc_that_is_damaged(
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    name: str,
    before: str,
    after: str,
    reason: str,
) -> None:
    source = write_euroc(tmp_path / "a")
    path = source / "mav0" / name
    path.write_text(path.read_text().replace(before, after))
    assert reason in refusal([str(source)], tmp_path / "out", capfd)
