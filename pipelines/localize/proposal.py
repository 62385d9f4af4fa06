"""Proposals that look at the image: normal distributions around aligned states.

Particles are best spent where the posterior has its mass, and the image tells where that may be.
States that explain it (by appearance, or the peaks of the last belief) are aligned with it; around
each a normal distribution is drawn from, as wide as the likelihood is there. The weights divide by
the density of what was drawn from, so that the posterior stays that of the paper's equation (2),
whatever is proposed (importance sampling; Thrun et al. 2001, "Robust Monte Carlo localization",
call it mixture MCL). A share of the particles still comes from the prior, so that no weight can
exceed the likelihood by more than its inverse (defensive mixture, Hesterberg 1995).
"""

import math
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.belief import log_sum
from pipelines.localize.state_space import StateSpace


@dataclass(frozen=True)
class Proposal:
    """A mixture of normal distributions in the tangent spaces of K states.

    Attributes:
        space: what a state is.
        means: ``(K, D)``.
        covariances: ``(K, D, D)``, positive definite.
        log_shares: ``(K,)`` normalised.
    """

    space: StateSpace
    means: FloatArray
    covariances: FloatArray
    log_shares: FloatArray

    def __len__(self) -> int:
        return len(self.means)

    def sample(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draws ``(count, D)`` states, from each component its share (systematic)."""
        edges = np.cumsum(np.exp(self.log_shares))
        places = (np.arange(count) + rng.random()) / count
        chosen = np.minimum(np.searchsorted(edges, places, side="right"), len(self) - 1)
        factors = np.linalg.cholesky(self.covariances)[chosen]
        noise = rng.standard_normal((count, self.space.dimension))
        return self.space.moved(self.means[chosen], np.einsum("mij,mj->mi", factors, noise))

    def log_density(self, states: FloatArray) -> FloatArray:
        """Logarithm of the density at states ``(M, D)``."""
        terms = np.empty((len(self), len(states)))
        constant = 0.5 * self.space.dimension * math.log(2.0 * math.pi)
        for index in range(len(self)):
            offsets = self.space.difference(states, self.means[index])
            factor = np.linalg.cholesky(self.covariances[index])
            standardised = np.linalg.solve(factor, offsets.T)
            terms[index] = (
                self.log_shares[index]
                - 0.5 * np.sum(standardised**2, axis=0)
                - float(np.log(np.diag(factor)).sum())
                - constant
            )
        return log_sum(terms)
