"""Which topics of a bag hold a camera, odometry, or ground truth, and which of them is meant."""

import difflib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from pipelines.artifacts.errors import InputError, quoted
from pipelines.ros.bag_file import (
    IMAGE_TYPES,
    INFO_TYPE,
    ODOMETRY_TYPE,
    POSE_TYPES,
    Bag,
)
from pipelines.ros.camera_info import is_rectified
from pipelines.ros.image_message import is_compressed, is_depth_image, message_size
from pipelines.ros.pose_track import frame_name

# What image_transport appends to a topic whose images are encoded.
_TRANSPORTS = ("compressed",)
# Packages whose messages are streams of video.
_VIDEO = re.compile(r"theora_image_transport/.*|ffmpeg_image_transport_msgs/.*|.*/CompressedVideo")
_GROUND_TRUTH = re.compile(r"ground_?truth|(^|/)gt(/|_|$)", re.IGNORECASE)
NO_ODOMETRY = "none"


@dataclass(frozen=True)
class CameraTopic:
    """A topic with images.

    Attributes:
        topic: its name.
        count: number of its images.
        frame: in which the camera looks along z.
        size: width and height, pixels, of the first image.
        encoding: of the first image, as its message says.
        is_depth: whether they are distances.
        info_topic: of its CameraInfo; None where there is none.
    """

    topic: str
    count: int
    frame: str
    size: tuple[int, int]
    encoding: str
    is_depth: bool
    info_topic: str | None

    @property
    def is_rectified(self) -> bool:
        """Whether its name says that the images have no distortion any more."""
        return is_rectified(self.topic)


def find_cameras(bag: Bag) -> tuple[CameraTopic, ...]:
    """All topics with images, by name; the first message of each is looked at.

    Raises:
        InputError: the first image of a topic is damaged.
    """
    return tuple(_camera_topic(bag, topic.name) for topic in bag.of_type(IMAGE_TYPES))


def choose_camera(bag: Bag, cameras: Sequence[CameraTopic], wanted: str | None) -> CameraTopic:
    """The camera that is imported.

    Args:
        bag: the bag.
        cameras: all of it.
        wanted: the name of a topic; None: there is only one, raw and compressed counted once.

    Raises:
        InputError: none, several and none is named, or none of this name.
    """
    if wanted is not None:
        topic = named_topic(bag, wanted, IMAGE_TYPES, "--camera", "images")
        camera = next(camera for camera in cameras if camera.topic == topic)
        if camera.is_depth:
            raise InputError(bag.path, f"topic {quoted(topic)} (--camera) holds depth, not images")
        return camera
    usable = [camera for camera in cameras if not camera.is_depth]
    if not usable:
        raise InputError(bag.path, f"holds no images{_instead_of_images(bag, cameras)}")
    bases = {_base_name(camera.topic) for camera in usable}
    if len(bases) > 1:
        names = ", ".join(quoted(camera.topic) for camera in usable)
        raise InputError(
            bag.path, f"holds images of {len(bases)} topics: {names}", "name one with --camera"
        )
    # What was encoded before is the second copy of what is there raw.
    return min(usable, key=lambda camera: len(camera.topic))


def find_odometry(bag: Bag, wanted: str | None) -> str | None:
    """The topic with the robot's odometry; None where tf has to say it, or nothing does.

    Args:
        bag: the bag.
        wanted: a topic, ``PARENT:CHILD`` or ``none``; None: the only topic of nav_msgs/Odometry.

    Raises:
        InputError: several and none is named, or none of this name.
    """
    if wanted is not None:
        if wanted == NO_ODOMETRY or is_frame_pair(wanted):
            return None
        return named_topic(bag, wanted, POSE_TYPES, "--odometry", "poses")
    found = [t.name for t in bag.of_type((ODOMETRY_TYPE,)) if not _GROUND_TRUTH.search(t.name)]
    if len(found) > 1:
        names = ", ".join(map(quoted, found))
        raise InputError(
            bag.path,
            f"holds odometry of {len(found)} topics: {names}",
            "name one with --odometry, or none",
        )
    return found[0] if found else None


