"""Bags become data sets: what went in comes out."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.errors import InputError
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.dataset import Dataset, load_dataset
from pipelines.dataset.images import decode_image, encode_png
from pipelines.dataset.importers.settings import ImportSettings
from pipelines.geometry.pose import inverse, rotation_angle
from pipelines.geometry.trajectory import Trajectory
from pipelines.ros.bag_import import BagImportSummary, import_bag
from pipelines.ros.image_message import image_of_message
from tests.bag_samples import (
    EPOCH,
    INFO,
    NS,
    ODOMETRY,
    TOPIC,
    Drive,
    Messages,
    circle,
    drive_of,
    entries,
    mosaic,
    small_drive,
    without,
    write_bag,
)
from tests.chain_samples import ELEVATORS, first_frames, lfnav, succeed

SAMPLES = ELEVATORS.parent


def brought_in(source: Path, output: Path, **options: Any) -> tuple[Dataset, BagImportSummary]:
    summary = import_bag(
        source, output, ImportSettings(**options), overwrite=False, progress=no_progress
    )
    return load_dataset(output), summary


def assert_same_poses(found: Trajectory | None, expected: Trajectory | None, count: int) -> None:
    """Within 0.1 mm and 0.01 degrees, at the times of both."""
    assert found is not None
    assert expected is not None
    assert len(found) == count
    np.testing.assert_allclose(
        found.timestamps - EPOCH / NS, expected.timestamps[:count], atol=1e-6
    )
    differences = inverse(expected.poses[:count]) @ found.poses
    assert np.linalg.norm(differences[:, :3, 3], axis=1).max() < 1e-4
    assert rotation_angle(differences).max() < np.radians(0.01)


@pytest.mark.parametrize(
    ("file", "images", "odometry", "compression"),
    [
        ("drive.bag", "jpeg", "topic", ""),
        ("drive.bag", "raw", "tf", "lz4"),
        ("drive.bag", "bayer", "topic", "bz2"),
        ("drive.db3", "jpeg", "tf", ""),
        ("drive.db3", "raw", "topic", "message"),
        ("drive.db3", "bayer", "tf", "file"),
        ("drive.mcap", "jpeg", "topic", "storage"),
        ("drive.mcap", "raw", "tf", ""),
        ("drive.mcap", "bayer", "topic", "storage"),
    ],
)
def test_a_data_set_comes_back_from_its_bag(
    tmp_path: Path, file: str, images: str, odometry: str, compression: str
) -> None:
    # Each with the images of one of the two, and all formats with both.
    name = "workshop" if odometry == "tf" else "elevators"
    count = 3
    original = load_dataset(first_frames(SAMPLES / name / "test", tmp_path / "original", count))
    messages = Messages(is_ros1=file.endswith(".bag"))
    found = entries(drive_of(original), messages, images=images, odometry=odometry)
    bag = write_bag(tmp_path / file, found, messages, compression=compression)
    imported, summary = brought_in(bag, tmp_path / "imported")
    assert len(imported) == count
    for index in range(count):
        if images == "jpeg":
            assert imported.read_image_bytes(index) == original.read_image_bytes(index)
            continue
        pixels = original.read_image(index)
        if images == "bayer":
            message = messages.image(0, mosaic(pixels), "bayer_rggb8")
            # Demosaicing has its limits at edges; on the whole it is the same picture.
            assert np.abs(imported.read_image(index).astype(int) - pixels).mean() < 4.0
            pixels = image_of_message(message, "sample")
        np.testing.assert_array_equal(imported.read_image(index), pixels)
    assert imported.camera == original.camera
    assert imported.base_from_camera is not None
    np.testing.assert_allclose(imported.base_from_camera, original.body_from_camera, atol=1e-9)
    assert_same_poses(imported.odometry, original.odometry, count)
    assert_same_poses(imported.groundtruth, original.groundtruth, count)
    assert summary.plan.notes == ()
    assert json.loads((tmp_path / "imported" / "import.json").read_text())["source"] == "bag"


def test_localization_of_an_imported_bag_is_that_of_the_data_set(tmp_path: Path) -> None:
    # A third of the map is enough: what counts is that both come out alike.
    photos, scene = first_frames(ELEVATORS / "map", tmp_path / "photos", 10), tmp_path / "scene.h5"
    succeed("reconstruct", photos, "-o", tmp_path / "map", "--method", "odometry")
    succeed("model", tmp_path / "map", "-o", scene, "--plane", "0,1,0,0")
    original = load_dataset(first_frames(SAMPLES / "elevators" / "test", tmp_path / "original", 2))
    messages = Messages(is_ros1=False)
    bag = write_bag(tmp_path / "drive.mcap", entries(drive_of(original), messages), messages)
    succeed("import", bag, "-o", tmp_path / "imported")
    poses = []
    for name in ("original", "imported"):
        run, text = tmp_path / f"{name}.h5", tmp_path / f"{name}.csv"
        succeed("localize", scene, tmp_path / name, "-o", run, "--seed", "1")
        succeed("export", run, "--format", "csv", "-o", text)
        rows = [line.split(",") for line in text.read_text().splitlines()[1:]]
        poses.append(np.array([[float(value) for value in row[3:6]] for row in rows]))
    assert poses[0].shape == poses[1].shape == (2, 3)
    # Odometry is written with nine decimals, from quaternions with 15.
    np.testing.assert_allclose(poses[0], poses[1], atol=1e-4)


def small_bag(
    folder: Path, drive: Drive | None = None, name: str = "drive.mcap", **options: Any
) -> Path:
    messages = Messages(is_ros1=name.endswith(".bag"))
    return write_bag(folder / name, entries(drive or small_drive(), messages, **options), messages)


def test_odometry_between_two_images_is_interpolated_on_the_circle(tmp_path: Path) -> None:
    # Poses come at 50 Hz, 7 ms beside the images.
    stamps = np.arange(EPOCH - NS + 7_000_000, EPOCH + 2 * NS, NS // 50)
    imported, _ = brought_in(
        small_bag(tmp_path, small_drive(odometry=circle(stamps))), tmp_path / "out"
    )
    assert imported.odometry is not None
    expected = circle(EPOCH + np.arange(6) * NS // 5).poses
    differences = inverse(expected) @ imported.odometry.poses
    assert np.linalg.norm(differences[:, :3, 3], axis=1).max() < 1e-4
    assert rotation_angle(differences).max() < np.radians(0.01)


def test_a_lone_file_and_the_parts_of_a_split_bag_are_bags(tmp_path: Path) -> None:
    folder = small_bag(tmp_path)
    lone, _ = brought_in(folder / "drive.mcap", tmp_path / "lone")
    assert len(lone) == 6
    messages = Messages(is_ros1=True)
    found = entries(small_drive(), messages)
    (tmp_path / "parts").mkdir()
    # Of ten parts the tenth is the second by its name.
    for number, part in ((9, found[: len(found) // 2]), (10, found[len(found) // 2 :])):
        write_bag(tmp_path / "parts" / f"drive_{number}.bag", part, messages)
    parts, _ = brought_in(tmp_path / "parts", tmp_path / "joined")
    assert len(parts) == 6
    assert [parts.read_image_bytes(index) for index in range(6)] == [
        lone.read_image_bytes(index) for index in range(6)
    ]


def test_images_outside_of_the_odometry_and_in_its_gaps_are_left_out(tmp_path: Path) -> None:
    stamps = np.arange(EPOCH + NS // 10, EPOCH + 2 * NS, NS // 50)
    # A hole of 0.3 s around the third image.
    stamps = stamps[(stamps < EPOCH + 300_000_000) | (stamps >= EPOCH + 600_000_000)]
    source = small_bag(tmp_path, small_drive(odometry=circle(stamps)))
    imported, summary = brought_in(source, tmp_path / "out")
    assert (imported.timestamps - EPOCH / NS).round(3).tolist() == [0.2, 0.6, 0.8, 1.0]
    assert "2 of 6 images" in summary.plan.notes[0]
    wider, summary = brought_in(source, tmp_path / "wide", max_gap=0.5)
    assert len(wider) == 5
    none, summary = brought_in(source, tmp_path / "none", odometry="none")
    assert (len(none), none.odometry) == (6, None)
    assert none.base_from_camera is not None


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"every": 2}, [0.0, 0.4, 0.8]),
        ({"start": 0.3, "end": 0.8}, [0.4, 0.6, 0.8]),
        ({"start": 0.4, "every": 2}, [0.4, 0.8]),
        # 0.5 m/s, an image each 0.1 m; a radian each 4 s.
        ({"distance": 0.15}, [0.0, 0.4, 0.8]),
        ({"angle": 8.0}, [0.0, 0.6]),
        ({"angle": 8.0, "distance": 0.15}, [0.0, 0.4, 0.8]),
        ({"distance": 100.0}, [0.0]),
    ],
)
def test_images_are_chosen(tmp_path: Path, options: dict[str, Any], expected: list[float]) -> None:
    imported, _ = brought_in(small_bag(tmp_path), tmp_path / "out", **options)
    assert (imported.timestamps - imported.timestamps[0] + expected[0]).round(3).tolist() == (
        expected
    )
    assert imported.odometry is not None
    assert len(imported.odometry) == len(imported)


def test_images_that_overtook_each_other_are_put_in_order(tmp_path: Path) -> None:
    messages = Messages(is_ros1=False)
    found = entries(small_drive(), messages)
    images = [index for index, entry in enumerate(found) if entry[0].startswith(TOPIC)]
    first, second = (found[index] for index in images[1:3])
    found[images[1]] = (first[0], second[1], first[2])
    found[images[2]] = (second[0], first[1], second[2])
    # The last one was sent twice.
    topic, received, message = found[images[-1]]
    found.append((topic, received + NS, message))
    bag = write_bag(tmp_path / "drive.mcap", sorted(found, key=lambda e: e[1]), messages)
    imported, summary = brought_in(bag, tmp_path / "out")
    drive = small_drive()
    assert [imported.read_image_bytes(i) for i in range(6)] == [f.data for f in drive.frames]
    assert "1 images with the stamp of another" in summary.plan.notes[0]


def test_of_several_cameras_one_is_named(tmp_path: Path) -> None:
    messages = Messages(is_ros1=False)
    found = entries(small_drive(), messages)
    pixels = decode_image(small_drive().frames[0].data, "sample")
    found += [
        ("/rear/image_raw", EPOCH + NS, messages.image(EPOCH + NS, pixels, "rgb8")),
        ("/rear/camera_info", EPOCH + NS, messages.camera_info(small_drive().camera, EPOCH)),
        # Depth is not a camera to choose.
        ("/depth/image", EPOCH, messages.image(EPOCH, pixels[:, :, :2].view("<u2"), "16UC1")),
    ]
    bag = write_bag(tmp_path / "drive.db3", sorted(found, key=lambda e: e[1]), messages)
    outcome = lfnav("import", bag, "-o", tmp_path / "out")
    assert outcome.code == 1
    assert (
        "holds images of 2 topics: '/camera/image_raw/compressed', '/rear/image_raw'; name one "
        "with --camera" in outcome.err
    )
    imported, _ = brought_in(bag, tmp_path / "rear", camera="rear/image_raw")
    np.testing.assert_array_equal(imported.read_image(0), pixels)
    assert lfnav("import", bag, "-o", tmp_path / "d", "--camera", "/depth/image").code == 1


def test_raw_images_count_before_their_encoded_copies(tmp_path: Path) -> None:
    messages = Messages(is_ros1=False)
    drive = small_drive()
    encoded = [e for e in entries(drive, messages) if e[0] == f"{TOPIC}/compressed"]
    found = entries(drive, messages, images="raw") + encoded
    bag = write_bag(tmp_path / "drive.mcap", sorted(found, key=lambda e: e[1]), messages)
    imported, summary = brought_in(bag, tmp_path / "out")
    assert imported.image_names[0].endswith(".png")
    assert f"'{TOPIC}/compressed'" in summary.plan.notes[0]
    imported, summary = brought_in(bag, tmp_path / "jpeg", camera=f"{TOPIC}/compressed")
    assert imported.image_names[0].endswith(".jpg")


def test_rectified_images_are_those_of_a_pinhole(tmp_path: Path) -> None:
    messages = Messages(is_ros1=True)
    found = [
        ("/camera/image_rect", *entry[1:]) if entry[0] == TOPIC else entry
        for entry in entries(small_drive(), messages, images="raw")
    ]
    imported, summary = brought_in(write_bag(tmp_path / "a.bag", found, messages), tmp_path / "out")
    assert imported.camera is not None
    assert imported.camera.model == "PINHOLE"
    assert "rectified" in summary.plan.notes[0]


def test_a_camera_without_calibration_may_be_given(tmp_path: Path) -> None:
    messages = Messages(is_ros1=False)
    found = without(entries(small_drive(), messages), INFO)
    bag = write_bag(tmp_path / "drive.mcap", found, messages)
    imported, _ = brought_in(bag, tmp_path / "out", focal=33.0)
    assert imported.camera is not None
    assert imported.camera.params == (33.0, 15.5, 11.5)


def test_a_bag_of_a_hand_held_camera_has_no_mount(tmp_path: Path) -> None:
    messages = Messages(is_ros1=False)
    found = without(entries(small_drive(), messages, odometry="none"), "/tf_static")
    imported, summary = brought_in(
        write_bag(tmp_path / "drive.mcap", found, messages), tmp_path / "out"
    )
    assert imported.base_from_camera is None
    assert imported.odometry is None
    assert summary.plan.notes == ("no odometry",)


def test_the_base_may_be_another_frame_of_the_robot(tmp_path: Path) -> None:
    messages = Messages(is_ros1=False)
    found = entries(small_drive(), messages)
    lower = np.eye(4)
    lower[2, 3] = -0.2
    static = messages.tf(messages.transform("base_link", "base_footprint", lower))
    found.insert(0, ("/tf_static", EPOCH, static))
    bag = write_bag(tmp_path / "drive.mcap", sorted(found, key=lambda e: e[1]), messages)
    imported, _ = brought_in(bag, tmp_path / "out", base="base_footprint")
    assert imported.base_from_camera is not None
    np.testing.assert_allclose(imported.base_from_camera[:3, 3], [0.1, -0.02, 0.7], atol=1e-9)
    assert imported.odometry is not None
    np.testing.assert_allclose(imported.odometry.poses[:, 2, 3], -0.2, atol=1e-9)
    # The camera itself as the body: no mount, and odometry is the camera's.
    alone, _ = brought_in(bag, tmp_path / "camera", base="camera_optical_frame")
    assert alone.base_from_camera is None
    assert alone.odometry is not None
    np.testing.assert_allclose(alone.odometry.poses[:, 2, 3], 0.5, atol=1e-9)


def test_a_mount_may_be_given_where_tf_does_not_say(tmp_path: Path) -> None:
    messages = Messages(is_ros1=False)
    found = without(entries(small_drive(), messages), "/tf_static")
    bag = write_bag(tmp_path / "drive.mcap", found, messages)
    outcome = lfnav("import", bag, "-o", tmp_path / "out")
    assert outcome.code == 1
    assert "--mount" in outcome.err
    succeed("import", bag, "-o", tmp_path / "out", "--mount", "0.1,-0.02,0.5,0,0,0")
    imported = load_dataset(tmp_path / "out")
    np.testing.assert_allclose(imported.body_from_camera, small_drive().base_from_camera, atol=1e-9)
    assert imported.odometry is not None
    assert len(imported.odometry) == 6


def test_a_bag_is_no_data_set_yet(tmp_path: Path) -> None:
    bag = small_bag(tmp_path)
    for path in (bag, bag / "drive.mcap"):
        with pytest.raises(InputError, match="lfnav import"):
            load_dataset(path)
    # A bag beside the images of a data set is not meant.
    folder = tmp_path / "photos"
    folder.mkdir()
    (folder / "a.png").write_bytes(encode_png(np.zeros((4, 4, 3), np.uint8)))
    (folder / "drive.bag").write_bytes(b"#ROSBAG V2.0\n")
    assert len(load_dataset(folder)) == 1


def test_a_mount_may_be_published_over_and_over_if_it_stays(tmp_path: Path) -> None:
    messages = Messages(is_ros1=True)
    found = entries(small_drive(), messages)
    static = next(entry[2] for entry in found if entry[0] == "/tf_static")
    found = without(found, "/tf_static")
    for stamp in range(EPOCH, EPOCH + NS, NS // 10):
        again = [
            messages.transform(t.header.frame_id, t.child_frame_id, np.eye(4), stamp)
            for t in static.transforms
        ]
        for new, old in zip(again, static.transforms, strict=True):
            new.transform = old.transform
        found.append(("/tf", stamp, messages.tf(*again)))
    bag = write_bag(tmp_path / "drive.bag", sorted(found, key=lambda e: e[1]), messages)
    imported, _ = brought_in(bag, tmp_path / "out")
    assert imported.base_from_camera is not None
    np.testing.assert_allclose(imported.base_from_camera, small_drive().base_from_camera, atol=1e-9)


def test_the_command_prints_what_it_found(tmp_path: Path) -> None:
    bag = small_bag(tmp_path)
    out = succeed("import", bag, "-o", tmp_path / "out")
    assert "bag (ROS 2)" in out
    assert "6 of 6 of /camera/image_raw/compressed" in out
    assert "0.100, -0.020, 0.500 m" in out
    assert f"{ODOMETRY}: 6 poses, 0.50 m" in out
    found = json.loads(succeed("import", bag, "-o", tmp_path / "out", "--overwrite", "--json"))
    assert (found["source"], found["images"], found["base"]) == ("bag", 6, "base_link")
    outcome = lfnav("import", bag, "-o", tmp_path / "out2", "--spacing", "1")
    assert outcome.code == 1
    assert "--spacing means nothing for a source of kind bag" in outcome.err
    outcome = lfnav("import", bag, "-o", tmp_path / "out2", "--from", "colmap")
    assert outcome.code == 1
    outcome = lfnav("import", tmp_path / "out", "-o", tmp_path / "out2", "--from", "bag")
    assert outcome.code == 1


def test_info_says_what_a_bag_holds(tmp_path: Path) -> None:
    bag = small_bag(tmp_path, name="drive.db3")
    out = succeed("info", bag)
    assert "6 images 32x24 jpeg, frame camera_optical_frame, OPENCV" in out
    assert "poses of base_link in odom" in out
    found = json.loads(succeed("info", bag, "--json"))
    assert found["kind"] == "bag"
    assert found["cameras"][0]["camera"]["model"] == "OPENCV"
    assert {topic["name"]: topic["count"] for topic in found["topics"]}[INFO] == 6
    np.testing.assert_allclose(
        found["mounts"]["camera_optical_frame"], small_drive().base_from_camera, atol=1e-9
    )


def test_what_is_interrupted_leaves_nothing(tmp_path: Path) -> None:
    source = small_bag(tmp_path)
    before = sorted(tmp_path.rglob("*"))

    def interrupt(items: Any, description: str, total: int | None = None) -> Any:
        for number, item in enumerate(items):
            if description == "images" and number == 4:
                raise KeyboardInterrupt
            yield item

    with pytest.raises(KeyboardInterrupt):
        import_bag(source, tmp_path / "out", ImportSettings(), overwrite=False, progress=interrupt)
    assert sorted(tmp_path.rglob("*")) == before
