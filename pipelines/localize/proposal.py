"""Proposals that look at the image: normal distributions around aligned states.

Particles are best spent where the posterior has its mass, and the image tells where that may be.
Hypotheses are the peaks of the predicted belief and, in a search, states from which the scene looks
like the image (``search``). They are aligned with the image; around each a normal distribution is
drawn from, as wide as the likelihood is there. The weights divide by the density of what was drawn
from, so that the posterior stays that of the paper's equation (2), whatever is proposed (importance
sampling; Thrun et al. 2001, "Robust Monte Carlo localization", call it mixture MCL). A share of the
particles still comes from the prior, so that no weight can exceed the likelihood by more than its
inverse (defensive mixture, Hesterberg 1995).
"""

import math
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.belief import Belief, log_sum, normalise_log_weights
from pipelines.localize.camera_faults import CameraFaults
from pipelines.localize.estimate import find_modes
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import Observations
from pipelines.localize.prediction import Prediction
from pipelines.localize.search import QUICK, THOROUGH, GlobalSearch
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import StateSpace, sigmas_of

# Hypotheses from image retrieval that are aligned: in a search, and where only the motion is
# unknown.
SEARCHED, UNKNOWN_MOTION_SEARCHED = 20, 8
# Peaks of the predicted belief that are aligned at most, and the least share of the weight of each.
FOLLOWED, FOLLOWED_SHARE = 6, 0.01
# The proposal is this much wider than the likelihood, and never narrower than metres and radians,
# nor wider.
WIDENING = 1.5
SMALLEST_POSITION, SMALLEST_ANGLE = 0.005, math.radians(0.15)
LARGEST_POSITION, LARGEST_ANGLE = 0.3, math.radians(10.0)


@dataclass(frozen=True)
class Proposal:
    """A mixture of normal distributions in the tangent spaces of K states.

    Attributes:
        space: what a state is.
        means: ``(K, D)``.
        covariances: ``(K, D, D)``, positive definite.
        log_shares: ``(K,)`` logarithms of the components' shares, normalised.
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


class ProposalBuilder:
    """Finds hypotheses for an image, and makes a proposal of them.

    Args:
        model: compares states with images.
        search: looks images up in the map.
        settings: of the particle filter: where hypotheses come from, widths of the images.

    Attributes:
        faults: what the searches say of the camera's picture.
    """

    def __init__(
        self, model: MeasurementModel, search: GlobalSearch, settings: LocalizerSettings
    ) -> None:
        self._model = model
        self._search = search
        self._settings = settings
        self._given = np.empty((0, model.space.dimension))
        self._faults_are_known = False
        self.faults = CameraFaults()

    def begin_image(self, given: FloatArray | None) -> None:
        """Says that another image follows.

        Args:
            given: ``(K, D)`` hypotheses for it that somebody else found, or None.
        """
        self._given = np.empty((0, self._model.space.dimension)) if given is None else given
        self._faults_are_known = False

    def build(self, prediction: Prediction, observations: Observations) -> Proposal | None:
        """The proposal for an image; None where no hypothesis can be aligned with it."""
        settings, model = self._settings, self._model
        hypotheses = self._hypotheses(prediction, observations)
        widths = [settings.coarse_width, settings.fine_width]
        if not prediction.is_start and prediction.anywhere_share == 0.0:
            widths = widths[1:]
        aligned = [model.aligned(state, observations, widths) for state in hypotheses]
        found = [alignment for alignment in aligned if math.isfinite(alignment.error)]
        if not found:
            return None
        means = np.stack([alignment.state for alignment in found])
        observation = observations.by_width[settings.fine_width]
        log_shares = model.log_likelihoods(means, observation)
        # Flattened: which of them is right is for the weights to say, not for the proposal.
        return Proposal(
            model.space,
            means,
            np.stack([self._covariance(alignment.curvature) for alignment in found]),
            normalise_log_weights(0.5 * log_shares)[0],
        )

    def _covariance(self, curvature: FloatArray) -> FloatArray:
        """Width ``(D, D)`` of the likelihood at a peak with this curvature, made somewhat wider."""
        space = self._model.space
        smallest = sigmas_of(space, SMALLEST_POSITION, SMALLEST_ANGLE)
        largest = sigmas_of(space, LARGEST_POSITION, LARGEST_ANGLE)
        inverse_temperature = 2.0 * self._model.likelihood.proposal_inverse_temperature / 255.0**2
        precision = inverse_temperature * curvature + np.diag(largest**-2.0)
        return np.asarray(WIDENING**2 * np.linalg.inv(precision) + np.diag(smallest**2))

    def _hypotheses(self, prediction: Prediction, observations: Observations) -> FloatArray:
        """States ``(K, D)`` worth aligning."""
        found = self._given
        if prediction.anywhere_share < 1.0:
            moved = Belief(prediction.centres, prediction.log_weights)
            modes = find_modes(moved, minimum_share=FOLLOWED_SHARE)[:FOLLOWED]
            found = np.concatenate([found, np.stack([mode.state for mode in modes])])
        may_be_elsewhere = prediction.is_start or prediction.anywhere_share > 0.0
        if may_be_elsewhere and self._settings.proposal != "pnp":
            count = SEARCHED if prediction.is_search else UNKNOWN_MOTION_SEARCHED
            found = np.concatenate([found, self._retrieved(prediction, observations, count)])
        return found

    def _retrieved(
        self, prediction: Prediction, observations: Observations, count: int
    ) -> FloatArray:
        """States ``(K, D)`` from which the scene looks like the image, ``count`` a database."""
        search, is_search = self._search, prediction.is_search
        is_near = prediction.is_start and prediction.anywhere_share == 0.0
        databases = [] if is_near else [search.everywhere(observations)]
        if is_near or (is_search and prediction.is_walk):
            # Views all over the map are too sparse to be sure of one where the body may have gone.
            databases.append(search.around(prediction, observations))
        effort = THOROUGH if is_search else QUICK
        found = []
        for database in databases:
            states, evidence = search.retrieved(database, observations, effort)
            found.append(search.distinct(database, states, evidence, count))
        if is_search and self._settings.start is None and not self._faults_are_known:
            # Without odometry several priors are tried on one image, which says the same each time.
            self._faults_are_known = prediction.is_walk
            self.faults = self.faults.updated(
                lambda image: search.largest_evidence(databases[0], image), observations
            )
        return np.concatenate(found)
