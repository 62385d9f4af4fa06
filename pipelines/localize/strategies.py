"""How the belief is carried from one frame to the next: three ways to do the paper's equation (2).

``condensation`` is the paper's filter, step by step: draw particles with probability proportional
to their weights, move each by a sample of the motion model, weight it with the likelihood of the
image; the number of particles is constant.

``coarse_to_fine`` finds the robot from anywhere by numbers alone: many particles and small images
at first, a likelihood that is kept from killing all but one of them, fewer particles as the belief
narrows.

``mixture`` lets the image say where to look (``mixture_mcl``), and is the default.
"""

import math
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
from pipelines.localize.outside_hypothesis import Presence
from pipelines.localize.places import compressed
from pipelines.localize.resampling import resample
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import StateSpace
from pipelines.localize.tempering import tempered

# An image that fits some place so well may show the map, although one alone does not prove it.
PROMISING = 5.0


@dataclass(frozen=True)
class Update:
    """What an image and a motion make of a belief.

    Attributes:
        belief: where the body is, if the image shows the map.
        modes: its peaks, heaviest first.
        inside: probability that it does.
        motion: ``(D,)`` the measured motion that it was carried on by, without odometry's known
            errors; None: before the first image, or nobody knows. A speed that is taken to go on is
            a place to look, and no measurement.
        position_sigma: of that motion's noise along each axis, metres.
        angle_sigma: of its angles, radians.
        is_promising: whether the image fits some place, although that is not yet probable.
        proves_nothing: whether nothing but the image says where the body is, and it is explained
            much less than images usually are.
    """

    belief: Belief
    modes: tuple[Mode, ...]
    inside: float
    motion: FloatArray | None
    position_sigma: float
    angle_sigma: float
    is_promising: bool = False
    proves_nothing: bool = False


class Strategy(Protocol):
    """Carries a belief from frame to frame."""

    def update(
        self,
        observations: Observations,
        increment: FloatArray | None,
        hypotheses: FloatArray | None = None,
    ) -> Update:
        """The belief after one image.

        Args:
            observations: the image.
            increment: ``(D,)`` the motion since the image before, or None.
            hypotheses: ``(K, D)`` states where somebody else thinks that the body is, or None.
                They say where to look, never what to believe.
        """

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of the images so far, a line each."""

    def learn(self, estimate: FloatArray) -> None:
        """Tells it the best estimate ``(D,)`` of a frame in which one mode is followed."""


def start_belief(
    space: StateSpace,
    region: Region,
    settings: LocalizerSettings,
    count: int,
    rng: np.random.Generator,
) -> Belief:
    """The belief before the first image: around the start pose, or anywhere."""
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
        region: where the robot may be.
        settings: of the filter.
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
        self._is_first = True
        self._presence = Presence()
        self._belief = start_belief(model.space, region, settings, self._start_count(settings), rng)

    def _start_count(self, settings: LocalizerSettings) -> int:
        return settings.particles

    def update(
        self,
        observations: Observations,
        increment: FloatArray | None,
        hypotheses: FloatArray | None = None,
    ) -> Update:
        """See ``Strategy.update``; hypotheses are ignored."""
        states, log_weights = self._belief.states, self._belief.log_weights
        motion = None
        if not self._is_first:
            motion = checked_increment(self._model.space, increment)
            states, log_weights = self._drawn(motion)
            self._presence = self._presence.predicted()
        self._is_first = False
        self._belief = self._weighted(states, log_weights, observations)
        is_promising = False
        if observations.is_informative:
            fine = observations.by_width[self._settings.fine_width]
            evidence = self._model.marginal_evidence(self._belief, log_weights, fine)
            self._presence = self._presence.updated(evidence)
            heaviest = self._belief.states[[int(np.argmax(self._belief.log_weights))]]
            largest = float(compressed(self._model.evidence(heaviest, fine)[0]))
            is_promising = max(evidence, largest) >= PROMISING
        sigmas = self._settings.motion.standard_deviations(self._model.space, motion)
        modes = find_modes(self._belief)
        return Update(self._belief, modes, self._presence.inside, motion, *sigmas, is_promising)

    @property
    def notes(self) -> tuple[str, ...]:
        """Nothing: the paper's filter looks at images one way only."""
        return ()

    def learn(self, estimate: FloatArray) -> None:
        """The paper's filter learns nothing but its belief."""

    def _drawn(self, increment: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """Resampled and moved states, and their log-weights."""
        settings, count = self._settings, len(self._belief)
        chosen = resample(self._belief.log_weights, count, settings.resampling, self._rng)
        moved = predict(
            self._model.space,
            self._belief.states[chosen],
            increment,
            settings.motion,
            self._rng,
        )
        return moved, equal_log_weights(count)

    def _weighted(
        self, states: FloatArray, log_weights: FloatArray, observations: Observations
    ) -> Belief:
        if not observations.is_informative:
            return Belief(states, log_weights)
        observation = observations.by_width[self._settings.fine_width]
        log_likelihoods = self._model.log_likelihoods(states, observation)
        return Belief(states, normalise_log_weights(log_weights + log_likelihoods)[0])


class CoarseToFine(Condensation):
    """Many particles and small images first, few and larger ones later."""

    def _start_count(self, settings: LocalizerSettings) -> int:
        return settings.search_particles

    def _drawn(self, increment: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        settings, belief, space = self._settings, self._belief, self._model.space
        count = next_count(belief, settings.particles, settings.shrink_factor)
        states, log_weights = belief.states, belief.log_weights
        enough = settings.resampling_threshold * len(belief)
        if count != len(belief) or effective_sample_size(log_weights) <= enough:
            states = states[resample(log_weights, count, settings.resampling, self._rng)]
            log_weights = np.full(count, -math.log(count))
        moved = predict(space, states, increment, settings.motion, self._rng)
        return roughened(space, moved, settings.roughening, self._rng), log_weights

    def _weighted(
        self, states: FloatArray, log_weights: FloatArray, observations: Observations
    ) -> Belief:
        if not observations.is_informative:
            return Belief(states, log_weights)
        settings = self._settings
        is_coarse = len(states) > 4 * settings.particles
        width = settings.coarse_width if is_coarse else settings.fine_width
        log_likelihoods = self._model.log_likelihoods(states, observations.by_width[width])
        share = settings.smallest_effective_share
        return Belief(states, tempered(log_weights, log_likelihoods, share)[0])
