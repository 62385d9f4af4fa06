"""Which photos structure from motion compares with each other.

Comparing all pairs takes hours for hundreds of photos. Those worth it are neighbours in time,
photos that by odometry see the same part of the room (this module), and photos that look alike
(``retrieval``), where odometry has drifted.
"""

import itertools
from dataclasses import dataclass

import numpy as np
import scipy

from pipelines.artifacts.arrays import BoolArray, FloatArray, IntArray
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import inverse

Pairs = list[tuple[int, int]]

# Every image is compared with every other up to this number of images.
EXHAUSTIVE_LIMIT = 40
# Odometry and a known camera given, photos above this number are paired by place and view.
SPATIAL_LIMIT = 150
# Neighbours in time: each of the next ones, then 2, 4, 8, ... times as far.
SEQUENTIAL_OVERLAP = 10
# And every so many-th image with every other such one, which closes loops.
LOOP_PERIOD = 10
# With odometry, neighbours in time are paired up to this number without a look at their views.
FOLLOWING = 3
# The partners that a photo proposes by its view, and the least share of the view that they see.
PARTNERS, MIN_OVERLAP = 20, 0.2
# Views are compared by points at these depths, in units of ``depth_unit``.
DEPTHS = (1.0, 2.0, 4.0)
COLUMNS, ROWS = 5, 4
# Photos farther apart than this (same unit), or turned by more than this, are not compared:
# features are not recognised across such changes.
REACH, MAX_TURN = 4.0, np.radians(60.0)
# Metres, and steps between photos: what a view is as wide as.
SMALLEST_UNIT, UNIT_STEPS = 1.0, 2.0
CHUNK = 20_000


def image_pairs(count: int, matcher: str) -> Pairs:
    """Which images are compared where nothing is known of their places.

    Args:
        count: number of images, in time order.
        matcher: "exhaustive", "sequential", or "auto": exhaustive for small numbers.

    Returns:
        Pairs (i, j) with i < j, sorted, each once.
    """
    if matcher == "exhaustive" or (matcher == "auto" and count <= EXHAUSTIVE_LIMIT):
        return list(itertools.combinations(range(count), 2))
    offsets = set(range(1, SEQUENTIAL_OVERLAP + 1))
    offsets |= {2**power for power in range(SEQUENTIAL_OVERLAP)}
    pairs = {(i, i + offset) for i in range(count) for offset in offsets if i + offset < count}
    pairs |= set(itertools.combinations(range(0, count, LOOP_PERIOD), 2))
    return sorted(pairs)


@dataclass(frozen=True)
class ViewGeometry:
    """What of a camera decides which photos see the same.

    Attributes:
        rays: ``(S, 3)`` rays at depth one, evenly over the image.
        unit: metres; see ``depth_unit``.
        camera: that took the photos.
    """

    rays: FloatArray
    unit: float
    camera: Camera

    def points(self) -> FloatArray:
        """Points ``(D S, 3)`` that a camera sees, in its frame, metres."""
        depths = self.unit * np.array(DEPTHS)
        return np.asarray((depths[:, None, None] * self.rays).reshape(-1, 3))

    def sees(self, points: FloatArray) -> BoolArray:
        """Which of the points ``(..., 3)`` in the camera's frame lie in its image."""
        intrinsics = self.camera.intrinsics
        depth = np.maximum(points[..., 2], 1e-9)
        column = intrinsics.fx * points[..., 0] / depth + intrinsics.cx
        row = intrinsics.fy * points[..., 1] / depth + intrinsics.cy
        return np.asarray(
            (points[..., 2] > 0.0)
            & (np.abs(column - (self.camera.width - 1) / 2.0) <= self.camera.width / 2.0)
            & (np.abs(row - (self.camera.height - 1) / 2.0) <= self.camera.height / 2.0)
        )


def view_geometry(camera: Camera, world_from_camera: FloatArray) -> ViewGeometry:
    """How views of these photos are compared; lens distortion matters little and is left out."""
    columns = (np.arange(COLUMNS) + 0.5) / COLUMNS * camera.width - 0.5
    rows = (np.arange(ROWS) + 0.5) / ROWS * camera.height - 0.5
    x, y = np.meshgrid(columns, rows)
    rays = camera.intrinsics.rays(x.ravel(), y.ravel())
    return ViewGeometry(rays / rays[:, 2:], depth_unit(world_from_camera), camera)


def depth_unit(world_from_camera: FloatArray) -> float:
    """Metres: how far things are, judged by how densely the photos were taken."""
    steps = np.linalg.norm(np.diff(world_from_camera[:, :3, 3], axis=0), axis=1)
    return max(SMALLEST_UNIT, UNIT_STEPS * float(np.median(steps)))


def view_overlap(
    geometry: ViewGeometry, world_from_camera: FloatArray, pairs: IntArray
) -> FloatArray:
    """How much two photos see of the same, for each of the pairs ``(P, 2)``.

    Returns:
        ``(P,)``: the share of either photo's points that the other one sees, the smaller of both.
        Walls are not known, so they do not count.
    """
    camera_from_world = inverse(world_from_camera)
    points = geometry.points()
    shares = np.empty((len(pairs), 2))
    for start in range(0, len(pairs), CHUNK):
        chunk = pairs[start : start + CHUNK]
        for side, (own, other) in enumerate((chunk.T, chunk.T[::-1])):
            relative = camera_from_world[other] @ world_from_camera[own]
            moved = points @ np.swapaxes(relative[:, :3, :3], 1, 2) + relative[:, None, :3, 3]
            shares[start : start + CHUNK, side] = geometry.sees(moved).mean(axis=1)
    return np.asarray(shares.min(axis=1))


def spatial_pairs(camera: Camera, world_from_camera: FloatArray) -> Pairs:
    """Pairs of photos that see the same by their poses, and the next ones in time.

    Each photo proposes the ``PARTNERS`` that see most of what it sees.

    Args:
        camera: that took the photos.
        world_from_camera: ``(N, 4, 4)`` in time order, by odometry or better.

    Returns:
        Pairs (i, j) with i < j, sorted, each once.
    """
    count = len(world_from_camera)
    geometry = view_geometry(camera, world_from_camera)
    tree = scipy.spatial.cKDTree(world_from_camera[:, :3, 3])
    near = tree.query_pairs(REACH * geometry.unit, output_type="ndarray").astype(np.int64)
    axes = world_from_camera[:, :3, 2]
    cosine = np.sum(axes[near[:, 0]] * axes[near[:, 1]], axis=1)
    near = near[cosine >= np.cos(MAX_TURN)]
    near = near[np.lexsort((near[:, 1], near[:, 0]))]
    overlap = view_overlap(geometry, world_from_camera, near)
    near, overlap = near[overlap >= MIN_OVERLAP], overlap[overlap >= MIN_OVERLAP]
    chosen = {(i, j) for i in range(count) for j in range(i + 1, min(count, i + 1 + FOLLOWING))}
    owners, partners = np.concatenate([near, near[:, ::-1]]).T
    order = np.lexsort((partners, -np.concatenate([overlap, overlap]), owners))
    owners, partners = owners[order], partners[order]
    rank = np.arange(len(owners)) - np.searchsorted(owners, owners)
    best = np.stack([owners, partners], axis=1)[rank < PARTNERS]
    chosen |= {(min(pair), max(pair)) for pair in best.tolist()}
    return sorted(chosen)
