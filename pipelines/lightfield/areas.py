"""Dividing a world into areas, each of which becomes a light field of its own.

Every photo is at home in one area: photos that see the same surface belong together, or those that
were taken in the same rectangle. Besides, an area holds photos of its neighbours that see what its
own photos see: those from around the doorways. Poses decide, and sparse points where there are
some; the photos themselves are not needed. The same reconstruction is always divided alike.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import InputError, OptionError, StageError, quoted
from pipelines.geometry.camera import Undistorter
from pipelines.lightfield.area_file import AreaFile, Doorway
from pipelines.lightfield.covisibility import covisibility
from pipelines.lightfield.normalised_cut import divide_graph
from pipelines.lightfield.recorded_paths import RecordedPaths, recorded_paths
from pipelines.reconstruct.reconstruction import Reconstruction

# Fewer photos than this are no bound to divide by.
MIN_AREA_VIEWS = 8
# Of an area's photos at most this share is at home there where areas are bounded in size.
OWN_SHARE = 0.8
# No part is smaller where it can be helped.
SMALLEST_PART = 15
# A seam that is weaker than this divides an area although it is small enough: a doorway.
NATURAL_CUT = 0.1
# A photo belongs to another area too where so much of what it shares with others lies there.
OVERLAP_SHARE = 0.1
# Metres: a photo from outside of all rectangles is at home in the nearest, if that is so near; and
# by so much an area of its own making is wider than the positions in it.
MARGIN = 0.5


@dataclass(frozen=True)
class Area:
    """A part of a world.

    Attributes:
        name: also that of its file.
        own: photos that are at home here, ascending indices; at least two.
        overlap: photos that are at home elsewhere and see what these see.
        rectangle: ``(4,)`` x_min, x_max, y_min, y_max, metres: as drawn, or around the positions of
            its own photos.
    """

    name: str
    own: IntArray
    overlap: IntArray
    rectangle: FloatArray

    @property
    def views(self) -> IntArray:
        """All its photos, ascending."""
        return np.union1d(self.own, self.overlap)


@dataclass(frozen=True)
class Division:
    """A world divided.

    Attributes:
        areas: at least one.
        home: ``(N,)`` the area in which each photo is at home; -1: in none.
        neighbours: pairs of areas, the smaller number first, between which a recorded path leads.
        paths: links between the photos' positions.
    """

    areas: tuple[Area, ...]
    home: IntArray
    neighbours: tuple[tuple[int, int], ...]
    paths: RecordedPaths

    def neighbours_of(self, area: int) -> list[int]:
        """The areas that are next to one."""
        return sorted(sum(pair) - area for pair in self.neighbours if area in pair)


def divide_by_covisibility(source: Reconstruction, largest: int) -> Division:
    """Areas along the weakest seams between photos that see the same surface.

    Args:
        source: posed photos.
        largest: the most photos of an area, overlap included.

    Raises:
        OptionError: ``largest`` is too small.
        StageError: no two photos lie near each other.
    """
    if largest < MIN_AREA_VIEWS:
        raise OptionError(f"{largest} photos are no area; allow at least {MIN_AREA_VIEWS}")
    paths = recorded_paths(source.world_from_camera)
    weights = _covisibility(source, paths)
    count = len(source.image_names)
    own = count if count <= largest else int(OWN_SHARE * largest)
    smallest = max(2, min(SMALLEST_PART, own // 2))
    parts = divide_graph(weights, own, smallest, NATURAL_CUT)
    parts = [part for part in parts if len(part) >= 2]
    if not parts:
        raise StageError("no two photos were taken near each other: there are no areas to be found")
    home = _homes(parts, count)
    digits = max(2, len(str(len(parts))))
    areas = tuple(
        Area(
            f"area-{number + 1:0{digits}d}",
            part,
            _overlap(weights, home, number, largest - len(part)),
            _around(source.world_from_camera[part, :2, 3]),
        )
        for number, part in enumerate(parts)
    )
    return Division(areas, home, _neighbours(home, paths), paths)


def divide_by_rectangles(source: Reconstruction, drawn: AreaFile) -> Division:
    """The areas that somebody drew.

    Args:
        source: posed photos.
        drawn: rectangles and doorways.

    Raises:
        InputError: an area holds fewer than two photos, or overlaps no other one.
    """
    positions = source.world_from_camera[:, :2, 3]
    bounds = np.array([rectangle.bounds for rectangle in drawn.rectangles])
    depth = np.minimum(
        np.minimum(positions[:, None, 0] - bounds[:, 0], bounds[:, 1] - positions[:, None, 0]),
        np.minimum(positions[:, None, 1] - bounds[:, 2], bounds[:, 3] - positions[:, None, 1]),
    )
    # Where rectangles overlap, a photo is at home in the one of which it is farther inside.
    home = np.argmax(depth, axis=1)
    home = np.where(depth[np.arange(len(home)), home] >= -MARGIN, home, -1)
    names = [rectangle.name for rectangle in drawn.rectangles]
    for number, name in enumerate(names):
        held = np.count_nonzero(home == number)
        if held < 2:
            photos = "1 photo" if held else "no photo"
            raise InputError(
                drawn.path, f"area {quoted(name)} holds {photos}", "an area needs at least two"
            )
    paths = recorded_paths(source.world_from_camera)
    paths = paths.without(_through_walls(paths, home, names, drawn.doorways))
    weights = _covisibility(source, paths)
    areas = []
    for number, rectangle in enumerate(drawn.rectangles):
        inside = np.flatnonzero((depth[:, number] >= 0.0) & (home >= 0) & (home != number))
        overlap = np.union1d(inside, _overlap(weights, home, number, len(home)))
        own = np.flatnonzero(home == number)
        areas.append(Area(rectangle.name, own, overlap, np.array(rectangle.bounds)))
    division = Division(tuple(areas), home, _neighbours(home, paths), paths)
    for number, name in enumerate(names):
        if len(names) > 1 and not division.neighbours_of(number):
            raise InputError(
                drawn.path,
                f"area {quoted(name)} overlaps no other: no recorded path leads out of it",
                "draw it larger, or leave it out",
            )
    return division


def _covisibility(source: Reconstruction, paths: RecordedPaths) -> scipy.sparse.csr_array:
    pinholes = [Undistorter(camera).intrinsics for camera in source.cameras]
    intrinsics = [pinholes[int(index)] for index in source.camera_index]
    return covisibility(
        source.world_from_camera, intrinsics, source.points, source.observations, paths
    )


def _homes(parts: list[IntArray], count: int) -> IntArray:
    home = np.full(count, -1)
    for number, part in enumerate(parts):
        home[part] = number
    return home


def _around(positions: FloatArray) -> FloatArray:
    """The rectangle ``(4,)`` around positions ``(K, 2)``, with a margin."""
    low, high = positions.min(axis=0) - MARGIN, positions.max(axis=0) + MARGIN
    return np.array([low[0], high[0], low[1], high[1]])


def _overlap(weights: scipy.sparse.csr_array, home: IntArray, area: int, room: int) -> IntArray:
    """Photos of other areas that share much with this area's own, at most ``room`` of them."""
    total = np.maximum(weights.sum(axis=1), 1e-12)
    share = (weights @ (home == area).astype(np.float64)) / total
    outside = np.flatnonzero((home != area) & (home >= 0) & (share >= OVERLAP_SHARE))
    strongest = np.argsort(-share[outside], kind="stable")[: max(0, room)]
    return np.sort(outside[strongest])


