"""Collision checks of straight lines on the floor, by the bounds that hold for all movements.

``Safety`` judges one movement from an estimated pose. A route is made of many lines: here they are
judged together, as the room that they leave between robot and surface.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.dock.safety import Safety

# Lines are checked at places so far apart, metres.
SPACING = 0.05


@dataclass(frozen=True)
class Blockage:
    """A circle on the floor into which the robot could not drive, whatever the map shows there.

    Attributes:
        place: ``(2,)`` its middle, metres.
        radius: metres.
        is_on_map: whether it is the map's surface that is too near there.
    """

    place: FloatArray
    radius: float
    is_on_map: bool = False


class CollisionCheck:
    """How much room straight lines leave.

    Room is the distance from the scene's surface beyond the least distance: negative where the
    robot would be too near, minus infinity outside of the area, the free ground, or in a blockage.

    Args:
        safety: the bounds.
        blockages: what was found to be blocked.
    """

    def __init__(self, safety: Safety, blockages: Sequence[Blockage] = ()) -> None:
        self._safety = safety
        self._blockages = tuple(blockages)

    def with_blockages(self, blockages: Sequence[Blockage]) -> "CollisionCheck":
        """The same bounds with other blockages."""
        return CollisionCheck(self._safety, blockages)

    def is_blocked(self, first: FloatArray, last: FloatArray) -> BoolArray:
        """Which lines from ``first`` to ``last``, ``(L, 2)`` each, touch a blockage: ``(L,)``."""
        blocked = np.zeros(len(first), dtype=np.bool_)
        along = last - first
        squared = np.maximum(np.sum(along**2, axis=1), 1e-12)
        for blockage in self._blockages:
            share = np.clip(np.sum((blockage.place - first) * along, axis=1) / squared, 0.0, 1.0)
            nearest = first + share[:, None] * along
            blocked |= np.linalg.norm(nearest - blockage.place, axis=1) < blockage.radius
        return blocked

    def room(self, places: FloatArray) -> FloatArray:
        """Room at places ``(M, 2)``: ``(M,)`` metres."""
        safety = self._safety
        x_min, x_max, y_min, y_max = safety.area
        inside: BoolArray = np.all((places >= [x_min, y_min]) & (places <= [x_max, y_max]), axis=1)
        if safety.ground is not None:
            inside &= safety.ground.contains(places)
        for blockage in self._blockages:
            apart = np.linalg.norm(places - blockage.place, axis=1)
            inside &= apart >= blockage.radius
        room = safety.clearance.distances(places) - safety.least_distance
        return np.where(inside, room, -np.inf)

    def room_along(self, first: FloatArray, last: FloatArray) -> FloatArray:
        """Least room along each line from ``first`` to ``last``.

        Args:
            first: ``(L, 2)``, or ``(2,)`` for lines that begin at the same place.
            last: ``(L, 2)``, or ``(2,)`` likewise.

        Returns:
            ``(L,)`` metres.
        """
        first, last = np.broadcast_arrays(np.atleast_2d(first), np.atleast_2d(last))
        if len(first) == 0:
            return np.empty(0)
        lengths = np.linalg.norm(last - first, axis=1)
        counts = np.maximum(2, np.ceil(lengths / SPACING).astype(np.int64) + 1)
        starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
        line = np.repeat(np.arange(len(first)), counts)
        share = (np.arange(int(counts.sum())) - starts[line]) / (counts[line] - 1)
        room = self.room(first[line] + share[:, None] * (last - first)[line])
        return np.asarray(np.minimum.reduceat(room, starts))

    def room_leaving(self, place: FloatArray, targets: FloatArray) -> FloatArray:
        """Room along lines ``(L,)`` from where the robot stands.

        A robot that stands too near to the surface may drive away from it: lines that nowhere come
        nearer than it is now have no room, but no less.

        Args:
            place: ``(2,)`` of the robot.
            targets: ``(L, 2)``.
        """
        room = self.room_along(place, targets)
        now = float(self.room(place[None])[0])
        if now >= 0.0 or not np.isfinite(now):
            return room
        return np.where((room < 0.0) & (room >= now), 0.0, room)
