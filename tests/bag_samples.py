"""Bags for tests: data sets as a robot would have recorded them, written by ``rosbags``."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.dataset.dataset import Dataset
from pipelines.dataset.images import decode_image
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import BASE_FROM_FORWARD_CAMERA, inverse, quaternion_of
from pipelines.ros.pose_track import PoseTrack

NS = 1_000_000_000
# A day on which robots drive: seconds since 1970, where floats have steps of 0.2 microseconds.
EPOCH = 1_700_000_000 * NS
TOPIC, INFO, ODOMETRY = "/camera/image_raw", "/camera/camera_info", "/odom"
CAMERA_FRAME = "camera_optical_frame"
MODELS = {
    "OPENCV": "plumb_bob",
    "FULL_OPENCV": "rational_polynomial",
    "OPENCV_FISHEYE": "equidistant",
}


@dataclass(frozen=True)
class Frame:
    """An image as it is published: its stamp (ns) and encoded bytes."""

    stamp: int
    data: bytes


@dataclass(frozen=True)
class Drive:
    """What a robot records: a small camera on a mount, images and odometry."""

    camera: Camera
    base_from_camera: FloatArray
    frames: tuple[Frame, ...]
    odometry: PoseTrack
    groundtruth: PoseTrack | None = None


@dataclass
class Messages:
    """Makes messages of ROS 1 or ROS 2.

    Attributes:
        is_ros1: which of them.
        change: called with each message (topic, message) before it is written, for bad bags.
    """

    is_ros1: bool
    store: Any = field(init=False)

    def __post_init__(self) -> None:
        self.store = get_typestore(Stores.ROS1_NOETIC if self.is_ros1 else Stores.ROS2_JAZZY)
        if self.is_ros1:
            definition = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(definition, "tf2_msgs/msg/TFMessage"))

    def make(self, name: str, **fields: Any) -> Any:
        return self.store.types[name](**fields)

    def header(self, stamp: int, frame: str) -> Any:
        time = self.make("builtin_interfaces/msg/Time", sec=stamp // NS, nanosec=stamp % NS)
        extra = {"seq": 0} if self.is_ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame, **extra)

    def _vector(self, name: str, values: FloatArray) -> Any:
        x, y, z = map(float, values)
        return self.make(f"geometry_msgs/msg/{name}", x=x, y=y, z=z)

    def _quaternion(self, pose: FloatArray) -> Any:
        x, y, z, w = map(float, quaternion_of(pose))
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def transform(self, parent: str, child: str, pose: FloatArray, stamp: int = 0) -> Any:
        return self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp, parent),
            child_frame_id=child,
            transform=self.make(
                "geometry_msgs/msg/Transform",
                translation=self._vector("Vector3", pose[:3, 3]),
                rotation=self._quaternion(pose),
            ),
        )

    def tf(self, *transforms: Any) -> Any:
        return self.make("tf2_msgs/msg/TFMessage", transforms=list(transforms))

    def pose(self, pose: FloatArray) -> Any:
        return self.make(
            "geometry_msgs/msg/Pose",
            position=self._vector("Point", pose[:3, 3]),
            orientation=self._quaternion(pose),
        )

    def pose_stamped(self, pose: FloatArray, stamp: int, frame: str) -> Any:
        return self.make(
            "geometry_msgs/msg/PoseStamped", header=self.header(stamp, frame), pose=self.pose(pose)
        )

    def odometry(
        self, pose: FloatArray, stamp: int, frame: str = "odom", child: str = "base_link"
    ) -> Any:
        zero = self._vector("Vector3", np.zeros(3))
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        return self.make(
            "nav_msgs/msg/Odometry",
            header=self.header(stamp, frame),
            child_frame_id=child,
            pose=self.make(
                "geometry_msgs/msg/PoseWithCovariance",
                pose=self.pose(pose),
                covariance=np.zeros(36),
            ),
            twist=self.make(
                "geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)
            ),
        )

    def camera_info(self, camera: Camera, stamp: int, **changes: Any) -> Any:
        pinhole = camera.intrinsics
        roi = self.make(
            "sensor_msgs/msg/RegionOfInterest",
            x_offset=0,
            y_offset=0,
            height=0,
            width=0,
            do_rectify=False,
        )
        matrices = {
            "d": np.array(camera.params[4:], dtype=np.float64),
            "k": pinhole.matrix().ravel(),
            "r": np.eye(3).ravel(),
            "p": np.column_stack([pinhole.matrix(), np.zeros(3)]).ravel(),
        }
        if self.is_ros1:
            matrices = {key.upper(): value for key, value in matrices.items()}
        values = {
            "header": self.header(stamp, CAMERA_FRAME),
            "height": camera.height,
            "width": camera.width,
            "distortion_model": MODELS[camera.model],
            "binning_x": 0,
            "binning_y": 0,
            "roi": roi,
            **matrices,
        }
        return self.make("sensor_msgs/msg/CameraInfo", **(values | changes))

    def compressed(self, frame: Frame, frame_id: str = CAMERA_FRAME) -> Any:
        return self.make(
            "sensor_msgs/msg/CompressedImage",
            header=self.header(frame.stamp, frame_id),
            format="jpeg",
            data=np.frombuffer(frame.data, np.uint8),
        )

    def image(self, stamp: int, samples: Any, encoding: str, frame_id: str = CAMERA_FRAME) -> Any:
        rows = np.ascontiguousarray(samples).reshape(len(samples), -1).view(np.uint8)
        return self.make(
            "sensor_msgs/msg/Image",
            header=self.header(stamp, frame_id),
            height=samples.shape[0],
            width=samples.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=rows.shape[1],
            data=rows.ravel(),
        )


Entry = tuple[str, int, Any]


def drive_of(dataset: Dataset) -> Drive:
    """A data set with a mount and odometry as a drive that began at ``EPOCH``."""
    assert dataset.camera is not None
    assert dataset.odometry is not None
    images = [
        Frame(EPOCH + round(time * NS), dataset.read_image_bytes(index))
        for index, time in enumerate(dataset.timestamps.tolist())
    ]
    tracks = [
        None
        if trajectory is None
        else PoseTrack(
            EPOCH + np.round(trajectory.timestamps * NS).astype(np.int64), trajectory.poses
        )
        for trajectory in (dataset.odometry, dataset.groundtruth)
    ]
    odometry, groundtruth = tracks
    assert odometry is not None
    return Drive(
        dataset.camera, dataset.body_from_camera, tuple(images), denser(odometry), groundtruth
    )


def denser(track: PoseTrack, step: int = NS // 10) -> PoseTrack:
    """The track with poses between its own, at most ``step`` ns apart."""
    between = np.arange(track.stamps[0], track.stamps[-1], step)
    stamps = np.union1d(track.stamps, between)
    poses, known = track.at(stamps, 1e9)
    assert np.all(known)
    return PoseTrack(stamps, poses)


def mosaic(image: ImageArray) -> ImageArray:
    """What a sensor with the pattern RGGB sees of an image."""
    samples = image[:, :, 1].copy()
    samples[::2, ::2] = image[::2, ::2, 0]
    samples[1::2, 1::2] = image[1::2, 1::2, 2]
    return samples


def entries(
    drive: Drive, messages: Messages, *, images: str = "jpeg", odometry: str = "topic"
) -> list[Entry]:
    """All messages of a drive: topic, time of receipt and message, in order.

    Args:
        drive: what was recorded.
        messages: how messages are made.
        images: ``jpeg``, ``raw`` or ``bayer``.
        odometry: ``topic``, ``tf`` or ``none``.
    """
    link = np.eye(4)
    link[:3, 3] = drive.base_from_camera[:3, 3]
    optical = inverse(link) @ drive.base_from_camera
    static = messages.tf(
        messages.transform("base_link", "camera_link", link),
        messages.transform("camera_link", CAMERA_FRAME, optical),
    )
    found: list[Entry] = [("/tf_static", drive.frames[0].stamp, static)]
    for frame in drive.frames:
        image, topic = _image(frame, messages, images)
        # Images take their time to the recorder.
        received = frame.stamp + 30_000_000
        found.append((topic, received, image))
        found.append((INFO, received, messages.camera_info(drive.camera, frame.stamp)))
    for stamp, pose in zip(drive.odometry.stamps.tolist(), drive.odometry.poses, strict=True):
        if odometry == "topic":
            found.append((ODOMETRY, stamp, messages.odometry(pose, stamp)))
        elif odometry == "tf":
            transform = messages.transform("odom", "base_link", pose, stamp)
            found.append(("/tf", stamp, messages.tf(transform)))
    if drive.groundtruth is not None:
        truth = drive.groundtruth
        for stamp, pose in zip(truth.stamps.tolist(), truth.poses, strict=True):
            found.append(("/ground_truth", stamp, messages.pose_stamped(pose, stamp, "map")))
    return sorted(found, key=lambda entry: entry[1])


def _image(frame: Frame, messages: Messages, images: str) -> tuple[Any, str]:
    if images == "jpeg":
        return messages.compressed(frame), f"{TOPIC}/compressed"
    pixels = decode_image(frame.data, "sample")
    if images == "raw":
        return messages.image(frame.stamp, pixels[:, :, ::-1], "bgr8"), TOPIC
    return messages.image(frame.stamp, mosaic(pixels), "bayer_rggb8"), TOPIC


def write_bag(path: Path, found: list[Entry], messages: Messages, *, compression: str = "") -> Path:
    """Writes a bag; its format is that of the path's suffix, a folder where it has none of them.

    Args:
        path: ``NAME.bag``; ``NAME.mcap`` or ``NAME.db3`` for the folder NAME with such a file.
        found: its messages.
        messages: by which they were made.
        compression: ``lz4`` or ``bz2`` of ROS 1; ``file`` or ``message`` of sqlite3, ``storage`` of
            mcap.

    Returns:
        The file of ROS 1, or the folder of ROS 2.
    """
    if path.suffix == ".bag":
        writer: Any = Writer1(path)
        if compression:
            writer.set_compression(Writer1.CompressionFormat[compression.upper()])
        serialize = messages.store.serialize_ros1
        target = path
    else:
        plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
        target = path.with_suffix("")
        writer = Writer2(target, version=9, storage_plugin=plugin)
        if compression:
            writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
        serialize = messages.store.serialize_cdr
    with writer:
        connections: dict[str, Any] = {}
        for topic, received, message in found:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=messages.store)
            writer.write(connections[topic], received, serialize(message, kind))
    return target


def small_drive(count: int = 6, **changes: Any) -> Drive:
    """A drive in a circle with images of noise, 32x24 pixels."""
    from pipelines.dataset.images import encode_jpeg

    camera = Camera("OPENCV", 32, 24, (30.0, 31.0, 15.5, 11.5, 0.1, -0.05, 0.001, -0.002))
    mount = np.eye(4)
    mount[:3, :3], mount[:3, 3] = BASE_FROM_FORWARD_CAMERA, (0.1, -0.02, 0.5)
    generator = np.random.default_rng(5)
    frames = [
        Frame(
            EPOCH + index * NS // 5,
            encode_jpeg(generator.integers(0, 256, (24, 32, 3)).astype(np.uint8)),
        )
        for index in range(count)
    ]
    stamps = np.arange(frames[0].stamp - NS, frames[-1].stamp + NS, NS // 50)
    drive = Drive(camera, mount, tuple(frames), circle(stamps))
    return replace(drive, **changes)


def circle(stamps: Any) -> PoseTrack:
    """Along a circle of 2 m at 0.5 m/s."""
    angles = (np.asarray(stamps) - EPOCH) / NS * 0.25
    poses = np.tile(np.eye(4), (len(angles), 1, 1))
    poses[:, 0, 0] = poses[:, 1, 1] = np.cos(angles)
    poses[:, 1, 0], poses[:, 0, 1] = np.sin(angles), -np.sin(angles)
    poses[:, 0, 3], poses[:, 1, 3] = 2.0 * np.sin(angles), 2.0 - 2.0 * np.cos(angles)
    return PoseTrack(np.asarray(stamps, dtype=np.int64), poses)


def without(found: list[Entry], topic: str) -> list[Entry]:
    """The messages of the other topics."""
    return [entry for entry in found if entry[0] != topic]


def changed(found: list[Entry], topic: str) -> Iterator[Any]:
    """The messages of a topic, to be changed in place."""
    return (entry[2] for entry in found if entry[0] == topic)
