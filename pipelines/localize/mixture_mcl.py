"""The mixture strategy: the image says where to look, the weights say what to believe.

One frame: odometry predicts where the body may be (``prediction``). Hypotheses that may explain the
image are aligned with it: the peaks of the last belief, and, while nobody knows where the body is
or the image no longer fits, places that look like it (``search``). Particles are drawn from
both, and weighted by likelihood times prior over the density that they were drawn from, which
leaves the posterior as it is in the paper, wherever particles were put. Between places as wholes
one image decides only so much (``places``), and beside all of them stands the hypothesis that the
image does not show the map (``outside_hypothesis``).
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.belief import Belief, Region, equal_log_weights, normalise_log_weights
from pipelines.localize.camera_faults import CameraFaults
from pipelines.localize.estimate import Mode, find_modes
from pipelines.localize.kld_sampling import next_count
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.motion import checked_increment
from pipelines.localize.observation import Observations
from pipelines.localize.odometry_calibration import uncalibrated
from pipelines.localize.outside_hypothesis import Presence, Usual
from pipelines.localize.places import labelled, log_priors, places_of, weighed
from pipelines.localize.prediction import (
    FITTING_SHARE,
    PROVING_SHARE,
    SPEED_CHANGE,
    SPEED_GROWTHS,
    UNKNOWN_MOTION_SEARCHED,
    UNKNOWN_MOTION_SHARE,
    Prediction,
    widened,
)
from pipelines.localize.proposal import Proposal
from pipelines.localize.resampling import resample
from pipelines.localize.search import GLANCE, THOROUGH, Search
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import StateSpace, sigmas_of
from pipelines.localize.strategies import PROMISING, Update

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
# Probability that the body is somewhere else in the map than odometry says, from one image to the
# next, while all is well; and at most, when there is a reason to doubt all that was believed.
CARRIED, MOST_CARRIED = 1e-3, 0.5
# Below this probability of seeing the map at all, the whole map is searched.
PRESENT = 0.8
# Below this probability that the picture is as it should be, a user is told.
FAULTY = 0.003
# While several peaks are left, the body is with this probability where none of them is.
UNDECIDED_SHARE = 0.05
UNDECIDED_MODE_SHARE = 0.95
# An image that says less than this share of what images usually say raises the question whether the
# body is somewhere else.
DOUBTFUL_SHARE = 0.5
# The proposal is this much wider than the likelihood, and never narrower than metres and radians.
WIDENING = 1.5
SMALLEST_POSITION, SMALLEST_ANGLE = 0.005, math.radians(0.15)
# What two estimates contribute to the error of the motion between them.
ESTIMATE_POSITION, ESTIMATE_ANGLE = 0.02, math.radians(0.5)
LARGEST_POSITION, LARGEST_ANGLE = 0.3, math.radians(10.0)


@dataclass(frozen=True)
class _Weighted:
    """What an image makes of a prior.

    Attributes:
        belief: the posterior.
        evidence: of the image for the map.
        largest: for the place that it fits best.
        explained: how much of the image the heaviest particle explains; known where it matters.
    """

    belief: Belief
    evidence: float
    largest: float
    explained: float = 1.0


class Informed:
    """Carries a belief from frame to frame with proposals that look at the image.

    Args:
        model: compares states with images.
        region: where the body may be.
        world_from_camera: ``(N, 4, 4)`` of the recorded views; hypotheses with six degrees of
            freedom are taken from around them.
        settings: of the filter.
        rng: the only source of randomness.
    """

    def __init__(
        self,
        model: MeasurementModel,
        region: Region,
        world_from_camera: FloatArray,
        settings: LocalizerSettings,
        rng: np.random.Generator,
    ) -> None:
        self._model = model
        self._region = region
        self._settings = settings
        self._rng = rng
        self._search = Search(model, region, world_from_camera, settings, rng)
        self._belief: Belief | None = None
        self._modes: tuple[Mode, ...] = ()
        self._presence = Presence()
        self._faults = CameraFaults()
        self._faults_are_known = False
        self._start_was_contradicted = False
        self._usual_evidence, self._usual_fit = Usual(), Usual()
        self._calibration = uncalibrated(model.space.dimension)
        self._increment: FloatArray | None = None
        self._velocity: FloatArray | None = None
        self._estimate: FloatArray | None = None
        self._last_estimate: FloatArray | None = None
        self._given = np.empty((0, model.space.dimension))

    @property
    def _space(self) -> StateSpace:
        return self._model.space

    @property
    def _is_walking(self) -> bool:
        """Whether a belief is carried on by a random walk."""
        return self._belief is not None and self._increment is None

    def update(
        self,
        observations: Observations,
        increment: FloatArray | None,
        hypotheses: FloatArray | None = None,
    ) -> Update:
        """See ``Strategy.update``."""
        self._given = np.empty((0, self._space.dimension)) if hypotheses is None else hypotheses
        motion = None
        if self._belief is not None:
            motion = checked_increment(self._space, increment)
        self._increment, self._last_estimate, self._estimate = motion, self._estimate, None
        self._faults_are_known = False
        before = self._presence if self._belief is None else self._presence.predicted()
        prediction = self._prediction(motion, before)
        if not observations.is_informative:
            self._belief, self._presence = self._unseen(prediction), before
            return self._update(self._belief, prediction, motion)
        weighted = self._weighted(prediction, observations)
        share = self._doubt(weighted.evidence, before, observations)
        if self._is_walking:
            weighted = self._explained(weighted, prediction, before, observations)
        elif share > prediction.anywhere_share:
            # The image does not fit where the body was thought to be: look everywhere at once.
            is_start = self._belief is None and self._settings.start is not None
            self._start_was_contradicted = self._start_was_contradicted or is_start
            wide = replace(prediction, anywhere_share=share)
            weighted = self._weighted(wide, observations)
        self._presence = before.updated(weighted.evidence)
        proves_nothing = self._is_walking and self._usual_fit.is_poor(
            weighted.explained, PROVING_SHARE
        )
        if self._presence.inside >= PRESENT:
            self._usual_evidence = self._usual_evidence.updated(weighted.evidence)
            if self._is_walking:
                self._usual_fit = self._usual_fit.updated(weighted.explained)
        self._belief = weighted.belief
        return self._update(self._belief, prediction, motion, weighted.largest, proves_nothing)

    def _update(
        self,
        belief: Belief,
        prediction: Prediction,
        motion: FloatArray | None,
        largest: float = -math.inf,
        proves_nothing: bool = False,
    ) -> Update:
        """What is known now, and by which motion it was carried on."""
        self._modes = find_modes(belief)
        return Update(
            belief,
            self._modes,
            self._presence.inside * self._faults.none,
            None if motion is None else self._calibration.corrected(motion),
            prediction.position_sigma,
            prediction.angle_sigma,
            largest >= PROMISING,
            proves_nothing,
        )

    def _explained(
        self,
        weighted: _Weighted,
        prediction: Prediction,
        before: Presence,
        observations: Observations,
    ) -> _Weighted:
        """What the likeliest of several motions makes of an image, where nobody knows the motion.

        The motion may be farther and farther from what it was taken to be, until the image says as
        much as images usually do.
        """
        wider = prediction
        # The whole map was searched already where the body is lost.
        for _ in range(0 if self._searches(prediction) else SPEED_GROWTHS):
            share = self._doubt(weighted.evidence, before, observations)
            if share == 0.0 and not self._usual_fit.is_poor(weighted.explained, FITTING_SHARE):
                break
            wider = widened(wider, share)
            then = self._weighted(wider, observations)
            weighted = then if then.evidence > weighted.evidence else weighted
        return weighted

    def _doubt(self, evidence: float, before: Presence, observations: Observations) -> float:
        """How likely it is that the body is somewhere else, after an image with this evidence.

        0 while the image says as much as images usually do.
        """
        if observations.uncovers:
            # What was concluded from a view that was partly hidden may be wrong.
            return MOST_CARRIED
        usual = self._usual_evidence.mean
        if evidence >= (PROMISING if usual is None else DOUBTFUL_SHARE * usual):
            return 0.0
        return max(CARRIED, MOST_CARRIED * (1.0 - before.updated(evidence).inside))

    @property
    def notes(self) -> tuple[str, ...]:
        """See ``Strategy.notes``."""
        notes = []
        if self._start_was_contradicted:
            notes.append(
                "the first image does not show what the map shows around the start pose: "
                "the start pose was given up and the whole map searched"
            )
        if self._faults.none < FAULTY:
            notes.append(
                f"the images fit the map better {self._faults.likeliest}: "
                "check how the camera is mounted and whether its driver changes the picture"
            )
        return tuple(notes)

    def learn(self, estimate: FloatArray) -> None:
        """Compares the motion between two estimates with odometry; without any, keeps it."""
        space, before, motion = self._space, self._last_estimate, self._increment
        self._estimate = estimate
        if before is None:
            return
        poses = space.poses(np.stack([before, estimate]))
        moved = space.increment(poses[0], poses[1])
        if motion is None:
            self._velocity = moved
            return
        error = space.difference(moved, motion)
        left = error - self._calibration.correction @ motion
        sigmas = sigmas_of(space, *self._settings.motion.standard_deviations(space, motion))
        expected = sigmas**2 + sigmas_of(space, ESTIMATE_POSITION, ESTIMATE_ANGLE) ** 2
        surprise = float(np.mean(left**2 / expected))
        self._calibration = self._calibration.learned(motion, error, surprise)

    def _prediction(self, motion: FloatArray | None, before: Presence) -> Prediction:
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
        if motion is None and self._velocity is not None:
            centres = space.composed(centres, self._velocity)
            p = space.positions
            metres, radians = map(np.linalg.norm, (self._velocity[:p], self._velocity[p:]))
            position_sigma = max(position_sigma, SPEED_CHANGE * float(metres))
            angle_sigma = max(angle_sigma, SPEED_CHANGE * float(radians))
        undecided = self._modes[0].share < UNDECIDED_MODE_SHARE
        anywhere = UNDECIDED_SHARE if undecided else 0.0
        if before.inside < PRESENT:
            anywhere = max(anywhere, MOST_CARRIED * (1.0 - before.inside))
        if motion is None:
            anywhere = max(anywhere, UNKNOWN_MOTION_SHARE)
        return Prediction(
            space,
            centres,
            log_weights,
            scale * position_sigma,
            scale * angle_sigma,
            self._region,
            anywhere,
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

    def _weighted(self, prediction: Prediction, observations: Observations) -> _Weighted:
        """Draws particles from prior and proposal and weights them with the image."""
        proposal = self._proposal(prediction, observations)
        count = self._count(prediction)
        proposed = round(PROPOSED_SHARE * count) if proposal is not None else 0
        settings = self._settings
        states = prediction.sample(count - proposed, settings.resampling, self._rng)
        correction = np.zeros(count)
        hypotheses = np.empty((0, self._space.dimension))
        if proposal is not None:
            hypotheses = proposal.means
            states = np.concatenate([states, proposal.sample(proposed, self._rng)])
            share = proposed / count
            log_prior = prediction.log_density(states)
            log_drawn = np.logaddexp(
                math.log1p(-share) + log_prior, math.log(share) + proposal.log_density(states)
            )
            correction = log_prior - log_drawn
        observation = observations.by_width[settings.fine_width]
        log_likelihoods = self._model.log_likelihoods(states, observation)
        places = places_of(self._space, hypotheses)
        labels = labelled(self._space, states, hypotheses, places)
        place_priors = log_priors(self._space, prediction.log_density(hypotheses), places)
        if self._is_walking:
            # Without odometry nothing but the image says how the body got here: it decides alone.
            labels, place_priors = np.zeros_like(labels), np.zeros(1)
        prior = correction - math.log(count)
        image = weighed(prior, log_likelihoods, labels, place_priors)
        log_weights, has_weight = normalise_log_weights(image.log_weights)
        if not has_weight:
            # The image speaks against all alike: what was believed before it stands.
            log_weights, _ = normalise_log_weights(correction)
        belief = Belief(states, log_weights)
        explained = 1.0
        if self._is_walking:
            heaviest = belief.states[int(np.argmax(belief.log_weights))]
            explained = self._model.explained(heaviest, observation)
        if self._model.is_absolute:
            return _Weighted(belief, image.marginal, image.largest, explained)
        marginal = self._model.marginal_evidence(belief, prior, observation)
        return _Weighted(belief, marginal, marginal, explained)

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
        return self._belief is None or prediction.anywhere_share > usual

    def _proposal(self, prediction: Prediction, observations: Observations) -> Proposal | None:
        """Normal distributions around hypotheses that were aligned with the image."""
        settings, model = self._settings, self._model
        hypotheses = self._hypotheses(prediction, observations)
        widths = [settings.coarse_width, settings.fine_width]
        if self._belief is not None and prediction.anywhere_share == 0.0:
            widths = widths[1:]
        aligned = [model.aligned(state, observations, widths) for state in hypotheses]
        found = [refined for refined in aligned if math.isfinite(refined.error)]
        if not found:
            return None
        means = np.stack([refined.state for refined in found])
        observation = observations.by_width[settings.fine_width]
        log_shares = model.log_likelihoods(means, observation)
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
        smallest = sigmas_of(space, SMALLEST_POSITION, SMALLEST_ANGLE)
        largest = sigmas_of(space, LARGEST_POSITION, LARGEST_ANGLE)
        sharpness = 2.0 * self._model.likelihood.proposal_inverse_temperature / 255.0**2
        precision = sharpness * curvature + np.diag(largest**-2.0)
        return np.asarray(WIDENING**2 * np.linalg.inv(precision) + np.diag(smallest**2))

    def _hypotheses(self, prediction: Prediction, observations: Observations) -> FloatArray:
        """States ``(K, D)`` worth aligning."""
        found = self._given
        if prediction.anywhere_share < 1.0:
            moved = Belief(prediction.centres, prediction.log_weights)
            modes = find_modes(moved, minimum_share=FOLLOWED_SHARE)[:FOLLOWED]
            found = np.concatenate([found, np.stack([mode.state for mode in modes])])
        is_start = self._belief is None
        if (is_start or prediction.anywhere_share > 0.0) and self._settings.proposal != "pnp":
            count = SEARCHED if self._searches(prediction) else UNKNOWN_MOTION_SEARCHED
            found = np.concatenate([found, self._lookalikes(prediction, observations, count)])
        return found

    def _lookalikes(
        self, prediction: Prediction, observations: Observations, count: int
    ) -> FloatArray:
        """States ``(K, D)`` from which the scene looks like the image, ``count`` a gallery."""
        search, is_search = self._search, self._searches(prediction)
        is_near = self._belief is None and prediction.anywhere_share == 0.0
        galleries = [] if is_near else [search.everywhere(observations)]
        if is_near or (is_search and self._is_walking):
            # The map's own places are too far apart to be sure to have one where it may have gone.
            galleries.append(search.around(prediction, observations))
        effort = THOROUGH if is_search else GLANCE
        found = []
        for gallery in galleries:
            states, evidence = search.found(gallery, observations, effort)
            found.append(search.distinct(gallery, states, evidence, count))
        if is_search and self._settings.start is None and not self._faults_are_known:
            self._faults_are_known = self._is_walking
            self._faults = self._faults.updated(
                lambda image: search.most_evidence(galleries[0], image), observations
            )
        return np.concatenate(found)
