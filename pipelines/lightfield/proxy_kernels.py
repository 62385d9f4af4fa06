"""The surface as a virtual camera sees it, fast: the same inverse depths as ``proxy``, compiled."""

import numpy as np

from pipelines.artifacts.array_types import BoolArray, Float32Array, FloatArray, IntArray
from pipelines.lightfield.compiled import compiled, compiled_leaf, compiled_loop
from pipelines.lightfield.mapping_kernels import virtual_rays
from pipelines.lightfield.proxy import (
    EDGE_FACTOR,
    LARGEST_GAP_SHARE,
    PINHOLE_FACTOR,
    PINHOLE_NEIGHBOURS,
    SOURCE_VIEWS,
    TURN_COST,
)
from pipelines.lightfield.splat_kernels import HALF, ONE, ZERO, DepthSamples, splat
from pipelines.lightfield.surface_room import SurfaceRoom
from pipelines.lightfield.views import ViewArrays

FACTOR, NEIGHBOURS = np.float32(PINHOLE_FACTOR), np.float32(PINHOLE_NEIGHBOURS)
EDGE, NEVER = np.float32(EDGE_FACTOR), np.float32(np.inf)


@compiled_leaf
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
    if distance <= 0.0:
        for y in range(surface.shape[0]):
            for x in range(surface.shape[1]):
                surface[y, x] = 0.0
        return
    right = -(plane[0] * rays[0, 0] + plane[1] * rays[1, 0] + plane[2] * rays[2, 0])
    down = -(plane[0] * rays[0, 1] + plane[1] * rays[1, 1] + plane[2] * rays[2, 1])
    start = -(plane[0] * rays[0, 2] + plane[1] * rays[1, 2] + plane[2] * rays[2, 2])
    for y in range(surface.shape[0]):
        for x in range(surface.shape[1]):
            value = (right * x + down * y + start) / distance
            surface[y, x] = max(value, 0.0)


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
        surface: (H, W) receives the result where it is wanted.
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
    height, width = len(room.mesh) - 1, room.mesh.shape[1] - 1
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
            width,
        )
    for row in range(height):
        _keep_solid(corners, np.uintp(row), np.uintp(width), room.mesh[row])
    _close(room)
    for row in range(height):
        room.mesh[row, width] = room.mesh[row, width - 1]
    for column in range(width + 1):
        room.mesh[height, column] = room.mesh[height - 1, column]
    for row in range(surface.shape[0]):
        first, last = room.starts[row], room.starts[row + 1]
        if first == last:
            continue
        y = row / spacing
        top = min(int(y), height - 1)
        _set_edges(room.mesh[top], room.mesh[top + 1], np.float32(y - top), room.edges)
        if last - first == surface.shape[1]:
            _interpolate(room, surface[row])
        else:
            _interpolate_some(room, first, last, surface[row])


@compiled_loop
def _keep_solid(
    corners: Float32Array, row: np.uintp, width: np.uintp, result: Float32Array
) -> None:
    """Writes a row of the mesh without corners that show the background between foreground points.

    Args:
        corners: ((h + 2) * (w + 2) + ELSEWHERE,) the mesh with a border of zeros.
        row: which.
        width: of the mesh.
        result: (w + 1,) receives the row.
    """
    above = row * (width + np.uintp(2))
    own = above + width + np.uintp(2)
    below = own + width + np.uintp(2)
    for i in range(width):
        value = corners[own + i + np.uintp(1)]
        limit = FACTOR * value
        nearer = ONE if corners[own + i] > limit else ZERO
        nearer += ONE if corners[own + i + np.uintp(2)] > limit else ZERO
        for column in range(np.uintp(3)):
            nearer += ONE if corners[above + i + column] > limit else ZERO
            nearer += ONE if corners[below + i + column] > limit else ZERO
        result[i] = ZERO if nearer >= NEIGHBOURS else value


