"""A run as a bag of ROS 2 (mcap), which Foxglove and RViz show.

Names are AMCL's. All stamps are those of the images, and so are the times of receipt. Frames in
which the filter gave no estimate have no pose and no map -> odom.
"""

import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.atomic import atomic_file, check_output
from pipelines.artifacts.errors import StageError, reason_of
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import inverse, quaternion_of
from pipelines.localize.run import FrameRecord, Run, load_run
from pipelines.localize.state_space import known_states, state_space_of_dimension
from pipelines.localize.trajectory_export import nanoseconds
from pipelines.ros.pose_publishing import full_covariance
from pipelines.ros.pose_track import NANOSECONDS

MAP, ODOM, BASE, CAMERA = "map", "odom", "base_link", "camera_optical_frame"
POSE_TOPIC, PARTICLE_TOPIC, ODOMETRY_TOPIC = "/amcl_pose", "/particlecloud", "/odom"
TF_TOPIC, STATIC_TOPIC, TRUTH_TOPIC = "/tf", "/tf_static", "/ground_truth"
IMAGE_TOPIC, INFO_TOPIC = "/camera/image_raw/compressed", "/camera/camera_info"
# What comes to a late subscriber as well, when the bag is played.
_LATCHED = (POSE_TOPIC, STATIC_TOPIC)
_MAGIC = {b"\xff\xd8\xff": "jpeg", b"\x89PN": "png"}
# builtin_interfaces/Time counts seconds in 32 bits.
_LATEST = 2**31


@dataclass(frozen=True)
class BagExportSummary:
    """A ``Summary`` of what was written: topic -> number of messages."""

    path: Path
    estimate: str
    frames: int
    messages: dict[str, int]

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        rows: list[tuple[str, ...]] = [
            ("bag", str(self.path)),
            ("format", "mcap"),
            ("estimate", self.estimate),
            ("frames", str(self.frames)),
        ]
        return rows + [(topic, f"{count} messages") for topic, count in self.messages.items()]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "path": str(self.path),
            "format": "mcap",
            "estimate": self.estimate,
            "frames": self.frames,
            "messages": dict(self.messages),
        }


def export_run_to_bag(
    run_path: Path, output: Path, estimate: str | None, overwrite: bool
) -> BagExportSummary:
    """Writes a run as a bag, atomically.

    Args:
        run_path: the run's file.
        output: the ``.mcap`` file.
        estimate: which estimate is the pose; None for the run's default.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: the run cannot be read, or the output exists or cannot be written.
        OptionError: the run has no estimate of this name.
        StageError: times that ROS has no numbers for, or ``rosbags`` is not installed.
    """
    check_output(output, overwrite)
    try:
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    except ImportError as error:
        raise StageError(
            f"writing bags needs the package rosbags ({reason_of(error)}); "
            "install it: pip install 'lfnav[ros]'"
        ) from error
    run = load_run(run_path)
    name = run.default_estimate if estimate is None else estimate
    content = _RunMessages(run, estimate)
    counts: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as scratch, atomic_file(output, overwrite) as temporary:
        folder = Path(scratch) / "run"
        writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            connections: dict[str, Any] = {}
            for topic, stamp, message in content.all():
                kind = message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(
                        topic,
                        kind,
                        typestore=content.store,
                        offered_qos_profiles=[_quality(latched=topic in _LATCHED)],
                    )
                data = content.store.serialize_cdr(message, kind)
                writer.write(connections[topic], stamp, data)
                counts[topic] = counts.get(topic, 0) + 1
        shutil.copyfile(folder / "run.mcap", temporary)
    return BagExportSummary(output, name, len(run.frames), counts)


