"""Odometry whose drift is taken out by what pairs of photos say of each other (a pose graph).

Two photos that show the same features tell how one is turned against the other and in which
direction it lies, but not how far. Odometry tells distances, heights and tilts, and drifts in
heading and place. Together they close the loops of a walk. Headings come first, then places: each
is a sparse linear problem, and links that contradict the others lose their weight (graduated
non-convexity, Yang et al. 2020).
"""

from dataclasses import dataclass

import numpy as np
import scipy
import scipy.sparse.linalg

from pipelines.artifacts.arrays import BoolArray, FloatArray, IntArray
from pipelines.geometry.pose import (
    about_z,
    angle_about_z,
    inverse,
    pose_from_rotation,
    wrap_angle,
)

# Odometry's drift, as a standard deviation: a share of each step, and radians a root metre; what
# even a step of no length leaves open.
STEP_SHARE, HEADING_RATE = 0.02, np.radians(0.3)
STEP_FLOOR, HEADING_FLOOR = 2e-3, np.radians(0.02)
# What a link leaves open: metres across its direction, also as a share of its length; radians.
LINK_PLACE, LINK_SHARE, LINK_HEADING = 0.02, 0.03, np.radians(0.2)
# Odometry's tilts are right, so a link that contradicts them by more is wrong.
LARGEST_TILT = np.radians(2.0)
# Links are doubted beyond this many standard deviations: at first, and in the end.
FIRST_DOUBT, LAST_DOUBT, DOUBT_FACTOR = 64.0, 3.0, 0.7
# A link is kept when it fits to so many standard deviations.
KEPT_DEVIATIONS = 5.0


@dataclass(frozen=True)
class Links:
    """What pairs of photos say of each other.

    Attributes:
        pairs: ``(L, 2)`` rows of the photos.
        rotations: ``(L, 3, 3)`` from the second camera's frame to the first one's.
        directions: ``(L, 3)`` unit vectors in the first camera's frame, to the second camera.
    """

    pairs: IntArray
    rotations: FloatArray
    directions: FloatArray


@dataclass(frozen=True)
class Drift:
    """By how much places and headings may be wrong between two photos.

    Attributes:
        place_floor, place_rate: metres, and metres a root metre walked between them.
        heading_floor, heading_rate: the same in radians.
    """

    place_floor: float
    place_rate: float
    heading_floor: float
    heading_rate: float

    def place(self, root: FloatArray) -> FloatArray:
        """Metres, for so many root metres."""
        return np.asarray(self.place_floor + self.place_rate * root)

    def heading(self, root: FloatArray) -> FloatArray:
        """Radians, for so many root metres."""
        return np.asarray(self.heading_floor + self.heading_rate * root)


ODOMETRY_DRIFT = Drift(0.2, 0.1, np.radians(3.0), np.radians(1.0))
# Of poses that were corrected once.
REMAINING_DRIFT = Drift(0.3, 0.02, np.radians(2.0), 0.0)


@dataclass(frozen=True)
class CorrectedPoses:
    """Odometry without its drift.

    Attributes:
        world_from_camera: ``(N, 4, 4)``; the first one is as it was.
        fitting: ``(L,)`` which links fit.
    """

    world_from_camera: FloatArray
    fitting: BoolArray


