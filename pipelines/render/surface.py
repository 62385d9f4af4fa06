"""The scene's surface as a virtual camera sees it: one inverse depth a pixel.

Two sources. One plane for the whole scene: its inverse depth is linear in the pixel. Or the views'
depth maps: those of the nearest views are projected into the virtual image, and the points nearest
to the virtual camera are the corners of a mesh that follows the surface. As in the paper, the
surface is approximated anew for every virtual view, and only where it is seen. ``Quality`` sets the
size of the mesh's cells. This is the readable version; ``native/depth_surface.hpp`` is the fast
one.
"""

import numpy as np

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import OptionError
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
    if name.upper() not in Quality.__members__:
        known = ", ".join(quality.name.lower() for quality in Quality)
        raise OptionError(f"quality {name!r} is none of {known}")
    return Quality[name.upper()]


# So many views' depth maps make the surface.
SOURCE_VIEWS = 8
# A turned camera is as bad a source as one so many median depths away, a radian.
TURN_COST = 1.5
# Depth samples a cell, along one side: more than one, so that no cell stays empty by rounding.
SAMPLES_PER_CELL = 1.4
# Steps from sample to sample are counted in such parts of a depth pixel: whole numbers, so that all
# that render take the same pixels.
PIXEL_PARTS = 256
# A corner is a far point seen through a gap in a near surface when so many of its eight neighbours
# are nearer by more than this factor.
PINHOLE_FACTOR, PINHOLE_NEIGHBOURS = 1.25, 5
# Corners whose depths differ by more than this factor belong to different surfaces.
EDGE_FACTOR = 1.1
# Gaps are closed with the farthest neighbour, over at most this share of the mesh.
LARGEST_GAP_SHARE = 0.125


def depth_inverse_depth(
    views: Views, world_from_camera: FloatArray, intrinsics: Intrinsics, quality: Quality
) -> FloatArray:
    """Inverse depth of the surface that the views' depth maps describe, ``(H, W)``; 0: none."""
    spacing = cell_size(views, intrinsics, quality)
    mesh = np.zeros(
        (
            int(np.ceil((intrinsics.height - 1) / spacing)) + 1,
            int(np.ceil((intrinsics.width - 1) / spacing)) + 1,
        )
    )
    for view in source_views(views, world_from_camera):
        _splat(views, int(view), world_from_camera, intrinsics, spacing, mesh)
    mesh = _closed(_without_pinholes(mesh))
    columns, rows = np.meshgrid(np.arange(intrinsics.width), np.arange(intrinsics.height))
    return _interpolated(mesh, columns / spacing, rows / spacing)


def cell_size(views: Views, intrinsics: Intrinsics, quality: Quality) -> float:
    """Side of the mesh's cells in virtual pixels, never finer than the depth maps can fill."""
    arrays = views.arrays
    focal = 0.5 * (intrinsics.fx + intrinsics.fy)
    has_depth = arrays.depth_size[:, 0] > 0
    scale = arrays.depth_size[has_depth, 0] / arrays.level_size[has_depth, 0, 0]
    finest = focal / float(np.min(arrays.focal[has_depth] * scale))
    return max(float(quality), finest)


def source_views(views: Views, world_from_camera: FloatArray) -> IntArray:
    """The views nearest to the virtual camera in place and direction that have depth maps."""
    arrays = views.arrays
    has_depth = arrays.depth_size[:, 0] > 0
    distance = np.linalg.norm(arrays.centres - world_from_camera[:3, 3], axis=1)
    cosine = np.clip(arrays.axes @ world_from_camera[:3, 2], -1.0, 1.0)
    cost = distance * usual_inverse_depth(views) + TURN_COST * np.sqrt(2.0 - 2.0 * cosine)
    cost[~has_depth] = np.inf
    order = np.argsort(cost, kind="stable")[:SOURCE_VIEWS]
    return np.asarray(order[np.isfinite(cost[order])], dtype=np.int64)


def usual_inverse_depth(views: Views) -> float:
    """Median of all known inverse depths: what is near and far in this scene."""
    inverse_depth = views.arrays.inverse_depth
    known = inverse_depth[(inverse_depth > 0.0) & (inverse_depth < np.inf)]
    return float(np.median(known)) if len(known) else 0.0


