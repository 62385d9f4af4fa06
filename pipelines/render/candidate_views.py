"""The views in the form in which those that show surface points best are found fast.

Neighbours stand together in groups (the leaves of a k-d tree, Bentley 1975). A sphere around a
group's centres bounds the viewing angle of every one of its views, and planes bound what they see,
so that most groups of a large light field need no look at all; and the views of a group are looked
at all at once.
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

GROUP_VIEWS = 16
# Sides of an image.
SIDES = 4
VIEW_NUMBERS, GROUP_NUMBERS = 18, 4 + 4 * SIDES


class ViewIndex(NamedTuple):
    """S views, and the G groups that they form, in the form that the C++ core takes.

    Attributes:
        origin: ``(3,)`` world coordinates of the origin in which all else is given, so that single
            precision is enough far away from the world's.
        order: ``(S,)`` int32 the views, rising.
        numbers: ``(S * VIEW_NUMBERS,)`` of each: projection row by row, centre, width, height,
            width of the strip along the border.
        members: ``(G * GROUP_VIEWS,)`` int32 rows of these, group by group; -1: none.
        blocks: ``(G * VIEW_NUMBERS * GROUP_VIEWS,)`` the same numbers, group by group, and in each
            number by number; all zero where there is no view.
        groups: ``(G * GROUP_NUMBERS,)`` of each group: centre and radius of the sphere around its
            views' centres; then for each side of an image the unit normal of the plane through the
            centre and that side, pointing inwards, in the middle of the views', and how far from it
            theirs are at most.
    """

    origin: FloatArray
    order: Int32Array
    numbers: Float32Array
    members: Int32Array
    blocks: Float32Array
    groups: Float32Array


def build_index(views: Views, usable: BoolArray) -> ViewIndex:
    """Puts the usable ones ``(N,)`` of N views into groups."""
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
    """Numbers ``(G, GROUP_NUMBERS)``, see ``ViewIndex``, of groups of views ``(S, ...)``."""
    numbers = np.zeros((len(groups), GROUP_NUMBERS), dtype=np.float32)
    for group, members in enumerate(groups):
        own = centres[members]
        middle = 0.5 * (own.min(axis=0) + own.max(axis=0))
        radius = np.linalg.norm(own - middle, axis=1).max()
        mean = normals[members].mean(axis=0)
        spread = np.linalg.norm(normals[members] - mean, axis=-1).max(axis=0)
        numbers[group] = [*middle, radius, *np.column_stack([mean, spread]).reshape(-1)]
    return numbers
