"""Data sets: what is right loads, what is wrong is one line that names the file and the reason."""

import json
import logging
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipelines.artifacts.arrays import ImageArray
from pipelines.artifacts.errors import InputError
from pipelines.dataset.dataset import Dataset, load_dataset
from pipelines.dataset.description import describe_dataset
from pipelines.dataset.images import encode_jpeg, encode_png
from pipelines.dataset.pairing import pair_images, poses_at_images
from pipelines.geometry.trajectory import Trajectory, read_tum

ROOT = Path(__file__).parents[2]
SAMPLES = ROOT / "sample_data"
HOLOLENS = ROOT.parent / "shared" / "data" / "hololens"
CAMERA = """
model = "PINHOLE"
width = 16
height = 12
params = [20.0, 21.0, 7.5, 5.5]
depth_scale = 5000
[mount]
x = 0.1
y = 0.2
z = 1.0
roll = 0.0
pitch = 0.0
yaw = 90.0
"""
TUM = "{time} {x} 0 0 0 0 0 1\n"


def picture(number: int, height: int = 12, width: int = 16) -> ImageArray:
    return np.full((height, width, 3), 10 * number, dtype=np.uint8)


@pytest.fixture(autouse=True)
def _warnings_are_said(caplog: pytest.LogCaptureFixture) -> None:
    # Commands with --quiet, which other tests run, silence the library.
    caplog.set_level(logging.WARNING, logger="pipelines")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four images at 0.5, 1.0, 1.5, 2.0 s with camera, odometry and ground truth."""
    root = tmp_path / "set"
    (root / "rgb").mkdir(parents=True)
    times = [0.5, 1.0, 1.5, 2.0]
    for number in range(len(times)):
        (root / "rgb" / f"{number}.png").write_bytes(encode_png(picture(number)))
    lines = [f"{time} rgb/{number}.png\n" for number, time in enumerate(times)]
    (root / "rgb.txt").write_text("# timestamp filename\n" + "".join(lines))
    (root / "camera.toml").write_text(CAMERA)
    for name in ("odometry.txt", "groundtruth.txt"):
        poses = "".join(TUM.format(time=time, x=2 * time) for time in times)
        (root / name).write_text("# timestamp tx ty tz qx qy qz qw\n" + poses)
    return root


def refused(folder: Path, named: Path, reason: str) -> None:
    """Loading fails with one line that names the file and the reason."""
    with pytest.raises(InputError, match=reason) as caught:
        load_dataset(folder)
    assert str(caught.value).startswith(f"{named}: ")
    assert "\n" not in str(caught.value)


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


# --- what is right -----------------------------------------------------------------------------


def test_everything_is_read(folder: Path) -> None:
    dataset = load_dataset(folder)
    assert dataset.image_names == ("rgb/0.png", "rgb/1.png", "rgb/2.png", "rgb/3.png")
    np.testing.assert_array_equal(dataset.timestamps, [0.5, 1.0, 1.5, 2.0])
    assert dataset.camera is not None
    assert dataset.camera.params == (20.0, 21.0, 7.5, 5.5)
    assert dataset.depth_scale == 5000.0
    assert dataset.depth_names is None
    assert dataset.odometry is not None
    assert dataset.groundtruth is not None
    np.testing.assert_allclose(dataset.odometry.poses[:, 0, 3], [1.0, 2.0, 3.0, 4.0])
    assert dataset.image_path(2) == folder / "rgb" / "2.png"
    np.testing.assert_array_equal(dataset.read_image(2), picture(2))
    assert dataset.read_image_bytes(2) == (folder / "rgb" / "2.png").read_bytes()


def test_the_mount_says_where_the_camera_looks(folder: Path) -> None:
    # Turned left by 90 degrees on the robot: the optical axis points along the base's y axis.
    body_from_camera = load_dataset(folder).body_from_camera
    np.testing.assert_allclose(body_from_camera @ [0, 0, 1, 0], [0, 1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(body_from_camera[:3, 3], [0.1, 0.2, 1.0])


def test_without_a_mount_the_body_is_the_camera(folder: Path) -> None:
    (folder / "camera.toml").write_text(CAMERA.split("[mount]", maxsplit=1)[0])
    dataset = load_dataset(folder)
    assert dataset.base_from_camera is None
    np.testing.assert_array_equal(dataset.body_from_camera, np.eye(4))


def test_other_trajectories_can_be_given(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.txt"
    other.write_text(TUM.format(time=0.5, x=7))
    dataset = load_dataset(folder, odometry=other, groundtruth=other)
    for trajectory in (dataset.odometry, dataset.groundtruth):
        assert trajectory is not None
        assert trajectory.poses[0, 0, 3] == 7.0
    with pytest.raises(InputError, match=r"nowhere\.txt"):
        load_dataset(folder, odometry=tmp_path / "nowhere.txt")


def test_a_sequence_of_the_tum_benchmark_loads_as_it_is(tmp_path: Path) -> None:
    # Times with microseconds, comments, other rates for everything, no camera.toml.
    (tmp_path / "rgb").mkdir()
    (tmp_path / "depth").mkdir()
    names = ["1305031102.175304", "1305031102.211214", "1305031102.243211"]
    for name in names:
        (tmp_path / "rgb" / f"{name}.png").write_bytes(encode_png(picture(1)))
    for name in ("1305031102.160407", "1305031102.226738"):
        (tmp_path / "depth" / f"{name}.png").write_bytes(encode_png(picture(1)))
    header = "# color images\n# file: 'rgbd_dataset_freiburg1_xyz.bag'\n# timestamp filename\n"
    (tmp_path / "rgb.txt").write_text(header + "".join(f"{n} rgb/{n}.png\n" for n in names))
    (tmp_path / "depth.txt").write_text(
        header
        + "1305031102.160407 depth/1305031102.160407.png\n"
        + "1305031102.226738 depth/1305031102.226738.png\n"
    )
    (tmp_path / "groundtruth.txt").write_text(
        "# ground truth trajectory\n"
        "1305031102.1758 1.3405 0.6266 1.6575 0.6574 0.6126 -0.2949 -0.3248\n"
        "1305031102.2114 1.3303 0.6256 1.6464 0.6579 0.6161 -0.2932 -0.3189\n"
        "1305031102.2414 1.3160 0.6254 1.6302 0.6609 0.6199 -0.2893 -0.3086\n"
    )
    dataset = load_dataset(tmp_path)
    assert dataset.camera is None
    assert dataset.depth_names == (
        "depth/1305031102.160407.png",
        "depth/1305031102.226738.png",
        "depth/1305031102.226738.png",
    )
    assert dataset.groundtruth is not None
    poses = poses_at_images(dataset, dataset.groundtruth, "groundtruth.txt")
    # Before the first and behind the last pose, within 0.02 s, it is that pose.
    between = np.interp(1305031102.211214, dataset.groundtruth.timestamps[:2], [1.3405, 1.3303])
    np.testing.assert_allclose(poses[:, 0, 3], [1.3405, between, 1.3160])


def test_a_depth_image_that_is_too_far_in_time_is_none(folder: Path) -> None:
    (folder / "depth.txt").write_text("0.51 rgb/0.png\n1.03 rgb/1.png\n")
    assert load_dataset(folder).depth_names == ("rgb/0.png", None, None, None)


@pytest.mark.parametrize("where", [".", "images"])
def test_a_plain_folder_of_images_is_in_natural_order(tmp_path: Path, where: str) -> None:
    images = tmp_path / where
    images.mkdir(exist_ok=True)
    names = ["img1.jpg", "IMG2.JPG", "img10.jpeg", "img011.png", "img100.PNG"]
    for name in names:
        encode = encode_png if name.lower().endswith("png") else encode_jpeg
        (images / name).write_bytes(encode(picture(1)))
    for other in ("notes.txt", ".hidden.png", "readme.md"):
        (images / other).write_text("no image")
    (tmp_path / "sparse").mkdir()
    dataset = load_dataset(tmp_path)
    assert [Path(name).name for name in dataset.image_names] == names
    assert dataset.image_path(0).is_file()
    np.testing.assert_array_equal(dataset.timestamps, [0.0, 1.0, 2.0, 3.0, 4.0])
    assert dataset.camera is None
    assert dataset.odometry is None
    (tmp_path / "camera.toml").write_text(CAMERA)
    assert load_dataset(tmp_path).camera is not None


@pytest.mark.parametrize(
    ("name", "images"),
    [("elevators/map", 28), ("elevators/test", 20), ("workshop/map", 40), ("workshop/test", 25)],
)
def test_the_sample_data_loads(name: str, images: int) -> None:
    dataset = load_dataset(SAMPLES / name)
    assert len(dataset) == images
    assert dataset.camera is not None
    assert (dataset.camera.width, dataset.camera.height) == (640, 480)
    # A horizontal field of view of 58 degrees.
    assert dataset.camera.intrinsics.fx == pytest.approx(320 / np.tan(np.deg2rad(29)))
    assert dataset.read_image(0).shape == (480, 640, 3)
    for trajectory in (dataset.odometry, dataset.groundtruth):
        assert trajectory is not None
        assert poses_at_images(dataset, trajectory, name).shape == (images, 4, 4)
    if name == "workshop/map":
        assert dataset.base_from_camera is None
    else:
        # The camera looks ahead from 1 m above the base.
        np.testing.assert_allclose(
            dataset.body_from_camera,
            [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 1], [0, 0, 0, 1]],
            atol=1e-12,
        )


@pytest.mark.skipif(not HOLOLENS.is_dir(), reason="the hololens data set is not here")
def test_a_real_recording_loads() -> None:
    dataset = load_dataset(HOLOLENS / "test")
    assert len(dataset) == 93
    assert dataset.read_image(0).shape == (240, 360, 3)
    assert dataset.depth_scale == 1000.0
    assert dataset.depth_names is not None
    assert None not in dataset.depth_names


# --- folders that are wrong --------------------------------------------------------------------


def test_a_missing_folder(tmp_path: Path) -> None:
    refused(tmp_path / "nowhere", tmp_path / "nowhere", "does not exist")
    refused(tmp_path / ("x" * 300), tmp_path / ("x" * 300), "cannot be read")


def test_an_empty_folder(tmp_path: Path) -> None:
    refused(tmp_path, tmp_path, r"holds no rgb\.txt and no images")


def test_a_file_instead_of_a_folder(tmp_path: Path) -> None:
    for name, reason in (
        ("drive.MP4", "is a video.*lfnav import drive.MP4"),
        ("a.txt", "is a file"),
    ):
        (tmp_path / name).write_bytes(b"data")
        refused(tmp_path / name, tmp_path / name, reason)


def test_images_in_several_folders(tmp_path: Path) -> None:
    for name in ("left", "right"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "0.png").write_bytes(encode_png(picture(0)))
    refused(tmp_path, tmp_path, r"several folders \(left, right\); give one of them")


def test_made_up_times_are_not_paired_with_recorded_ones(folder: Path) -> None:
    (folder / "rgb.txt").unlink()
    refused(folder, folder, r"holds odometry\.txt but no rgb\.txt")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read all")
def test_a_folder_without_permission(folder: Path) -> None:
    folder.chmod(0)
    try:
        refused(folder, folder, "no permission")
    finally:
        folder.chmod(0o755)


# --- image lists that are wrong ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("2.0 rgb/missing.png", r"line 5: 'rgb/missing\.png' is not there"),
        ("2.0 " + "x" * 300, r"line 5: 'x+'\.\.\. is not there"),
        ("2.0 .", r"line 5: '\.' is not there"),
        ("2.0 ../secret.png", r"line 5: '\.\./secret\.png' leads out of the data set's folder"),
        ("2.0 rgb/../../secret.png", "line 5: .* leads out"),
        ("2.0 /etc/passwd", "line 5: '/etc/passwd' leads out"),
        ("2.0 a\x00b.png", "line 5: .* is not a file name"),
        ("2.0", "line 5: not of the form: timestamp filename"),
        ("two rgb/3.png", "line 5: 'two' is not a timestamp"),
        ("nan rgb/3.png", "line 5: the timestamp nan is not finite"),
        ("inf rgb/3.png", "line 5: the timestamp inf is not finite"),
        ("1.5 rgb/3.png", "line 5: time 1.500000 does not come after 1.500000"),
        ("1.0 rgb/3.png", "line 5: time 1.000000 does not come after 1.500000"),
    ],
)
def test_a_line_that_is_wrong(folder: Path, line: str, reason: str) -> None:
    (folder.parent / "secret.png").write_bytes(encode_png(picture(0)))
    edit(folder / "rgb.txt", "2.0 rgb/3.png", line)
    refused(folder, folder / "rgb.txt", reason)


def test_a_list_without_images(folder: Path) -> None:
    (folder / "rgb.txt").write_text("# timestamp filename\n\n")
    refused(folder, folder / "rgb.txt", "names no image")


def test_a_list_that_is_no_text(folder: Path) -> None:
    (folder / "rgb.txt").write_bytes(b"\xff\x00")
    refused(folder, folder / "rgb.txt", "is no text in UTF-8")


def test_lists_are_forgiving_about_form(folder: Path) -> None:
    (folder / "rgb" / "a b.png").write_bytes(encode_png(picture(0)))
    (folder / "rgb.txt").write_bytes(
        b"\xef\xbb\xbf#comment\r\n\r\n  0.5\t./rgb/0.png \r\n1.0 rgb/a b.png"
    )
    assert load_dataset(folder).image_names == ("rgb/0.png", "rgb/a b.png")


def test_an_image_may_be_named_several_times(folder: Path) -> None:
    # A robot that stands, or sees the same once more.
    lines = ["0.5 rgb/1.png", "1.0 ./rgb/1.png", "1.5 rgb/0.png", "2.0 rgb/1.png"]
    (folder / "rgb.txt").write_text("\n".join(lines))
    dataset = load_dataset(folder)
    assert dataset.image_names == ("rgb/1.png", "rgb/1.png", "rgb/0.png", "rgb/1.png")
    assert np.array_equal(dataset.read_image(0), dataset.read_image(3))


LIST = ["0.5 rgb/0.png", "1.0 rgb/1.png", "1.5 rgb/2.png", "2.0 rgb/3.png"]


@pytest.mark.parametrize(
    "content",
    [
        "timestamp,filename\r\n" + "\r\n".join(LIST).replace(" ", ","),
        "#timestamp [s]\tfilename\n" + "\n".join(LIST).replace(" ", "\t"),
        "% made by a tool\n\n" + "\n".join(LIST).replace(" ", " ; "),
        "// by hand\r" + "\r".join(LIST),
    ],
)
def test_a_list_with_other_separators_and_comments(folder: Path, content: str) -> None:
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        (folder / "rgb.txt").write_bytes(content.encode(encoding))
        dataset = load_dataset(folder)
        assert dataset.image_names == tuple(line.split()[1] for line in LIST)
        assert dataset.timestamps.tolist() == [0.5, 1.0, 1.5, 2.0]


@pytest.mark.parametrize(
    ("header", "unit"),
    [("#timestamp [ns],filename", 10**9), ("time_us name", 10**6), ("# stamp (ms)", 10**3)],
)
def test_a_list_whose_header_names_the_unit_of_time(
    folder: Path, header: str, unit: int, caplog: pytest.LogCaptureFixture
) -> None:
    lines = [f"{round(float(line.split()[0]) * unit)} {line.split()[1]}" for line in LIST]
    (folder / "rgb.txt").write_text("\n".join([header, *lines]))
    assert load_dataset(folder).timestamps.tolist() == [0.5, 1.0, 1.5, 2.0]
    assert not caplog.messages


@pytest.mark.parametrize(("unit", "name"), [(9, "nano"), (6, "micro"), (3, "milli")])
@pytest.mark.parametrize("start", [1403636579.0, 1735689600.0])
def test_times_since_1970_that_cannot_be_seconds(
    folder: Path, unit: int, name: str, start: float, caplog: pytest.LogCaptureFixture
) -> None:
    times = [start + 0.5 * index for index in range(4)]
    lines = [f"{round(time * 10**unit)} rgb/{index}.png" for index, time in enumerate(times)]
    (folder / "rgb.txt").write_text("\n".join(lines))
    poses = "".join(TUM.format(time=time, x=2.0 * index) for index, time in enumerate(times))
    (folder / "odometry.txt").write_text(poses)
    dataset = load_dataset(folder)
    np.testing.assert_allclose(dataset.timestamps, times, atol=1e-6)
    assert dataset.odometry is not None
    found = poses_at_images(dataset, dataset.odometry, "odometry.txt")
    np.testing.assert_allclose(found[:, 0, 3], [0.0, 2.0, 4.0, 6.0], atol=1e-5)
    (said,) = caplog.messages
    assert said == f"{folder / 'rgb.txt'}: times are taken for {name}seconds"


def test_times_that_look_like_milliseconds_are_named_where_nothing_pairs(folder: Path) -> None:
    lines = [f"{round(1000 * float(line.split()[0]))} {line.split()[1]}" for line in LIST]
    (folder / "rgb.txt").write_text("\n".join(lines))
    dataset = load_dataset(folder)
    assert dataset.odometry is not None
    with pytest.raises(InputError, match="those of the images look like milliseconds"):
        poses_at_images(dataset, dataset.odometry, "odometry.txt")


def test_a_damaged_truth_stops_only_what_needs_it(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (folder / "groundtruth.txt").write_text("0.5 1 2 3\n")
    dataset = load_dataset(folder)
    assert dataset.groundtruth is None
    assert "groundtruth.txt: line 1: 4 values" in caplog.messages[0]
    with pytest.raises(InputError, match=r"groundtruth\.txt: line 1: 4 values"):
        dataset.true_poses()
    with pytest.raises(InputError, match=r"groundtruth\.txt: line 1: 4 values"):
        load_dataset(folder, groundtruth=folder / "groundtruth.txt")
    (folder / "groundtruth.txt").unlink()
    with pytest.raises(InputError, match=r"groundtruth\.txt: is missing"):
        load_dataset(folder).true_poses()


def test_odometry_for_which_there_is_no_use_is_not_read(folder: Path) -> None:
    (folder / "odometry.txt").write_text("nonsense\n")
    assert load_dataset(folder, reads_odometry=False).odometry is None
    refused(folder, folder / "odometry.txt", "line 1: 1 values instead of 8")


# --- images that are wrong ---------------------------------------------------------------------


def test_a_truncated_jpeg_is_named_when_it_is_read(folder: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (12, 16, 3)).astype(np.uint8)
    data = encode_jpeg(noise)
    (folder / "rgb" / "1.png").write_bytes(data[:-100])
    dataset = load_dataset(folder)
    with pytest.raises(InputError, match=r"1\.png: is a damaged or truncated image"):
        dataset.read_image(1)


@pytest.mark.parametrize(
    ("content", "reason"),
    [(b"a text, really", "neither a JPEG, PNG, TIFF nor WebP"), (b"", "is empty")],
)
def test_what_is_no_image_is_named(folder: Path, content: bytes, reason: str) -> None:
    (folder / "rgb" / "2.png").write_bytes(content)
    refused(folder, folder / "rgb" / "2.png", reason)


def test_an_image_of_another_size_than_the_camera(folder: Path) -> None:
    (folder / "rgb" / "2.png").write_bytes(encode_png(picture(0, 16, 12)))
    refused(folder, folder / "rgb" / "2.png", r"is 12x16 pixels, camera\.toml says 16x12")


def test_images_of_different_sizes(folder: Path) -> None:
    (folder / "camera.toml").unlink()
    (folder / "rgb" / "2.png").write_bytes(encode_png(picture(0, 16, 14)))
    refused(folder, folder / "rgb" / "2.png", r"is 14x16 pixels, rgb/0\.png is 16x12")


def test_an_image_that_changes_after_loading(folder: Path) -> None:
    dataset = load_dataset(folder)
    (folder / "rgb" / "2.png").write_bytes(encode_png(picture(0, 16, 12)))
    with pytest.raises(InputError, match=r"2\.png: is 12x16 pixels"):
        dataset.read_image(2)
    (folder / "rgb" / "2.png").unlink()
    with pytest.raises(InputError, match=r"2\.png: cannot be read"):
        dataset.read_image(2)


# --- trajectories that are wrong ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("1.0 0 0 0 0 0 0 2", "line 3: the quaternion has length 2.0000"),
        ("1.0 0 0 0 0 0 0 0.5", "line 3: the quaternion has length 0.5000"),
        ("1.0 0 0 0 0 0 0 one", "line 3: 'one' is not a number"),
        ("1.0 " + "0 " * 11 + "1", "line 3: 13 values .*begin with a line that names the columns"),
        ("1.0 " + "0 " * 11, "line 3: 12 values .*matrices without times"),
        ("0.5 0 0 0 0 0 0 1", "line 3: time 0.500000 does not come after 0.500000"),
        ("1.0 0 0 0 0 0 1", "line 3: 7 values instead of 8"),
    ],
)
def test_a_pose_that_is_wrong(folder: Path, line: str, reason: str) -> None:
    edit(folder / "odometry.txt", TUM.format(time=1.0, x=2.0).strip(), line)
    refused(folder, folder / "odometry.txt", reason)


def trajectory_at(times: list[float]) -> Trajectory:
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, 0, 3] = times
    return Trajectory(np.array(times), poses)


@pytest.fixture
def dataset(folder: Path) -> Dataset:
    return load_dataset(folder)


def test_poses_are_those_at_the_time_of_the_image(dataset: Dataset) -> None:
    # The last is the one of the end, which is 0.015 s from the image.
    times = [0.3, 0.49, 0.505, 0.99, 1.2, 1.515, 1.985]
    found = pair_images(dataset, trajectory_at(times), "a/odometry.txt")
    np.testing.assert_allclose(found.world_from_body[:, 0, 3], [0.5, 1.0, 1.5, 1.985])
    (note,) = found.notes
    assert note == "odometry.txt begins or ends 0.015 s from an image, which takes the pose there"


def test_images_without_a_pose_are_left_out_and_counted(dataset: Dataset) -> None:
    trajectory = trajectory_at([0.9, 1.1, 1.3, 1.9])
    found = pair_images(dataset, trajectory, "a/odometry.txt")
    assert found.image_index.tolist() == [1]
    assert found.left_out == {
        0: "time 0.500000 lies before the first pose of odometry.txt (0.900000)",
        2: "time 1.500000 lies in a gap of odometry.txt of 0.600 s, and --max-gap is 0.2 s",
        3: "time 2.000000 lies after the last pose of odometry.txt (1.900000)",
    }
    assert found.notes == (
        "3 of 4 images are left out: 2 before the first or after the last pose of odometry.txt, 1 "
        "in gaps of odometry.txt longer than 0.2 s",
    )
    part = dataset.part(found.image_index.tolist())
    assert part.image_names == ("rgb/1.png",)
    assert part.timestamps.tolist() == [1.0]
    wide = pair_images(dataset, trajectory, "a/odometry.txt", max_gap=0.6)
    assert wide.image_index.tolist() == [1, 2]


@pytest.mark.parametrize(
    ("times", "reason"),
    [
        ([0.5, 1.0, 2.0], "has no pose for 1 of 4 images: of rgb/2.png the time 1.500000 lies in"),
        ([0.5], "has no pose for 3 of 4 images: of rgb/1.png the time 1.000000 lies after"),
        ([10.0, 10.5], "none of its poses lies within 0.02 s of an image"),
        ([0.5, 1.03, 1.5, 2.0], "has no pose for 1 of 4 images: of rgb/1.png"),
    ],
)
def test_times_that_do_not_pair(dataset: Dataset, times: list[float], reason: str) -> None:
    with pytest.raises(InputError, match=f"odometry.txt: {re.escape(reason)}"):
        poses_at_images(dataset, trajectory_at(times), "odometry.txt")


# --- camera files that are wrong ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('model = "PINHOLE"', "", "model is missing"),
        ("width = 16", "", "width is missing"),
        ("params = [20.0, 21.0, 7.5, 5.5]", "", "params is missing"),
        ("20.0, 21.0", "-20.0, 21.0", "focal length fx = -20 is not positive"),
        ("20.0, 21.0", "0.0, 21.0", "focal length fx = 0 is not positive"),
        ("20.0, 21.0", "nan, 21.0", "params: nan is not finite"),
        ("20.0, 21.0", "20.0, inf", "params: inf is not finite"),
        ("20.0, 21.0", "1" + "0" * 400 + ", 21.0", "params: 10+ is not finite"),
        ("20.0, 21.0", "20.0", "takes 4 params .*, got 3"),
        ("20.0, 21.0", '"20.0", 21.0', "params: '20.0' is not a number"),
        ("20.0, 21.0", "true, 21.0", "params: 'True' is not a number"),
        ("[20.0, 21.0, 7.5, 5.5]", "20.0", "params is not a list"),
        ("PINHOLE", "PINHOL", "unknown camera model 'PINHOL'; known are SIMPLE_PINHOLE"),
        ('"PINHOLE"', "5", "model is not a text"),
        ("width = 16", "width = 16.0", "width is not a whole number"),
        ("width = 16", "width = true", "width is not a whole number"),
        ("width = 16", "width = -16", "camera size -16x12 is not positive"),
        ("width = 16", "width = 16\nwitdh = 16", "unknown key witdh; known are model, width"),
        ("width = 16", "width = ", "is not TOML"),
        ("depth_scale = 5000", "depth_scale = 0", "depth_scale = 0 is not positive"),
        ("depth_scale = 5000", 'depth_scale = "5000"', "depth_scale: '5000' is not a number"),
        ("z = 1.0", "", r"mount\.z is missing"),
        ("z = 1.0", "z = 1.0\nw = 2", r"unknown key mount\.w"),
        ("z = 1.0", "z = nan", r"mount\.z: nan is not finite"),
        ("z = 1.0", "z = [1.0]", r"mount\.z: '\[1\.0\]' is not a number"),
    ],
)
def test_a_camera_file_that_is_wrong(folder: Path, old: str, new: str, reason: str) -> None:
    edit(folder / "camera.toml", old, new)
    refused(folder, folder / "camera.toml", reason)


def test_a_mount_that_is_no_table(folder: Path) -> None:
    (folder / "camera.toml").write_text(CAMERA.split("[mount]", maxsplit=1)[0] + "mount = 5\n")
    refused(folder, folder / "camera.toml", "mount is not a table")


def test_a_camera_file_that_is_no_text(folder: Path) -> None:
    (folder / "camera.toml").write_bytes(b"\xff\x00")
    refused(folder, folder / "camera.toml", "is no text in UTF-8")


# --- lfnav info --------------------------------------------------------------------------------


def test_a_description_counts_and_measures(folder: Path) -> None:
    summary = describe_dataset(folder)
    described = summary.to_dict()
    assert described["images"] == 4
    assert described["duration"] == 1.5
    assert described["odometry"] == {"poses": 4, "path_length": 3.0, "start": 0.5, "end": 2.0}
    assert described["camera"]["model"] == "PINHOLE"
    assert ("odometry", "4 poses, 3.00 m") in summary.table()
    for name in ("rgb.txt", "camera.toml", "odometry.txt", "groundtruth.txt"):
        (folder / name).unlink()
    plain = describe_dataset(folder)
    assert plain.to_dict()["duration"] is None
    assert ("duration", "unknown") in plain.table()


def run_info(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "lfnav_cli.main", "info", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_lfnav_info_prints_a_table_or_json() -> None:
    path = SAMPLES / "elevators" / "map"
    odometry = read_tum(path / "odometry.txt")
    steps = np.diff(odometry.poses[:, :3, 3], axis=0)
    result = run_info(str(path), "--json")
    assert (result.returncode, result.stderr) == (0, "")
    described = json.loads(result.stdout)
    assert described["kind"] == "dataset"
    assert described["odometry"]["path_length"] == pytest.approx(np.sqrt((steps**2).sum(1)).sum())
    table = run_info(str(path))
    assert table.returncode == 0
    assert re.search(r"images +28\n", table.stdout)


def test_lfnav_info_of_nothing_is_one_line_and_exit_code_1(tmp_path: Path) -> None:
    result = run_info(str(tmp_path / "nowhere"))
    assert result.returncode == 1
    assert result.stdout == ""
    assert result.stderr == f"lfnav: {tmp_path}/nowhere: does not exist\n"
