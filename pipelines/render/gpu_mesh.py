"""The Delaunay mesh for a GPU: triangulated on the CPU, of the views that the GPU selects.

A triangulation does not suit a GPU; shading and comparing do. So the GPU says which views see
anything of the virtual frustum, the CPU builds their meshes (``native.delaunay_meshes``) and packs
them into the words that ``mesh.wgsl`` reads. A region of a mesh is a triangle, or beyond the mesh's
border the part of the image in which the same views are blended.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray, Int32Array
from pipelines.geometry.camera import Intrinsics
from pipelines.native import delaunay_meshes
from pipelines.render.delaunay_mesh import MESH_LIMITS

WordArray = NDArray[np.uint32]
# Builds meshes from the pose of each index on, several at a time: ``ThreadPoolExecutor.map``.
Run = Callable[[Callable[[int], "Meshes"], Iterable[int]], Iterable["Meshes"]]

VIEWS_PER_REGION = 3
# As in ``mesh.wgsl``: four-word units of a region; pixels whose region one unit holds; views whose
# visibility one unit holds.
REGION_UNITS, PIXELS_PER_UNIT, VIEWS_PER_UNIT = 4, 4, 128
# Poses of one call of the core, and the most of one dispatch of the GPU.
POSES_A_CALL, MOST_POSES = 16, 4096


@dataclass(frozen=True)
class Meshes:
    """Meshes in B virtual images.

    Attributes:
        views: ``(B, R, 3)`` of each region, -1 after the last.
        weights: ``(B, R, 3, 4)`` of each view: coefficients of x, y, 1, x y from the middle of the
            image.
        region_of_pixel: ``(B, H, W)`` region of each pixel; -1 everywhere where there is no mesh.
        regions: number of regions of the mesh that has most.
    """

    views: Int32Array
    weights: Float32Array
    region_of_pixel: Int32Array
    regions: int


def largest_mesh_bytes(intrinsics: Intrinsics, view_count: int) -> int:
    """Bytes that one pose's mesh takes on the GPU at most.

    Args:
        intrinsics: of the virtual image.
        view_count: views that may be in the mesh.
    """
    units = REGION_UNITS * (4 * view_count + 8)
    units += _rounded_up(intrinsics.width * intrinsics.height, PIXELS_PER_UNIT) // PIXELS_PER_UNIT
    units += _rounded_up(view_count, VIEWS_PER_UNIT) // VIEWS_PER_UNIT
    return 16 * units


def build_meshes(
    run: Run,
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
    centres: FloatArray,
    visible: BoolArray,
) -> list[Meshes]:
    """Meshes in the virtual images of B cameras.

    Args:
        run: maps a function over indices, several at a time.
        world_from_camera: ``(B, 4, 4)``.
        intrinsics: of all cameras.
        centres: ``(N, 3)`` recording centres of the views.
        visible: ``(B, N)`` which views are in each mesh.
    """
    poses = np.ascontiguousarray(world_from_camera, dtype=np.float64)

    def build(start: int) -> Meshes:
        part = slice(start, start + POSES_A_CALL)
        views, weights, region_of_pixel, regions = delaunay_meshes(
            poses=poses[part],
            intrinsics=intrinsics.vector(),
            width=intrinsics.width,
            height=intrinsics.height,
            centres=centres,
            takes_part=visible[part],
            limits=MESH_LIMITS,
        )
        own_views, own_weights = views[:, :regions].copy(), weights[:, :regions].copy()
        return Meshes(own_views, own_weights, region_of_pixel, regions)

    return list(run(build, range(0, len(poses), POSES_A_CALL)))


def pack_meshes(parts: list[Meshes], visible: BoolArray) -> tuple[WordArray, int]:
    """The meshes as ``mesh.wgsl`` reads them, ``(B, n)`` words, and the regions of each.

    Args:
        parts: the meshes of all B poses.
        visible: ``(B, N)`` which views are in each mesh.
    """
    regions = max(part.regions for part in parts)
    count, view_count = visible.shape
    height, width = parts[0].region_of_pixel.shape[1:]
    table = np.zeros((count, regions, REGION_UNITS, 4), dtype=np.uint32)
    pixels = np.zeros((count, _rounded_up(height * width, PIXELS_PER_UNIT)), dtype=np.uint32)
    start = 0
    for part in parts:
        own = slice(start, start + len(part.views))
        start += len(part.views)
        table[own, : part.regions, 0, :VIEWS_PER_REGION] = part.views.astype(np.uint32)
        table[own, : part.regions, 1:] = part.weights.view(np.uint32)
        own_pixels = part.region_of_pixel.reshape(len(part.views), -1)
        pixels[own, : height * width] = own_pixels.astype(np.uint32)
    bits = np.zeros((count, _rounded_up(view_count, VIEWS_PER_UNIT)), dtype=np.uint8)
    bits[:, :view_count] = visible
    masks = np.packbits(bits, axis=1, bitorder="little").view("<u4")
    return np.concatenate([table.reshape(count, -1), pixels, masks], axis=1), regions


def _rounded_up(number: int, step: int) -> int:
    return -(-number // step) * step
