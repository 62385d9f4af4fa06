"""What stands on the floor of a scene, seen from above, by its depth maps."""

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.camera import Undistorter
from pipelines.lightfield.scene import Scene

# Points of the surface lower than this are floor, metres.
FLOOR = 0.12
# Depth maps are read at every so many pixels, and their points gathered in cells of this size.
PIXEL_STRIDE, CELL = 4, 0.05
# A cell with fewer points than this is an error of a depth map.
LEAST_POINTS = 3


def standing_points(scene: Scene, top: float) -> FloatArray | None:
    """Where the surface stands on the floor, ``(M, 2)`` metres; None where no depth map shows any.

    Args:
        scene: the light field.
        top: what is higher than this above the floor does not count, metres.
    """
    if not scene.depth:
        return None
    points = [_points_of_view(scene, index, top) for index in range(len(scene))]
    places = np.concatenate(points)
    cells = np.floor(places / CELL).astype(np.int64)
    _, owner, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    owner = owner.reshape(-1)
    sums = [np.bincount(owner, places[:, axis], len(counts)) for axis in range(2)]
    # The middle of a cell's points and not of the cell: narrow passages count centimetres.
    kept = np.stack(sums, axis=1)[counts >= LEAST_POINTS] / counts[counts >= LEAST_POINTS, None]
    return None if len(kept) == 0 else np.asarray(kept, dtype=np.float64)


def _points_of_view(scene: Scene, index: int, top: float) -> FloatArray:
    """Where the surface that one view shows stands on the floor, ``(M, 2)``."""
    depth = scene.depth[index]
    height, width = depth.inverse_depth.shape
    pinhole = Undistorter(scene.camera_of(index)).intrinsics.resized(width, height)
    rows, columns = np.mgrid[0:height:PIXEL_STRIDE, 0:width:PIXEL_STRIDE]
    inverse = depth.inverse_depth[rows, columns].astype(np.float64)
    known = depth.confident[rows, columns] & (inverse > 0.0)
    z = 1.0 / inverse[known]
    camera = np.stack(
        [
            (columns[known] - pinhole.cx) / pinhole.fx * z,
            (rows[known] - pinhole.cy) / pinhole.fy * z,
            z,
        ],
        axis=1,
    )
    pose = scene.world_from_camera[index]
    world = camera @ pose[:3, :3].T + pose[:3, 3]
    standing = (world[:, 2] > FLOOR) & (world[:, 2] < top)
    return np.asarray(world[standing, :2])
