"""What to do while nobody knows where the robot is: learn most, risk least.

It turns on the spot, which is safe wherever it stands, and never drives towards a guess. Of the two
directions that it has not looked at yet and can reach next, it takes the one in which the places
where it may be look most different from each other (the disagreement of the expected views: the
discrete form of choosing the measurement with the greatest expected information, Fox, Burgard,
Thrun 1998, "Active Markov localization for mobile robots"). When it has looked all round, it backs
away from what it sees, if that is safe at every place where it may be, and looks round again.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.planar_motion import moved
from pipelines.dock.robot import STANDSTILL, Movement
from pipelines.dock.safety import Safety
from pipelines.geometry.camera import Intrinsics
from pipelines.localize.state_space import PLANAR
from pipelines.render.renderer import Renderer

# Directions round the robot that are looked at one after the other.
DIRECTIONS = 12
TURN = 2.0 * math.pi / DIRECTIONS
# How far it backs away, metres.
BACK = 0.2
# Places with less of the weight than this are not asked; no more than so many are.
LEAST_SHARE, MOST_PLACES = 0.05, 6
# Pixels across of the expected views.
WIDTH = 20
# An expected view that the scene does not show is worth as much disagreement as this, grey levels.
UNCOVERED_DIFFERENCE = 20.0
# A view that shows less of the scene than this is none to steer by.
ENOUGH_COVERED = 0.6


@dataclass(frozen=True)
class Search:
    """What was looked at in this search.

    Attributes:
        heading: radians turned since it began, as odometry says.
        seen: numbers of the directions looked at, ``round(heading / TURN)`` modulo ``DIRECTIONS``.
        steps: movements since it began.
        direction: +1 or -1, the way it last turned.
        hints: small turns made because something in view looked like the map.
    """

    heading: float = 0.0
    seen: frozenset[int] = frozenset()
    steps: int = 0
    direction: int = 1
    hints: int = 0

    @property
    def number(self) -> int:
        """Of the direction that the robot looks in."""
        return round(self.heading / TURN) % DIRECTIONS

    def after(self, measured: Movement) -> "Search":
        """The search after a movement."""
        direction = 1 if measured.turn > 0.0 else -1 if measured.turn < 0.0 else self.direction
        return replace(
            self,
            heading=self.heading + measured.turn,
            seen=self.seen | {self.number},
            steps=self.steps + 1,
            direction=direction,
        )


class Explorer:
    """Chooses the movements of a search.

    Args:
        renderer: of the scene.
        base_from_camera: ``(4, 4)`` the camera's mount.
        intrinsics: of the camera.
        safety: bounds of all movements.
    """

    def __init__(
        self,
        renderer: Renderer,
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
        """The next movement, and the search as it then is.

        Args:
            search: so far.
            modes: ``(K, 4)`` places where the robot may be, and their shares of the weight.
            largest_turn: radians.
        """
        looked_at = search.seen | {search.number}
        if len(looked_at) == DIRECTIONS:
            again = replace(search, seen=frozenset())
            back = Movement(forward=-BACK)
            return (back, again) if self._may_back(modes) else (STANDSTILL, again)
        options = [self._unseen(search, sign) for sign in (search.direction, -search.direction)]
        values = [self._disagreement(modes, turn) - 1e-3 * abs(turn) for turn in options]
        turn = options[0] if values[0] >= values[1] else options[1]
        return Movement(turn=math.copysign(min(abs(turn), largest_turn), turn)), search

    def sees(self, state: FloatArray) -> bool:
        """Whether the scene fills most of what the camera sees at a state ``(3,)``."""
        return self.shown_share(state) >= ENOUGH_COVERED

    def shown_share(self, state: FloatArray) -> float:
        """Share of what the camera sees at a state ``(3,)`` that the scene shows."""
        poses = (PLANAR.poses(state) @ self._base_from_camera)[None]
        _, covered = self._renderer.render_many(poses, self._intrinsics)
        return float(covered.mean())

    @staticmethod
    def _unseen(search: Search, sign: int) -> float:
        """Radians to the nearest direction on one side that was not looked at."""
        for number in range(1, DIRECTIONS):
            if (search.number + sign * number) % DIRECTIONS not in search.seen:
                return sign * number * TURN
        return sign * TURN

    def _disagreement(self, modes: FloatArray, turn: float) -> float:
        """How different the places look after a turn, grey levels, weighted by their shares."""
        places = modes[modes[:, 3] >= LEAST_SHARE][:MOST_PLACES]
        if len(places) < 2:
            return 0.0
        states = PLANAR.moved(places[:, :3], np.array([0.0, 0.0, turn]))
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
        """Whether backing away is safe wherever the robot may be."""
        safety, back = self._safety, Movement(forward=-BACK)
        for place in modes[modes[:, 3] >= LEAST_SHARE]:
            state, then = place[:3], moved(place[:3], back)
            nearer = safety.clearance.distance(then) < safety.clearance.distance(state)
            if safety.outside_by(then) > 0.0 or (nearer and not safety.is_allowed(then)):
                return False
        return True