def _splat(
    views: Views,
    view: int,
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
    spacing: float,
    mesh: FloatArray,
) -> None:
    """Projects one depth map into the virtual image; of points in one cell the nearest stays."""
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
    turn = matrix[:, :3] @ arrays.rays[view]
    shift = matrix[:, :3] @ arrays.centres[view] + matrix[:, 3]
    target = np.stack([x, y, np.ones_like(x)], axis=-1) @ turn.T + values[known, None] * shift
    front = target[:, 2] > 1e-9
    target, values = target[front], values[known][front]
    column = np.floor(target[:, 0] / target[:, 2] / spacing + 0.5).astype(np.int64)
    row = np.floor(target[:, 1] / target[:, 2] / spacing + 0.5).astype(np.int64)
    inside = (column >= 0) & (column < mesh.shape[1]) & (row >= 0) & (row < mesh.shape[0])
    nearness = values[inside] / target[inside, 2]
    np.maximum.at(mesh, (row[inside], column[inside]), nearness)


def sample_steps(arrays: ViewArrays, focal: float, spacing: float) -> IntArray:
    """From one projected depth pixel to the next, so that each cell gets a sample or two.

    Args:
        arrays: the light field.
        focal: of the virtual camera, pixels.
        spacing: of the mesh's corners, virtual pixels.

    Returns:
        Each view's step ``(N,)`` in parts of a pixel, of which ``PIXEL_PARTS`` are one.
    """
    scale = arrays.depth_size[:, 0] / arrays.level_size[:, 0, 0]
    pixels = spacing * arrays.focal * scale / focal / SAMPLES_PER_CELL
    return np.asarray((PIXEL_PARTS * np.maximum(1.0, pixels)).astype(np.int64))


def _neighbours(mesh: FloatArray) -> FloatArray:
    """``(8, h, w)`` values of the eight neighbours; 0 beyond the border."""
    height, width = mesh.shape
    padded = np.pad(mesh, 1)
    places = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    return np.stack([padded[i : i + height, j : j + width] for i, j in places])


def _without_pinholes(mesh: FloatArray) -> FloatArray:
    """Empties corners that show the background through gaps between foreground points."""
    nearer = np.sum(_neighbours(mesh) > PINHOLE_FACTOR * mesh, axis=0)
    return np.where(nearer >= PINHOLE_NEIGHBOURS, 0.0, mesh)


def _closed(mesh: FloatArray) -> FloatArray:
    """Fills empty corners from the farthest known neighbour: what appears behind an edge is far."""
    for _ in range(int(LARGEST_GAP_SHARE * max(mesh.shape)) + 1):
        around = _neighbours(mesh)
        smallest = np.where(around > 0.0, around, np.inf).min(axis=0)
        fillable = (mesh == 0.0) & np.isfinite(smallest)
        if not fillable.any():
            break
        mesh = np.where(fillable, smallest, mesh)
    return mesh


def _interpolated(mesh: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Bilinear between corners of one surface; across an edge, or a gap, the nearest corner."""
    left = np.minimum(x.astype(np.int64), mesh.shape[1] - 1)
    top = np.minimum(y.astype(np.int64), mesh.shape[0] - 1)
    right = np.minimum(left + 1, mesh.shape[1] - 1)
    bottom = np.minimum(top + 1, mesh.shape[0] - 1)
    fx, fy = x - left, y - top
    corners = np.stack([mesh[top, left], mesh[top, right], mesh[bottom, left], mesh[bottom, right]])
    smooth = (
        corners[0] * (1 - fx) * (1 - fy)
        + corners[1] * fx * (1 - fy)
        + corners[2] * (1 - fx) * fy
        + corners[3] * fx * fy
    )
    nearest = mesh[np.where(fy < 0.5, top, bottom), np.where(fx < 0.5, left, right)]
    lowest = corners.min(axis=0)
    one_surface = (lowest > 0.0) & (corners.max(axis=0) <= EDGE_FACTOR * lowest)
    return np.asarray(np.where(one_surface, smooth, nearest))
