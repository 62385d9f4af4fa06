"""Candidate view selection: an index in which the views that show a point best are found fast.

Neighbouring views form groups (the leaves of a k-d tree, Bentley 1975). A sphere around a group's
centres bounds the viewing angle of each of its views, and planes bound their frustums, so that most
groups of a large light field are rejected as a whole. The views of a group are evaluated at once,
by SIMD instructions.
"""

from typing import NamedTuple

import numpy as np

from pipelines.artifacts.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    Int32Array,
    IntArray,
)
from pipelines.lightfield.view_penalties import BORDER_SHARE
from pipelines.lightfield.views import Views

# Views of a group: the width of the widest SIMD registers in single precision.
GROUP_VIEWS = 16
# Sides of an image.
SIDES = 4
# Numbers that describe a view, and a group.
VIEW_NUMBERS, GROUP_NUMBERS = 18, 4 + 4 * SIDES


class ViewIndex(NamedTuple):
    """S views, and the G groups that they form, in the form that the C++ core takes.

    Attributes:
        origin: ``(3,)`` world coordinates of a local origin, to which all else refers: single
            precision is then enough far away from the world's origin.
        order: ``(S,)`` int32 indices of the views, rising.
        numbers: ``(S * VIEW_NUMBERS,)`` of each view: projection row by row, centre, width, height,
            width of the strip along the border.
        members: ``(G * GROUP_VIEWS,)`` int32 positions in ``order``, group by group; -1: none.
        blocks: ``(G * VIEW_NUMBERS * GROUP_VIEWS,)`` the numbers of the views, group by group, and
            within a group number by number; all zero where there is no view.
        groups: ``(G * GROUP_NUMBERS,)`` of each group: centre and radius of the sphere around its
            views' centres; then for each side of an image the mean of the views' unit normals of
            the plane through centre and side, pointing inwards, and their largest distance from the
            mean.
    """

    origin: FloatArray
    order: Int32Array
    numbers: Float32Array
    members: Int32Array
    blocks: Float32Array
    groups: Float32Array


def build_index(views: Views, usable: BoolArray) -> ViewIndex:
    """Groups views.

    Args:
        views: the light field's photos.
        usable: ``(N,)`` views that may take part.
    """
    chosen = np.flatnonzero(usable)
    centres = views.centres[chosen]
    origin = centres.mean(axis=0) if len(chosen) else np.zeros(3)
    numbers = np.zeros((len(chosen), VIEW_NUMBERS), dtype=np.float32)
    projection = views.arrays.projection[chosen]
    projection[:, :, 3] += projection[:, :, :3] @ origin
    size = views.arrays.level_size[chosen, 0]
    numbers[:, :12] = projection.reshape(-1, 12)
    numbers[:, 12:15] = centres - origin
    numbers[:, 15:17] = size
    numbers[:, 17] = BORDER_SHARE * size.min(axis=1)
    groups = _groups(centres, np.arange(len(chosen)))
    members = np.full((len(groups), GROUP_VIEWS), -1, dtype=np.int32)
    blocks = np.zeros((len(groups), VIEW_NUMBERS, GROUP_VIEWS), dtype=np.float32)
    for group, rows in enumerate(groups):
        members[group, : len(rows)] = rows
        blocks[group, :, : len(rows)] = numbers[rows].T
    return ViewIndex(
        origin=origin,
        order=chosen.astype(np.int32),
        numbers=numbers.reshape(-1),
        members=members.reshape(-1),
        blocks=blocks.reshape(-1),
        groups=_group_numbers(centres - origin, _inward_normals(views)[chosen], groups).reshape(-1),
    )


def _groups(centres: FloatArray, members: IntArray) -> list[IntArray]:
    """Splits members in the middle of their longest extent until no group is too large."""
    if len(members) <= GROUP_VIEWS:
        return [members] if len(members) else []
    own = centres[members]
    axis = int(np.argmax(own.max(axis=0) - own.min(axis=0)))
    order = members[np.argsort(own[:, axis], kind="stable")]
    half = len(members) // 2
    return _groups(centres, order[:half]) + _groups(centres, order[half:])


def _inward_normals(views: Views) -> FloatArray:
    """Unit normals ``(N, SIDES, 3)``: a view shows what lies on the inner side of all planes."""
    across, down, forward = np.moveaxis(views.arrays.projection[:, :, :3], 1, 0)
    size = views.arrays.level_size[:, 0, :, None]
    normals = np.stack(
        [
            across + 0.5 * forward,
            (size[:, 0] - 0.5) * forward - across,
            down + 0.5 * forward,
            (size[:, 1] - 0.5) * forward - down,
        ],
        axis=1,
    )
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def _group_numbers(
    centres: FloatArray, normals: FloatArray, groups: list[IntArray]
) -> Float32Array:
    """``ViewIndex.groups`` as ``(G, GROUP_NUMBERS)``.

    Args:
        centres: ``(S, 3)`` of the views, from the local origin.
        normals: ``(S, SIDES, 3)`` inward normals of their frustums.
        groups: positions of each group's views.
    """
    numbers = np.zeros((len(groups), GROUP_NUMBERS), dtype=np.float32)
    for group, members in enumerate(groups):
        own = centres[members]
        middle = 0.5 * (own.min(axis=0) + own.max(axis=0))
        radius = np.linalg.norm(own - middle, axis=1).max()
        mean = normals[members].mean(axis=0)
        spread = np.linalg.norm(normals[members] - mean, axis=-1).max(axis=0)
        numbers[group] = [*middle, radius, *np.column_stack([mean, spread]).reshape(-1)]
    return numbers
