"""Bags that are damaged, incomplete or hostile: one line, exit code 1, and nothing left behind."""

import bz2
import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import storage_mcap
from rosbags.typesys import get_types_from_msg

from pipelines.artifacts.errors import InputError
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.importers.settings import ImportSettings
from pipelines.geometry.pose import BASE_FROM_FORWARD_CAMERA
from pipelines.ros import bag_file, decompression_limit
from pipelines.ros.bag_file import open_bag
from pipelines.ros.bag_import import import_bag
from tests.bag_samples import (
    CAMERA_FRAME,
    EPOCH,
    INFO,
    NS,
    ODOMETRY,
    TOPIC,
    Entry,
    Messages,
    changed,
    entries,
    small_drive,
    without,
    write_bag,
)
from tests.chain_samples import lfnav

IMAGES = f"{TOPIC}/compressed"
FORMATS = ("drive.bag", "drive.db3", "drive.mcap")


def refused(bag: Path, *options: str) -> str:
    """Imports a bag, which must fail with one line, and leave nothing."""
    output = bag.parent / "output"
    before = sorted(bag.parent.rglob("*"))
    outcome = lfnav("import", bag, "-o", output, *options)
    assert outcome.code == 1, outcome.out
    assert outcome.out == ""
    assert outcome.err.startswith("lfnav: ")
    assert outcome.err.count("\n") == 1, outcome.err
    assert "internal error" not in outcome.err
    assert outcome.err.strip().isprintable()
    assert sorted(bag.parent.rglob("*")) == before
    return outcome.err


def spoilt(folder: Path, spoil: Callable[[list[Entry], Messages], Any], **options: Any) -> Path:
    """A small bag whose messages were changed before they were written."""
    messages = Messages(is_ros1=False)
    found = entries(small_drive(), messages, **options)
    result = spoil(found, messages)
    return write_bag(folder / "drive.mcap", result or found, messages)


def file_of(bag: Path) -> Path:
    return bag if bag.is_file() else next(p for p in bag.iterdir() if p.suffix != ".yaml")


def good(folder: Path, name: str, **options: Any) -> Path:
    messages = Messages(is_ros1=name.endswith(".bag"))
    return write_bag(folder / name, entries(small_drive(), messages), messages, **options)


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("share", [0.0, 0.5, 0.999])
def test_a_bag_that_is_cut_off(tmp_path: Path, name: str, share: float) -> None:
    bag = good(tmp_path, name)
    file = file_of(bag)
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    assert file.name in (message := refused(bag)) or bag.name in message
    assert "lfnav: " in refused(file)


@pytest.mark.parametrize("name", FORMATS)
def test_a_bag_with_flipped_bytes_gives_one_line_or_a_data_set(tmp_path: Path, name: str) -> None:
    bag = good(tmp_path, name)
    file = file_of(bag)
    whole = file.read_bytes()
    generator = np.random.default_rng(7)
    for _ in range(6):
        data = bytearray(whole)
        for place in generator.integers(0, len(data), 20):
            data[place] = int(generator.integers(0, 256))
        file.write_bytes(data)
        outcome = lfnav("import", bag, "-o", tmp_path / "output", "--overwrite")
        assert outcome.code in {0, 1}
        assert "internal error" not in outcome.err
        assert outcome.err.count("\n") <= 1


def test_a_bag_without_index(tmp_path: Path) -> None:
    bag = good(tmp_path, "drive.bag")
    data = bytearray(bag.read_bytes())
    place = data.index(b"index_pos=") + len(b"index_pos=")
    data[place : place + 8] = bytes(8)
    bag.write_bytes(data)
    assert "not indexed" in (message := refused(bag))
    assert "rosbag reindex" in message


def test_an_mcap_without_summary_is_read_all_the_same(tmp_path: Path) -> None:
    file = file_of(good(tmp_path, "drive.mcap"))
    data = bytearray(file.read_bytes())
    data[-28:-12] = bytes(16)
    file.write_bytes(data)
    assert lfnav("import", file, "-o", tmp_path / "output").code == 0


def test_a_recording_that_was_not_ended(tmp_path: Path) -> None:
    bag = good(tmp_path, "drive.mcap")
    (bag / "metadata.yaml").unlink()
    assert "holds no metadata.yaml" in (message := refused(bag))
    assert "name the file drive.mcap" in message


