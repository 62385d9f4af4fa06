"""Two rooms side by side with doorways between them, as road maps and as bounds of movements.

Both rooms are 4 m by 4 m; the wall between them is x = 0. Photos were taken every half a metre, a
metre from the walls, and on two lanes beside the middle of each doorway.
"""

import math
from collections.abc import Sequence

import numpy as np
import scipy.spatial

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.dock.clearance import Clearance
from pipelines.dock.road_map import RoadMap
from pipelines.dock.safety import Safety
from pipelines.lightfield.recorded_paths import recorded_paths

WEST, EAST = np.array([-2.0, -1.0]), np.array([2.0, -1.0])
AREA = (-4.0, 4.0, -2.0, 2.0)
LANE = 0.16
# Obstacle points are so far apart, metres.
DENSE = 0.02


class PointClearance(Clearance):
    """Distances from given obstacle points ``(M, 2)``."""

    def __init__(self, points: FloatArray) -> None:
        self._obstacles = scipy.spatial.cKDTree(points)


class Rooms:
    """The rooms.

    Args:
        doors: y of the middle and width of each doorway, metres.
    """

    def __init__(self, doors: Sequence[tuple[float, float]]) -> None:
        self.doors = tuple(doors)
        grid = np.arange(-1.0, 1.01, 0.5)
        places = [(middle + x, y) for middle in (-2.0, 2.0) for x in grid for y in grid]
        for y, _ in doors:
            places += [(x, y + side) for x in (-0.6, -0.2, 0.2, 0.6) for side in (LANE, -LANE)]
        poses = np.tile(np.eye(4), (len(places), 1, 1))
        poses[:, :2, 3] = places
        paths = recorded_paths(poses)
        self.road_map = RoadMap(paths.positions[:, :2], paths.links)

    def safety(self, least_distance: float) -> Safety:
        """Bounds of a robot whose middle stays that far from the walls, metres."""
        y = np.arange(-2.0, 2.0 + DENSE, DENSE)
        x = np.arange(-4.0, 4.0 + DENSE, DENSE)
        inner = y[~self._is_open(y)]
        lines = [(x, np.full_like(x, -2.0)), (x, np.full_like(x, 2.0))]
        lines += [(np.full_like(y, -4.0), y), (np.full_like(y, 4.0), y)]
        lines.append((np.zeros_like(inner), inner))
        points = np.concatenate([np.stack(line, axis=1) for line in lines])
        return Safety(AREA, PointClearance(points), least_distance)

    def wall_distance(self, place: FloatArray) -> float:
        """Metres from a place ``(2,)`` to the nearest wall, from the plan and not from points."""
        x, y = float(place[0]), float(place[1])
        outer = min(4.0 - abs(x), 2.0 - abs(y))
        if self._is_open(np.array([y]))[0]:
            jambs = [
                math.hypot(x, y - middle - side * 0.5 * width)
                for middle, width in self.doors
                for side in (-1.0, 1.0)
            ]
            return min(outer, *jambs)
        return min(outer, abs(x))

    def crosses_wall(self, first: FloatArray, last: FloatArray) -> bool:
        """Whether a straight movement leads through the wall between the rooms."""
        if first[0] * last[0] > 0.0 or first[0] == last[0]:
            return False
        y = first[1] + (last[1] - first[1]) * first[0] / (first[0] - last[0])
        return not bool(self._is_open(np.array([y]))[0])

    def _is_open(self, y: FloatArray) -> BoolArray:
        is_open: BoolArray = np.zeros(len(y), dtype=np.bool_)
        for middle, width in self.doors:
            is_open |= np.abs(y - middle) < 0.5 * width
        return is_open
