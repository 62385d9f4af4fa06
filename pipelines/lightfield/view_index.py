"""The views sorted by where they were taken, so that the best for a surface point are found fast.

Neighbours stand together in groups (the leaves of a k-d tree, Bentley 1975). A sphere around a
group's centres bounds the viewing angle of every one of its views, so that most groups of a large
light field need no look at all.
"""

from typing import NamedTuple

import numpy as np

from pipelines.artifacts.array_types import (
    BoolArray,
    Float32Array,
    FloatArray,
    Int32Array,
    IntArray,
)
from pipelines.lightfield.blending import BORDER_SHARE
from pipelines.lightfield.record_type import compiled_record
from pipelines.lightfield.views import Views

GROUP_VIEWS = 16
VIEW_NUMBERS, SPHERE_NUMBERS = 18, 4


@compiled_record
class ViewIndex(NamedTuple):
    """S views in G groups, in the form that compiled code takes.

    Attributes:
        origin: ``(3,)`` world coordinates of the origin in which all else is given, so that single
            precision is enough far away from the world's.
        order: ``(S,)`` int32 the views, group by group.
        places: ``(N,)`` int32 where each of all views stands in that order; -1: nowhere.
        starts: ``(G + 1,)`` where in that order a group begins.
        numbers: ``(S, 18)`` of each view in that order: projection row by row, centre, width,
            height, width of the strip along the border.
        spheres: ``(G, 4)`` centre and radius of each group.
    """

    origin: FloatArray
    order: Int32Array
    places: Int32Array
    starts: IntArray
    numbers: Float32Array
    spheres: Float32Array


def build_index(views: Views, usable: BoolArray) -> ViewIndex:
    """Sorts the usable ones ``(N,)`` of N views into groups."""
    chosen = np.flatnonzero(usable)
    centres = views.centres
    origin = centres[chosen].mean(axis=0) if len(chosen) else np.zeros(3)
    groups = _groups(centres, chosen)
    order = np.concatenate([*groups, np.zeros(0, dtype=np.int64)])
    numbers = np.zeros((len(order), VIEW_NUMBERS), dtype=np.float32)
    places = np.full(len(views), -1, dtype=np.int32)
    places[order] = np.arange(len(order))
    for place, view in enumerate(order):
        projection = views.arrays.projection[view].copy()
        projection[:, 3] += projection[:, :3] @ origin
        width, height = views.arrays.level_size[view, 0]
        numbers[place, :12] = projection.reshape(-1)
        numbers[place, 12:15] = centres[view] - origin
        numbers[place, 15:] = width, height, BORDER_SHARE * min(width, height)
    return ViewIndex(
        origin=origin,
        order=order.astype(np.int32),
        places=places,
        starts=np.cumsum([0, *map(len, groups)]),
        numbers=numbers,
        spheres=_spheres(centres - origin, groups),
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


def _spheres(centres: FloatArray, groups: list[IntArray]) -> Float32Array:
    """Centre and radius ``(G, 4)`` around the centres ``(N, 3)`` of each group's views."""
    spheres = np.zeros((len(groups), SPHERE_NUMBERS), dtype=np.float32)
    for group, members in enumerate(groups):
        own = centres[members]
        middle = 0.5 * (own.min(axis=0) + own.max(axis=0))
        spheres[group, :3] = middle
        spheres[group, 3] = np.linalg.norm(own - middle, axis=1).max()
    return spheres
