"""The surface as a virtual camera sees it, fast: the same inverse depths as ``proxy``, compiled."""

from typing import NamedTuple

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray, Int32Array, IntArray
from pipelines.lightfield.compiled import compiled, compiled_leaf, compiled_loop, compiled_step
from pipelines.lightfield.mapping_kernels import virtual_rays
from pipelines.lightfield.proxy import (
    EDGE_FACTOR,
    LARGEST_GAP_SHARE,
    PINHOLE_FACTOR,
    PINHOLE_NEIGHBOURS,
    SOURCE_VIEWS,
    TURN_COST,
)
from pipelines.lightfield.splat_kernels import (
    ELSEWHERE,
    TOGETHER,
    DepthSamples,
    depth_samples,
    splat,
)
from pipelines.lightfield.views import ViewArrays


@compiled_step
def plane_surface(
    pose: FloatArray, rays: FloatArray, plane: FloatArray, surface: Float32Array
) -> None:
    """Writes the plane's inverse depth (H, W) in a virtual image; 0 where it is not seen.

    Args:
        pose: (4, 4) world_from_camera.
        rays: (3, 3) virtual pixels to world directions.
        plane: (4,) unit normal and offset.
        surface: (H, W) receives the result.
    """
    distance = plane[3]
    for i in range(3):
        distance += plane[i] * pose[i, 3]
    surface[:] = 0.0
    if distance <= 0.0:
        return
    slope = np.empty(3)
    for j in range(3):
        slope[j] = -(plane[0] * rays[0, j] + plane[1] * rays[1, j] + plane[2] * rays[2, j])
    for y in range(surface.shape[0]):
        for x in range(surface.shape[1]):
            value = (slope[0] * x + slope[1] * y + slope[2]) / distance
            surface[y, x] = max(value, 0.0)


class SurfaceRoom(NamedTuple):
    """Memory for the surface from depth maps in images of one size, over a mesh of h x w corners.

    Attributes:
        corners: ``(h w + ELSEWHERE,)`` inverse depths of the mesh, row by row, and what lies
            outside.
        padded: ``(h + 2, w + 2)`` the mesh with a border.
        mesh: ``(h, w)`` as it is in the end.
        empty: ``(h w,)`` corners without a depth, and
        filled: ``(h w,)`` what they are given.
        lefts: ``(W,)`` the corner on the left of each column, and
        shares: ``(W,)`` how far the column is from it to the next.
        matrix: ``(3, 4)`` world points to homogeneous virtual pixels.
        costs: ``(SOURCE_VIEWS,)`` how far views are away.
        numbers: ``(16,)``, and
        scratch: ``(TOGETHER,)``, and
        cells: ``(TOGETHER,)`` int32; see ``splat_kernels``.
    """

    corners: FloatArray
    padded: FloatArray
    mesh: FloatArray
    empty: IntArray
    filled: FloatArray
    lefts: IntArray
    shares: FloatArray
    matrix: FloatArray
    costs: FloatArray
    numbers: FloatArray
    scratch: FloatArray
    cells: Int32Array


@compiled_step
def surface_room_for(width: int, height: int, spacing: float) -> SurfaceRoom:
    """Memory for images of one size and corners that are so many pixels apart."""
    rows = int(np.ceil((height - 1) / spacing)) + 1
    columns = int(np.ceil((width - 1) / spacing)) + 1
    lefts, shares = np.empty(width, np.int64), np.empty(width)
    for column in range(width):
        lefts[column] = min(int(column / spacing), columns - 1)
        shares[column] = column / spacing - lefts[column]
    return SurfaceRoom(
        np.empty(rows * columns + ELSEWHERE),
        np.zeros((rows + 2, columns + 2)),
        np.empty((rows, columns)),
        np.empty(rows * columns, np.int64),
        np.empty(rows * columns),
        lefts,
        shares,
        np.empty((3, 4)),
        np.empty(SOURCE_VIEWS),
        np.empty(16),
        np.empty(TOGETHER),
        np.empty(TOGETHER, np.int32),
    )


