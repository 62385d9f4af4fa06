"""KLD sampling: how many particles a belief needs; and roughening, which keeps them apart.

Both keep a shrinking particle set from collapsing onto a few states.
"""

import math
from statistics import NormalDist

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.belief import Belief
from pipelines.localize.state_space import StateSpace, grid_cells, state_space_of_dimension

# Size of the grid cells in which particles are counted: metres and radians.
CELL_POSITION, CELL_HEADING = 0.25, math.radians(15.0)
# The posterior's distance from the sampled one stays below KLD_ERROR with this probability.
KLD_ERROR, KLD_QUANTILE = 0.08, 0.99
# Cells that hold less than this share of the weight are not part of the belief any more.
NEGLIGIBLE_SHARE = 1e-4


def kld_count(occupied_cells: int) -> int:
    """Particles that represent a belief spread over so many cells (Fox 2003, equation 12).

    With them, the Kullback-Leibler distance between the sampled and the true distribution over the
    cells is below ``KLD_ERROR`` with probability ``KLD_QUANTILE``.
    """
    if occupied_cells <= 1:
        return 1
    degrees = occupied_cells - 1.0
    spread = 2.0 / (9.0 * degrees)
    quantile = NormalDist().inv_cdf(KLD_QUANTILE)
    bracket = 1.0 - spread + math.sqrt(spread) * quantile
    return math.ceil(degrees / (2.0 * KLD_ERROR) * bracket**3)


def next_count(belief: Belief, smallest: int, shrink_factor: float) -> int:
    """How many particles to draw from a belief: as many as the KLD bound asks for, within limits.

    Args:
        belief: the particles; there are never more than these.
        smallest: there are never fewer.
        shrink_factor: nor fewer than this share of those in the belief: several images have to
            agree before hypotheses are given up.
    """
    space = state_space_of_dimension(belief.states.shape[1])
    cells = grid_cells(space, belief.states, CELL_POSITION, CELL_HEADING)
    _, members = np.unique(cells, axis=0, return_inverse=True)
    shares = np.bincount(members.reshape(-1), weights=belief.weights)
    wanted = kld_count(int(np.count_nonzero(shares > NEGLIGIBLE_SHARE)))
    slowest = math.ceil(shrink_factor * len(belief))
    return max(smallest, min(len(belief), max(wanted, slowest)))


def roughened(
    space: StateSpace, states: FloatArray, factor: float, rng: np.random.Generator
) -> FloatArray:
    """Spreads equally weighted particles so that copies of one explore its surroundings.

    Normal noise of standard deviation ``factor`` times the spread times M^(-1/D) in each of the D
    dimensions: the distance between M evenly spaced particles (roughening, Gordon, Salmond, Smith
    1993, section 3).

    Args:
        space: what a state is.
        states: ``(M, D)``.
        factor: 0 adds nothing.
        rng: source of randomness.
    """
    sigma = factor * space.spread(states) * len(states) ** (-1.0 / space.dimension)
    return space.moved(states, rng.normal(size=states.shape) * sigma)
