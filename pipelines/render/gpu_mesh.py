"""The Delaunay mesh for a GPU: made on the CPU, which views it holds decided on the GPU.

A triangulation is no work for a GPU; shading and comparing are. So the GPU says which views see
anything of the virtual frustum, the CPU makes their meshes (``native.delaunay_meshes``) and packs
them into the words that ``net.wgsl`` reads.
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
# Runs work on parts, several at a time: ``ThreadPoolExecutor.map``.
Run = Callable[[Callable[[int], "Nets"], Iterable[int]], Iterable["Nets"]]

VIEWS_PER_CELL = 3
# ``net.wgsl``: words of four for a cell, pixels in one, views in one.
CELL_WORDS, LABELS_PER_WORD, VIEWS_PER_WORD = 4, 4, 128
# So many poses are one thread's turn, and so many the card's.
POSES_TOGETHER, MOST_POSES = 16, 4096


@dataclass(frozen=True)
class Nets:
    """Meshes in B virtual images.

    Attributes:
        views: ``(B, c, 3)`` of each region, -1 behind the last.
        weights: ``(B, c, 3, 4)`` coefficients of x, y, 1, x y from the middle of the image.
        labels: ``(B, H, W)`` each pixel's region; -1 everywhere where there is no mesh.
        cells: regions of the mesh that has most.
    """

    views: Int32Array
    weights: Float32Array
    labels: Int32Array
    cells: int


def largest_net_bytes(intrinsics: Intrinsics, view_count: int) -> int:
    """Bytes that one pose's mesh needs on the GPU at most."""
    pixels = intrinsics.width * intrinsics.height
    return 16 * _words_per_pose(_most_cells(view_count), pixels, view_count)


def cut_nets(
    run: Run,
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
    centres: FloatArray,
    visible: BoolArray,
) -> list[Nets]:
    """Meshes in the virtual images of B cameras.

    Args:
        run: does the parts.
        world_from_camera: ``(B, 4, 4)``.
        intrinsics: of all of them.
        centres: ``(N, 3)`` of the views.
        visible: ``(B, N)`` which views are in the meshes.
    """
    poses = np.ascontiguousarray(world_from_camera, dtype=np.float64)

    def cut(start: int) -> Nets:
        part = slice(start, start + POSES_TOGETHER)
        views, weights, labels, cells = delaunay_meshes(
            poses=poses[part],
            intrinsics=intrinsics.vector(),
            width=intrinsics.width,
            height=intrinsics.height,
            centres=centres,
            takes_part=visible[part],
            limits=MESH_LIMITS,
        )
        return Nets(views[:, :cells].copy(), weights[:, :cells].copy(), labels, cells)

    return list(run(cut, range(0, len(poses), POSES_TOGETHER)))


def net_words(parts: list[Nets], visible: BoolArray) -> tuple[WordArray, int]:
    """The meshes as ``net.wgsl`` reads them, ``(B, n)``, and the regions each has room for.

    Args:
        parts: the meshes of all B poses.
        visible: ``(B, N)``.
    """
    cells = max(part.cells for part in parts)
    count, view_count = visible.shape
    height, width = parts[0].labels.shape[1:]
    table = np.zeros((count, cells, CELL_WORDS, 4), dtype=np.uint32)
    labels = np.zeros((count, _rounded_up(height * width, LABELS_PER_WORD)), dtype=np.uint32)
    start = 0
    for part in parts:
        own = slice(start, start + len(part.views))
        start += len(part.views)
        table[own, : part.cells, 0, :VIEWS_PER_CELL] = part.views.astype(np.uint32)
        table[own, : part.cells, 1:] = part.weights.view(np.uint32)
        labels[own, : height * width] = part.labels.reshape(len(part.views), -1).astype(np.uint32)
    bits = np.zeros((count, _rounded_up(view_count, VIEWS_PER_WORD)), dtype=np.uint8)
    bits[:, :view_count] = visible
    masks = np.packbits(bits, axis=1, bitorder="little").view("<u4")
    return np.concatenate([table.reshape(count, -1), labels, masks], axis=1), cells


def _rounded_up(number: int, step: int) -> int:
    return -(-number // step) * step


def _most_cells(view_count: int) -> int:
    return 4 * view_count + 8


def _words_per_pose(cells: int, pixels: int, view_count: int) -> int:
    """Words of four."""
    labels = _rounded_up(pixels, LABELS_PER_WORD) // LABELS_PER_WORD
    bits = _rounded_up(view_count, VIEWS_PER_WORD) // VIEWS_PER_WORD
    return CELL_WORDS * cells + labels + bits