@compiled_leaf
def _close(room: SurfaceRoom) -> None:
    """Fills empty corners from the farthest known neighbour."""
    mesh, empty, filled = room.mesh, room.empty, room.filled
    height, width = len(mesh) - 1, mesh.shape[1] - 1
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
            smallest = NEVER
            for i in range(max(row - 1, 0), min(row + 2, height)):
                for j in range(max(column - 1, 0), min(column + 2, width)):
                    if mesh[i, j] > 0.0:
                        smallest = min(smallest, mesh[i, j])
            filled[number] = smallest
        left = 0
        for number in range(count):
            if filled[number] < NEVER:
                mesh[empty[number] // width, empty[number] % width] = filled[number]
            else:
                empty[left] = empty[number]
                left += 1
        if left == count:
            break
        count = left


@compiled_loop
def _set_edges(
    upper: Float32Array, lower: Float32Array, share: np.float32, edges: Float32Array
) -> None:
    """Writes the values of a row of pixels between two rows of corners.

    Bilinear between corners of one surface; across an edge, or a gap, the nearest corner.

    Args:
        upper: (w + 1,) corners above, and
        lower: below.
        share: how far the pixels are from these to those.
        edges: (4 w,) see ``SurfaceRoom``.
    """
    width = np.uintp(len(edges) // 4)
    step = ONE if share >= HALF else ZERO
    for i in range(width):
        a, b = upper[i], upper[i + np.uintp(1)]
        c, d = lower[i], lower[i + np.uintp(1)]
        lowest = min(a, b, c, d)
        is_smooth = (lowest > ZERO) & (max(a, b, c, d) <= EDGE * lowest)
        down = share if is_smooth else step
        left, right = a + (c - a) * down, b + (d - b) * down
        slope = right - left if is_smooth else ZERO
        edges[i], edges[width + i] = left, right
        edges[width + width + i], edges[width + width + width + i] = slope, slope


@compiled_loop
def _interpolate(room: SurfaceRoom, surface: Float32Array) -> None:
    """Writes a row (W,) of the surface, whose edges are set."""
    edges, halves, offsets = room.edges, room.halves, room.offsets
    slopes = np.uintp(len(edges) // 2)
    for i in range(np.uintp(len(surface))):
        half = np.uintp(halves[i])
        surface[i] = edges[half] + edges[slopes + half] * offsets[i]


@compiled_leaf
def _interpolate_some(room: SurfaceRoom, first: int, last: int, surface: Float32Array) -> None:
    """Like ``_interpolate``, from one of the wanted pixels to another."""
    edges, halves, offsets = room.edges, room.halves, room.offsets
    slopes = np.uintp(len(edges) // 2)
    for i in range(np.uintp(first), np.uintp(last)):
        column = np.uintp(room.columns[i])
        half = np.uintp(halves[column])
        surface[column] = edges[half] + edges[slopes + half] * offsets[column]


@compiled
def plane_surfaces(
    poses: FloatArray,
    intrinsics: FloatArray,
    plane: FloatArray,
    rays: FloatArray,
    surfaces: Float32Array,
) -> None:
    """Writes the plane's inverse depths (B, H, W) in B virtual images; see ``plane_surface``."""
    for index in range(len(poses)):
        virtual_rays(poses[index], intrinsics, rays)
        plane_surface(poses[index], rays, plane, surfaces[index])


@compiled
def choose_sources(
    views: ViewArrays,
    usual_inverse_depth: float,
    poses: FloatArray,
    costs: FloatArray,
    sources: IntArray,
    is_source: BoolArray,
) -> None:
    """Chooses the views whose depth maps are projected into B virtual images.

    Args:
        views: the light field.
        usual_inverse_depth: the median of all depth maps.
        poses: (B, 4, 4) world_from_camera.
        costs: (SOURCE_VIEWS,) overwritten.
        sources: (B, SOURCE_VIEWS) receives the views whose depth maps make each image's surface,
            -1 behind the last.
        is_source: (N,) receives which views any image's surface is made of.
    """
    for view in range(len(is_source)):
        is_source[view] = False
    for index in range(len(poses)):
        own = sources[index]
        count = _choose_sources(views, usual_inverse_depth, poses[index], costs, own)
        for number in range(count):
            is_source[own[number]] = True
        for number in range(count, SOURCE_VIEWS):
            own[number] = -1


@compiled
def depth_surfaces(
    views: ViewArrays,
    samples: DepthSamples,
    sources: IntArray,
    poses: FloatArray,
    intrinsics: FloatArray,
    spacing: float,
    room: SurfaceRoom,
    surfaces: Float32Array,
) -> None:
    """Writes the depth maps' surface (B, H, W) in B virtual images; see ``_depth_surface``.

    Args:
        views: the light field.
        samples: of its depth maps, and
        sources: (B, SOURCE_VIEWS); see ``choose_sources``.
        poses: (B, 4, 4) world_from_camera.
        intrinsics: (4,) fx, fy, cx, cy.
        spacing: of the mesh's corners, virtual pixels.
        room: for images of this size and the pixels that matter; changed.
        surfaces: (B, H, W) receives their inverse depths.
    """
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
