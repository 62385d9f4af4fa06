"""Obstacle points: where surfaces stand on the floor of a scene, by its depth maps.

Where photos look in all directions there are hundreds of depth maps, and some are wrong far away:
along a corridor they show its wall where a door stands open. Obstacles of a scene without a plane
are therefore kept only where the views nearby do not see through them (free-space violation,
Merrell et al. 2007).
"""

import numpy as np
import scipy

from pipelines.artifacts.arrays import BoolArray, FloatArray, IntArray
from pipelines.geometry.camera import Undistorter
from pipelines.lightfield.ground_carving import median_depth
from pipelines.lightfield.open_world import OpenWorld
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene
from pipelines.lightfield.world_file import area_path

# Points of the surface lower than this are floor, metres.
FLOOR = 0.12
# Depth maps are sampled at every so many pixels; points are gathered in grid cells of this size,
# metres.
PIXEL_STRIDE, CELL = 4, 0.05
# A cell with fewer points than this is an outlier of a depth map.
LEAST_POINTS = 3
# Points of a cell are tested in slices of this height, metres: one may see over a table.
SLICE = 0.2
# A view sees through a point when its depth map is farther by more than this, metres and share of
# the depth. Views that are more than so many median depths away are not asked.
SLACK, SLACK_SHARE, NEARBY_IN_DEPTHS = 0.1, 0.03, 2.0
# A point is there when so many views see it, as a multiple of those that see through it.
SEEN_SHARE = 2.0
# In a world, a place is next to an area when the nearest photo of that is by so much farther than
# the nearest of all, metres: photos beyond a wall may be nearer to what stands before it.
BESIDE_AREA = 1.0


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
    cells = np.floor(places[:, :2] / CELL).astype(np.int64)
    _, owner, counts = distinct_rows(cells)
    sums = [np.bincount(owner, places[:, axis], len(counts)) for axis in range(2)]
    kept = counts >= LEAST_POINTS
    if scene.surface is None:
        kept &= _standing(scene, places, owner, kept)
    # The mean of a cell's points, not its centre: in narrow passages centimetres count.
    means = np.stack(sums, axis=1)[kept] / counts[kept, None]
    return None if len(means) == 0 else np.asarray(means, dtype=np.float64)


def obstacle_points_of_world(world: OpenWorld, top: float) -> FloatArray | None:
    """Positions ``(M, 2)`` of the obstacles in all areas; None where no depth map shows any.

    The areas are read one after the other, and of each only the points are kept, and of these only
    those in the area and next to it: of what is far from its photos none says that it is not there.

    Args:
        world: its areas.
        top: surfaces higher than this above the floor do not count, metres.

    Raises:
        InputError: an area's file is damaged, or cannot be read any more.
    """
    if not world.has_depth:
        return None
    points = [np.zeros((0, 2))]
    for number, area in enumerate(world.index.areas):
        found = obstacle_points(load_scene(area_path(world.path, area.name)), top)
        if found is not None:
            points.append(found[world.area_map.beside(found, number, BESIDE_AREA)])
    together = np.concatenate(points)
    return together if len(together) > 0 else None


def _points_of_view(scene: Scene, index: int, top: float) -> FloatArray:
    """Positions ``(M, 3)`` of the obstacles that one view shows."""
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
    return np.asarray(world[is_obstacle])


def _standing(
    scene: Scene, points: FloatArray, owner: IntArray, candidates: BoolArray
) -> BoolArray:
    """Which cells hold something that views nearby do not see through.

    Args:
        scene: the light field.
        points: ``(P, 3)`` of the surface.
        owner: ``(P,)`` the cell of each.
        candidates: ``(C,)`` the cells that are asked for.

    Returns:
        ``(C,)``; cells that no view nearby has in sight count as obstacles.
    """
    asked = candidates[owner]
    points, owner = points[asked], owner[asked]
    keys = np.stack([owner, np.floor(points[:, 2] / SLICE).astype(np.int64)], axis=1)
    slices, part, counts = distinct_rows(keys)
    sums = [np.bincount(part, points[:, axis], len(slices)) for axis in range(3)]
    middles = np.stack(sums, axis=1) / counts[:, None]
    seen, passed = np.zeros((2, len(slices)))
    tree = scipy.spatial.cKDTree(middles)
    reach = NEARBY_IN_DEPTHS * median_depth(scene.depth)
    for index in range(len(scene)):
        near = np.array(tree.query_ball_point(scene.world_from_camera[index, :3, 3], reach))
        if len(near) > 0:
            beyond = _depth_beyond(scene, index, middles[near])
            seen[near] += np.abs(beyond) <= 1.0
            passed[near] += beyond > 1.0
    stands = np.zeros(len(candidates), dtype=np.bool_)
    stands[slices[seen >= SEEN_SHARE * passed, 0]] = True
    return stands


def distinct_rows(rows: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Distinct rows, which of them each row is, and how often each is there.

    That is ``np.unique`` along an axis, which sorts rows as bytes and takes many times as long.

    Args:
        rows: ``(P, 2)``.

    Returns:
        ``(D, 2)`` rising, ``(P,)`` and ``(D,)``.
    """
    order = np.lexsort((rows[:, 1], rows[:, 0]))
    sorted_rows = rows[order]
    is_first = np.ones(len(rows), dtype=np.bool_)
    is_first[1:] = np.any(sorted_rows[1:] != sorted_rows[:-1], axis=1)
    number = np.cumsum(is_first) - 1
    owner = np.empty(len(rows), dtype=np.int64)
    owner[order] = number
    return sorted_rows[is_first], owner, np.bincount(number)


def _depth_beyond(scene: Scene, index: int, points: FloatArray) -> FloatArray:
    """By how much a view's depth exceeds that of points ``(K, 3)``, in units of the slack.

    Returns:
        ``(K,)``; NaN where the view does not have a point in sight or knows no depth.
    """
    depth = scene.depth[index]
    height, width = depth.inverse_depth.shape
    pinhole = Undistorter(scene.camera_of(index)).intrinsics.resized(width, height)
    pose = scene.world_from_camera[index]
    x, y, z = ((points - pose[:3, 3]) @ pose[:3, :3]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        column = np.rint(pinhole.fx * x / z + pinhole.cx)
        row = np.rint(pinhole.fy * y / z + pinhole.cy)
        inside = (z > 0.0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        pixel = np.where(inside, row, 0).astype(int), np.where(inside, column, 0).astype(int)
        known = inside & depth.confident[pixel] & (depth.inverse_depth[pixel] > 0.0)
        beyond = (1.0 / depth.inverse_depth[pixel] - z) / (SLACK + SLACK_SHARE * z)
    return np.where(known, beyond, np.nan)
