"""The scene's surface as a virtual camera sees it: one inverse depth a pixel.

Two sources. One plane for the whole scene: its inverse depth is linear in the pixel. Or the views'
depth maps: those of the nearest views are projected into the virtual image, and the points nearest
to the virtual camera are the vertices of a depth grid that follows the surface. As in the paper,
the surface is approximated for every virtual view, and only where it is seen. ``Quality`` sets the
spacing of the grid. This is the readable version; ``native/depth_surface.hpp`` is the fast one.
"""

import numpy as np

from pipelines.artifacts.arguments import checked_choice, checked_instance
from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.pose import inverse
from pipelines.lightfield.views import ViewArrays, Views
from pipelines.render.choices import Quality


def quality_named(name: str | None, has_depth: bool, preferred: Quality) -> Quality:
    """The quality of a name; None: ``preferred`` where there are depth maps, else the plane.

    Raises:
        OptionError: unknown name.
    """
    if name is None:
        return preferred if has_depth else Quality.PLANE
    checked_instance(name, "quality", str)
    checked_choice(name.lower(), "quality", (quality.name.lower() for quality in Quality))
    return Quality[name.upper()]


# So many views' depth maps make the surface.
SOURCE_VIEWS = 8
# A view that is rotated by a radian is as bad a source as one so many median depths away.
ROTATION_COST = 1.5
# Depth samples a grid cell, along one side: more than one, so that none stays empty by rounding.
SAMPLES_PER_CELL = 1.4
# Steps from sample to sample are counted in such parts of a depth pixel: whole numbers, so that all
# renderers sample the same pixels.
PIXEL_PARTS = 256
# A vertex is a far point seen through a gap in a near surface when so many of its eight neighbours
# are nearer by more than this factor.
PINHOLE_FACTOR, PINHOLE_NEIGHBOURS = 1.25, 5
# Vertices whose depths differ by more than this factor belong to different surfaces.
EDGE_FACTOR = 1.1
# Holes are filled with the farthest neighbour, over at most this share of the grid.
LARGEST_GAP_SHARE = 0.125


def depth_inverse_depth(
    views: Views, world_from_camera: FloatArray, intrinsics: Intrinsics, quality: Quality
) -> FloatArray:
    """Inverse depth of the surface that the views' depth maps describe, ``(H, W)``; 0: none."""
    spacing = grid_spacing(views, intrinsics, quality)
    grid = np.zeros(
        (
            int(np.ceil((intrinsics.height - 1) / spacing)) + 1,
            int(np.ceil((intrinsics.width - 1) / spacing)) + 1,
        )
    )
    for view in source_views(views, world_from_camera):
        _splat(views, int(view), world_from_camera, intrinsics, spacing, grid)
    grid = _filled(_without_pinholes(grid))
    columns, rows = np.meshgrid(np.arange(intrinsics.width), np.arange(intrinsics.height))
    return _interpolated(grid, columns / spacing, rows / spacing)


def grid_spacing(views: Views, intrinsics: Intrinsics, quality: Quality) -> float:
    """Spacing of the depth grid in virtual pixels, never finer than the depth maps can fill."""
    arrays = views.arrays
    focal = 0.5 * (intrinsics.fx + intrinsics.fy)
    has_depth = arrays.depth_size[:, 0] > 0
    scale = arrays.depth_size[has_depth, 0] / arrays.level_size[has_depth, 0, 0]
    finest = focal / float(np.min(arrays.focal[has_depth] * scale))
    return max(float(quality), finest)


def source_views(views: Views, world_from_camera: FloatArray) -> IntArray:
    """The views with depth maps that are nearest to the virtual camera, in position and axis."""
    arrays = views.arrays
    has_depth = arrays.depth_size[:, 0] > 0
    distance = np.linalg.norm(arrays.centres - world_from_camera[:3, 3], axis=1)
    cosine = np.clip(arrays.axes @ world_from_camera[:3, 2], -1.0, 1.0)
    cost = distance * median_inverse_depth(views) + ROTATION_COST * np.sqrt(2.0 - 2.0 * cosine)
    cost[~has_depth] = np.inf
    order = np.argsort(cost, kind="stable")[:SOURCE_VIEWS]
    return np.asarray(order[np.isfinite(cost[order])], dtype=np.int64)


def median_inverse_depth(views: Views) -> float:
    """Median of all known inverse depths of a light field, 1 / metres; 0 where there are none."""
    inverse_depth = views.arrays.inverse_depth
    known = inverse_depth[(inverse_depth > 0.0) & (inverse_depth < np.inf)]
    # These are copies: to copy them once more would take as much memory again.
    return float(np.median(known, overwrite_input=True)) if len(known) else 0.0


