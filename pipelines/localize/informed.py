"""The informed strategy: the image says where to look, the weights say what to believe.

One frame: odometry predicts where the body may be (``prediction``). Hypotheses that may explain the
image are aligned with it: the peaks of the last belief, and, while nobody knows where the body is
or the image no longer fits, places that look like it (``appearance``). Particles are drawn from
both, and weighted by likelihood times prior over the density that they were drawn from, which
leaves the posterior as it is in the paper, wherever particles were put.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.array_types import FloatArray
from pipelines.localize.adaptation import ImageFit, uncalibrated
from pipelines.localize.appearance import (
    AppearanceIndex,
    best_distinct,
    build_index,
    spread_states,
    states_around_views,
)
from pipelines.localize.belief import Belief, Region, equal_log_weights, normalise_log_weights
from pipelines.localize.estimate import find_modes
from pipelines.localize.likelihood import Comparison
from pipelines.localize.motion import checked_increment
from pipelines.localize.observation import Observations
from pipelines.localize.population import next_count
from pipelines.localize.prediction import Prediction
from pipelines.localize.proposal import Proposal
from pipelines.localize.resampling import resample
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import StateSpace

# Hypotheses that are aligned in a search, and peaks that are followed.
SEARCHED, FOLLOWED = 20, 6
# A peak that is followed holds at least this share of the weight.
FOLLOWED_SHARE = 0.01
# Share of the particles that are drawn from the proposal.
PROPOSED_SHARE = 0.6
# A search keeps so many times as many particles as tracking, where that is not more than enough.
SEARCH_FACTOR, ENOUGH_PARTICLES = 8, 4_000
# The density of the prior takes time with each particle in it; so many stand for any number.
LARGEST_PRIOR = 2_000
# While several peaks are left, the body is with this probability where none of them is.
UNDECIDED_SHARE = 0.05
UNDECIDED_MODE_SHARE = 0.95
# The share when there is a reason to doubt all that was believed.
CARRIED_SHARE = 0.5
# Where nobody knows the motion, the next image may come from anywhere: a hand turns a camera by
# half its view in a moment. Then there is always a search, though for fewer places.
UNKNOWN_MOTION_SHARE, UNKNOWN_MOTION_SEARCHED = 0.1, 8
# The proposal is this much wider than the likelihood, and never narrower than metres and radians.
WIDENING = 1.5
SMALLEST_POSITION, SMALLEST_ANGLE = 0.005, math.radians(0.15)
# What two estimates contribute to the error of the motion between them.
ESTIMATE_POSITION, ESTIMATE_ANGLE = 0.02, math.radians(0.5)
LARGEST_POSITION, LARGEST_ANGLE = 0.3, math.radians(10.0)


@dataclass(frozen=True)
class _Update:
    """A belief, how well its best state explains the image, and whether it left any doubt."""

    belief: Belief
    match: float


class Informed:
    """Carries a belief from frame to frame with proposals that look at the image.

    Args:
        comparison: of states with images.
        region: where the body may be.
        world_from_camera: ``(N, 4, 4)`` of the recorded views; hypotheses with six degrees of
            freedom are taken from around them.
        settings: of the filter.
        rng: the only source of randomness.
    """

    def __init__(
        self,
        comparison: Comparison,
        region: Region,
        world_from_camera: FloatArray,
        settings: LocalizerSettings,
        rng: np.random.Generator,
    ) -> None:
        self._comparison = comparison
        self._region = region
        self._views = world_from_camera
        self._settings = settings
        self._rng = rng
        self._index: AppearanceIndex | None = None
        self._belief: Belief | None = None
        self._fit = ImageFit()
        self._calibration = uncalibrated(comparison.space.dimension)
        self._increment: FloatArray | None = None
        self._estimate: FloatArray | None = None
        self._last_estimate: FloatArray | None = None
        self._given = np.empty((0, comparison.space.dimension))

    @property
    def _space(self) -> StateSpace:
        return self._comparison.space

    @property
    def _is_walking(self) -> bool:
        """Whether a belief is carried on by a random walk."""
        return self._belief is not None and self._increment is None

    def update(
        self,
        observations: Observations,
        increment: FloatArray | None,
        hypotheses: FloatArray | None = None,
    ) -> Belief:
        """See ``Strategy.update``."""
        self._given = np.empty((0, self._space.dimension)) if hypotheses is None else hypotheses
        motion = None
        if self._belief is not None:
            motion = checked_increment(self._space, increment)
        self._increment, self._last_estimate, self._estimate = motion, self._estimate, None
        prediction = self._prediction(motion)
        if observations.is_blind:
            self._belief = self._unseen(prediction)
            return self._belief
        if self._is_walking:
            share = max(UNKNOWN_MOTION_SHARE, prediction.anywhere_share)
            prediction = replace(prediction, anywhere_share=share)
        if observations.uncovers and prediction.anywhere_share < CARRIED_SHARE:
            # What was concluded from a view that was partly hidden may be wrong.
            prediction = replace(prediction, anywhere_share=CARRIED_SHARE)
        update = self._weighted(prediction, observations)
        share = self._fit.reset_share(update.match)
        if share > prediction.anywhere_share:
            # The image does not fit where the body was thought to be: look everywhere at once.
            update = self._weighted(replace(prediction, anywhere_share=share), observations)
        self._fit = self._fit.with_match(update.match)
        self._belief = update.belief
        return self._belief

    def learn(self, estimate: FloatArray) -> None:
        """Compares the motion between two estimates with odometry."""
        space, before, motion = self._space, self._last_estimate, self._increment
        if before is not None and motion is not None:
            poses = space.poses(np.stack([before, estimate]))
            error = space.difference(space.increment(poses[0], poses[1]), motion)
            left = error - self._calibration.correction @ motion
            sigmas = _spread(space, *self._settings.motion.standard_deviations(space, motion))
            expected = sigmas**2 + _spread(space, ESTIMATE_POSITION, ESTIMATE_ANGLE) ** 2
            surprise = float(np.mean(left**2 / expected))
            self._calibration = self._calibration.learned(motion, error, surprise)
        self._estimate = estimate

    def _prediction(self, motion: FloatArray | None) -> Prediction:
        """The prior of this frame."""
        space, settings = self._space, self._settings
        if self._belief is None:
            return self._first_prediction()
        centres, log_weights, scale = self._belief.states, self._belief.log_weights, 1.0
        if len(centres) > LARGEST_PRIOR:
            chosen = resample(log_weights, LARGEST_PRIOR, settings.resampling, self._rng)
            centres, log_weights = centres[chosen], equal_log_weights(LARGEST_PRIOR)
        if motion is not None:
            centres = space.composed(centres, self._calibration.corrected(motion))
            scale = self._calibration.noise_scale
        position_sigma, angle_sigma = settings.motion.standard_deviations(space, motion)
        modes = find_modes(self._belief)
        undecided = settings.start is None and modes[0].share < UNDECIDED_MODE_SHARE
        return Prediction(
            space,
            centres,
            log_weights,
            scale * position_sigma,
            scale * angle_sigma,
            self._region,
            UNDECIDED_SHARE if undecided else 0.0,
        )

    def _first_prediction(self) -> Prediction:
        settings, space = self._settings, self._space
        start = np.zeros(space.dimension) if settings.start is None else np.array(settings.start)
        return Prediction(
            space,
            start[None],
            np.zeros(1),
            settings.start_position_sigma,
            settings.start_heading_sigma,
            self._region,
            1.0 if settings.start is None else 0.0,
        )

    def _unseen(self, prediction: Prediction) -> Belief:
        """The belief after an image that shows nothing: what odometry says, spread by its noise."""
        count = self._settings.particles if self._belief is None else len(self._belief)
        states = prediction.sample(count, self._settings.resampling, self._rng)
        return Belief(states, equal_log_weights(count))

    def _weighted(self, prediction: Prediction, observations: Observations) -> _Update:
        """Draws particles from prior and proposal and weights them with the image."""
        proposal = self._proposal(prediction, observations)
        count = self._count(prediction)
        proposed = round(PROPOSED_SHARE * count) if proposal is not None else 0
        settings = self._settings
        states = prediction.sample(count - proposed, settings.resampling, self._rng)
        correction = np.zeros(count)
        if proposal is not None:
            states = np.concatenate([states, proposal.sample(proposed, self._rng)])
            share = proposed / count
            log_prior = prediction.log_density(states)
            log_drawn = np.logaddexp(
                math.log1p(-share) + log_prior, math.log(share) + proposal.log_density(states)
            )
            correction = log_prior - log_drawn
        observation = observations.by_width[settings.fine_width]
        log_likelihoods = self._comparison.log_likelihoods(states, observation)
        log_weights, has_weight = normalise_log_weights(correction + log_likelihoods)
        if not has_weight:
            # The image speaks against all alike: what was believed before it stands.
            log_weights, _ = normalise_log_weights(correction)
        belief = Belief(states, log_weights)
        best = states[np.argmax(belief.log_weights)][None]
        return _Update(belief, self._comparison.match(best, observation))

    def _count(self, prediction: Prediction) -> int:
        settings = self._settings
        largest = max(settings.particles, min(SEARCH_FACTOR * settings.particles, ENOUGH_PARTICLES))
        if self._searches(prediction):
            return largest
        if self._belief is None:
            return settings.particles
        return min(largest, next_count(self._belief, settings.particles, 0.0))

    def _searches(self, prediction: Prediction) -> bool:
        """Whether there is a reason to look everywhere, and not only that the motion is unknown."""
        usual = UNKNOWN_MOTION_SHARE if self._is_walking else 0.0
        return prediction.anywhere_share > usual

    def _proposal(self, prediction: Prediction, observations: Observations) -> Proposal | None:
        """Normal distributions around hypotheses that were aligned with the image."""
        settings, comparison = self._settings, self._comparison
        hypotheses = self._hypotheses(prediction, observations)
        widths = [settings.coarse_width, settings.fine_width]
        if prediction.anywhere_share == 0.0:
            widths = widths[1:]
        aligned = [comparison.aligned(state, observations, widths) for state in hypotheses]
        found = [refined for refined in aligned if math.isfinite(refined.error)]
        if not found:
            return None
        means = np.stack([refined.state for refined in found])
        observation = observations.by_width[settings.fine_width]
        log_shares = comparison.log_likelihoods(means, observation)
        # Flattened: which of them is right is for the weights to say, not for the proposal.
        return Proposal(
            self._space,
            means,
            np.stack([self._covariance(refined.curvature) for refined in found]),
            normalise_log_weights(0.5 * log_shares)[0],
        )

    def _covariance(self, curvature: FloatArray) -> FloatArray:
        """Width ``(D, D)`` of the likelihood at a peak with this curvature, made somewhat wider."""
        space = self._space
        smallest = _spread(space, SMALLEST_POSITION, SMALLEST_ANGLE)
        largest = _spread(space, LARGEST_POSITION, LARGEST_ANGLE)
        sharpness = 2.0 * self._comparison.likelihood.proposal_sharpness / 255.0**2
        precision = sharpness * curvature + np.diag(largest**-2.0)
        return np.asarray(WIDENING**2 * np.linalg.inv(precision) + np.diag(smallest**2))

    def _hypotheses(self, prediction: Prediction, observations: Observations) -> FloatArray:
        """States ``(K, D)`` worth aligning."""
        found = self._given
        if prediction.anywhere_share < 1.0:
            moved = Belief(prediction.centres, prediction.log_weights)
            modes = find_modes(moved, minimum_share=FOLLOWED_SHARE)[:FOLLOWED]
            found = np.concatenate([found, np.stack([mode.state for mode in modes])])
        if prediction.anywhere_share > 0.0 and self._settings.proposal != "pnp":
            count = SEARCHED if self._searches(prediction) else UNKNOWN_MOTION_SEARCHED
            found = np.concatenate([found, self._lookalikes(observations, count)])
        return found

    def _lookalikes(self, observations: Observations, count: int) -> FloatArray:
        """States ``(count, D)`` all over the region from which the scene looks like the image."""
        observation = observations.by_width[self._settings.coarse_width]
        if self._index is None:
            self._index = build_index(
                self._comparison.renderer,
                self._space,
                self._comparison.body_from_camera,
                observation.intrinsics,
                self._places(),
            )
        costs = self._index.costs(observation)
        best = best_distinct(self._space, self._index.states, costs, count)
        return self._index.states[best]

    def _places(self) -> FloatArray:
        """States ``(N, D)`` at which thumbnails are rendered."""
        count = self._settings.search_particles
        if self._space.angles == 1:
            return spread_states(self._space, self._region, count)
        mount = self._comparison.body_from_camera
        return states_around_views(self._space, self._views, mount, count, self._rng)


def _spread(space: StateSpace, position: float, angle: float) -> FloatArray:
    return np.array([position] * space.positions + [angle] * space.angles)
