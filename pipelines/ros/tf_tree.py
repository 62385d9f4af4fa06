"""The tree of frames that /tf and /tf_static make, and what it says of two of them."""

import difflib
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, quoted
from pipelines.geometry.pose import inverse, rotation_angle
from pipelines.ros.pose_track import PoseSamples, PoseTrack, frame_name, merged_stamps, stamp_of

# REP-105's names of the robot's frame, and of the one in which odometry is given.
BASE_FRAMES = ("base_link", "base_footprint")
ODOMETRY_FRAME = "odom"
# What a mount that is published again and again may differ by, and still be fixed.
FIXED_METRES, FIXED_RADIANS = 1e-3, 1e-3
# All transforms that are kept are 64 bytes each: 128 MB.
MAX_TRANSFORMS = 2_000_000


@dataclass
class _Edge:
    """From a frame to its parent: what was published last on /tf_static, and all of /tf."""

    parent: str
    child: str
    static: PoseSamples | None = None
    samples: PoseSamples = field(default_factory=PoseSamples)


@dataclass(frozen=True)
class _Step:
    """One edge of a way through the tree; ``down`` where it leads from the parent to the child."""

    edge: _Edge
    down: bool

    def of(self, parent_from_child: FloatArray) -> FloatArray:
        return parent_from_child if self.down else inverse(parent_from_child)


