"""The paper's net for a graphics card: cut on the CPU, which views it holds decided on the card.

A triangulation is no work for a card; shading and comparing are. So the card says which views see
anything of the virtual frustum, the CPU cuts their nets (``net_kernels``) and packs them into the
words that ``net.wgsl`` reads.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipelines.artifacts.array_types import BoolArray, Float32Array, FloatArray, IntArray
from pipelines.geometry.camera import Intrinsics
from pipelines.lightfield.compiled import compiled
from pipelines.lightfield.net_cell_kernels import NetRoom, net_room_for
from pipelines.lightfield.net_kernels import build_net

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
    """Nets in B virtual images.

    Attributes:
        views: ``(B, c, 3)`` of each cell, -1 behind the last.
        weights: ``(B, c, 3, 4)`` coefficients of x, y, 1, x y.
        labels: ``(B, H, W)`` each pixel's cell; -1 everywhere where there is no net.
        cells: of the net that has most.
    """

    views: IntArray
    weights: FloatArray
    labels: IntArray
    cells: int


def largest_net_bytes(intrinsics: Intrinsics, view_count: int) -> int:
    """Bytes that one pose's net needs on the card at most."""
    pixels = intrinsics.width * intrinsics.height
    return 16 * _words_per_pose(_most_cells(view_count), pixels, view_count)


def cut_nets(
    run: Run,
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
    centres: FloatArray,
    visible: BoolArray,
) -> list[Nets]:
    """Nets in the virtual images of B cameras.

    Args:
        run: does the parts.
        world_from_camera: ``(B, 4, 4)``.
        intrinsics: of all of them.
        centres: ``(N, 3)`` of the views.
        visible: ``(B, N)`` which views are in the nets.
    """
    poses = np.ascontiguousarray(world_from_camera, dtype=np.float64)

    def cut(start: int) -> Nets:
        part = slice(start, start + POSES_TOGETHER)
        count = len(poses[part])
        most = _most_cells(len(centres))
        views = np.full((count, most, VIEWS_PER_CELL), -1, dtype=np.int64)
        weights = np.zeros((count, most, VIEWS_PER_CELL, 4))
        labels = np.empty((count, intrinsics.height, intrinsics.width), dtype=np.int64)
        cells = _cut(
            poses[part],
            intrinsics.vector(),
            centres,
            visible[part],
            net_room_for(len(centres)),
            views,
            weights,
            labels,
        )
        return Nets(views[:, :cells].copy(), weights[:, :cells].copy(), labels, cells)

    return list(run(cut, range(0, len(poses), POSES_TOGETHER)))


def net_words(parts: list[Nets], visible: BoolArray) -> tuple[WordArray, int]:
    """The nets as ``net.wgsl`` reads them, ``(B, n)``, and how many cells each has room for.

    Args:
        parts: the nets of all B poses.
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
        table[own, : part.cells, 1:] = _centred(part.weights, width, height).view(np.uint32)
        labels[own, : height * width] = part.labels.reshape(len(part.views), -1).astype(np.uint32)
    bits = np.zeros((count, _rounded_up(view_count, VIEWS_PER_WORD)), dtype=np.uint8)
    bits[:, :view_count] = visible
    masks = np.packbits(bits, axis=1, bitorder="little").view("<u4")
    return np.concatenate([table.reshape(count, -1), labels, masks], axis=1), cells


def _centred(weights: FloatArray, width: int, height: int) -> Float32Array:
    """The weights' coefficients with the middle of the image as the origin.

    Thin triangles have steep weights: single precision needs an origin near the pixels.
    """
    x, y, one = weights[..., 0], weights[..., 1], weights[..., 2]
    centred = weights.astype(np.float32)
    centred[..., 2] = x * (0.5 * (width - 1)) + y * (0.5 * (height - 1)) + one
    return centred


def _rounded_up(number: int, step: int) -> int:
    return -(-number // step) * step


def _most_cells(view_count: int) -> int:
    return 4 * view_count + 8


def _words_per_pose(cells: int, pixels: int, view_count: int) -> int:
    """Words of four."""
    labels = _rounded_up(pixels, LABELS_PER_WORD) // LABELS_PER_WORD
    bits = _rounded_up(view_count, VIEWS_PER_WORD) // VIEWS_PER_WORD
    return CELL_WORDS * cells + labels + bits


@compiled
def _cut(
    poses: FloatArray,
    intrinsics: FloatArray,
    centres: FloatArray,
    visible: BoolArray,
    room: NetRoom,
    views: IntArray,
    weights: FloatArray,
    labels: IntArray,
) -> int:
    """Writes the nets of B poses; returns the number of cells of the largest."""
    most = 0
    for index in range(len(poses)):
        cells = build_net(
            centres,
            poses[index],
            intrinsics,
            visible[index],
            room,
            views[index],
            weights[index],
            labels[index],
        )
        if cells == 0:
            labels[index] = -1
        most = max(most, cells)
    return most