@pytest.mark.parametrize(
    "text",
    [
        "rosbag2_bagfile_information:\n  version: 99\n",
        "rosbag2_bagfile_information: []\n",
        "rosbag2_bagfile_information: {version: 5, relative_file_paths: [gone.mcap]}\n",
        "rosbag2_bagfile_information: &a [*a, *a]\n",
        "rosbag2_bagfile_information: \x1b[2J{\n",
    ],
)
def test_metadata_that_is_none(tmp_path: Path, text: str) -> None:
    bag = good(tmp_path, "drive.mcap")
    (bag / "metadata.yaml").write_text(text)
    assert "drive" in refused(bag)


def test_what_is_no_bag_at_all(tmp_path: Path) -> None:
    for name in ("a.bag", "a.db3", "a.mcap"):
        (tmp_path / name).write_bytes(b"\x1b[2J no bag" * 100)
        assert "a" in refused(tmp_path / name)
    (tmp_path / "folder").mkdir()
    assert "is no bag" in refused(tmp_path / "folder", "--from", "bag")
    assert "does not exist" in refused(tmp_path / "gone.mcap")
    assert "in none of .bag, .db3, .mcap" in refused(
        (tmp_path / "a.bag").rename(tmp_path / "a.tape"), "--from", "bag"
    )


def test_unknown_types_are_listed_and_not_read(tmp_path: Path) -> None:
    messages = Messages(is_ros1=False)
    messages.store.register(get_types_from_msg("uint8[] x", "my_msgs/msg/Odd"))
    odd = messages.make("my_msgs/msg/Odd", x=np.zeros(3, np.uint8))
    found = [*entries(small_drive(), messages), ("/odd", EPOCH, odd)]
    bag = write_bag(tmp_path / "drive.mcap", sorted(found, key=lambda e: e[1]), messages)
    assert lfnav("import", bag, "-o", tmp_path / "out").code == 0
    assert "1 x my_msgs/msg/Odd" in lfnav("info", bag).out
    assert "is of type 'my_msgs/msg/Odd', not images" in refused(bag, "--camera", "/odd")


@pytest.mark.parametrize("is_ros1", [True, False])
def test_a_type_of_another_version_is_refused(tmp_path: Path, is_ros1: bool) -> None:
    messages = Messages(is_ros1=is_ros1)
    fields = "std_msgs/Header header\nstring format\nuint8[] data\nfloat64 exposure"
    found = entries(small_drive(), messages)
    store = messages.store
    store.fielddefs.pop("sensor_msgs/msg/CompressedImage")
    store.types.pop("sensor_msgs/msg/CompressedImage")
    store.cache.clear()
    store.register(get_types_from_msg(fields, "sensor_msgs/msg/CompressedImage"))
    for message in changed(found, IMAGES):
        message.exposure = 0.1
    bag = write_bag(tmp_path / ("a.bag" if is_ros1 else "a.db3"), found, messages)
    assert f"topic '{IMAGES}' has another version of the type" in refused(bag)


def other_size(found: list[Entry], messages: Messages) -> None:
    image = list(changed(found, TOPIC))[3]
    image.height, image.data = 20, image.data[: 20 * image.step]


def with_encoding(found: list[Entry], messages: Messages) -> None:
    for image in changed(found, TOPIC):
        image.encoding = "\x1b]0;bgr9\x07" + 1000 * "x"


def zero_stamps(found: list[Entry], messages: Messages) -> None:
    for image in changed(found, IMAGES):
        image.header = messages.header(0, CAMERA_FRAME)


def clock_set_back(found: list[Entry], messages: Messages) -> None:
    list(changed(found, IMAGES))[3].header = messages.header(EPOCH - 9 * NS, CAMERA_FRAME)


def zero_odometry(found: list[Entry], messages: Messages) -> None:
    for message in changed(found, ODOMETRY):
        message.header = messages.header(0, "odom")