class TransformTree:
    """Transforms between frames, over time.

    Args:
        source: the bag, for errors.
    """

    def __init__(self, source: Path | str) -> None:
        self.source = source
        self._edges: dict[tuple[str, str], _Edge] = {}
        self._neighbours: dict[str, list[_Step]] = {}
        self._tracks: dict[tuple[str, str], PoseTrack] = {}
        self._moving = 0

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all frames, sorted."""
        return tuple(sorted(self._neighbours))

    @property
    def moving_pairs(self) -> tuple[tuple[str, str], ...]:
        """Parent and child of all transforms of /tf, sorted."""
        return tuple(sorted(key for key, edge in self._edges.items() if len(edge.samples)))

    def add(self, transforms: Iterable[Any], *, is_static: bool) -> None:
        """Adds the TransformStamped of a TFMessage.

        Raises:
            InputError: a transform that is none, or more than memory should hold.
        """
        for transform in transforms:
            parent, child = (
                frame_name(transform.header.frame_id),
                frame_name(transform.child_frame_id),
            )
            edge = self._edges.get((parent, child))
            if edge is None:
                edge = self._edges[parent, child] = _Edge(parent, child)
                self._neighbours.setdefault(parent, []).append(_Step(edge, down=True))
                self._neighbours.setdefault(child, []).append(_Step(edge, down=False))
            translation, rotation = transform.transform.translation, transform.transform.rotation
            if is_static:
                edge.static = PoseSamples()
                edge.static.add(0, translation, rotation)
                continue
            self._moving += 1
            if self._moving > MAX_TRANSFORMS:
                raise InputError(
                    self.source,
                    f"/tf has more than {MAX_TRANSFORMS} transforms",
                    "split the bag, or leave topics out of it",
                )
            self._tracks.pop((parent, child), None)
            edge.samples.add(stamp_of(transform), translation, rotation)

    def fixed(self, target: str, source: str) -> FloatArray:
        """``target_from_source``, ``(4, 4)``, of two frames that do not move against each other.

        Raises:
            InputError: the tree does not connect them, or they move.
        """
        # A way of static transforms counts before one that was published over and over.
        steps = self._way(target, source, lambda edge: edge.static is not None)
        if steps is None:
            steps = self._connected(target, source)
        pose = np.eye(4)
        for step in steps:
            pose = pose @ step.of(self._constant(step.edge))
        return pose

    def track(self, target: str, source: str, max_gap: float) -> PoseTrack:
        """``target_from_source`` over time, at all moments at which all parts of it are known.

        Args:
            target, source: frames.
            max_gap: seconds that two transforms may lie apart for what is between to be known.

        Raises:
            InputError: the tree does not connect them, or they never move.
        """
        steps = self._connected(target, source)
        tracks = {
            (edge.parent, edge.child): self._track(edge)
            for edge in (step.edge for step in steps)
            if edge.static is None
        }
        if not tracks:
            raise InputError(
                self.source,
                f"frame {quoted(source)} does not move in {quoted(target)}: "
                "/tf_static connects them",
            )
        stamps = merged_stamps(tracks.values())
        known = np.ones(len(stamps), dtype=np.bool_)
        poses: FloatArray = np.tile(np.eye(4), (len(stamps), 1, 1))
        for step in steps:
            edge = step.edge
            if edge.static is not None:
                poses = poses @ step.of(self._constant(edge))
                continue
            parts, is_known = tracks[edge.parent, edge.child].at(stamps, max_gap)
            known &= is_known
            poses = poses @ step.of(parts)
        return PoseTrack(stamps[known], poses[known])

    def recorded(self, parent: str, child: str) -> PoseTrack:
        """The transforms of one of the ``moving_pairs``, as they were published.

        Raises:
            InputError: one that is none, or stamps that are all zero.
        """
        return self._track(self._edges[parent, child])

    def _connected(self, target: str, source: str) -> list[_Step]:
        for frame in (target, source):
            if frame not in self._neighbours:
                near = difflib.get_close_matches(frame, self.frames, 3, 0.4)
                names = f"; the nearest are {', '.join(map(quoted, near))}" if near else ""
                raise InputError(self.source, f"tf has no frame {quoted(frame)}{names}")
        steps = self._way(target, source, lambda _: True)
        if steps is None:
            raise InputError(
                self.source, f"tf does not connect {quoted(source)} and {quoted(target)}"
            )
        return steps

    def _way(
        self, target: str, source: str, allowed: Callable[[_Edge], bool]
    ) -> list[_Step] | None:
        """The shortest way from ``target`` to ``source`` over edges that are allowed."""
        came: dict[str, tuple[str, _Step] | None] = {target: None}
        waiting = deque([target])
        while waiting and source not in came:
            frame = waiting.popleft()
            for step in self._neighbours.get(frame, ()):
                following = step.edge.child if step.down else step.edge.parent
                if following not in came and allowed(step.edge):
                    came[following] = (frame, step)
                    waiting.append(following)
        if source not in came:
            return None
        steps: list[_Step] = []
        before = came[source]
        while before is not None:
            steps.append(before[1])
            before = came[before[0]]
        return steps[::-1]

    def _track(self, edge: _Edge) -> PoseTrack:
        key = (edge.parent, edge.child)
        if key not in self._tracks:
            what = f"/tf of {quoted(edge.child)}"
            self._tracks[key] = edge.samples.track(self.source, what)
        return self._tracks[key]

    def _constant(self, edge: _Edge) -> FloatArray:
        """The transform of an edge that is always the same."""
        if edge.static is not None:
            what = f"/tf_static of {quoted(edge.child)}"
            return np.asarray(edge.static.track(self.source, what).poses[0], dtype=np.float64)
        poses = self._track(edge).poses
        changes = inverse(poses[:1]) @ poses
        distance = float(np.linalg.norm(changes[:, :3, 3], axis=1).max())
        angle = float(rotation_angle(changes).max())
        if distance > FIXED_METRES or angle > FIXED_RADIANS:
            raise InputError(
                self.source,
                f"frame {quoted(edge.child)} moves in {quoted(edge.parent)}, by {distance:.3g} m "
                f"and {np.degrees(angle):.3g} degrees: the camera is not fixed to the robot",
            )
        return np.asarray(poses[0], dtype=np.float64)


def base_of_tf(tree: TransformTree) -> str | None:
    """The robot's frame by its usual name; None where tf has none."""
    return next((frame for frame in BASE_FRAMES if frame in tree.frames), None)


def odometry_frames(tree: TransformTree) -> tuple[tuple[str, str], ...]:
    """Parent and child of the transforms that are odometry by the name of the parent."""
    return tuple(pair for pair in tree.moving_pairs if pair[0].rpartition("/")[2] == ODOMETRY_FRAME)
