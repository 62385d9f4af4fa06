"""From a belief to answers: the likeliest particle, the mean, and the modes.

A belief over a symmetric place has several peaks, and their mean is a place where the robot
certainly is not. ``find_modes`` therefore looks for the peaks themselves. The particles' weights
are summed in the cells of a grid over (x, y, heading) and smoothed; each cell then points to its
densest neighbour, which leads uphill to a peak (the discrete form of mean shift). Peaks with hardly
a dip between them are one mode: two are merged where the density on the pass between them is at
least ``MERGE_RATIO`` of the lower peak. Only occupied cells are stored, and the heading's cells
close to a ring, so that neither the size of the area nor the jump at +-pi matters.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import OptionError
from pipelines.localize.belief import Belief
from pipelines.localize.state_space import StateSpace, state_space_of_dimension

MERGE_RATIO = 0.5
# Along x and along y; beyond it the cells' numbers would no longer fit 64 bits.
MAX_GRID_CELLS = 1e7


@dataclass(frozen=True)
class Mode:
    """One peak of the belief.

    Attributes:
        state: ``(D,)`` weighted mean of its particles.
        share: its particles' part of the whole weight, in (0, 1].
        covariance: ``(D, D)`` of its particles about ``state``: m^2, m rad, rad^2.
        members: ``(m,)`` indices of its particles.
    """

    state: FloatArray
    share: float
    covariance: FloatArray
    members: IntArray


def max_weight_state(belief: Belief) -> FloatArray:
    """The state ``(D,)`` of the heaviest particle, the paper's estimate; of ties the first."""
    return np.array(belief.states[int(np.argmax(belief.log_weights))])


def mean_state(belief: Belief) -> FloatArray:
    """The weighted mean ``(D,)`` of all particles, orientations by the shortest way round."""
    return _space_of(belief).mean(belief.states, belief.weights)


def _space_of(belief: Belief) -> StateSpace:
    return state_space_of_dimension(belief.states.shape[1])


def state_covariance(
    space: StateSpace, states: FloatArray, weights: FloatArray, centre: FloatArray
) -> FloatArray:
    """Weighted covariance ``(D, D)`` of states about a centre, angles by the shortest way round.

    Args:
        space: what a state is.
        states: ``(M, D)``.
        weights: ``(M,)``, not all zero; need not add up to 1.
        centre: ``(D,)``.
    """
    deviation = space.difference(states, centre)
    covariance = (deviation * weights[:, None]).T @ deviation / np.sum(weights)
    # Exactly symmetric, whatever the order in which the product was summed.
    return np.asarray(0.5 * (covariance + covariance.T), dtype=np.float64)


def find_modes(
    belief: Belief,
    position_bandwidth: float = 0.3,
    heading_bandwidth: float = float(np.radians(20.0)),
    minimum_share: float = 0.01,
) -> tuple[Mode, ...]:
    """The peaks of the belief, heaviest first; the heaviest is always among them.

    Args:
        belief: the particles.
        position_bandwidth: metres; peaks closer than about twice this may count as one.
        heading_bandwidth: radians; peaks closer than about twice this may count as one. Rounded so
            that whole cells fill the circle.
        minimum_share: peaks with less of the weight than this are left out.

    Raises:
        OptionError: a bandwidth that is not positive and finite, or too small for the extent.
    """
    for name, bandwidth in (("position", position_bandwidth), ("heading", heading_bandwidth)):
        if not (np.isfinite(bandwidth) and bandwidth > 0.0):
            raise OptionError(f"{name} bandwidth {bandwidth:g} is not positive")
    weights = belief.weights
    # Particles without weight take part in no peak.
    candidates = np.flatnonzero(weights > 0.0)
    states, candidate_weights = belief.states[candidates], weights[candidates]
    space = _space_of(belief)
    if space.angles == 1:
        labels = _peak_labels(states, candidate_weights, position_bandwidth, heading_bandwidth)
    else:
        labels = _connected_labels(space, states, position_bandwidth, heading_bandwidth)
    shares = np.bincount(labels, weights=candidate_weights)
    heaviest_first = np.argsort(-shares, kind="stable")
    modes: list[Mode] = []
    for label in heaviest_first:
        share = min(1.0, float(shares[label]))
        if modes and share < minimum_share:
            break
        chosen = np.flatnonzero(labels == label)
        mode_states, mode_weights = states[chosen], candidate_weights[chosen]
        centre = space.mean(mode_states, mode_weights)
        covariance = state_covariance(space, mode_states, mode_weights, centre)
        modes.append(Mode(centre, share, covariance, candidates[chosen].astype(np.int64)))
    return tuple(modes)


def modes_table(modes: tuple[Mode, ...]) -> FloatArray:
    """``(K, D + 1)``: state and share of each mode, at least one, in the order given."""
    return np.array([[*mode.state, mode.share] for mode in modes])


