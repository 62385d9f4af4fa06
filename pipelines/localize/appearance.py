"""Where could this image have been taken? Thumbnails of the scene from all over, compared at once.

Thousands of small views are rendered once; a camera image is then compared with all of them by two
matrix products, which takes milliseconds. The comparison is the paper's, the squared difference
with a fitted brightness factor, tile by tile: a tile that fits badly counts no more than
``WORST_TILE``, since something may stand in front of it. This is what rejects hopeless hypotheses
early, and what finds a robot that was carried away.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pipelines.artifacts.array_types import Float32Array, FloatArray, IntArray
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.pose import inverse
from pipelines.lightfield.comparison import LARGEST_GAIN, UNCOVERED_SQUARED
from pipelines.lightfield.renderer import Renderer
from pipelines.localize.belief import Region
from pipelines.localize.observation import Observation
from pipelines.localize.state_space import StateSpace

TILES_ACROSS, TILES_DOWN = 4, 3
# A tile that differs more than this, relative to 255^2, shows something else.
WORST_TILE = 0.06
# Around a recorded view the others are spread by so much: metres and radians.
AROUND_POSITION, AROUND_ANGLE = 0.3, 0.2
# Bases of the Halton sequence that covers places and headings.
HALTON_BASES = (2, 3, 5)
# Hypotheses nearer to each other than this are one; metres and radians.
DISTINCT_POSITION, DISTINCT_ANGLE = 0.4, 0.2


@dataclass(frozen=True)
class AppearanceIndex:
    """Thumbnails rendered at N states.

    Attributes:
        states: ``(N, D)``.
        thumbnails: ``(N, 3 H W)`` colours, tile by tile, zero where uncovered.
        covered: ``(N, H W)`` 1 where covered, else 0, tile by tile.
        order: ``(H W,)`` pixels in the order in which they are kept.
        starts: ``(T + 1,)`` where in that order the tiles begin.
    """

    states: FloatArray
    thumbnails: Float32Array
    covered: Float32Array
    order: IntArray
    starts: IntArray

    def costs(self, observation: Observation) -> FloatArray:
        """Mean over the tiles of their mean squared differences ``(N,)``, relative to 255^2."""
        query = observation.image.reshape(-1, 3)[self.order]
        used = np.isfinite(query[:, 0]).astype(np.float32)
        query = np.nan_to_num(query)
        total, weights = np.zeros(len(self.states)), 0.0
        for first, end in pairwise(self.starts):
            weight = float(used[first:end].sum())
            if weight > 0.0:
                costs = self._tile_costs(int(first), int(end), query, used)
                total += weight * np.minimum(costs, WORST_TILE)
                weights += weight
        return np.asarray(total / max(weights, 1.0), dtype=np.float64)

    def _tile_costs(
        self, first: int, end: int, query: Float32Array, used: Float32Array
    ) -> Float32Array:
        """Mean squared differences ``(N,)`` of one tile, after its own brightness factor."""
        part, weights = query[first:end], used[first:end]
        thumbnails, covered = self.thumbnails[:, 3 * first : 3 * end], self.covered[:, first:end]
        products = thumbnails @ part.reshape(-1)
        energies = thumbnails**2 @ np.repeat(weights, 3)
        seen = covered @ (part**2).sum(axis=1)
        gains = np.clip(products / np.maximum(energies, 1.0), 1.0 / LARGEST_GAIN, LARGEST_GAIN)
        squares = np.maximum(seen - 2.0 * gains * products + gains**2 * energies, 0.0)
        compared = float(weights.sum())
        uncovered = 1.0 - covered @ weights / compared
        costs = squares / (3.0 * 255.0**2 * compared) + UNCOVERED_SQUARED * uncovered
        return np.asarray(costs, dtype=np.float32)


def build_index(
    renderer: Renderer,
    space: StateSpace,
    body_from_camera: FloatArray,
    intrinsics: Intrinsics,
    states: FloatArray,
) -> AppearanceIndex:
    """Renders the thumbnails of states ``(N, D)``."""
    poses = space.poses(states) @ body_from_camera
    images, covered = renderer.render_many(poses, intrinsics)
    order, starts = _tiles(intrinsics)
    # np.take leaves the states in their place in memory, indexing would not.
    flat = np.take(images.reshape(len(states), -1, 3), order, axis=1)
    seen = np.take(covered.reshape(len(states), -1), order, axis=1).astype(np.float32)
    return AppearanceIndex(states, flat.reshape(len(states), -1), seen, order, starts)


def _tiles(intrinsics: Intrinsics) -> tuple[IntArray, IntArray]:
    """Pixels ordered by tile, and where the tiles begin, with the end after the last."""
    rows = np.arange(intrinsics.height) * TILES_DOWN // intrinsics.height
    columns = np.arange(intrinsics.width) * TILES_ACROSS // intrinsics.width
    tiles = (rows[:, None] * TILES_ACROSS + columns[None, :]).reshape(-1)
    order = np.argsort(tiles, kind="stable")
    starts = np.flatnonzero(np.diff(tiles[order], prepend=-1))
    return order.astype(np.int64), np.append(starts, len(order)).astype(np.int64)


def spread_states(space: StateSpace, region: Region, count: int) -> FloatArray:
    """States ``(count, D)`` of a robot on the floor, evenly over a region and all headings.

    A Halton sequence: more even than random numbers, and the same every time.
    """
    places = np.stack([_radical_inverses(count, base) for base in HALTON_BASES], axis=1)
    low = np.append(region.low, -np.pi)
    high = np.append(region.high, np.pi)
    return space.moved(low + places * (high - low), np.zeros(space.dimension))


def _radical_inverses(count: int, base: int) -> FloatArray:
    """``(count,)``: 0, 1, 2 ... with their digits mirrored at the point, in [0, 1)."""
    rest, result = np.arange(count), np.zeros(count)
    worth = 1.0 / base
    while rest.any():
        result += worth * (rest % base)
        rest, worth = rest // base, worth / base
    return result


def states_around_views(
    space: StateSpace,
    world_from_camera: FloatArray,
    body_from_camera: FloatArray,
    count: int,
    rng: np.random.Generator,
) -> FloatArray:
    """States ``(count or more, D)`` at the recorded views ``(N, 4, 4)`` and around them.

    Six degrees of freedom cannot be covered evenly; views are where the scene was seen from.
    """
    own = space.states(world_from_camera @ inverse(body_from_camera))
    copies = count // len(own)
    # Of no states at all there are no rotations before SciPy 1.16.
    if copies < 2:
        return own
    sigma = np.array([AROUND_POSITION] * space.positions + [AROUND_ANGLE] * space.angles)
    around = np.repeat(own, copies - 1, axis=0)
    moved = space.moved(around, sigma * rng.standard_normal(around.shape))
    return np.concatenate([own, moved])


def best_distinct(space: StateSpace, states: FloatArray, costs: FloatArray, count: int) -> IntArray:
    """Indices of the cheapest states that are not near a cheaper one, cheapest first.

    Args:
        space: what a state is.
        states: ``(N, D)``.
        costs: ``(N,)``.
        count: at most so many.
    """
    order = np.argsort(costs, kind="stable")
    chosen: list[int] = []
    while len(order) and len(chosen) < count:
        best = int(order[0])
        chosen.append(best)
        rest = states[order]
        distance = np.linalg.norm(
            rest[:, : space.positions] - states[best, : space.positions], axis=1
        )
        angle = space.pair_angles(states[best : best + 1], rest)[0]
        order = order[(distance > DISTINCT_POSITION) | (angle > DISTINCT_ANGLE)]
    return np.array(chosen, dtype=np.int64)
