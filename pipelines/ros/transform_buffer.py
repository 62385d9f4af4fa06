"""Transforms as they arrive: what ``/tf`` and ``/tf_static`` say of two frames at a moment.

Only the last seconds are kept. A pose between two messages is interpolated; beyond the newest there
is none, for a robot may have braked since.
"""

import bisect
import difflib
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import LfnavError, quoted
from pipelines.geometry.interpolation import poses_between
from pipelines.geometry.pose import inverse, pose_from_quaternion
from pipelines.ros.pose_track import NANOSECONDS, QUATERNION_TOLERANCE, frame_name, stamp_of

# Two messages may lie so far apart for what is between them to be known; seconds.
LARGEST_GAP = 1.0


class TransformError(LfnavError):
    """There is no transform between two frames at a moment, or not yet."""


@dataclass
class _Frame:
    """A frame in its parent: stamps (ns), positions and quaternions, in order of time."""

    parent: str
    is_static: bool
    stamps: list[int] = field(default_factory=list)
    poses: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)


class TransformBuffer:
    """The tree of frames over the last seconds; may be filled by one thread and read by another.

    Args:
        seconds: for which transforms are kept.
    """

    def __init__(self, seconds: float = 10.0) -> None:
        self._kept = round(seconds * NANOSECONDS)
        self._frames: dict[str, _Frame] = {}
        self._changed = threading.Condition()

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all frames, sorted."""
        with self._changed:
            parents = {frame.parent for frame in self._frames.values()}
            return tuple(sorted(parents | set(self._frames)))

    def clear(self) -> None:
        """Forgets what moves: the clock was set back."""
        with self._changed:
            self._frames = {name: item for name, item in self._frames.items() if item.is_static}
            self._changed.notify_all()

    def add(self, transforms: Iterable[Any], *, is_static: bool) -> tuple[str, ...]:
        """Adds the TransformStamped of a TFMessage.

        Returns:
            The frames whose transform is none: not finite, or with a quaternion that is not of
            unit length. They are left out.
        """
        refused = []
        with self._changed:
            for transform in transforms:
                child = frame_name(transform.child_frame_id)
                parent = frame_name(transform.header.frame_id)
                pose = _pose_parts(transform.transform.translation, transform.transform.rotation)
                if pose is None:
                    refused.append(child)
                else:
                    self._insert(parent, child, stamp_of(transform), pose, is_static)
            self._changed.notify_all()
        return tuple(refused)

    def add_pose(self, parent: str, child: str, stamp: int, pose: Any) -> bool:
        """Adds a geometry_msgs/Pose of one frame in another; whether it is one.

        Args:
            parent, child: frames.
            stamp: ns.
            pose: of the child in the parent.
        """
        parts = _pose_parts(pose.position, pose.orientation)
        if parts is None:
            return False
        with self._changed:
            self._insert(frame_name(parent), frame_name(child), stamp, parts, is_static=False)
            self._changed.notify_all()
        return True

    def wait(self, target: str, source: str, stamp: int, seconds: float) -> FloatArray:
        """``lookup`` once the transform has arrived, within ``seconds``.

        Raises:
            TransformError: it has not.
        """
        end = time.monotonic() + seconds
        with self._changed:
            while True:
                try:
                    return self._lookup(frame_name(target), frame_name(source), stamp)
                except TransformError:
                    left = end - time.monotonic()
                    if left <= 0.0:
                        raise
                self._changed.wait(left)

    def lookup(self, target: str, source: str, stamp: int) -> FloatArray:
        """``target_from_source`` at a moment, ``(4, 4)``.

        Args:
            target, source: frames.
            stamp: ns.

        Raises:
            TransformError: an unknown frame, frames that are not connected, or nothing is known of
                that moment; the text names the frames.
        """
        with self._changed:
            return self._lookup(frame_name(target), frame_name(source), stamp)

    def _insert(
        self,
        parent: str,
        child: str,
        stamp: int,
        pose: tuple[FloatArray, FloatArray],
        is_static: bool,
    ) -> None:
        frame = self._frames.get(child)
        if frame is None or frame.parent != parent or is_static:
            frame = self._frames[child] = _Frame(parent, is_static)
        if frame.stamps and stamp > frame.stamps[-1]:
            index = len(frame.stamps)
        else:
            index = bisect.bisect_left(frame.stamps, stamp)
        if index < len(frame.stamps) and frame.stamps[index] == stamp:
            frame.poses[index] = pose
            return
        frame.stamps.insert(index, stamp)
        frame.poses.insert(index, pose)
        first = bisect.bisect_left(frame.stamps, frame.stamps[-1] - self._kept)
        del frame.stamps[:first], frame.poses[:first]

    def _lookup(self, target: str, source: str, stamp: int) -> FloatArray:
        ways = [self._ancestors(frame) for frame in (target, source)]
        for frame, way in ((target, ways[0]), (source, ways[1])):
            is_parent = any(item.parent == frame for item in self._frames.values())
            if len(way) == 1 and not is_parent:
                raise TransformError(f"tf has no frame {quoted(frame)}{self._nearest(frame)}")
        common = next((frame for frame in ways[1] if frame in ways[0]), None)
        if common is None:
            raise TransformError(f"tf does not connect {quoted(target)} and {quoted(source)}")
        common_from_target, common_from_source = (
            self._product(way[: way.index(common)], stamp) for way in ways
        )
        return inverse(common_from_target) @ common_from_source

    def _ancestors(self, frame: str) -> list[str]:
        way = [frame]
        # A loop would be a fault of whoever publishes.
        while frame in self._frames and self._frames[frame].parent not in way:
            frame = self._frames[frame].parent
            way.append(frame)
        return way

    def _nearest(self, frame: str) -> str:
        parents = {item.parent for item in self._frames.values()}
        near = difflib.get_close_matches(frame, sorted(parents | set(self._frames)), 3, 0.4)
        return f"; the nearest are {', '.join(map(quoted, near))}" if near else ""

    def _product(self, way: list[str], stamp: int) -> FloatArray:
        """From the last frame's parent to the first of the frames."""
        pose = np.eye(4)
        for name in way:
            pose = self._at(name, stamp) @ pose
        return pose

    def _at(self, name: str, stamp: int) -> FloatArray:
        frame = self._frames[name]
        if frame.is_static:
            return pose_from_quaternion(*frame.poses[0])
        what = f"tf of {quoted(name)} in {quoted(frame.parent)}"
        index = bisect.bisect_left(frame.stamps, stamp)
        if index == len(frame.stamps):
            late = (stamp - frame.stamps[-1]) / NANOSECONDS
            raise TransformError(f"{what} ends {late:.3f} s before the image")
        if frame.stamps[index] == stamp:
            return pose_from_quaternion(*frame.poses[index])
        if index == 0:
            early = (frame.stamps[0] - stamp) / NANOSECONDS
            raise TransformError(f"{what} begins {early:.3f} s after the image")
        before, after = frame.stamps[index - 1], frame.stamps[index]
        if after - before > LARGEST_GAP * NANOSECONDS:
            raise TransformError(
                f"{what} has a gap of {(after - before) / NANOSECONDS:.3f} s around the image"
            )
        share = (stamp - before) / (after - before)
        earlier, later = (
            pose_from_quaternion(*pose)[None] for pose in frame.poses[index - 1 : index + 1]
        )
        return np.asarray(poses_between(earlier, later, np.array([share]))[0])


def _pose_parts(position: Any, orientation: Any) -> tuple[FloatArray, FloatArray] | None:
    """Position and unit quaternion, scalar last; None where they are none."""
    place = np.array([position.x, position.y, position.z], dtype=np.float64)
    rotation = np.array(
        [orientation.x, orientation.y, orientation.z, orientation.w], dtype=np.float64
    )
    length = float(np.linalg.norm(rotation))
    if not np.all(np.isfinite(place)) or not abs(length - 1.0) <= QUATERNION_TOLERANCE:
        return None
    return place, rotation / length
