"""Obstacle points: where surfaces stand on the floor of a scene, by its depth maps."""

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.camera import Undistorter
from pipelines.lightfield.scene import Scene

# Points of the surface lower than this are floor, metres.
FLOOR = 0.12
# Depth maps are sampled at every so many pixels; points are gathered in grid cells of this size,
# metres.
PIXEL_STRIDE, CELL = 4, 0.05
# A cell with fewer points than this is an outlier of a depth map.
LEAST_POINTS = 3


def obstacle_points(scene: Scene, top: float) -> FloatArray | None:
    """Positions ``(M, 2)`` of obstacles on the floor, metres; None where no depth map shows any.

    Args:
        scene: the light field.
        top: surfaces higher than this above the floor do not count, metres.
    """
    if not scene.depth:
        return None
    points = [_points_of_view(scene, index, top) for index in range(len(scene))]
    places = np.concatenate(points)
    cells = np.floor(places / CELL).astype(np.int64)
    _, owner, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    owner = owner.reshape(-1)
    sums = [np.bincount(owner, places[:, axis], len(counts)) for axis in range(2)]
    # The mean of a cell's points, not its centre: in narrow passages centimetres count.
    kept = np.stack(sums, axis=1)[counts >= LEAST_POINTS] / counts[counts >= LEAST_POINTS, None]
    return None if len(kept) == 0 else np.asarray(kept, dtype=np.float64)


def _points_of_view(scene: Scene, index: int, top: float) -> FloatArray:
    """Positions ``(M, 2)`` of the obstacles that one view shows."""
    depth = scene.depth[index]
    height, width = depth.inverse_depth.shape
    pinhole = Undistorter(scene.camera_of(index)).intrinsics.resized(width, height)
    rows, columns = np.mgrid[0:height:PIXEL_STRIDE, 0:width:PIXEL_STRIDE]
    inverse = depth.inverse_depth[rows, columns].astype(np.float64)
    known = depth.confident[rows, columns] & (inverse > 0.0)
    camera = pinhole.rays(columns[known], rows[known]) * (1.0 / inverse[known])[:, None]
    pose = scene.world_from_camera[index]
    world = camera @ pose[:3, :3].T + pose[:3, 3]
    is_obstacle = (world[:, 2] > FLOOR) & (world[:, 2] < top)
    return np.asarray(world[is_obstacle, :2])
