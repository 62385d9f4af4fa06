"""KITTI, 7-Scenes and videos: sequences that become data sets."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lfnav_cli import common
from lfnav_cli.main import main
from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, OptionError
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.dataset import load_dataset
from pipelines.dataset.images import decode_depth, encode_depth
from pipelines.dataset.importers.kitti import read_kitti
from pipelines.dataset.importers.settings import ImportSettings
from pipelines.dataset.pairing import poses_at_images
from pipelines.reconstruct.import_description import ImportSummary
from pipelines.reconstruct.import_stage import import_source
from pipelines.reconstruct.reconstruction import load_reconstruction
from tests.import_samples import project, refusal, write_picture

# Left colour camera: 6 cm to the left of camera 0, as in the benchmark.
P2 = np.array([[40.0, 0.0, 15.0, 2.4], [0.0, 40.0, 11.0, 0.1], [0.0, 0.0, 1.0, 0.003]])


def imported(source: Path, output: Path, **options: object) -> ImportSummary:
    settings = ImportSettings(**options)  # type: ignore[arg-type]
    return import_source(source, output, settings, overwrite=False, progress=no_progress)


# ---------------------------------------------------------------------------- KITTI


def kitti_poses(count: int) -> FloatArray:
    """A car that drives ahead (z) and turns right about its down axis (y)."""
    poses = np.zeros((count, 3, 4))
    for index in range(count):
        turn = 0.1 * index
        poses[index, :, :3] = [
            [np.cos(turn), 0.0, np.sin(turn)],
            [0.0, 1.0, 0.0],
            [-np.sin(turn), 0.0, np.cos(turn)],
        ]
        poses[index, :, 3] = (0.05 * index, -0.01 * index, 1.0 * index)
    return poses


def write_kitti(root: Path, count: int = 5, sequence: str = "03") -> Path:
    folder = root / "sequences" / sequence
    for index in range(count):
        write_picture(folder / "image_2" / f"{index:06d}.png", index)
    lines = [f"P{k}: " + " ".join(f"{v:e}" for v in (P2 * (k == 2)).ravel()) for k in range(4)]
    (folder / "calib.txt").write_text("\n".join(lines) + "\n")
    (folder / "times.txt").write_text("".join(f"{0.1 * k:e}\n" for k in range(count)))
    (root / "poses").mkdir(exist_ok=True)
    rows = [" ".join(f"{v:.9e}" for v in pose.ravel()) for pose in kitti_poses(count)]
    (root / "poses" / f"{sequence}.txt").write_text("\n".join(rows) + "\n")
    return folder


def test_kitti_points_land_where_its_projection_matrix_says(tmp_path: Path) -> None:
    folder = write_kitti(tmp_path / "kitti")
    summary = imported(folder, tmp_path / "out")
    data = load_dataset(tmp_path / "out")
    assert data.camera is not None
    assert data.groundtruth is not None
    bodies = poses_at_images(data, data.groundtruth, "groundtruth.txt")
    for index, pose in enumerate(kitti_poses(5)):
        in_first_camera = pose[:, :3] @ [0.4, -0.3, 6.0] + pose[:, 3]
        x, y, z = P2 @ [0.4, -0.3, 6.0, 1.0]
        # REP-103 above the road: forward is z, left is -x, up is -y, the camera 1.65 m up.
        right, down, forward = in_first_camera
        world = np.array([forward, -right, 1.65 - down])
        found = project(data.camera, bodies[index] @ data.body_from_camera, world)
        np.testing.assert_allclose(found, [x / z, y / z], atol=1e-5)
    # The body is the road below the camera.
    assert bodies[0, 2, 3] == pytest.approx(0.0, abs=0.01)
    np.testing.assert_allclose(data.timestamps, 0.1 * np.arange(5))
    assert data.read_image_bytes(3) == (folder / "image_2" / "000003.png").read_bytes()
    # The next command that is printed works.
    arguments = summary.next_command().replace(" map ", f" {tmp_path}/map ").split()[1:]
    assert common.run_command(main, arguments) == 0
    content = load_reconstruction(tmp_path / "map")
    np.testing.assert_allclose(content.world_from_camera, bodies @ data.body_from_camera, atol=1e-9)


def test_kitti_from_its_root_thinned_and_without_poses(tmp_path: Path) -> None:
    root = tmp_path / "kitti"
    write_kitti(root, sequence="03")
    write_kitti(root, sequence="11")
    (root / "poses" / "11.txt").unlink()
    with pytest.raises(OptionError, match="03, 11"):
        read_kitti(root, ImportSettings())
    summary = imported(root, tmp_path / "out", sequence="11", every=2, camera_height=1.2)
    data = load_dataset(tmp_path / "out")
    assert data.image_names == tuple(f"rgb/00000{k}.png" for k in (0, 2, 4))
    assert data.groundtruth is None
    assert data.body_from_camera[2, 3] == 1.2
    assert summary.next_command().endswith("--method sfm")


def test_kitti_images_may_be_part_of_the_sequence(tmp_path: Path) -> None:
    folder = write_kitti(tmp_path)
    for index in (0, 1, 3):
        (folder / "image_2" / f"{index:06d}.png").unlink()
    recording = read_kitti(folder, ImportSettings())
    assert [frame.timestamp for frame in recording.frames] == pytest.approx([0.2, 0.4])
    assert recording.world_from_camera is not None
    # Body 2 drove 2 m ahead and 0.1 m to the right, and its camera is 6 cm to the left.
    steps = np.diff(recording.world_from_camera[:, :3, 3], axis=0)
    assert steps[0, 0] == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("calib.txt", "P0: 1 2 3", "holds no P2"),
        ("calib.txt", "P2: 1 2 3", "3 values instead of 12"),
        ("calib.txt", "P2: " + "1 " * 12, "rectified"),
        ("calib.txt", "P2: -1 0 0 0 0 1 0 0 0 0 1 0", "not positive"),
        ("times.txt", "0.0\n0.1\n", "has 2 lines, but there is an image number 4"),
        ("times.txt", "0\n1\n1\n2\n3\n", "do not increase"),
        ("times.txt", "0\n1\nnan\n2\n3\n", "line 3"),
        ("../../poses/03.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "has 1 lines"),
        ("../../poses/03.txt", ("1 " * 12 + "\n") * 5, "line 1 is singular"),
        ("../../poses/03.txt", "\xff", "values instead of 12"),
    ],
)
def test_kitti_refuses_what_is_damaged(
    tmp_path: Path, name: str, text: str, reason: str, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = write_kitti(tmp_path / "kitti")
    (folder / name).write_text(text)
    assert reason in refusal([str(folder)], tmp_path / "out", capfd)


# ---------------------------------------------------------------------------- 7-Scenes


def write_scene(folder: Path, count: int = 3) -> FloatArray:
    """Frames of 640 x 480; the depth is row + column, 65535 in the first column."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    rows, columns = np.mgrid[0:480, 0:640]
    depth = (rows + columns + 1).astype(np.uint16)
    depth[:, 0] = 65535
    for index in range(count):
        stem = folder / f"frame-{index:06d}"
        write_picture(Path(f"{stem}.color.png"), index, 640, 480)
        Path(f"{stem}.depth.png").write_bytes(encode_depth(depth))
        poses[index, :3, 3] = (0.1 * index, 0.2, 0.3)
        text = "\n".join("\t ".join(f"{v:.8e}" for v in row) for row in poses[index])
        Path(f"{stem}.pose.txt").write_text(text + "\t\n")
    return poses


