"""Which ground the views of a scene leave free, by their depth maps.

Space carving on the floor's plan: a ray from a recording position passes free cells up to the
surface that it meets, and says that the cells behind are hidden. Only the part of a ray near its
camera's height counts: higher up it may pass over a partition, lower down below a table. A cell is
free where enough rays pass it, and not nearly all of the rays that would reach it end before.
"""

from collections.abc import Sequence

import numpy as np
import scipy

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.geometry.camera import Intrinsics
from pipelines.lightfield.free_ground import FreeGround
from pipelines.lightfield.scene import SceneDepth

# Side of a cell, metres, unless the ground then has more cells along a side than this.
CELL, LARGEST_SIDE = 0.1, 1500
# A robot may be this many median depths of the depth maps away from where photos were taken:
# farther away it sees other things than they do, or the same ones from far behind.
REACH_IN_DEPTHS = 1.0
# Metres above and below its camera within which a ray counts.
BAND = 0.3
# The median depth is that of every so many pixels, across and down.
STRIDE = 4
# Rays of a depth map across and down.
RAYS_ACROSS, RAYS_DOWN = 48, 36
# A cell is free when so many rays pass it, and so many of those that end before it.
LEAST_PASSING, PASSING_SHARE = 3, 0.25
# What lies so far around a recording position or a free cell is free too, metres: where photos were
# taken there was room for whoever took them, and a robot's camera is not its middle.
MARGIN = 0.25


def free_ground(
    world_from_camera: FloatArray, intrinsics: Sequence[Intrinsics], depth: Sequence[SceneDepth]
) -> FreeGround:
    """The ground that the views leave free, as far from them as they usually see.

    Args:
        world_from_camera: ``(N, 4, 4)``, N > 0.
        intrinsics: of the N undistorted photos.
        depth: their depth maps.
    """
    centres = world_from_camera[:, :3, 3]
    reach = REACH_IN_DEPTHS * median_depth(depth)
    low, high = centres[:, :2].min(axis=0), centres[:, :2].max(axis=0)
    extent = float(np.max(high - low)) + 2.0 * (reach + MARGIN)
    cell = max(CELL, extent / LARGEST_SIDE)
    corner = low - reach - MARGIN - cell
    columns, rows = (np.ceil((high + reach + MARGIN + cell - corner) / cell)).astype(int).tolist()
    passing, ending = np.zeros((2, rows * columns))
    for pose, pinhole, view in zip(world_from_camera, intrinsics, depth, strict=True):
        steps, is_before = _along_rays(pose, pinhole, view, reach, cell)
        column, row = np.floor((steps - corner) / cell).astype(np.int64).T
        index = row * columns + column
        passing += np.bincount(index[is_before], minlength=rows * columns)
        ending += np.bincount(index[~is_before], minlength=rows * columns)
    is_free = (passing >= LEAST_PASSING) & (passing >= PASSING_SHARE * ending)
    cells = is_free.reshape(rows, columns)
    column, row = np.floor((centres[:, :2] - corner) / cell).astype(np.int64).T
    cells[row, column] = True
    near = scipy.ndimage.distance_transform_edt(~cells) * cell <= MARGIN
    return FreeGround(corner, cell, np.asarray(near, dtype=np.bool_))


def median_depth(depth: Sequence[SceneDepth]) -> float:
    """Metres along the optical axis, over known pixels all across the maps."""
    sampled = [view.inverse_depth[::STRIDE, ::STRIDE] for view in depth]
    return 1.0 / float(np.median(np.concatenate([values[values > 0.0] for values in sampled])))


def _along_rays(
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
    depth: SceneDepth,
    reach: float,
    cell: float,
) -> tuple[FloatArray, BoolArray]:
    """Places along the rays of a view, from above.

    Returns:
        Places ``(S, 2)``, metres, and which lie before the surface ``(S,)``; the others lie behind.
        Those in the cell of the surface itself are left out.
    """
    height, width = depth.inverse_depth.shape
    pinhole = intrinsics.resized(width, height)
    u = ((np.arange(RAYS_ACROSS) + 0.5) / RAYS_ACROSS * width).astype(int)
    v = ((np.arange(RAYS_DOWN) + 0.5) / RAYS_DOWN * height).astype(int)
    column, row = (grid.reshape(-1) for grid in np.meshgrid(u, v))
    inverse_depth = depth.inverse_depth[row, column].astype(np.float64)
    known = inverse_depth > 0.0
    local = pinhole.rays(column[known], row[known])
    rays = local @ world_from_camera[:3, :3].T
    level = np.linalg.norm(rays[:, :2], axis=1)
    # All lengths from here on are along the floor.
    with np.errstate(divide="ignore"):
        in_band = BAND * level / np.abs(rays[:, 2])
    longest = np.minimum(reach, in_band)
    surface = level / inverse_depth[known]
    usable = level > 0.0
    direction = rays[usable, :2] / level[usable, None]
    lengths = np.arange(0.0, reach, 0.5 * cell)
    counts = lengths <= longest[usable, None]
    before = lengths <= surface[usable, None] - 0.5 * cell
    behind = lengths >= surface[usable, None] + cell
    ray, step = np.nonzero(counts & (before | behind))
    places = world_from_camera[:2, 3] + lengths[step, None] * direction[ray]
    return places, before[ray, step]
