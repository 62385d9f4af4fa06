"""How the belief is carried from one frame to the next: ways to do the paper's equation (2).

Each strategy does three steps: resample, predict with the motion, weight by the image.

``condensation`` is the paper's filter, step by step: draw particles with probability proportional
to their weights, move each by a sample of the motion model, weight it with the likelihood of the
image. The number of particles is constant.

``coarse_to_fine`` finds the robot from anywhere by numbers alone: many particles and small images
at first, a likelihood that is kept from killing all but one of them, fewer particles as the belief
narrows.

``mixture`` is mixture-proposal Monte Carlo localization (``mixture_mcl``), and is the default.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.belief import (
    Belief,
    Region,
    effective_sample_size,
    equal_log_weights,
    gaussian_belief,
    normalise_log_weights,
    uniform_belief,
)
from pipelines.localize.estimate import Mode, find_modes
from pipelines.localize.kld_sampling import next_count, roughened
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.motion import checked_increment, predict
from pipelines.localize.observation import Observations
from pipelines.localize.outside_hypothesis import OutsideHypothesis
from pipelines.localize.places import compressed
from pipelines.localize.resampling import resample
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import StateSpace
from pipelines.localize.tempering import tempered

# An image with so much evidence for some place may show the map, although one alone does not prove
# it; natural units.
FITTING_EVIDENCE = 5.0


@dataclass(frozen=True)
class Posterior:
    """What an image and a motion make of a belief.

    Attributes:
        belief: where the body is, if the image shows the map.
        modes: its peaks, heaviest first.
        inside: probability that the image shows the map.
        motion: ``(D,)`` the measured motion that led here, without odometry's known errors; None:
            before the first image, or nobody knows. A speed that is taken to go on says where to
            search, and is no measurement.
        position_sigma: standard deviation of that motion's noise along each axis, metres.
        angle_sigma: standard deviation of its noise in each angle, radians.
        fits_a_place: whether the image fits some place, although that is not yet probable.
        is_inconclusive: whether nothing but the image says where the body is, and it is explained
            much less than images usually are.
    """

    belief: Belief
    modes: tuple[Mode, ...]
    inside: float
    motion: FloatArray | None
    position_sigma: float
    angle_sigma: float
    fits_a_place: bool = False
    is_inconclusive: bool = False

    @property
    def place_probability(self) -> float:
        """Probability that the body is in the heaviest mode, against all alternatives."""
        return self.inside * self.modes[0].share


class Strategy(Protocol):
    """Carries a belief from frame to frame; its steps are called in this order."""

    def resample(self) -> None:
        """Draws particles from the belief in proportion to their weights."""

    def predict(self, increment: FloatArray | None) -> None:
        """Moves what was drawn by the motion since the image before.

        Args:
            increment: ``(D,)`` measured in the body's frame, or None; not used for the first image.
        """

    def weight(self, observations: Observations, hypotheses: FloatArray | None = None) -> Posterior:
        """Weights what was predicted with one image.

        Args:
            observations: the image.
            hypotheses: ``(K, D)`` states where somebody else thinks that the body is, or None.
                They say where to search, never what to believe.
        """

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of the images so far, a line each."""

    def learn(self, estimate: FloatArray) -> None:
        """Tells it the best estimate ``(D,)`` of a frame in which one mode is tracked."""


def start_belief(
    space: StateSpace,
    region: Region,
    settings: LocalizerSettings,
    count: int,
    rng: np.random.Generator,
) -> Belief:
    """The belief before the first image: around the start pose, or anywhere.

    Args:
        space: what a state is.
        region: where the body may be.
        settings: of the particle filter: the start pose and its uncertainty.
        count: number of particles where there is no start pose.
        rng: source of the draws.
    """
    if settings.start is None:
        return uniform_belief(space, region, count, rng)
    return gaussian_belief(
        space,
        settings.start,
        settings.start_position_sigma,
        settings.start_heading_sigma,
        settings.particles,
        rng,
    )


