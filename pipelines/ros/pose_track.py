"""Poses over time from messages, and the pose at a moment between two of them."""

from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, IntArray
from pipelines.artifacts.errors import InputError
from pipelines.geometry.interpolation import poses_between
from pipelines.geometry.pose import pose_from_quaternion

NANOSECONDS = 1_000_000_000
# Quaternions in messages are unit ones but for rounding to 32 bits.
QUATERNION_TOLERANCE = 0.02
# Metres: further than any robot goes, and its square is still a number.
LARGEST_NUMBER = 1e9


@dataclass(frozen=True)
class PoseTrack:
    """Poses of one frame in another.

    Attributes:
        stamps: ``(N,)`` ns, strictly increasing.
        poses: ``(N, 4, 4)``, metres.
    """

    stamps: IntArray
    poses: FloatArray

    def __len__(self) -> int:
        return len(self.stamps)

    def at(self, stamps: IntArray, max_gap: float) -> tuple[FloatArray, BoolArray]:
        """Poses at other moments: straight lines, and rotations along great circles.

        Args:
            stamps: ``(M,)`` ns.
            max_gap: seconds that two poses may lie apart for what is between them to be known.

        Returns:
            ``(M, 4, 4)`` poses, and ``(M,)`` whether each is known; the others are the identity.
        """
        poses = np.tile(np.eye(4), (len(stamps), 1, 1))
        right = np.searchsorted(self.stamps, stamps, side="left")
        exact = (right < len(self)) & (self.stamps[np.minimum(right, len(self) - 1)] == stamps)
        between = ~exact & (right > 0) & (right < len(self))
        left = np.maximum(right - 1, 0)
        inner = np.minimum(right, len(self) - 1)
        between &= self.stamps[inner] - self.stamps[left] <= max_gap * NANOSECONDS
        poses[exact] = self.poses[right[exact]]
        if np.any(between):
            first, second = left[between], right[between]
            share = (stamps[between] - self.stamps[first]) / (
                self.stamps[second] - self.stamps[first]
            )
            poses[between] = poses_between(self.poses[first], self.poses[second], share)
        return poses, np.asarray(exact | between, dtype=np.bool_)

    def moved(self, before: FloatArray, after: FloatArray) -> "PoseTrack":
        """The track of another frame in another: ``before @ pose @ after``, both ``(4, 4)``."""
        return PoseTrack(self.stamps, before @ self.poses @ after)


@dataclass
class PoseSamples:
    """Poses while they are read, eight bytes a number; ``track`` puts them in order."""

    numbers: "array[float]" = field(default_factory=lambda: array("d"))
    stamps: "array[int]" = field(default_factory=lambda: array("q"))

    def __len__(self) -> int:
        return len(self.stamps)

    def add(self, stamp: int, position: Any, orientation: Any) -> None:
        """Adds the pose of a message: its stamp (ns), a Point or Vector3, a Quaternion."""
        self.stamps.append(stamp)
        self.numbers.extend((position.x, position.y, position.z))
        self.numbers.extend((orientation.x, orientation.y, orientation.z, orientation.w))

    def track(self, name: Path | str, what: str) -> PoseTrack:
        """The poses in order of time; of several with one stamp the last.

        Args:
            name: of the bag, for the error.
            what: they are poses of, for the error.

        Raises:
            InputError: numbers that are not finite, a quaternion that is none, stamps that are all
                zero.
        """
        stamps = np.array(self.stamps, dtype=np.int64)
        table = np.array(self.numbers, dtype=np.float64).reshape(-1, 7)
        if len(stamps) > 1 and not np.any(stamps):
            raise InputError(name, f"the stamps of {what} are all zero")
        # Numbers that are not a number compare false.
        if not np.all(np.abs(table) <= LARGEST_NUMBER):
            raise InputError(name, f"{what} has a pose that is not finite, or beyond all places")
        lengths = np.linalg.norm(table[:, 3:], axis=1)
        if np.any(np.abs(lengths - 1.0) > QUATERNION_TOLERANCE):
            raise InputError(name, f"{what} has a quaternion that is not of unit length")
        order = np.argsort(stamps, kind="stable")
        is_last = np.append(np.diff(stamps[order]) > 0, True)[: len(order)]
        order = order[is_last]
        return PoseTrack(stamps[order], pose_from_quaternion(table[order, :3], table[order, 3:]))


def stamp_of(message: Any) -> int:
    """The time (ns) in a message's header, of ROS 1 or 2."""
    stamp = message.header.stamp
    part = stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nsec
    return int(stamp.sec) * NANOSECONDS + int(part)


def frame_name(text: object) -> str:
    """The name of a frame; the first releases of tf wrote a slash in front."""
    return str(text).lstrip("/")


def path_length(poses: FloatArray) -> float:
    """Metres: the sum of the straight steps from pose to pose ``(N, 4, 4)``."""
    return float(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum())


def moved_enough(poses: FloatArray, distance: float | None, angle: float | None) -> list[int]:
    """Indices of the first pose, and of each that lies far enough from the one taken before.

    Args:
        poses: ``(N, 4, 4)``.
        distance: metres; None: the distance does not count.
        angle: radians, likewise. Of both, one is enough.
    """
    taken: list[int] = []
    for index, pose in enumerate(poses):
        if not taken:
            taken.append(index)
            continue
        last = poses[taken[-1]]
        cosine = (float(np.trace(last[:3, :3].T @ pose[:3, :3])) - 1.0) / 2.0
        is_far = distance is not None and np.linalg.norm(pose[:3, 3] - last[:3, 3]) >= distance
        is_turned = angle is not None and np.arccos(np.clip(cosine, -1.0, 1.0)) >= angle
        if is_far or is_turned:
            taken.append(index)
    return taken


def merged_stamps(tracks: Iterable[PoseTrack]) -> IntArray:
    """All stamps of several tracks, each once, in order."""
    return np.unique(np.concatenate([track.stamps for track in tracks]))