def _splat(
    views: Views,
    view: int,
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
    spacing: float,
    grid: FloatArray,
) -> None:
    """Splats one depth map onto the depth grid: each vertex keeps the nearest of its points."""
    arrays = views.arrays
    depth = views.depth_map(view).astype(np.float64)
    focal = 0.5 * (intrinsics.fx + intrinsics.fy)
    step = sample_steps(arrays, focal, spacing)[view]
    scale_x = arrays.level_size[view, 0, 0] / arrays.depth_size[view, 0]
    scale_y = arrays.level_size[view, 0, 1] / arrays.depth_size[view, 1]
    rows, columns = np.meshgrid(
        *(np.arange(0, PIXEL_PARTS * size, step) // PIXEL_PARTS for size in depth.shape),
        indexing="ij",
    )
    values = depth[rows, columns]
    known = values > 0.0
    x = (columns[known] + 0.5) * scale_x - 0.5
    y = (rows[known] + 0.5) * scale_y - 0.5
    matrix = intrinsics.matrix() @ inverse(world_from_camera)[:3]
    homography = matrix[:, :3] @ arrays.rays[view]
    epipole = matrix[:, :3] @ arrays.centres[view] + matrix[:, 3]
    pixels = np.stack([x, y, np.ones_like(x)], axis=-1)
    target = pixels @ homography.T + values[known, None] * epipole
    front = target[:, 2] > 1e-9
    target, values = target[front], values[known][front]
    column = np.floor(target[:, 0] / target[:, 2] / spacing + 0.5).astype(np.int64)
    row = np.floor(target[:, 1] / target[:, 2] / spacing + 0.5).astype(np.int64)
    inside = (column >= 0) & (column < grid.shape[1]) & (row >= 0) & (row < grid.shape[0])
    inverse_depth = values[inside] / target[inside, 2]
    np.maximum.at(grid, (row[inside], column[inside]), inverse_depth)


def sample_steps(arrays: ViewArrays, focal: float, spacing: float) -> IntArray:
    """Steps between sampled depth pixels, so that each grid cell gets a sample or two.

    Args:
        arrays: the light field.
        focal: focal length of the virtual camera, pixels.
        spacing: of the depth grid, virtual pixels.

    Returns:
        Each view's step ``(N,)`` in parts of a pixel, of which ``PIXEL_PARTS`` are one.
    """
    scale = arrays.depth_size[:, 0] / arrays.level_size[:, 0, 0]
    pixels = spacing * arrays.focal * scale / focal / SAMPLES_PER_CELL
    return np.asarray((PIXEL_PARTS * np.maximum(1.0, pixels)).astype(np.int64))


def _neighbours(grid: FloatArray) -> FloatArray:
    """``(8, h, w)`` values of the eight neighbours; 0 beyond the border."""
    height, width = grid.shape
    padded = np.pad(grid, 1)
    places = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    return np.stack([padded[i : i + height, j : j + width] for i, j in places])


def _without_pinholes(grid: FloatArray) -> FloatArray:
    """Empties vertices that show the background through gaps between foreground points."""
    nearer = np.sum(_neighbours(grid) > PINHOLE_FACTOR * grid, axis=0)
    return np.where(nearer >= PINHOLE_NEIGHBOURS, 0.0, grid)


def _filled(grid: FloatArray) -> FloatArray:
    """Fills holes with the farthest known neighbour: what appears behind an edge is far."""
    for _ in range(int(LARGEST_GAP_SHARE * max(grid.shape)) + 1):
        around = _neighbours(grid)
        smallest = np.where(around > 0.0, around, np.inf).min(axis=0)
        fillable = (grid == 0.0) & np.isfinite(smallest)
        if not fillable.any():
            break
        grid = np.where(fillable, smallest, grid)
    return grid


def _interpolated(grid: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Bilinear between vertices of one surface; across a depth edge, or a hole, the nearest one."""
    left = np.minimum(x.astype(np.int64), grid.shape[1] - 1)
    top = np.minimum(y.astype(np.int64), grid.shape[0] - 1)
    right = np.minimum(left + 1, grid.shape[1] - 1)
    bottom = np.minimum(top + 1, grid.shape[0] - 1)
    fx, fy = x - left, y - top
    around = np.stack([grid[top, left], grid[top, right], grid[bottom, left], grid[bottom, right]])
    smooth = (
        around[0] * (1 - fx) * (1 - fy)
        + around[1] * fx * (1 - fy)
        + around[2] * (1 - fx) * fy
        + around[3] * fx * fy
    )
    nearest = grid[np.where(fy < 0.5, top, bottom), np.where(fx < 0.5, left, right)]
    lowest = around.min(axis=0)
    one_surface = (lowest > 0.0) & (around.max(axis=0) <= EDGE_FACTOR * lowest)
    return np.asarray(np.where(one_surface, smooth, nearest))
