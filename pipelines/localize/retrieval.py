"""Image retrieval: where could this image have been taken? Views from all over, compared at once.

Thousands of small views are rendered once, in the channels in which images are compared; a camera
image is then compared with all of them by matrix products, which takes milliseconds. What counts is
the correlation of tiles, each weighted by how much the camera image shows there: light that changes
leaves it nearly as it is, and what stands in front of some tiles changes only these. A tile that no
photo shows adds nothing. This says where to look, not what to believe.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray, IntArray
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.pose import inverse
from pipelines.localize.belief import Region, radical_inverses
from pipelines.localize.observation import Observation
from pipelines.localize.state_space import StateSpace, sigmas_of
from pipelines.render.channels import ZERO
from pipelines.render.renderer import Renderer

TILES_ACROSS, TILES_DOWN = 4, 3
# Root mean square of a channel below which a tile shows nothing, as bytes.
FAINT = 11.5
# Around a recorded view the others are spread by so much: metres and radians.
AROUND_POSITION, AROUND_ANGLE = 0.3, 0.2
# Bases of the Halton sequence that covers places and headings.
HALTON_BASES = (2, 3, 5)
# Hypotheses nearer to each other than this are one; metres and radians.
DISTINCT_POSITION, DISTINCT_ANGLE = 0.4, 0.2


@dataclass(frozen=True)
class RetrievalIndex:
    """Small views rendered at N states.

    Attributes:
        states: ``(N, D)``.
        thumbnails: ``(N, 3 H W)`` channels less their zero, tile by tile; 0 where uncovered.
        order: ``(H W,)`` pixels in the order in which they are kept.
        starts: ``(T + 1,)`` where in that order the tiles begin.
        energies: ``(T, N)`` squares of a tile's numbers, summed up.
    """

    states: FloatArray
    thumbnails: Float32Array
    order: IntArray
    starts: IntArray
    energies: Float32Array

    def scores(self, observation: Observation) -> FloatArray:
        """How alike the views are to an image in the same channels ``(N,)``; higher is better."""
        query = observation.image.reshape(-1, 3)[self.order] - np.float32(ZERO)
        used = np.isfinite(query[:, 0])
        query = np.where(used[:, None], query, np.float32(0.0))
        total = np.zeros(len(self.states))
        for tile, (first, end) in enumerate(pairwise(self.starts)):
            part = query[first:end].reshape(-1)
            thumbnails = self.thumbnails[:, 3 * first : 3 * end]
            energy = float(part @ part)
            energies = self.energies[tile]
            if not used[first:end].all():
                energies = _energies(thumbnails, used[first:end])
            floor = FAINT**2 * 3.0 * max(float(used[first:end].sum()), 1.0)
            total += energy * (thumbnails @ part) / np.sqrt(energies * energy + floor**2)
        return total


def build_index(
    renderer: Renderer,
    space: StateSpace,
    body_from_camera: FloatArray,
    intrinsics: Intrinsics,
    states: FloatArray,
) -> RetrievalIndex:
    """Renders the small views of states ``(N, D)``; the renderer's photos are in channels."""
    poses = space.poses(states) @ body_from_camera
    images, covered = renderer.render_many(poses, intrinsics)
    images -= np.float32(ZERO)
    images[~covered] = 0.0
    order, starts = _tiles(intrinsics)
    # np.take leaves the states in their place in memory, indexing would not.
    flat = np.take(images.reshape(len(states), -1, 3), order, axis=1).reshape(len(states), -1)
    energies = [
        _energies(flat[:, 3 * first : 3 * end], np.ones(end - first, dtype=np.bool_))
        for first, end in pairwise(starts)
    ]
    return RetrievalIndex(states, flat, order, starts, np.stack(energies))


def joined(indices: Sequence[RetrievalIndex]) -> RetrievalIndex:
    """One index of the views of several, whose images are of one size; at least one."""
    first = indices[0]
    if len(indices) == 1:
        return first
    return RetrievalIndex(
        np.concatenate([index.states for index in indices]),
        np.concatenate([index.thumbnails for index in indices]),
        first.order,
        first.starts,
        np.concatenate([index.energies for index in indices], axis=1),
    )


def _energies(thumbnails: Float32Array, used: BoolArray) -> Float32Array:
    """Squares ``(N,)`` of one tile's numbers ``(N, 3 P)``, summed up over its used pixels."""
    return np.asarray(thumbnails**2 @ np.repeat(used, 3).astype(np.float32), dtype=np.float32)


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

    A Halton sequence: more even than random numbers, and the same every time. Where only a part of
    the region's rectangle is free, it is the part of a longer sequence that lies there.
    """
    low = np.append(region.low, -np.pi)
    high = np.append(region.high, np.pi)
    length = count
    while True:
        places = np.stack([radical_inverses(length, base) for base in HALTON_BASES], axis=1)
        states = low + places * (high - low)
        if region.ground is not None:
            states = states[region.ground.contains(states[:, :2])]
        if len(states) >= count:
            return space.moved(states[:count], np.zeros(space.dimension))
        length *= 2


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
    return np.concatenate([own, spread_around(space, own, copies - 1, rng)])


def spread_around(
    space: StateSpace,
    states: FloatArray,
    copies: int,
    rng: np.random.Generator,
    position: float = AROUND_POSITION,
    angle: float = AROUND_ANGLE,
) -> FloatArray:
    """States ``(copies N, D)`` around others, those around one after the other.

    Args:
        space: what a state is.
        states: ``(N, D)``.
        copies: so many around each.
        rng: the only source of randomness.
        position: standard deviation, metres; by default that around recorded views.
        angle: likewise, radians.
    """
    around = np.repeat(states, copies, axis=0)
    sigma = sigmas_of(space, position, angle)
    return space.moved(around, sigma * rng.standard_normal(around.shape))


def best_distinct(
    space: StateSpace, states: FloatArray, scores: FloatArray, count: int, scale: float = 1.0
) -> IntArray:
    """Indices of the best states that are not near a better one, best first.

    Args:
        space: what a state is.
        states: ``(N, D)``.
        scores: ``(N,)``, higher is better.
        count: at most so many.
        scale: factor on how far apart distinct states are.
    """
    order = np.argsort(-scores, kind="stable")
    chosen: list[int] = []
    while len(order) and len(chosen) < count:
        best = int(order[0])
        chosen.append(best)
        rest = states[order]
        distance = np.linalg.norm(
            rest[:, : space.positions] - states[best, : space.positions], axis=1
        )
        angle = space.pair_angles(states[best : best + 1], rest)[0]
        order = order[(distance > scale * DISTINCT_POSITION) | (angle > scale * DISTINCT_ANGLE)]
    return np.array(chosen, dtype=np.int64)
