"""A room and the photos taken all around in it, ray by ray, for tests of scenes without a plane.

The room is a box. A partition with a doorway divides it; photos are taken in its western part.
"""

from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.lightfield.scene import SceneDepth
from tests.depth_samples import write_rgbd
from tests.lightfield_samples import looking, pinhole, pinhole_rays, pixels_of, waves

CAMERA = pinhole(96, 72, 70.0)
# x, y, z of the room's opposite corners, metres.
LOW, HIGH = np.array([0.0, 0.0, 0.0]), np.array([6.0, 3.0, 2.4])
# The partition, and the doorway in it.
PARTITION_X, DOOR_LOW, DOOR_HIGH = 3.6, 1.0, 1.9
CAMERA_HEIGHT = 1.0


def poses_all_around(spacing: float = 0.6, directions: int = 8) -> FloatArray:
    """``(N, 4, 4)`` photos in the western part, at each place in all directions."""
    poses = []
    for x in np.arange(0.8, 3.0, spacing):
        for y in np.arange(0.7, 2.5, spacing):
            for angle in np.arange(directions) * 2.0 * np.pi / directions + 0.1 * x:
                place = np.array([x, y, CAMERA_HEIGHT])
                ahead = np.array([np.cos(angle), np.sin(angle), -0.05])
                poses.append(looking(place, place + ahead))
    return np.array(poses)


def seen(pose: FloatArray) -> tuple[ImageArray, FloatArray]:
    """Photo and depth (metres along z) of the room, ray by ray."""
    rays = pinhole_rays(CAMERA, pixels_of(CAMERA)) @ pose[:3, :3].T
    centre = pose[:3, 3]
    with np.errstate(divide="ignore"):
        to_walls = np.where(rays > 0.0, (HIGH - centre) / rays, (LOW - centre) / rays)
        to_partition = (PARTITION_X - centre[0]) / rays[..., 0]
    depth = np.min(np.where(to_walls > 0.0, to_walls, np.inf), axis=-1)
    y = centre[1] + to_partition * rays[..., 1]
    is_met = (to_partition > 0.0) & ((y < DOOR_LOW) | (y > DOOR_HIGH))
    depth = np.where(is_met, np.minimum(depth, to_partition), depth)
    points = centre + depth[..., None] * rays
    # Two octaves, turned so that no wall has a constant colour along one of its sides.
    turned = points + 0.7 * np.roll(points, 1, axis=-1)
    colours = 0.6 * waves(1.7 * turned) + 0.4 * waves(6.1 * turned + 2.0)
    return np.rint(colours).astype(np.uint8), depth


def exact_depth(poses: FloatArray) -> tuple[SceneDepth, ...]:
    """A depth map a pose, without errors."""
    maps = [(1.0 / seen(pose)[1]).astype(np.float32) for pose in poses]
    return tuple(SceneDepth(values, np.ones(values.shape, dtype=np.bool_)) for values in maps)


def write_dataset(root: Path, poses: FloatArray) -> Path:
    """A data set of a robot whose camera is its body, with exact poses and depth images."""
    return write_rgbd(root, poses, seen, CAMERA)