class _RunMessages:
    """The messages of a run, in order of time."""

    def __init__(self, run: Run, estimate: str | None) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.run = run
        self.store: Any = get_typestore(Stores.ROS2_JAZZY)
        self.estimate = run.default_estimate if estimate is None else estimate
        states = run.estimated_states(estimate)
        self.known = known_states(states)
        self.poses = run.space.poses(states)
        self.odometry = None if run.odometry is None else run.space.poses(run.odometry)
        self.truth = None if run.groundtruth is None else run.space.poses(run.groundtruth)
        self.stamps = [nanoseconds(float(time)) for time in run.timestamps]
        if self.stamps[0] < 0 or self.stamps[-1] >= _LATEST * NANOSECONDS:
            raise StageError(
                f"the run's times, from {run.timestamps[0]:.3f} to {run.timestamps[-1]:.3f} s, are "
                "none that ROS can state"
            )

    def all(self) -> Iterator[tuple[str, int, Any]]:
        """Topic, stamp (ns) and message."""
        mount = self._transform(self.stamps[0], BASE, CAMERA, self.run.base_from_camera)
        yield STATIC_TOPIC, self.stamps[0], self._tf(mount)
        for index, (frame, stamp) in enumerate(zip(self.run.frames, self.stamps, strict=True)):
            yield from self._image(index, stamp)
            transforms = self._transforms(index, stamp)
            if transforms:
                yield TF_TOPIC, stamp, self._tf(*transforms)
            if self.odometry is not None:
                yield ODOMETRY_TOPIC, stamp, self._odometry(stamp, self.odometry[index])
            if self.known[index]:
                yield POSE_TOPIC, stamp, self._pose_message(frame, stamp, self.poses[index])
            yield PARTICLE_TOPIC, stamp, self._particles(frame, stamp)
            if self.truth is not None and np.all(np.isfinite(self.truth[index])):
                yield (
                    TRUTH_TOPIC,
                    stamp,
                    self._make(
                        "geometry_msgs/msg/PoseStamped",
                        header=self._header(stamp, MAP),
                        pose=self._pose(self.truth[index]),
                    ),
                )

    def _make(self, name: str, **fields: Any) -> Any:
        return self.store.types[name](**fields)

    def _header(self, stamp: int, frame: str) -> Any:
        time = self._make(
            "builtin_interfaces/msg/Time", sec=stamp // NANOSECONDS, nanosec=stamp % NANOSECONDS
        )
        return self._make("std_msgs/msg/Header", stamp=time, frame_id=frame)

    def _vector(self, name: str, values: FloatArray) -> Any:
        x, y, z = (float(value) for value in values)
        return self._make(f"geometry_msgs/msg/{name}", x=x, y=y, z=z)

    def _turn(self, pose: FloatArray) -> Any:
        x, y, z, w = (float(value) for value in quaternion_of(pose))
        return self._make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def _pose(self, pose: FloatArray) -> Any:
        return self._make(
            "geometry_msgs/msg/Pose",
            position=self._vector("Point", pose[:3, 3]),
            orientation=self._turn(pose),
        )

    def _transform(self, stamp: int, parent: str, child: str, pose: FloatArray) -> Any:
        return self._make(
            "geometry_msgs/msg/TransformStamped",
            header=self._header(stamp, parent),
            child_frame_id=child,
            transform=self._make(
                "geometry_msgs/msg/Transform",
                translation=self._vector("Vector3", pose[:3, 3]),
                rotation=self._turn(pose),
            ),
        )

    def _tf(self, *transforms: Any) -> Any:
        return self._make("tf2_msgs/msg/TFMessage", transforms=list(transforms))

    def _transforms(self, index: int, stamp: int) -> list[Any]:
        """Where the pose is known map -> odom, and odom -> base_link; without odometry one step."""
        pose = self.poses[index] if self.known[index] else None
        if self.odometry is None:
            return [] if pose is None else [self._transform(stamp, MAP, BASE, pose)]
        odometry = self.odometry[index]
        found = [self._transform(stamp, ODOM, BASE, odometry)]
        if pose is not None:
            found.insert(0, self._transform(stamp, MAP, ODOM, pose @ inverse(odometry)))
        return found

    def _with_covariance(self, pose: FloatArray, covariance: FloatArray) -> Any:
        full = full_covariance(covariance, state_space_of_dimension(len(covariance)))
        return self._make(
            "geometry_msgs/msg/PoseWithCovariance", pose=self._pose(pose), covariance=full.ravel()
        )

    def _pose_message(self, frame: FrameRecord, stamp: int, pose: FloatArray) -> Any:
        refined = frame.refined_covariance if self.estimate == "refined" else None
        return self._make(
            "geometry_msgs/msg/PoseWithCovarianceStamped",
            header=self._header(stamp, MAP),
            pose=self._with_covariance(pose, frame.covariance if refined is None else refined),
        )

    def _odometry(self, stamp: int, pose: FloatArray) -> Any:
        still = self._vector("Vector3", np.zeros(3))
        twist = self._make("geometry_msgs/msg/Twist", linear=still, angular=still)
        return self._make(
            "nav_msgs/msg/Odometry",
            header=self._header(stamp, ODOM),
            child_frame_id=BASE,
            pose=self._with_covariance(pose, np.zeros((6, 6))),
            twist=self._make(
                "geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)
            ),
        )

    def _particles(self, frame: FrameRecord, stamp: int) -> Any:
        poses = [self._pose(pose) for pose in self.run.space.poses(frame.particles)]
        return self._make(
            "geometry_msgs/msg/PoseArray", header=self._header(stamp, MAP), poses=poses
        )

    def _image(self, index: int, stamp: int) -> Iterator[tuple[str, int, Any]]:
        """The camera image as it was recorded, and its camera."""
        data = self.run.encoded_images[index]
        kind = _MAGIC.get(data[:3])
        if kind is None:
            return
        header = self._header(stamp, CAMERA)
        yield (
            IMAGE_TOPIC,
            stamp,
            self._make(
                "sensor_msgs/msg/CompressedImage",
                header=header,
                format=kind,
                data=np.frombuffer(data, dtype=np.uint8),
            ),
        )
        yield INFO_TOPIC, stamp, self._camera_info(header, self.run.camera)

    def _camera_info(self, header: Any, camera: Camera) -> Any:
        distortion = camera.distortion
        model = "plumb_bob"
        if camera.model == "OPENCV_FISHEYE":
            model = "equidistant"
        elif camera.model == "FULL_OPENCV":
            model = "rational_polynomial"
        else:
            distortion = distortion[:5]
        matrix = camera.intrinsics.matrix()
        roi = self._make(
            "sensor_msgs/msg/RegionOfInterest",
            x_offset=0,
            y_offset=0,
            height=0,
            width=0,
            do_rectify=False,
        )
        return self._make(
            "sensor_msgs/msg/CameraInfo",
            header=header,
            height=camera.height,
            width=camera.width,
            distortion_model=model,
            d=distortion,
            k=matrix.ravel(),
            r=np.eye(3).ravel(),
            p=np.column_stack([matrix, np.zeros(3)]).ravel(),
            binning_x=0,
            binning_y=0,
            roi=roi,
        )


def _quality(*, latched: bool) -> Any:
    """What a publisher of these messages offers: AMCL's, without deadlines."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    # ROS 2 writes "for ever" so.
    forever = QosTime(9223372036, 854775807)
    return Qos(
        QosHistory.KEEP_LAST,
        1 if latched else 10,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        forever,
        forever,
        QosLiveliness.AUTOMATIC,
        forever,
        False,
    )
