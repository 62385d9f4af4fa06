"""The first reading of a bag: all that is small, and of images only their stamps.

Which images are taken, and where the camera was, is known before the first image is decoded.
"""

from array import array
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import IntArray
from pipelines.artifacts.errors import InputError, quoted
from pipelines.artifacts.stages import Progress
from pipelines.ros.bag_file import IMAGE_TYPES, INFO_TYPE, TF_TYPES, Bag, BagMessage
from pipelines.ros.camera_info import info_key
from pipelines.ros.pose_track import (
    NANOSECONDS,
    PoseSamples,
    PoseTrack,
    frame_name,
    stamp_of,
)
from pipelines.ros.tf_tree import TransformTree

STATIC_SUFFIX = "tf_static"
# Images pass each other on their way to the bag by less than this; a clock that is set back, or a
# simulation that is started again, goes back by more.
LARGEST_DISORDER = NANOSECONDS


@dataclass
class PoseMessages:
    """The poses of a topic: those of ``child`` in ``frame``; empty where a message does not say."""

    frame: str = ""
    child: str = ""
    samples: PoseSamples = field(default_factory=PoseSamples)


@dataclass
class Survey:
    """What a bag says beside its images.

    Attributes:
        tree: all transforms.
        infos: topic -> its first CameraInfo.
        poses: topic -> its poses.
        images: topic -> stamps (ns) of its images in the order of their receipt.
    """

    tree: TransformTree
    infos: dict[str, Any] = field(default_factory=dict)
    poses: dict[str, PoseMessages] = field(default_factory=dict)
    images: dict[str, "array[int]"] = field(default_factory=dict)

    def track(self, topic: str) -> PoseTrack:
        """The poses of a topic in order of time.

        Raises:
            InputError: numbers that are no poses, or stamps that are all zero.
        """
        return self.poses_of(topic).samples.track(self.tree.source, f"topic {quoted(topic)}")

    def poses_of(self, topic: str) -> PoseMessages:
        """What was read of a topic with poses.

        Raises:
            InputError: nothing, though the bag's index says that there is something.
        """
        if topic not in self.poses:
            raise InputError(self.tree.source, f"topic {quoted(topic)} has no messages")
        return self.poses[topic]

    def image_stamps(self, topic: str) -> IntArray:
        """``(N,)`` stamps (ns) of a topic's images in the order of their receipt.

        Raises:
            InputError: all are zero, or the clock goes back.
        """
        stamps = np.array(self.images[topic], dtype=np.int64)
        if len(stamps) > 1 and not np.any(stamps):
            raise InputError(
                self.tree.source,
                f"the stamps of all images of {quoted(topic)} are zero",
                "the driver has to set header.stamp",
            )
        latest = np.maximum.accumulate(stamps)
        if np.any(latest - stamps > LARGEST_DISORDER):
            first = int(np.argmax(latest - stamps > LARGEST_DISORDER))
            raise InputError(
                self.tree.source,
                f"the clock of {quoted(topic)} goes back by "
                f"{(latest[first] - stamps[first]) / NANOSECONDS:.3f} s at image {first}",
                "cut the bag there: what came before and after are two recordings",
            )
        return stamps


def survey_bag(bag: Bag, topics: Collection[str], progress: Progress) -> Survey:
    """Reads all transforms, and the CameraInfo, poses and images' stamps of some topics.

    Args:
        bag: the bag.
        topics: names of those beside the transforms.
        progress: told how far the work is.

    Raises:
        InputError: the bag is damaged, or a camera's CameraInfo changes.
    """
    names = sorted({*topics, *(topic.name for topic in bag.of_type(TF_TYPES))})
    survey = Survey(TransformTree(bag.path))
    keys: dict[str, tuple[Any, ...]] = {}
    for message in progress(bag.messages(names), "reading", bag.count(names)):
        if message.type in IMAGE_TYPES:
            stamps = survey.images.setdefault(message.topic, array("q"))
            stamps.append(bag.stamp(message))
        elif message.type in TF_TYPES:
            is_static = message.topic.endswith(STATIC_SUFFIX)
            survey.tree.add(bag.decoded(message).transforms, is_static=is_static)
        elif message.type == INFO_TYPE:
            _add_info(bag, survey, keys, message)
        else:
            _add_pose(bag, survey, message)
    return survey


def _add_info(
    bag: Bag, survey: Survey, keys: dict[str, tuple[Any, ...]], message: BagMessage
) -> None:
    info = bag.decoded(message)
    key = info_key(info)
    if message.topic not in keys:
        keys[message.topic] = key
        survey.infos[message.topic] = info
    # Numbers that are not a number differ from themselves; their camera is refused later.
    elif key != keys[message.topic] and repr(key) != repr(keys[message.topic]):
        raise InputError(
            bag.path,
            f"the camera of {quoted(message.topic)} changes at time "
            f"{stamp_of(info) / NANOSECONDS:.6f}",
            "a data set has one camera",
        )


def _add_pose(bag: Bag, survey: Survey, message: BagMessage) -> None:
    content = bag.decoded(message)
    poses = survey.poses.setdefault(message.topic, PoseMessages())
    frame = frame_name(content.header.frame_id)
    child = frame_name(getattr(content, "child_frame_id", ""))
    if not len(poses.samples):
        poses.frame, poses.child = frame, child
    elif (frame, child) != (poses.frame, poses.child):
        raise InputError(
            bag.path,
            f"topic {quoted(message.topic)} has poses of {quoted(child)} in {quoted(frame)} beside "
            f"those of {quoted(poses.child)} in {quoted(poses.frame)}",
        )
    if hasattr(content, "transform"):
        place, turn = content.transform.translation, content.transform.rotation
    else:
        # PoseStamped has the pose itself, the others one with a covariance.
        pose = content.pose if hasattr(content.pose, "position") else content.pose.pose
        place, turn = pose.position, pose.orientation
    poses.samples.add(stamp_of(content), place, turn)
