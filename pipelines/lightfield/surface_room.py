"""Memory for the surface that depth maps describe, made in Python for compiled functions."""

from typing import NamedTuple

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray, Int32Array, IntArray
from pipelines.artifacts.errors import OptionError
from pipelines.lightfield.aligned_memory import aligned
from pipelines.lightfield.record_type import compiled_record
from pipelines.lightfield.splat_kernels import ELSEWHERE, NUMBERS, TOGETHER
from pipelines.lightfield.vector_code import LANES

# Kernels work out which corner a point is nearest to in single precision, exact up to here.
MOST_CORNERS = 1 << 24


@compiled_record
class SurfaceRoom(NamedTuple):
    """Memory for the surface from depth maps in images of one size, over a mesh of h x w corners.

    Attributes:
        corners: ``((h + 2) (w + 2) + ELSEWHERE,)`` inverse depths of the mesh with a border, row by
            row, and what lies outside.
        mesh: ``(h + 1, w + 1)`` as it is in the end; the last row and column are there twice.
        empty: ``(h w,)`` corners without a depth, and
        filled: ``(h w,)`` what they are given.
        edges: ``(4 w,)`` values between two rows of corners: on the left of each cell, on the right
            of each, and twice, how much they change from there to here.
        halves: ``(W,)`` int32 the side of a cell that each column is nearest to, and
        offsets: ``(W,)`` how far away that is, as a share of the cell; to the left less than 0.
        columns: ``(P,)`` int32 of the pixels that matter, row by row, and
        starts: ``(H + 1,)`` where rows begin.
        matrix: ``(3, 4)`` world points to homogeneous virtual pixels.
        numbers: ``(NUMBERS,)``, and
        scratch: ``(LANES * TOGETHER,)``, and
        cells: ``(LANES * TOGETHER,)`` int32; see ``splat_kernels.splat``.
    """

    corners: Float32Array
    mesh: Float32Array
    empty: IntArray
    filled: Float32Array
    edges: Float32Array
    halves: Int32Array
    offsets: Float32Array
    columns: Int32Array
    starts: IntArray
    matrix: FloatArray
    numbers: Float32Array
    scratch: Float32Array
    cells: Int32Array


def surface_room_for(width: int, height: int, spacing: float, wanted: Int32Array) -> SurfaceRoom:
    """Memory for images of one size.

    Args:
        width: of the images, and
        height: of them.
        spacing: of the mesh's corners, pixels.
        wanted: (P,) int32 indices of the pixels that matter, rising.

    Raises:
        OptionError: more corners than can be told apart.
    """
    rows = int(np.ceil((height - 1) / spacing)) + 1
    columns = int(np.ceil((width - 1) / spacing)) + 1
    places = np.arange(width) / spacing
    lefts = np.minimum(places.astype(np.int64), columns - 1)
    is_right = places - lefts >= 0.5
    behind = (rows + 2) * (columns + 2)
    if behind + ELSEWHERE > MOST_CORNERS:
        raise OptionError(
            f"a surface of {columns} x {rows} corners in an image of {width} x {height} pixels is "
            "too large; choose a coarser quality, or fewer pixels"
        )
    return SurfaceRoom(
        aligned(behind + ELSEWHERE, np.float32),
        np.empty((rows + 1, columns + 1), np.float32),
        np.empty(rows * columns, np.int64),
        np.empty(rows * columns, np.float32),
        aligned(4 * columns, np.float32),
        np.where(is_right, lefts + columns, lefts).astype(np.int32),
        (places - lefts - is_right).astype(np.float32),
        wanted % width,
        np.searchsorted(wanted, np.arange(height + 1) * width),
        np.empty((3, 4)),
        np.empty(NUMBERS, np.float32),
        aligned(LANES * TOGETHER, np.float32),
        aligned(LANES * TOGETHER, np.int32),
    )