def find_ground_truth(bag: Bag, wanted: str | None) -> str | None:
    """The topic with the robot's true poses; None where tf has to say it, or nothing does.

    Args:
        bag: the bag.
        wanted: a topic or ``PARENT:CHILD``; None: the only topic with poses whose name says so.

    Raises:
        InputError: none of this name.
    """
    if wanted is not None:
        if is_frame_pair(wanted):
            return None
        return named_topic(bag, wanted, POSE_TYPES, "--groundtruth", "poses")
    found = [t.name for t in bag.of_type(POSE_TYPES) if _GROUND_TRUTH.search(t.name)]
    return found[0] if len(found) == 1 else None


def is_frame_pair(text: str) -> bool:
    """Whether a source of poses is ``PARENT:CHILD``, two frames of tf, and not a topic."""
    return ":" in text


def frame_pair(text: str) -> tuple[str, str]:
    """The frames of ``PARENT:CHILD``."""
    parent, _, child = text.partition(":")
    return frame_name(parent), frame_name(child)


def named_topic(bag: Bag, wanted: str, types: Iterable[str], option: str, what: str) -> str:
    """The topic of a name, with or without its first slash.

    Raises:
        InputError: there is none of this name, which lists the nearest, or its messages are of
            another type, or it has none.
    """
    types = tuple(types)
    name = wanted if wanted in bag.topics else f"/{wanted}"
    if name not in bag.topics:
        usable = [topic.name for topic in bag.of_type(types)]
        near = difflib.get_close_matches(wanted, usable, 3, 0.3) or usable[:3]
        nearest = f"the nearest are {', '.join(map(quoted, near))}" if near else ""
        raise InputError(bag.path, f"has no topic {quoted(wanted)} ({option})", nearest)
    topic = bag.topics[name]
    if topic.type not in types:
        raise InputError(
            bag.path, f"topic {quoted(name)} ({option}) is of type {quoted(topic.type)}, not {what}"
        )
    if topic.count == 0:
        raise InputError(bag.path, f"topic {quoted(name)} ({option}) has no messages")
    return name


def _camera_topic(bag: Bag, name: str) -> CameraTopic:
    # Its generator is closed at once: what it holds of the bag is let go.
    messages = bag.messages([name])
    first = next(messages, None)
    messages.close()  # type: ignore[attr-defined]
    if first is None:
        raise InputError(bag.path, f"topic {quoted(name)} has no message, though its index has")
    message = bag.decoded(first)
    is_depth = is_depth_image(message)
    where = f"{bag.path}, topic {quoted(name)}"
    frame = frame_name(message.header.frame_id)
    return CameraTopic(
        topic=name,
        count=bag.topics[name].count,
        frame=frame,
        size=(0, 0) if is_depth else message_size(message, where),
        encoding=str(message.format if is_compressed(message) else message.encoding),
        is_depth=is_depth,
        info_topic=_info_topic(bag, name, frame),
    )


def _info_topic(bag: Bag, name: str, frame: str) -> str | None:
    """The CameraInfo beside a topic, or else the only one whose frame is the camera's."""
    base = _base_name(name)
    infos = [topic.name for topic in bag.of_type((INFO_TYPE,))]
    for candidate in (f"{base.rpartition('/')[0]}/camera_info", f"{base}/camera_info"):
        if candidate in infos:
            return candidate
    of_frame = []
    for info in infos:
        messages = bag.messages([info])
        first = next(messages, None)
        messages.close()  # type: ignore[attr-defined]
        if first is not None and frame_name(bag.decoded(first).header.frame_id) == frame:
            of_frame.append(info)
    return of_frame[0] if len(of_frame) == 1 else None


def _base_name(topic: str) -> str:
    base, _, transport = topic.rpartition("/")
    return base if transport in _TRANSPORTS else topic


def _instead_of_images(bag: Bag, cameras: Sequence[CameraTopic]) -> str:
    """What there is where images would be looked for."""
    if cameras:
        return f": {quoted(cameras[0].topic)} holds depth"
    for topic in bag.topics.values():
        if topic.count and _VIDEO.fullmatch(topic.type.replace("/msg/", "/")):
            return f": {quoted(topic.name)} is a video ({quoted(topic.type)}), which is not decoded"
    return ""
