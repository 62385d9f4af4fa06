"""Active search while the robot is not localized: learn most, risk least.

The robot rotates on the spot, which is safe wherever it stands, and never drives towards a guess.
Of the two nearest directions that it has not viewed yet, it takes the one in which the predicted
views at the modes of its belief differ most. (The measurement with the greatest expected
information, Fox, Burgard, Thrun 1998, "Active Markov localization for mobile robots", in a discrete
form.) After a full rotation it backs away, if that is safe at every mode, and rotates again.
"""

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray
from pipelines.dock.planar_motion import moved
from pipelines.dock.robot import STANDSTILL, Movement
from pipelines.dock.safety import Safety
from pipelines.geometry.camera import Intrinsics
from pipelines.localize.state_space import PLANAR

# Directions that are viewed one after the other, and the yaw from one to the next.
DIRECTIONS = 12
DIRECTION_STEP = 2.0 * math.pi / DIRECTIONS
# Distance that the robot backs away, metres.
BACK = 0.2
# Modes with less of the weight than this are left out; at most so many are compared.
LEAST_SHARE, MOST_MODES = 0.05, 6
# Predicted views are so many pixels across.
WIDTH = 20
# A pixel that one predicted view covers and the other does not counts as this difference, grey
# levels.
UNCOVERED_DIFFERENCE = 20.0
# A view of which the scene covers less than this share is no view to drive by.
ENOUGH_COVERED = 0.6


@dataclass(frozen=True)
class Search:
    """Progress of a search.

    Attributes:
        heading: yaw since the search began, by odometry, radians.
        viewed: numbers of the directions viewed, ``round(heading / DIRECTION_STEP)`` modulo
            ``DIRECTIONS``.
        steps: movements since the search began.
        direction: +1 or -1, the sense of the last rotation.
        hints: small rotations made to keep a possible match in view.
    """

    heading: float = 0.0
    viewed: frozenset[int] = frozenset()
    steps: int = 0
    direction: int = 1
    hints: int = 0

    @property
    def number(self) -> int:
        """Number of the direction that the robot looks in."""
        return round(self.heading / DIRECTION_STEP) % DIRECTIONS

    def after(self, measured: Movement) -> "Search":
        """The search after a movement measured by odometry."""
        direction = 1 if measured.turn > 0.0 else -1 if measured.turn < 0.0 else self.direction
        return replace(
            self,
            heading=self.heading + measured.turn,
            viewed=self.viewed | {self.number},
            steps=self.steps + 1,
            direction=direction,
        )


class RendersViews(Protocol):
    """What renders small views of the map anywhere."""

    def render_many(
        self, world_from_camera: FloatArray, intrinsics: Intrinsics
    ) -> tuple[Float32Array, BoolArray]:
        """Images ``(M, h, w, 3)`` at poses ``(M, 4, 4)``, and which pixels the map covers."""


class Explorer:
    """Chooses the movements of a search.

    Args:
        renderer: renders the map's photos.
        base_from_camera: ``(4, 4)`` the camera's mount.
        intrinsics: of the camera, without distortion.
        safety: bounds of all movements.
    """

    def __init__(
        self,
        renderer: RendersViews,
        base_from_camera: FloatArray,
        intrinsics: Intrinsics,
        safety: Safety,
    ) -> None:
        self._renderer = renderer
        self._base_from_camera = base_from_camera
        height = max(1, round(intrinsics.height * WIDTH / intrinsics.width))
        self._intrinsics = intrinsics.resized(WIDTH, height)
        self._safety = safety

    def movement(
        self, search: Search, modes: FloatArray, largest_turn: float
    ) -> tuple[Movement, Search]:
        """The next movement, and the progress of the search with it.

        Args:
            search: progress so far.
            modes: ``(K, 4)`` modes of the belief: x, y, heading, and the share of the weight.
            largest_turn: yaw of one movement at most, radians.
        """
        viewed = search.viewed | {search.number}
        if len(viewed) == DIRECTIONS:
            again = replace(search, viewed=frozenset())
            back = Movement(forward=-BACK)
            return (back, again) if self._may_back(modes) else (STANDSTILL, again)
        options = [self._unviewed(search, sign) for sign in (search.direction, -search.direction)]
        values = [self._disagreement(modes, yaw) - 1e-3 * abs(yaw) for yaw in options]
        yaw = options[0] if values[0] >= values[1] else options[1]
        return Movement(turn=math.copysign(min(abs(yaw), largest_turn), yaw)), search

    def sees_scene(self, state: FloatArray) -> bool:
        """Whether the scene covers most of the camera's view at a state ``(3,)``."""
        return self.covered_share(state) >= ENOUGH_COVERED

    def covered_share(self, state: FloatArray) -> float:
        """Share of the camera's view at a state ``(3,)`` that the scene covers, 0 to 1."""
        poses = (PLANAR.poses(state) @ self._base_from_camera)[None]
        _, covered = self._renderer.render_many(poses, self._intrinsics)
        return float(covered.mean())

    @staticmethod
    def _unviewed(search: Search, sign: int) -> float:
        """Yaw (radians) to the nearest direction on one side that was not viewed."""
        for number in range(1, DIRECTIONS):
            if (search.number + sign * number) % DIRECTIONS not in search.viewed:
                return sign * number * DIRECTION_STEP
        return sign * DIRECTION_STEP

    def _disagreement(self, modes: FloatArray, yaw: float) -> float:
        """Difference of the predicted views after a rotation, grey levels, weighted by shares."""
        places = modes[modes[:, 3] >= LEAST_SHARE][:MOST_MODES]
        if len(places) < 2:
            return 0.0
        states = PLANAR.moved(places[:, :3], np.array([0.0, 0.0, yaw]))
        poses = PLANAR.poses(states) @ self._base_from_camera
        images, covered = self._renderer.render_many(poses, self._intrinsics)
        total = 0.0
        for first in range(len(places)):
            for second in range(first):
                both = (covered[first] & covered[second])[..., None]
                one = (covered[first] ^ covered[second])[..., None]
                difference = np.abs(images[first] - images[second])
                values = np.where(both, difference, np.where(one, UNCOVERED_DIFFERENCE, 0.0))
                total += float(places[first, 3] * places[second, 3] * values.mean())
        return total

    def _may_back(self, modes: FloatArray) -> bool:
        """Whether backing away is safe at every mode."""
        safety, back = self._safety, Movement(forward=-BACK)
        for place in modes[modes[:, 3] >= LEAST_SHARE]:
            state, then = place[:3], moved(place[:3], back)
            nearer = safety.clearance.distance(then) < safety.clearance.distance(state)
            if safety.outside_by(then) > 0.0 or (nearer and not safety.is_allowed(then)):
                return False
        return True