@compiled_leaf
def _choose_sources(
    views: ViewArrays,
    usual_inverse_depth: float,
    pose: FloatArray,
    cost: FloatArray,
    sources: IntArray,
) -> int:
    """Writes the indices of the views whose depth maps make the surface; returns their number."""
    count = 0
    for view in range(len(views.centres)):
        if views.depth_size[view, 0] == 0:
            continue
        squared, cosine = 0.0, 0.0
        for i in range(3):
            squared += (views.centres[view, i] - pose[i, 3]) ** 2
            cosine += views.axes[view, i] * pose[i, 2]
        cosine = min(max(cosine, -1.0), 1.0)
        own = np.sqrt(squared) * usual_inverse_depth + TURN_COST * np.sqrt(2.0 - 2.0 * cosine)
        if count < SOURCE_VIEWS:
            slot = count
            count += 1
        elif own < cost[SOURCE_VIEWS - 1]:
            slot = SOURCE_VIEWS - 1
        else:
            continue
        while slot > 0 and cost[slot - 1] > own:
            cost[slot] = cost[slot - 1]
            sources[slot] = sources[slot - 1]
            slot -= 1
        cost[slot] = own
        sources[slot] = view
    return count


@compiled_leaf
def _depth_surface(
    views: ViewArrays,
    samples: DepthSamples,
    sources: IntArray,
    pose: FloatArray,
    intrinsics: FloatArray,
    spacing: float,
    room: SurfaceRoom,
    surface: Float32Array,
) -> None:
    """Writes the inverse depth (H, W) of the surface that the depth maps describe; 0: none.

    Args:
        views: the light field.
        samples: of its depth maps.
        sources: (SOURCE_VIEWS,) whose depth maps make the surface; -1 behind the last.
        pose: (4, 4) world_from_camera of the virtual camera.
        intrinsics: (4,) fx, fy, cx, cy.
        spacing: of the mesh's corners, virtual pixels.
        room: for images of this size; changed.
        surface: (H, W) receives the result.
    """
    matrix, corners = room.matrix, room.corners
    for j in range(3):
        matrix[0, j] = intrinsics[0] * pose[j, 0] + intrinsics[2] * pose[j, 2]
        matrix[1, j] = intrinsics[1] * pose[j, 1] + intrinsics[3] * pose[j, 2]
        matrix[2, j] = pose[j, 2]
    for i in range(3):
        matrix[i, 3] = -(
            matrix[i, 0] * pose[0, 3] + matrix[i, 1] * pose[1, 3] + matrix[i, 2] * pose[2, 3]
        )
    for i in range(len(corners)):
        corners[i] = 0.0
    height, columns = len(room.mesh), room.mesh.shape[1]
    for number in range(SOURCE_VIEWS):
        if sources[number] < 0:
            break
        splat(
            views,
            samples,
            sources[number],
            matrix,
            spacing,
            room.numbers,
            room.scratch,
            room.cells,
            corners,
            height,
            columns,
        )
    _leave_out_pinholes(room)
    _close(room)
    _interpolate(room, spacing, surface)


@compiled_leaf
def _leave_out_pinholes(room: SurfaceRoom) -> None:
    """Writes the mesh without corners that show the background between foreground points."""
    height, width = room.mesh.shape
    padded = room.padded
    for row in range(height):
        for column in range(width):
            padded[row + 1, column + 1] = room.corners[row * width + column]
    for row in range(height):
        _keep_solid(padded[row], padded[row + 1], padded[row + 2], room.mesh[row])


@compiled_loop
def _keep_solid(above: FloatArray, own: FloatArray, below: FloatArray, result: FloatArray) -> None:
    """Writes a row (w,) without its pinholes.

    Args:
        above: (w + 2,) the row above, with a 0 at both ends; so are the next two.
        own: the row.
        below: the row below.
        result: receives the row.
    """
    for i in range(len(result)):
        limit = PINHOLE_FACTOR * own[i + 1]
        nearer = 1.0 if own[i] > limit else 0.0
        nearer += 1.0 if own[i + 2] > limit else 0.0
        for column in range(3):
            nearer += 1.0 if above[i + column] > limit else 0.0
            nearer += 1.0 if below[i + column] > limit else 0.0
        result[i] = 0.0 if nearer >= PINHOLE_NEIGHBOURS else own[i + 1]