def _neighbours(home: IntArray, paths: RecordedPaths) -> tuple[tuple[int, int], ...]:
    ends = np.sort(home[paths.links], axis=1)
    crossing = ends[(ends[:, 0] != ends[:, 1]) & (ends[:, 0] >= 0)]
    return tuple((int(a), int(b)) for a, b in np.unique(crossing, axis=0))


def _through_walls(
    paths: RecordedPaths, home: IntArray, names: list[str], doorways: tuple[Doorway, ...]
) -> IntArray:
    """Numbers of the links from one area to another that pass none of the doorways between them."""
    if not doorways:
        return np.empty(0, dtype=np.int64)
    ends = home[paths.links]
    crosses = np.all(ends >= 0, axis=1) & (ends[:, 0] != ends[:, 1])
    first, second = paths.positions[paths.links[:, 0], :2], paths.positions[paths.links[:, 1], :2]
    for doorway in doorways:
        pair = [names.index(name) for name in doorway.areas]
        between = np.all(np.sort(ends, axis=1) == np.sort(pair), axis=1)
        distance = _distance_to_segments(np.array([doorway.x, doorway.y]), first, second)
        crosses &= ~(between & (distance <= 0.5 * doorway.width))
    return np.flatnonzero(crosses)


def _distance_to_segments(point: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """``(E,)`` from one point to each segment, metres."""
    along = second - first
    length = np.maximum(np.sum(along**2, axis=1), 1e-12)
    place = np.clip(np.sum((point - first) * along, axis=1) / length, 0.0, 1.0)
    return np.asarray(np.linalg.norm(first + place[:, None] * along - point, axis=1))
