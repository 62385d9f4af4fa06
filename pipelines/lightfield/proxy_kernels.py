"""The surface as a virtual camera sees it, fast: the same inverse depths as ``proxy``, compiled."""

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray, IntArray
from pipelines.lightfield.compiled import compiled, compiled_loop
from pipelines.lightfield.mapping_kernels import virtual_rays
from pipelines.lightfield.proxy import (
    EDGE_FACTOR,
    LARGEST_GAP_SHARE,
    PINHOLE_FACTOR,
    PINHOLE_NEIGHBOURS,
    SOURCE_VIEWS,
    TURN_COST,
)
from pipelines.lightfield.splat_kernels import TOGETHER, splat
from pipelines.lightfield.views import ViewArrays


@compiled
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


@compiled
def choose_sources(
    views: ViewArrays, usual_inverse_depth: float, pose: FloatArray, sources: IntArray
) -> int:
    """Writes the indices of the views whose depth maps make the surface; returns their number."""
    cost = np.empty(SOURCE_VIEWS)
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


@compiled
def depth_surface(
    views: ViewArrays,
    usual_inverse_depth: float,
    pose: FloatArray,
    intrinsics: FloatArray,
    spacing: float,
    surface: Float32Array,
) -> None:
    """Writes the inverse depth (H, W) of the surface that the depth maps describe; 0: none.

    Args:
        views: the light field.
        usual_inverse_depth: the median of all depth maps.
        pose: (4, 4) world_from_camera of the virtual camera.
        intrinsics: (4,) fx, fy, cx, cy.
        spacing: of the mesh's corners, virtual pixels.
        surface: (H, W) receives the result.
    """
    height, width = surface.shape
    rows = int(np.ceil((height - 1) / spacing)) + 1
    # One column more for what lies outside.
    mesh = np.zeros((rows, int(np.ceil((width - 1) / spacing)) + 2))
    matrix = np.empty((3, 4))
    for j in range(3):
        matrix[0, j] = intrinsics[0] * pose[j, 0] + intrinsics[2] * pose[j, 2]
        matrix[1, j] = intrinsics[1] * pose[j, 1] + intrinsics[3] * pose[j, 2]
        matrix[2, j] = pose[j, 2]
    for i in range(3):
        matrix[i, 3] = -(
            matrix[i, 0] * pose[0, 3] + matrix[i, 1] * pose[1, 3] + matrix[i, 2] * pose[2, 3]
        )
    sources = np.empty(SOURCE_VIEWS, dtype=np.int64)
    count = choose_sources(views, usual_inverse_depth, pose, sources)
    focal = 0.5 * (intrinsics[0] + intrinsics[1])
    scratch, cells = np.empty(TOGETHER), np.empty(TOGETHER, np.int32)
    for number in range(count):
        splat(views, sources[number], matrix, focal, spacing, scratch, cells, mesh)
    _interpolate(_closed(_without_pinholes(mesh[:, :-1].copy())), spacing, surface)


@compiled
def _without_pinholes(mesh: FloatArray) -> FloatArray:
    """Empties corners that show the background through gaps between foreground points."""
    height, width = mesh.shape
    padded, result = np.zeros((height + 2, width + 2)), np.empty_like(mesh)
    for row in range(height):
        for column in range(width):
            padded[row + 1, column + 1] = mesh[row, column]
    for row in range(height):
        _keep_solid(padded[row], padded[row + 1], padded[row + 2], result[row])
    return result


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


@compiled
def _closed(mesh: FloatArray) -> FloatArray:
    """Fills empty corners from the farthest known neighbour."""
    height, width = mesh.shape
    current = mesh.copy()
    # Only the empty corners are looked at again in each round.
    empty = np.empty(height * width, dtype=np.int64)
    count = 0
    for index in range(height * width):
        if mesh[index // width, index % width] == 0.0:
            empty[count] = index
            count += 1
    filled = np.empty(count)
    for _ in range(int(LARGEST_GAP_SHARE * max(height, width)) + 1):
        for number in range(count):
            row, column = empty[number] // width, empty[number] % width
            smallest = np.inf
            for i in range(max(row - 1, 0), min(row + 2, height)):
                for j in range(max(column - 1, 0), min(column + 2, width)):
                    if current[i, j] > 0.0:
                        smallest = min(smallest, current[i, j])
            filled[number] = smallest
        left = 0
        for number in range(count):
            if filled[number] < np.inf:
                current[empty[number] // width, empty[number] % width] = filled[number]
            else:
                empty[left] = empty[number]
                left += 1
        if left == count:
            break
        count = left
    return current


@compiled
def _interpolate(mesh: FloatArray, spacing: float, surface: Float32Array) -> None:
    """Bilinear between corners of one surface; across an edge, or a gap, the nearest corner."""
    lefts, shares = np.empty(surface.shape[1], np.int64), np.empty(surface.shape[1])
    for column in range(surface.shape[1]):
        lefts[column] = min(int(column / spacing), mesh.shape[1] - 1)
        shares[column] = column / spacing - lefts[column]
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
    """Writes the depth maps' surface (B, H, W) in B virtual images; see ``depth_surface``."""
    for index in range(len(poses)):
        depth_surface(
            views, usual_inverse_depth, poses[index], intrinsics, spacing, surfaces[index]
        )