def walked(world_from_camera: FloatArray) -> FloatArray:
    """Metres ``(N,)`` walked until each of the photos."""
    steps = np.linalg.norm(np.diff(world_from_camera[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def beside_nearest(
    poses: FloatArray, placed: IntArray, before: FloatArray, rows: IntArray
) -> tuple[FloatArray, IntArray]:
    """Poses of photos that lie to the placed one nearest in time as they lay before.

    Args:
        poses: ``(P, 4, 4)`` world_from_camera of the placed photos.
        placed: ``(P,)`` their rows in ``before``; of two as near the one named first counts.
        before: ``(N, 4, 4)`` of all photos in time order.
        rows: ``(R,)`` of the photos asked for.

    Returns:
        world_from_camera ``(R, 4, 4)``, and the row of the nearest photo of each ``(R,)``.
    """
    nearest = np.array([np.argmin(np.abs(placed - row)) for row in rows], dtype=np.int64)
    found = poses[nearest] @ inverse(before[placed[nearest]]) @ before[rows]
    return found, placed[nearest]


def correct_drift(
    odometry: FloatArray, start: FloatArray, links: Links, drift: Drift, reach: float
) -> CorrectedPoses:
    """Headings and places that fit odometry and links best.

    Args:
        odometry: ``(N, 4, 4)`` world_from_camera in time order, z up.
        start: ``(N, 4, 4)`` the poses as they are known so far: of odometry, or corrected before.
        links: between photos that match.
        drift: by how much ``start`` may be wrong; links that ask for more are not believed.
        reach: metres; cameras farther apart do not recognise the same features.
    """
    path = walked(odometry)
    between = np.sqrt(np.abs(path[links.pairs[:, 1]] - path[links.pairs[:, 0]]))
    headings, believed = _headings(odometry, start, links, drift.heading(between))
    turn = about_z(headings)
    rotations = turn @ odometry[:, :3, :3]
    steps = np.einsum("nij,nj->ni", turn[:-1], np.diff(odometry[:, :3, 3], axis=0))
    directions = np.einsum("nij,nj->ni", rotations[links.pairs[:, 0]], links.directions)
    turned = Links(links.pairs, links.rotations, directions)
    places, fitting = _places(start, steps, turned, believed, drift.place(between), reach)
    return CorrectedPoses(pose_from_rotation(rotations, places), fitting)


def _headings(
    odometry: FloatArray, start: FloatArray, links: Links, allowed: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Turns ``(N,)`` about z that odometry lacks, and which links ``(L,)`` fit them."""
    first, second = links.pairs.T
    asked = odometry[first, :3, :3] @ links.rotations @ odometry[second, :3, :3].swapaxes(1, 2)
    tilts = np.arccos(np.clip(asked[:, 2, 2], -1.0, 1.0))
    headings = np.unwrap(angle_about_z(start[:, :3, :3] @ odometry[:, :3, :3].swapaxes(1, 2)))
    ahead = headings[second] - headings[first]
    turns = ahead + wrap_angle(angle_about_z(asked) - ahead)
    plausible = (tilts < LARGEST_TILT) & (np.abs(turns - ahead) < allowed)
    chain = np.hypot(HEADING_FLOOR, HEADING_RATE * np.sqrt(np.diff(walked(odometry))))
    graph = _Graph(len(odometry), links.pairs, chain, np.full(len(turns), LINK_HEADING), plausible)
    still, whole = np.zeros((len(chain), 1)), np.ones((len(turns), 1, 1))
    for doubt in _doubts():
        residuals = headings[second] - headings[first] - turns
        weights = graph.trust(residuals, doubt)
        headings = graph.solve(still, whole, turns[:, None], weights)[:, 0]
    residuals = headings[second] - headings[first] - turns
    return headings, plausible & (np.abs(residuals) < KEPT_DEVIATIONS * LINK_HEADING)


def _places(
    start: FloatArray,
    steps: FloatArray,
    links: Links,
    believed: BoolArray,
    allowed: FloatArray,
    reach: float,
) -> tuple[FloatArray, BoolArray]:
    """Places ``(N, 3)`` and which links ``(L,)``, directions in the world, fit them."""
    first, second = links.pairs.T
    places = start[:, :3, 3] - start[0, :3, 3]
    # Along its direction a link asks for nothing.
    across = np.eye(3) - links.directions[:, :, None] * links.directions[:, None, :]

    def residuals() -> tuple[FloatArray, FloatArray, BoolArray]:
        apart = places[second] - places[first]
        ahead = np.sum(apart * links.directions, axis=1) > 0.0
        off = np.linalg.norm(np.einsum("nij,nj->ni", across, apart), axis=1)
        return off, np.linalg.norm(apart, axis=1), ahead

    off, lengths, _ = residuals()
    plausible = believed & (off < allowed) & (lengths < reach + allowed)
    chain = np.hypot(STEP_FLOOR, STEP_SHARE * np.linalg.norm(steps, axis=1))
    sigmas = np.hypot(LINK_PLACE, LINK_SHARE * lengths)
    graph = _Graph(len(start), links.pairs, chain, sigmas, plausible)
    for doubt in _doubts():
        places = graph.solve(steps, across, np.zeros((len(off), 3)), graph.trust(off, doubt))
        off, _, ahead = residuals()
    return places + start[0, :3, 3], plausible & ahead & (off < KEPT_DEVIATIONS * sigmas)


def _doubts() -> list[float]:
    doubts = [FIRST_DOUBT]
    while doubts[-1] > LAST_DOUBT:
        doubts.append(max(LAST_DOUBT, DOUBT_FACTOR * doubts[-1]))
    return doubts + [LAST_DOUBT] * 4


@dataclass(frozen=True)
class _Graph:
    """A chain with links across it, each saying a difference of two nodes' values.

    Attributes:
        count: nodes; the first one has the value 0.
        pairs: ``(L, 2)`` nodes of the links.
        chain: ``(N - 1,)`` standard deviations of the chain.
        sigmas: ``(L,)`` of the links.
        plausible: ``(L,)`` which links count at all.
    """

    count: int
    pairs: IntArray
    chain: FloatArray
    sigmas: FloatArray
    plausible: BoolArray

    def trust(self, residuals: FloatArray, doubt: float) -> FloatArray:
        """Weights ``(L,)`` of the links (Geman and McClure's function)."""
        ratio = residuals / (doubt * self.sigmas)
        return np.asarray(self.plausible / (1.0 + ratio**2) ** 2)

    def solve(
        self, steps: FloatArray, across: FloatArray, links: FloatArray, weights: FloatArray
    ) -> FloatArray:
        """Values ``(N, D)`` by weighted least squares.

        Args:
            steps: ``(N - 1, D)`` differences along the chain.
            across: ``(L, D, D)`` the part of a difference that each link tells.
            links: ``(L, D)`` what it tells.
            weights: ``(L,)``.
        """
        width = steps.shape[1]
        nodes = np.arange(self.count)
        ends = np.concatenate([np.stack([nodes[:-1], nodes[1:]], axis=1), self.pairs])
        root = np.sqrt(np.concatenate([1.0 / self.chain**2, weights / self.sigmas**2]))
        told = np.concatenate([np.tile(np.eye(width), (self.count - 1, 1, 1)), across])
        blocks = root[:, None, None] * told
        both = np.stack([-blocks, blocks], axis=1).reshape(-1, width, width)
        rows = 2 * np.arange(len(ends) + 1)
        shape = (width * len(ends), width * self.count)
        matrix = scipy.sparse.bsr_array((both, ends.ravel(), rows), shape=shape).tocsc()
        matrix = matrix[:, width:]
        right = (root[:, None] * np.concatenate([steps, links])).ravel()
        values = scipy.sparse.linalg.splu((matrix.T @ matrix).tocsc()).solve(matrix.T @ right)
        return np.concatenate([np.zeros((1, width)), values.reshape(-1, width)])