def _connected_labels(
    space: StateSpace, states: FloatArray, position_bandwidth: float, heading_bandwidth: float
) -> IntArray:
    """Which cluster each particle belongs to, ``(M,)``: chains of particles near each other.

    In six dimensions a grid of cells is nearly empty, and a peak of density means little; the
    particles there are few and lie in clumps.
    """
    places = scipy.spatial.cKDTree(states[:, : space.positions])
    pairs = places.query_pairs(position_bandwidth, output_type="ndarray")
    if len(pairs) == 0:
        return np.arange(len(states), dtype=np.int64)
    rotations = scipy.spatial.transform.Rotation.from_rotvec(states[:, space.positions :])
    angles = (rotations[pairs[:, 0]].inv() * rotations[pairs[:, 1]]).magnitude()
    pairs = pairs[angles <= heading_bandwidth]
    adjacency = scipy.sparse.coo_array(
        (np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (len(states),) * 2
    )
    return np.asarray(
        scipy.sparse.csgraph.connected_components(adjacency, directed=False)[1], dtype=np.int64
    )


def _peak_labels(
    states: FloatArray, weights: FloatArray, position_bandwidth: float, heading_bandwidth: float
) -> IntArray:
    """Which peak each particle belongs to, ``(M,)``, numbered from 0."""
    # At least three cells, or a cell's two neighbours round the ring would be the same one.
    heading_cells = max(3, round(2.0 * np.pi / heading_bandwidth))
    cells = np.empty((len(states), 3), dtype=np.int64)
    place = (states[:, :2] - states[:, :2].min(axis=0)) / position_bandwidth
    if np.max(place) > MAX_GRID_CELLS:
        raise OptionError(
            f"particles are spread over more than {MAX_GRID_CELLS:.0e} times the position bandwidth"
        )
    cells[:, :2] = np.floor(place)
    revolutions = np.mod(states[:, 2], 2.0 * np.pi) / (2.0 * np.pi)
    cells[:, 2] = np.floor(revolutions * heading_cells).astype(np.int64) % heading_cells
    # Two empty cells of margin: a neighbour's key never runs into the next row.
    rows = int(cells[:, 1].max()) + 3
    keys = ((cells[:, 0] + 1) * rows + cells[:, 1] + 1) * heading_cells + cells[:, 2]
    occupied, cell_of_particle = np.unique(keys, return_inverse=True)
    mass = np.bincount(cell_of_particle, weights=weights).astype(np.float64)
    neighbours, kernel = _neighbours(occupied, rows, heading_cells)
    density = _smoothed(_smoothed(mass, neighbours, kernel), neighbours, kernel)
    peaks = _uphill(density, neighbours)
    merged = _merge_shallow(density, neighbours, peaks)
    return np.unique(merged, return_inverse=True)[1][cell_of_particle].astype(np.int64)


def _neighbours(occupied: IntArray, rows: int, heading_cells: int) -> tuple[IntArray, FloatArray]:
    """Indices ``(C, 27)`` of each occupied cell's neighbours and itself, -1 where unoccupied.

    Also the ``(27,)`` weights of a triangular kernel over them.
    """
    heading = occupied % heading_cells
    place = occupied // heading_cells
    dx, dy, dh = np.indices((3, 3, 3)).reshape(3, -1, 1) - 1
    keys = (place + dx * rows + dy) * heading_cells + (heading + dh) % heading_cells
    found = np.minimum(np.searchsorted(occupied, keys), len(occupied) - 1)
    neighbours = np.where(occupied[found] == keys, found, -1)
    kernel = np.asarray(0.5 ** (abs(dx) + abs(dy) + abs(dh))[:, 0] / 8.0, dtype=np.float64)
    return np.ascontiguousarray(neighbours.T, dtype=np.int64), kernel


def _smoothed(values: FloatArray, neighbours: IntArray, kernel: FloatArray) -> FloatArray:
    # The appended zero is what index -1, an unoccupied cell, reads.
    return np.asarray(np.append(values, 0.0)[neighbours] @ kernel, dtype=np.float64)


def _uphill(density: FloatArray, neighbours: IntArray) -> IntArray:
    """The peak cell, ``(C,)``, that each cell reaches by going to its densest neighbour."""
    # Ranks instead of densities: equal densities would let two cells point at each other.
    rank = np.empty(len(density), dtype=np.int64)
    rank[np.argsort(density, kind="stable")] = np.arange(len(density))
    neighbour_ranks = np.append(rank, -1)[neighbours]
    best = np.argmax(neighbour_ranks, axis=1)
    target = neighbours[np.arange(len(density)), best]
    # Following the targets of the targets doubles the length of the paths until all end at peaks.
    while not np.array_equal(target[target], target):
        target = target[target]
    return np.asarray(target, dtype=np.int64)


def _merge_shallow(density: FloatArray, neighbours: IntArray, peaks: IntArray) -> IntArray:
    """Peak of each cell, ``(C,)``, after merging peaks without a real dip between them."""
    cell, column = np.nonzero(neighbours >= 0)
    other = neighbours[cell, column]
    on_border = peaks[cell] < peaks[other]
    cell, other = cell[on_border], other[on_border]
    passes = np.minimum(density[cell], density[other])
    parent = {int(peak): int(peak) for peak in np.unique(peaks)}

    def root(peak: int) -> int:
        while parent[peak] != peak:
            peak = parent[peak]
        return peak

    # Highest passes first; stable, so that the result does not depend on the sorting algorithm.
    for index in np.argsort(-passes, kind="stable"):
        first, second = root(int(peaks[cell[index]])), root(int(peaks[other[index]]))
        if first == second:
            continue
        low, high = sorted((first, second), key=lambda peak: (density[peak], peak))
        if passes[index] >= MERGE_RATIO * density[low]:
            parent[low] = high
    return np.array([root(int(peak)) for peak in peaks], dtype=np.int64)