def test_seven_scenes_depth_poses_and_camera(tmp_path: Path) -> None:
    poses = write_scene(tmp_path / "seq-01")
    summary = imported(tmp_path / "seq-01", tmp_path / "out")
    data = load_dataset(tmp_path / "out")
    assert summary.kind == "7scenes"
    assert any("--upright" in note for note in summary.notes)  # z of this world is no up
    assert data.camera is not None
    assert data.camera.intrinsics.vector().tolist() == [585.0, 585.0, 320.0, 240.0]
    assert data.groundtruth is not None
    np.testing.assert_allclose(data.groundtruth.poses, poses, atol=1e-8)
    np.testing.assert_allclose(data.timestamps, np.arange(3) / 30.0, atol=1e-9)
    assert data.depth_scale == 1000.0
    assert data.depth_names is not None
    name = data.depth_names[1]
    assert name is not None
    depth = decode_depth((data.root / name).read_bytes(), name)
    assert np.all(depth[:, 0] == 0)
    assert depth[7, 9] == 17
    assert depth.shape == (480, 640)


def test_seven_scenes_upright_and_another_focal_length(tmp_path: Path) -> None:
    write_scene(tmp_path / "seq-01")
    imported(tmp_path / "seq-01", tmp_path / "out", upright=True, focal=525.0, every=2)
    data = load_dataset(tmp_path / "out")
    assert data.camera is not None
    assert data.camera.intrinsics.fx == 525.0
    assert data.groundtruth is not None
    # Cameras along z, down along y: forward becomes x, down -z; the first is the origin.
    np.testing.assert_allclose(
        data.groundtruth.poses[:, :3, 3], [[0.0, 0.0, 0.0], [0.0, -0.2, 0.0]], atol=1e-8
    )
    np.testing.assert_allclose(data.groundtruth.poses[0, :3, 1], [0.0, 0.0, -1.0], atol=1e-8)


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        ("frame-000001.pose.txt", None, "frame-000001.pose.txt: does not exist"),
        ("frame-000001.pose.txt", b"1 0 0 0\n" * 4, "last row"),
        ("frame-000001.pose.txt", b"-inf " * 4 + b"\n", "not finite"),
        ("frame-000001.color.png", b"\x89PNG", "frame-000001.color.png"),
        ("frame-000001.depth.png", b"no image", "frame-000001.depth.png"),
    ],
)
def test_seven_scenes_refuses_what_is_damaged(
    tmp_path: Path, name: str, data: bytes | None, reason: str, capfd: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "seq-01"
    write_scene(source)
    (source / name).unlink()
    if data is not None:
        (source / name).write_bytes(data)
    assert reason in refusal([str(source)], tmp_path / "out", capfd)


def test_seven_scenes_depth_of_another_size_is_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    write_scene(tmp_path / "s")
    small = encode_depth(np.ones((24, 32), dtype=np.uint16))
    (tmp_path / "s" / "frame-000002.depth.png").write_bytes(small)
    error = refusal([str(tmp_path / "s")], tmp_path / "out", capfd)
    assert "frame-000002.depth.png: is 32x24 pixels" in error


# ---------------------------------------------------------------------------- video


# In a process of its own: once OpenCV has used FFmpeg for writing, its talk cannot be switched off.
WRITE_VIDEO = """
import json, sys
import cv2, numpy as np
writer = cv2.VideoWriter(sys.argv[1], cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 48))
assert writer.isOpened()
for color in json.loads(sys.argv[2]):
    writer.write(np.full((48, 64, 3), color, dtype=np.uint8))
writer.release()
"""


def write_video(path: Path, colors: list[tuple[int, int, int]]) -> None:
    """25 frames a second of one colour each, blue, green, red."""
    subprocess.run([sys.executable, "-c", WRITE_VIDEO, str(path), json.dumps(colors)], check=True)


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("video") / "drive.avi"
    write_video(path, [(8 * index,) * 3 for index in range(25)])  # frame k is grey of level 8 k
    return path


@pytest.mark.parametrize(
    ("options", "indices"),
    [
        ({}, range(25)),
        ({"every": 10}, (0, 10, 20)),
        ({"fps": 5.0}, (0, 5, 10, 15, 20)),
        ({"fps": 100.0}, range(25)),
        ({"max_frames": 25}, range(25)),
        ({"every": 2, "max_frames": 3}, (0, 2, 4)),
    ],
)
def test_video_frames_are_those_asked_for(
    tmp_path: Path, video: Path, options: dict[str, float], indices: tuple[int, ...]
) -> None:
    summary = imported(video, tmp_path / "out", **options)
    data = load_dataset(tmp_path / "out")
    assert data.image_names == tuple(f"rgb/{index:06d}.jpg" for index in indices)
    np.testing.assert_allclose(data.timestamps, np.array(indices) / 25.0, atol=1e-6)
    levels = [data.read_image(k).mean() for k in range(len(data))]
    np.testing.assert_allclose(levels, 8.0 * np.array(indices), atol=2.0)
    assert data.camera is None
    stopped = any("--max-frames" in note for note in summary.notes)
    assert stopped == (len(options) == 2)


def test_video_colours_png_and_a_camera(tmp_path: Path) -> None:
    path = tmp_path / "red.avi"
    write_video(path, [(0, 0, 200)] * 3)
    imported(path, tmp_path / "out", image_format="png", fov=90.0)
    data = load_dataset(tmp_path / "out")
    assert data.image_names[0].endswith(".png")
    red, green, blue = data.read_image(0).reshape(-1, 3).mean(axis=0)
    assert red > 180.0
    assert max(green, blue) < 30.0
    assert data.camera is not None
    assert data.camera.params == pytest.approx((32.0, 31.5, 23.5))


def test_a_video_that_breaks_off_says_so(tmp_path: Path, video: Path) -> None:
    data = video.read_bytes()
    (tmp_path / "cut.avi").write_bytes(data[: len(data) // 2])
    summary = imported(tmp_path / "cut.avi", tmp_path / "out")
    assert 0 < summary.images < 25
    assert "of the 25 stated frames could be decoded" in summary.notes[0]


@pytest.mark.parametrize(
    "content", [b"", b"this is no video" * 500, b"RIFF\xff\xff\xff\xffAVI LIST"]
)
def test_a_video_that_cannot_be_decoded_is_one_line(
    tmp_path: Path, content: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "drive.mp4").write_bytes(content)
    error = refusal([str(tmp_path / "drive.mp4")], tmp_path / "out", capfd)
    assert "drive.mp4: is no video, is damaged" in error


def test_a_video_whose_frames_are_all_damaged_is_one_line(
    tmp_path: Path, video: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    data = video.read_bytes()
    start = data.index(b"movi")
    (tmp_path / "noise.avi").write_bytes(data[:start] + b"\x5a" * (len(data) - start))
    assert "noise.avi" in refusal([str(tmp_path / "noise.avi")], tmp_path / "out", capfd)


def test_the_library_raises_and_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "drive.mp4").write_bytes(b"x" * 100)
    with pytest.raises(InputError):
        imported(tmp_path / "drive.mp4", tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["drive.mp4"]