@compiled_leaf
def _close(room: SurfaceRoom) -> None:
    """Fills empty corners from the farthest known neighbour."""
    mesh, empty, filled = room.mesh, room.empty, room.filled
    height, width = mesh.shape
    # Only the empty corners are looked at again in each round.
    count = 0
    for row in range(height):
        for column in range(width):
            if mesh[row, column] == 0.0:
                empty[count] = row * width + column
                count += 1
    rounds = int(LARGEST_GAP_SHARE * max(height, width)) + 1
    while count > 0 and rounds > 0:
        rounds -= 1
        for number in range(count):
            row, column = empty[number] // width, empty[number] % width
            smallest = np.inf
            for i in range(max(row - 1, 0), min(row + 2, height)):
                for j in range(max(column - 1, 0), min(column + 2, width)):
                    if mesh[i, j] > 0.0:
                        smallest = min(smallest, mesh[i, j])
            filled[number] = smallest
        left = 0
        for number in range(count):
            if filled[number] < np.inf:
                mesh[empty[number] // width, empty[number] % width] = filled[number]
            else:
                empty[left] = empty[number]
                left += 1
        if left == count:
            break
        count = left


@compiled_leaf
def _interpolate(room: SurfaceRoom, spacing: float, surface: Float32Array) -> None:
    """Bilinear between corners of one surface; across an edge, or a gap, the nearest corner."""
    mesh, lefts, shares = room.mesh, room.lefts, room.shares
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    is_smooth = False
    for row in range(surface.shape[0]):
        y = row / spacing
        top = min(int(y), mesh.shape[0] - 1)
        bottom = min(top + 1, mesh.shape[0] - 1)
        fy = y - top
        cell = -1
        for column in range(surface.shape[1]):
            left, fx = lefts[column], shares[column]
            if left != cell:
                cell = left
                right = min(left + 1, mesh.shape[1] - 1)
                a, b = mesh[top, left], mesh[top, right]
                c, d = mesh[bottom, left], mesh[bottom, right]
                lowest = min(a, b, c, d)
                is_smooth = lowest > 0.0 and max(a, b, c, d) <= EDGE_FACTOR * lowest
            if is_smooth:
                surface[row, column] = (a * (1 - fx) + b * fx) * (1 - fy) + (
                    c * (1 - fx) + d * fx
                ) * fy
            elif fy < 0.5:
                surface[row, column] = a if fx < 0.5 else b
            else:
                surface[row, column] = c if fx < 0.5 else d


@compiled
def plane_surfaces(
    poses: FloatArray, intrinsics: FloatArray, plane: FloatArray, surfaces: Float32Array
) -> None:
    """Writes the plane's inverse depths (B, H, W) in B virtual images; see ``plane_surface``."""
    rays = np.empty((3, 3))
    for index in range(len(poses)):
        virtual_rays(poses[index], intrinsics, rays)
        plane_surface(poses[index], rays, plane, surfaces[index])


@compiled
def depth_surfaces(
    views: ViewArrays,
    usual_inverse_depth: float,
    poses: FloatArray,
    intrinsics: FloatArray,
    spacing: float,
    surfaces: Float32Array,
) -> None:
    """Writes the depth maps' surface (B, H, W) in B virtual images; see ``_depth_surface``.

    Args:
        views: the light field.
        usual_inverse_depth: the median of all depth maps.
        poses: (B, 4, 4) world_from_camera.
        intrinsics: (4,) fx, fy, cx, cy.
        spacing: of the mesh's corners, virtual pixels.
        surfaces: (B, H, W) receives the inverse depths.
    """
    room = surface_room_for(surfaces.shape[2], surfaces.shape[1], spacing)
    sources = np.full((len(poses), SOURCE_VIEWS), -1, np.int64)
    is_source = np.zeros(len(views.centres), np.bool_)
    for index in range(len(poses)):
        own = sources[index]
        for number in range(
            _choose_sources(views, usual_inverse_depth, poses[index], room.costs, own)
        ):
            is_source[own[number]] = True
    focal = 0.5 * (intrinsics[0] + intrinsics[1])
    samples = depth_samples(views, is_source, focal, spacing)
    for index in range(len(poses)):
        _depth_surface(
            views,
            samples,
            sources[index],
            poses[index],
            intrinsics,
            spacing,
            room,
            surfaces[index],
        )