def odometry_on_another_clock(found: list[Entry], messages: Messages) -> None:
    for number, message in enumerate(changed(found, ODOMETRY)):
        message.header = messages.header(5 * NS + number * NS // 50, "odom")


def odometry_of_two_frames(found: list[Entry], messages: Messages) -> None:
    list(changed(found, ODOMETRY))[9].child_frame_id = "other"


def broken_quaternion(found: list[Entry], messages: Messages) -> None:
    list(changed(found, ODOMETRY))[7].pose.pose.orientation.w = 9.0


def broken_position(found: list[Entry], messages: Messages) -> None:
    list(changed(found, ODOMETRY))[7].pose.pose.position.x = float("nan")


def split_tree(found: list[Entry], messages: Messages) -> None:
    for message in changed(found, "/tf_static"):
        message.transforms = message.transforms[1:]
        message.transforms.append(messages.transform("base_link", "laser", np.eye(4)))


def no_tree(found: list[Entry], messages: Messages) -> list[Entry]:
    return without(found, "/tf_static")


def loop_of_frames(found: list[Entry], messages: Messages) -> None:
    for message in changed(found, "/tf_static"):
        message.transforms = [
            messages.transform(parent, child, np.eye(4))
            for parent, child in (("a", "b"), ("b", "a"), ("a", "a"), ("base_link", "a"))
        ]


def moving_camera(found: list[Entry], messages: Messages) -> list[Entry]:
    for number in range(10):
        pose = np.eye(4)
        pose[:3, :3], pose[0, 3] = BASE_FROM_FORWARD_CAMERA, 0.1 * number
        stamp = EPOCH + number * NS // 10
        transform = messages.transform("base_link", CAMERA_FRAME, pose, stamp)
        found.append(("/tf", stamp, messages.tf(transform)))
    return sorted(without(found, "/tf_static"), key=lambda entry: entry[1])


def no_info(found: list[Entry], messages: Messages) -> list[Entry]:
    return without(found, INFO)


def changing_info(found: list[Entry], messages: Messages) -> None:
    info = list(changed(found, INFO))[3]
    info.k = info.k * 1.1


def uncalibrated(found: list[Entry], messages: Messages) -> None:
    for info in changed(found, INFO):
        info.k = np.zeros(9)


def unknown_distortion(found: list[Entry], messages: Messages) -> None:
    for info in changed(found, INFO):
        info.distortion_model = "\x1b[31mdouble_sphere"


def two_odometries(found: list[Entry], messages: Messages) -> list[Entry]:
    return found + [("/ekf", *entry[1:]) for entry in found if entry[0] == ODOMETRY]


def no_images(found: list[Entry], messages: Messages) -> list[Entry]:
    return without(found, IMAGES)


def broken_jpeg(found: list[Entry], messages: Messages) -> None:
    image = list(changed(found, IMAGES))[2]
    image.data = image.data[:-100]


@pytest.mark.parametrize(
    ("spoil", "images", "reason"),
    [
        (other_size, "raw", "is 32x20 pixels, the first one 32x24"),
        (with_encoding, "raw", r"encoding '\x1b]0;bgr9\x07xxx"),
        (zero_stamps, "jpeg", f"the stamps of all images of '{IMAGES}' are zero"),
        (clock_set_back, "jpeg", "goes back by 9.400 s at image 3"),
        (zero_odometry, "jpeg", f"the stamps of topic '{ODOMETRY}' are all zero"),
        (odometry_on_another_clock, "jpeg", "no image lies within the odometry's time"),
        (odometry_of_two_frames, "jpeg", "has poses of 'other' in 'odom' beside those of"),
        (broken_quaternion, "jpeg", "quaternion that is not of unit length"),
        (broken_position, "jpeg", "not finite"),
        (split_tree, "jpeg", f"tf does not connect '{CAMERA_FRAME}' and 'base_link'"),
        (no_tree, "jpeg", "tf has no frame 'base_link'"),
        (loop_of_frames, "jpeg", f"tf has no frame '{CAMERA_FRAME}'"),
        (moving_camera, "jpeg", "the camera is not fixed to the robot"),
        (no_info, "jpeg", f"holds no CameraInfo for '{IMAGES}'; give its focal length"),
        (changing_info, "jpeg", f"the camera of '{INFO}' changes at time"),
        (uncalibrated, "jpeg", "was not calibrated"),
        (unknown_distortion, "jpeg", r"'\x1b[31mdouble_sphere' is not known"),
        (two_odometries, "jpeg", f"odometry of 2 topics: '/ekf', '{ODOMETRY}'"),
        (no_images, "jpeg", "holds no images"),
        (broken_jpeg, "jpeg", "damaged or truncated image"),
    ],
)
def test_what_no_data_set_can_be_made_of(
    tmp_path: Path, spoil: Callable[[list[Entry], Messages], Any], images: str, reason: str
) -> None:
    bag = spoilt(tmp_path, spoil, images=images)
    message = refused(bag)
    assert reason in message
    assert len(message) < 1000
    assert "internal error" not in lfnav("info", bag).err


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--camera", "/camera/image_ram"), f"nearest are '{IMAGES}'"),
        (("--odometry", "/odon"), f"nearest are '{ODOMETRY}'"),
        (("--groundtruth", "/vicon"), "has no topic '/vicon' (--groundtruth)"),
        (("--camera", ODOMETRY), "not images"),
        (("--odometry", IMAGES), "not poses"),
        (("--odometry", "odom:base_lnk"), "tf has no frame 'odom'"),
        (("--odometry", "base_link:camera_lnk"), "nearest are 'camera_link'"),
        (("--odometry", "base_link:camera_link"), "does not move"),
        (("--base", "base_lonk"), "nearest are 'base_link'"),
        (("--odometry", "none", "--distance", "1"), "--distance and --angle need odometry"),
        (("--start", "100"), "no image lies between"),
    ],
)
def test_what_is_named_and_not_there(tmp_path: Path, options: tuple[str, ...], reason: str) -> None:
    assert reason in refused(good(tmp_path, "drive.mcap"), *options)