class Condensation:
    """The paper's filter.

    Args:
        model: compares states with images.
        region: where the body may be.
        settings: of the particle filter.
        rng: the only source of randomness.
    """

    def __init__(
        self,
        model: MeasurementModel,
        region: Region,
        settings: LocalizerSettings,
        rng: np.random.Generator,
    ) -> None:
        self._model = model
        self._settings = settings
        self._rng = rng
        self._outside = OutsideHypothesis()
        self._belief = start_belief(model.space, region, settings, self._start_count(settings), rng)
        self._motion: FloatArray | None = None
        self._is_first = True

    def _start_count(self, settings: LocalizerSettings) -> int:
        return settings.particles

    def resample(self) -> None:
        """Draws as many particles as before; the belief before the first image stays."""
        if not self._is_first:
            self._belief = self._resampled(self._belief)

    def predict(self, increment: FloatArray | None) -> None:
        """Moves each particle by a sample of the motion model.

        Args:
            increment: ``(D,)`` measured in the body's frame; None: a random walk. Not used for the
                first image.
        """
        if self._is_first:
            return
        self._motion = checked_increment(self._model.space, increment)
        self._belief = Belief(self._moved(self._belief.states), self._belief.log_weights)
        self._outside = self._outside.predicted()

    def weight(self, observations: Observations, hypotheses: FloatArray | None = None) -> Posterior:
        """Weights each particle with the likelihood of the image.

        Args:
            observations: the image.
            hypotheses: not used: the image has no say in where particles are drawn.
        """
        self._is_first = False
        prior, fits_a_place = self._belief, False
        if observations.is_informative:
            self._belief = Belief(prior.states, self._log_weights(prior, observations))
            fine = observations.by_width[self._settings.fine_width]
            evidence = self._model.marginal_evidence(self._belief, prior.log_weights, fine)
            self._outside = self._outside.updated(evidence)
            heaviest = self._belief.states[int(np.argmax(self._belief.log_weights))]
            largest = float(compressed(self._model.evidence_at(heaviest, fine)))
            fits_a_place = max(evidence, largest) >= FITTING_EVIDENCE
        motion = self._motion
        sigmas = self._settings.motion.standard_deviations(self._model.space, motion)
        modes = find_modes(self._belief)
        return Posterior(self._belief, modes, self._outside.inside, motion, *sigmas, fits_a_place)

    @property
    def notes(self) -> tuple[str, ...]:
        """Nothing: the paper's filter looks at images one way only."""
        return ()

    def learn(self, estimate: FloatArray) -> None:
        """The paper's filter learns nothing but its belief."""

    def _resampled(self, belief: Belief) -> Belief:
        count = len(belief)
        chosen = resample(belief.log_weights, count, self._settings.resampling, self._rng)
        return Belief(belief.states[chosen], equal_log_weights(count))

    def _moved(self, states: FloatArray) -> FloatArray:
        return predict(self._model.space, states, self._motion, self._settings.motion, self._rng)

    def _log_weights(self, prior: Belief, observations: Observations) -> FloatArray:
        """Normalised log-weights ``(M,)`` of predicted particles after an image."""
        observation = observations.by_width[self._settings.fine_width]
        log_likelihoods = self._model.log_likelihoods(prior.states, observation)
        return normalise_log_weights(prior.log_weights + log_likelihoods)[0]


class CoarseToFine(Condensation):
    """Many particles and small images first, few and larger ones later."""

    def _start_count(self, settings: LocalizerSettings) -> int:
        return settings.search_particles

    def _resampled(self, belief: Belief) -> Belief:
        """Fewer particles as the belief narrows; as they are while their weights are even."""
        settings = self._settings
        count = next_count(belief, settings.particles, settings.shrink_factor)
        enough = settings.resampling_threshold * len(belief)
        if count == len(belief) and effective_sample_size(belief.log_weights) > enough:
            return belief
        chosen = resample(belief.log_weights, count, settings.resampling, self._rng)
        return Belief(belief.states[chosen], equal_log_weights(count))

    def _moved(self, states: FloatArray) -> FloatArray:
        moved = super()._moved(states)
        return roughened(self._model.space, moved, self._settings.roughening, self._rng)

    def _log_weights(self, prior: Belief, observations: Observations) -> FloatArray:
        settings = self._settings
        is_coarse = len(prior) > 4 * settings.particles
        width = settings.coarse_width if is_coarse else settings.fine_width
        log_likelihoods = self._model.log_likelihoods(prior.states, observations.by_width[width])
        return tempered(prior.log_weights, log_likelihoods, settings.smallest_effective_share)[0]
