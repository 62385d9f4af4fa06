"""Mixture-proposal MCL: the image says where to search, the weights say what to believe.

One frame: the motion predicts where the body may be (``prediction``). Particles are drawn from that
prior and from a proposal that looks at the image (``proposal``): normal distributions around
hypotheses aligned with it. They are weighted by likelihood times prior over the density that they
were drawn from, which leaves the posterior as it is in the paper, wherever particles were put.
Between places as wholes one image decides only so much (``places``), and beside all of them stands
the hypothesis that the image does not show the map (``outside_hypothesis``).

An image that says much less than images usually do raises the question whether the body is
somewhere else: it is then searched for everywhere, within the same frame.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.belief import Belief, Region, equal_log_weights, normalise_log_weights
from pipelines.localize.estimate import Mode, find_modes
from pipelines.localize.kld_sampling import next_count
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import Observations
from pipelines.localize.outside_hypothesis import MovingAverage, OutsideHypothesis
from pipelines.localize.places import log_priors, place_labels, places_of, weighted_by_place
from pipelines.localize.prediction import (
    UNKNOWN_MOTION_SHARE,
    WIDENINGS,
    MotionPredictor,
    Prediction,
)
from pipelines.localize.proposal import ProposalBuilder
from pipelines.localize.resampling import resample
from pipelines.localize.search import GlobalSearch
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.strategies import FITTING_EVIDENCE, Posterior

# Share of the particles that are drawn from the proposal.
PROPOSED_SHARE = 0.6
# A search keeps so many times as many particles as tracking, where that is not more than enough.
SEARCH_FACTOR, ENOUGH_PARTICLES = 8, 4_000
# The density of the prior takes time with each particle in it; so many stand for any number.
LARGEST_PRIOR = 2_000
# Probability that the body was carried away between two images: the least where an image says too
# little, and the most.
CARRIED, MOST_CARRIED = 1e-3, 0.5
# Below this probability that the image shows the map, the whole map is searched.
PRESENT = 0.8
# Below this probability that the camera's picture has no fault, a user is told.
FAULTY = 0.003
# While the heaviest peak has less than this share of the weight, the body is where no peak is with
# this probability.
UNDECIDED_MODE_SHARE, UNDECIDED_SHARE = 0.95, 0.05
# An image with less than this share of the usual evidence says too little.
DOUBTFUL_SHARE = 0.5
# Where the motion is unknown: an image that is explained less than the first share of how well
# images usually are does not fit yet; less than the second, and it proves no place, however much
# better it fits there than elsewhere.
FITTING_SHARE, PROVING_SHARE = 0.7, 0.5


@dataclass(frozen=True)
class _Weighted:
    """What an image makes of a prior.

    Attributes:
        belief: the posterior.
        evidence: of the image for the map.
        largest: of the image for the place that it fits best.
        explained: how much of the image the heaviest particle explains; known where the motion is
            unknown, else 1.
    """

    belief: Belief
    evidence: float
    largest: float
    explained: float = 1.0


class MixtureProposalMcl:
    """The strategy ``mixture``: carries a belief on with proposals that look at the image.

    Args:
        model: compares states with images.
        region: where the body may be.
        search: looks images up in the map.
        settings: of the particle filter.
        rng: the only source of randomness.
    """

    def __init__(
        self,
        model: MeasurementModel,
        region: Region,
        search: GlobalSearch,
        settings: LocalizerSettings,
        rng: np.random.Generator,
    ) -> None:
        self._model = model
        self._settings = settings
        self._rng = rng
        self._predictor = MotionPredictor(model.space, region, settings)
        self._search = search
        self._proposals = ProposalBuilder(model, search, settings)
        self._belief: Belief | None = None
        self._resampled: Belief | None = None
        self._prediction = self._predictor.start()
        self._modes: tuple[Mode, ...] = ()
        self._outside = OutsideHypothesis()
        self._start_was_contradicted = False
        self._usual_evidence, self._usual_fit = MovingAverage(), MovingAverage()

    def resample(self) -> None:
        """Draws the particles that stand for the belief in the prior, where it has very many."""
        belief = self._belief
        if belief is not None and len(belief) > LARGEST_PRIOR:
            scheme = self._settings.resampling
            chosen = resample(belief.log_weights, LARGEST_PRIOR, scheme, self._rng)
            belief = Belief(belief.states[chosen], equal_log_weights(LARGEST_PRIOR))
        self._resampled = belief

    def predict(self, increment: FloatArray | None) -> None:
        """Makes the prior of the next image.

        Args:
            increment: ``(D,)`` measured in the body's frame; None: nobody knows. Not used for the
                first image.
        """
        if self._resampled is None:
            return
        self._outside = self._outside.predicted()
        anywhere = self._anywhere_share(is_walk=increment is None)
        self._prediction = self._predictor.predicted(self._resampled, increment, anywhere)

    def weight(self, observations: Observations, hypotheses: FloatArray | None = None) -> Posterior:
        """Draws particles from the prior and the proposal, and weights them with the image.

        Args:
            observations: the image.
            hypotheses: ``(K, D)`` states that are aligned like those that are found here, or None.
        """
        prediction = self._prediction
        self._search.prepare(prediction)
        self._proposals.begin_image(hypotheses)
        if not observations.is_informative:
            self._belief = self._unseen(prediction)
            return self._posterior(self._belief)
        weighted = self._weighted(prediction, observations)
        elsewhere = self._elsewhere_share(weighted.evidence, observations)
        if prediction.is_walk:
            weighted = self._weighted_by_wider_priors(weighted, observations)
        elif elsewhere > prediction.anywhere_share:
            # The image does not fit where the body was thought to be: search everywhere at once.
            is_start_pose = prediction.is_start and self._settings.start is not None
            self._start_was_contradicted = self._start_was_contradicted or is_start_pose
            wide = replace(prediction, anywhere_share=elsewhere)
            weighted = self._weighted(wide, observations)
        self._outside = self._outside.updated(weighted.evidence)
        is_inconclusive = prediction.is_walk and self._usual_fit.is_undercut(
            weighted.explained, PROVING_SHARE
        )
        if self._outside.inside >= PRESENT:
            self._usual_evidence = self._usual_evidence.updated(weighted.evidence)
            if prediction.is_walk:
                self._usual_fit = self._usual_fit.updated(weighted.explained)
        self._belief = weighted.belief
        return self._posterior(self._belief, weighted.largest, is_inconclusive)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of the images so far, a line each."""
        notes = []
        if self._start_was_contradicted:
            notes.append(
                "the first image does not show what the map shows around the start pose: "
                "the start pose was given up and the whole map searched"
            )
        faults = self._proposals.faults
        if faults.none < FAULTY:
            notes.append(
                f"the images fit the map better {faults.likeliest}: "
                "check how the camera is mounted and whether its driver changes the picture"
            )
        return tuple(notes)

    def learn(self, estimate: FloatArray) -> None:
        """Learns from the best estimate ``(D,)`` of a frame how odometry errs, or the speed."""
        self._predictor.learn(estimate)

    def _posterior(
        self, belief: Belief, largest: float = -math.inf, is_inconclusive: bool = False
    ) -> Posterior:
        """What is known now, and by which motion it was carried on."""
        self._modes = find_modes(belief)
        prediction = self._prediction
        return Posterior(
            belief,
            self._modes,
            self._outside.inside * self._proposals.faults.none,
            prediction.motion,
            prediction.position_sigma,
            prediction.angle_sigma,
            largest >= FITTING_EVIDENCE,
            is_inconclusive,
        )

    def _anywhere_share(self, *, is_walk: bool) -> float:
        """Probability, before the image, that the body is not where the motion leads."""
        undecided = self._modes[0].share < UNDECIDED_MODE_SHARE
        share = UNDECIDED_SHARE if undecided else 0.0
        if self._outside.inside < PRESENT:
            share = max(share, MOST_CARRIED * (1.0 - self._outside.inside))
        return max(share, UNKNOWN_MOTION_SHARE) if is_walk else share

    def _elsewhere_share(self, evidence: float, observations: Observations) -> float:
        """Probability, after the image, that the body is not where the motion leads.

        0 while the image says as much as images usually do.

        Args:
            evidence: of the image for the map, where the body was thought to be.
            observations: the image.
        """
        if observations.is_newly_masked:
            # What was concluded from a view that was partly hidden may be wrong.
            return MOST_CARRIED
        usual = self._usual_evidence.mean
        if evidence >= (FITTING_EVIDENCE if usual is None else DOUBTFUL_SHARE * usual):
            return 0.0
        return max(CARRIED, MOST_CARRIED * (1.0 - self._outside.updated(evidence).inside))

    def _weighted_by_wider_priors(
        self, weighted: _Weighted, observations: Observations
    ) -> _Weighted:
        """What the likeliest of several motions makes of an image, where nobody knows the motion.

        The prior is widened until the image says as much, and is explained as well, as images
        usually are.

        Args:
            weighted: what the image made of the narrowest prior.
            observations: the image.
        """
        prior = self._prediction
        # Where the body is lost the whole map was searched already.
        for _ in range(0 if prior.is_search else WIDENINGS):
            share = self._elsewhere_share(weighted.evidence, observations)
            fits = not self._usual_fit.is_undercut(weighted.explained, FITTING_SHARE)
            if share == 0.0 and fits:
                break
            prior = prior.widened(share)
            then = self._weighted(prior, observations)
            weighted = then if then.evidence > weighted.evidence else weighted
        return weighted

    def _unseen(self, prediction: Prediction) -> Belief:
        """The belief after an image that shows nothing: the prior."""
        count = self._settings.particles if self._belief is None else len(self._belief)
        states = prediction.sample(count, self._settings.resampling, self._rng)
        return Belief(states, equal_log_weights(count))

    def _weighted(self, prediction: Prediction, observations: Observations) -> _Weighted:
        """Draws particles from prior and proposal and weights them with the image."""
        settings, model = self._settings, self._model
        proposal = self._proposals.build(prediction, observations)
        count = self._count(prediction)
        proposed = round(PROPOSED_SHARE * count) if proposal is not None else 0
        states = prediction.sample(count - proposed, settings.resampling, self._rng)
        correction = np.zeros(count)
        hypotheses = np.empty((0, model.space.dimension))
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
        log_likelihoods = model.log_likelihoods(states, observation)
        places = places_of(model.space, hypotheses)
        labels = place_labels(model.space, states, hypotheses, places)
        place_priors = log_priors(model.space, prediction.log_density(hypotheses), places)
        if prediction.is_walk:
            # Without odometry nothing but the image says how the body got here: it decides alone.
            labels, place_priors = np.zeros_like(labels), np.zeros(1)
        prior = correction - math.log(count)
        by_place = weighted_by_place(prior, log_likelihoods, labels, place_priors)
        log_weights, has_weight = normalise_log_weights(by_place.log_weights)
        if not has_weight:
            # The image speaks against all alike: what was believed before it stands.
            log_weights, _ = normalise_log_weights(correction)
        belief = Belief(states, log_weights)
        explained = 1.0
        if prediction.is_walk:
            heaviest = belief.states[int(np.argmax(belief.log_weights))]
            explained = model.explained(heaviest, observation)
        if model.is_absolute:
            return _Weighted(belief, by_place.marginal, by_place.largest, explained)
        marginal = model.marginal_evidence(belief, prior, observation)
        return _Weighted(belief, marginal, marginal, explained)

    def _count(self, prediction: Prediction) -> int:
        """How many particles stand for the posterior."""
        settings = self._settings
        largest = max(settings.particles, min(SEARCH_FACTOR * settings.particles, ENOUGH_PARTICLES))
        if self._belief is None or prediction.is_search:
            return largest
        return min(largest, next_count(self._belief, settings.particles, 0.0))