def test_an_empty_bag(tmp_path: Path) -> None:
    messages = Messages(is_ros1=True)
    assert "holds no images" in refused(write_bag(tmp_path / "a.bag", [], messages))
    assert "0.00 s" in lfnav("info", tmp_path / "a.bag").out


def test_without_rosbags_one_line_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = good(tmp_path, "drive.mcap")
    monkeypatch.setitem(__import__("sys").modules, "rosbags.rosbag1", None)
    assert "pip install 'lfnav[ros]'" in refused(bag)


# --- bags made to do harm ----------------------------------------------------------------------


def bomb(compress: Callable[[bytes], bytes]) -> bytes:
    return compress(bytes(4 * 1024**2))


@pytest.mark.parametrize("kind", ["bz2", "lz4", "zstd"])
def test_what_is_decompressed_has_a_limit(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    import lz4.frame
    from rosbags.rosbag1 import reader as rosbag1

    zstd: Any = storage_mcap
    compress = {"bz2": bz2.compress, "lz4": lz4.frame.compress, "zstd": zstd.zstd.compress}[kind]
    original = dict(rosbag1.decompressors), dict(storage_mcap.DECOMPRESSORS)
    monkeypatch.setattr(decompression_limit, "MAX_CHUNK_BYTES", 1024**2)
    with decompression_limit.limited_decompression():
        if kind == "zstd":
            decompress: Any = lambda data: storage_mcap.DECOMPRESSORS["zstd"](data, 2**40)  # noqa: E731
        else:
            decompress = rosbag1.decompressors[kind]
        assert decompress(compress(b"abc" * 1000)) == b"abc" * 1000
        with pytest.raises(ValueError, match="unfolds to more than 1048576 bytes"):
            decompress(bomb(compress))
        with pytest.raises(ValueError, match="cut off"):
            decompress(compress(b"abc" * 1000)[:-8])
    assert (rosbag1.decompressors, storage_mcap.DECOMPRESSORS) == original


def test_chunks_that_would_be_open_at_once_have_a_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = good(tmp_path, "drive.mcap")
    with open_bag(bag) as opened:
        assert opened.topics
    monkeypatch.setattr(bag_file, "MAX_OVERLAPPING_BYTES", 1000)
    assert "would be open at once" in refused(bag)


def test_a_message_of_sqlite_has_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = good(tmp_path, "drive.db3")
    # A blob that SQLite makes as it is read.
    with sqlite3.connect(file_of(bag)) as database:
        database.execute("UPDATE messages SET data = zeroblob(3000000) WHERE id = 20")
    monkeypatch.setattr(bag_file, "MAX_CHUNK_BYTES", 2_000_000)
    assert "damaged bag" in refused(bag)


def test_an_image_of_impossible_size_is_not_allocated(tmp_path: Path) -> None:
    def spoil(found: list[Entry], messages: Messages) -> None:
        for image in changed(found, TOPIC):
            image.width = image.height = 2**31

    assert "pixels" in refused(spoilt(tmp_path, spoil, images="raw"))


def test_a_sequence_longer_than_its_message_is_damage(tmp_path: Path) -> None:
    bag = good(tmp_path, "drive.db3")
    with sqlite3.connect(file_of(bag)) as database:
        (topic,) = database.execute("SELECT id FROM topics WHERE name = ?", (IMAGES,)).fetchone()
        (data,) = database.execute(
            "SELECT data FROM messages WHERE topic_id = ? LIMIT 1", (topic,)
        ).fetchone()
        place = data.index(b"jpeg\0") + 8
        huge = data[:place] + struct.pack("<I", 2**32 - 1) + data[place + 4 :]
        database.execute("UPDATE messages SET data = ? WHERE topic_id = ?", (huge, topic))
    assert "damaged message" in refused(bag)


def test_a_bag_with_too_many_transforms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from pipelines.ros import tf_tree

    messages = Messages(is_ros1=False)
    found = entries(small_drive(), messages, odometry="tf")
    bag = write_bag(tmp_path / "drive.mcap", found, messages)
    monkeypatch.setattr(tf_tree, "MAX_TRANSFORMS", 10)
    with pytest.raises(InputError, match="more than 10 transforms"):
        import_bag(bag, tmp_path / "out", ImportSettings(), overwrite=False, progress=no_progress)
