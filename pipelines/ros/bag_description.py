"""Summary of a bag, for ``lfnav info``: its topics, and what an import would find in them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, reason_of
from pipelines.artifacts.stages import Progress
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import mount_of
from pipelines.ros.bag_file import INFO_TYPE, POSE_TYPES, Bag, Topic, open_bag
from pipelines.ros.bag_survey import Survey, survey_bag
from pipelines.ros.bag_topics import CameraTopic, find_cameras
from pipelines.ros.camera_info import camera_of_info
from pipelines.ros.pose_track import NANOSECONDS, PoseTrack, path_length
from pipelines.ros.tf_tree import TransformTree, base_of_tf, odometry_frames

# Of a frame whose z axis is that of a camera, as REP-103 names it.
OPTICAL_SUFFIX = "optical_frame"


@dataclass(frozen=True)
class DescribedCamera:
    """A topic with images, and its camera; ``problem`` says why it is not known."""

    topic: CameraTopic
    camera: Camera | None
    problem: str

    def text(self) -> str:
        """For people."""
        topic = self.topic
        if topic.is_depth:
            return f"{topic.count} images of depth ({reason_of(topic.encoding)})"
        size = f"{topic.size[0]}x{topic.size[1]}"
        known = self.problem if self.camera is None else self.camera.model
        return (
            f"{topic.count} images {size} {reason_of(topic.encoding)}, frame "
            f"{reason_of(topic.frame)}, {known}"
        )


@dataclass(frozen=True)
class DescribedPoses:
    """A topic, or two frames of tf, with poses that could be odometry or ground truth."""

    name: str
    frame: str
    child: str
    track: PoseTrack

    def text(self) -> str:
        """For people."""
        seconds = (self.track.stamps[-1] - self.track.stamps[0]) / NANOSECONDS
        return (
            f"{len(self.track)} poses of {reason_of(self.child) or 'a body'} in "
            f"{reason_of(self.frame) or 'a world'}, {seconds:.2f} s, "
            f"{path_length(self.track.poses):.2f} m"
        )


@dataclass(frozen=True)
class BagDescription:
    """A summary of a bag.

    Attributes:
        path: the file or folder.
        bag_format: for people.
        topics: all, by name.
        duration: seconds from the first receipt to the last.
        cameras: topics with images.
        poses: what could be odometry or ground truth.
        mounts: frame of a camera -> ``base_from_camera``, ``(4, 4)``.
        base: the robot's frame that the mounts are on; None where tf has none.
    """

    path: Path
    bag_format: str
    topics: tuple[Topic, ...]
    duration: float
    cameras: tuple[DescribedCamera, ...]
    poses: tuple[DescribedPoses, ...]
    mounts: dict[str, FloatArray]
    base: str | None

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people; the first row holds the column headings."""
        rows: list[tuple[str, ...]] = [
            ("bag", str(self.path)),
            ("format", self.bag_format),
            ("duration", f"{self.duration:.2f} s"),
        ]
        rows += [
            (reason_of(topic.name), f"{topic.count} x {reason_of(topic.type)}")
            for topic in self.topics
        ]
        rows += [(f"camera {reason_of(c.topic.topic)}", c.text()) for c in self.cameras]
        if not self.cameras:
            rows.append(("cameras", "none: the bag holds no images"))
        rows += [(f"poses {reason_of(p.name)}", p.text()) for p in self.poses]
        for frame, mount in self.mounts.items():
            (x, y, z), (roll, pitch, yaw) = mount_of(mount)
            text = f"{x:.3f}, {y:.3f}, {z:.3f} m, {roll:.1f}, {pitch:.1f}, {yaw:.1f} degrees"
            rows.append((f"mount of {reason_of(frame)}", f"{text} on {reason_of(self.base or '')}"))
        return rows

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types, SI units."""
        return {
            "kind": "bag",
            "path": str(self.path),
            "format": self.bag_format,
            "duration": self.duration,
            "topics": [
                {"name": topic.name, "type": topic.type, "count": topic.count}
                for topic in self.topics
            ],
            "cameras": [
                {
                    "topic": found.topic.topic,
                    "images": found.topic.count,
                    "width": found.topic.size[0],
                    "height": found.topic.size[1],
                    "encoding": found.topic.encoding,
                    "depth": found.topic.is_depth,
                    "frame": found.topic.frame,
                    "camera": None if found.camera is None else found.camera.to_dict(),
                    "problem": found.problem or None,
                }
                for found in self.cameras
            ],
            "poses": [
                {
                    "name": found.name,
                    "frame": found.frame,
                    "child_frame": found.child,
                    "poses": len(found.track),
                    "start": float(found.track.stamps[0] / NANOSECONDS),
                    "end": float(found.track.stamps[-1] / NANOSECONDS),
                    "path_length": path_length(found.track.poses),
                }
                for found in self.poses
            ],
            "base": self.base,
            "mounts": {frame: mount.tolist() for frame, mount in self.mounts.items()},
        }


def describe_bag(path: Path, progress: Progress) -> BagDescription:
    """Reads a bag (of images the first of each topic) and describes it.

    Args:
        path: a file or folder, as for ``open_bag``.
        progress: told how far the work is.

    Raises:
        InputError: no bag, or a damaged one.
        StageError: ``rosbags`` is not installed.
    """
    with open_bag(path) as bag:
        cameras = find_cameras(bag)
        names = [topic.name for topic in bag.of_type((INFO_TYPE, *POSE_TYPES))]
        survey = survey_bag(bag, names, progress)
        base = _base(survey)
        return BagDescription(
            path=path,
            bag_format=bag.format,
            topics=tuple(bag.topics.values()),
            duration=(bag.end - bag.start) / NANOSECONDS,
            cameras=tuple(_described(bag, camera, survey) for camera in cameras),
            poses=_poses(survey),
            mounts={} if base is None else _mounts(survey.tree, base, cameras),
            base=base,
        )


def _described(bag: Bag, topic: CameraTopic, survey: Survey) -> DescribedCamera:
    info = None if topic.info_topic is None else survey.infos.get(topic.info_topic)
    if info is None or topic.is_depth:
        return DescribedCamera(topic, None, "no CameraInfo")
    try:
        camera = camera_of_info(info, topic.size, bag.path, rectified=topic.is_rectified)
    except InputError as error:
        return DescribedCamera(topic, None, error.reason)
    return DescribedCamera(topic, camera, "")


def _base(survey: Survey) -> str | None:
    """The frame that odometry is of, or else the usual one."""
    children = {messages.child for messages in survey.poses.values() if messages.child}
    children |= {child for _, child in odometry_frames(survey.tree)}
    known = [child for child in sorted(children) if child in survey.tree.frames]
    return known[0] if len(known) == 1 else base_of_tf(survey.tree)


def _poses(survey: Survey) -> tuple[DescribedPoses, ...]:
    found = [
        DescribedPoses(topic, messages.frame, messages.child, survey.track(topic))
        for topic, messages in sorted(survey.poses.items())
    ]
    found += [
        DescribedPoses(f"{parent}:{child}", parent, child, survey.tree.recorded(parent, child))
        for parent, child in odometry_frames(survey.tree)
    ]
    return tuple(found)


def _mounts(
    tree: TransformTree, base: str, cameras: tuple[CameraTopic, ...]
) -> dict[str, FloatArray]:
    frames = {camera.frame for camera in cameras}
    frames |= {frame for frame in tree.frames if frame.endswith(OPTICAL_SUFFIX)}
    mounts = {}
    for frame in sorted(frames):
        try:
            mounts[frame] = tree.fixed(base, frame)
        except InputError:
            continue  # an import of that camera says why
    return mounts
