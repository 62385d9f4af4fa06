"""How a posterior becomes a status: tracking, global, lost, blind or stale.

The body is tracked while it is in one place of the map with a high probability, all alternatives
counted (other places, outside of the map), and that place is narrow. It is lost while the image
more probably does not show the map at all, and searched for globally in between. An image that
shows nothing is blind, one that the camera has delivered before although the body moved is stale;
both are judged first, whatever else is known.

A place may have aliases all over the map that fit one image tolerably. So a body that has not been
found yet is tracked only after the place is confirmed: by several images in a row, or by one image
of which a large share is explained.
"""

import math

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.area_proof import UNPROVEN_PROBABILITY, AreaProof
from pipelines.localize.estimate import Mode
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import Observations
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import StateSpace, magnitudes, state_space_of_dimension
from pipelines.localize.strategies import Posterior

# Least probability of the main place, and its largest standard deviations (metres, radians).
TRACKING_PROBABILITY = 0.9
TRACKING_POSITION, TRACKING_HEADING = 0.35, math.radians(10.0)
# A place is confirmed by so many images in a row, or by one image of which this share is explained
# (``MeasurementModel.explained``); a smaller share is enough where a start pose is given.
CONFIRMING_IMAGES, CONFIRMING_SHARE, STARTING_SHARE = 2, 0.4, 0.25
# Below this probability that the image shows the map the body is lost.
LOST_PROBABILITY = 0.5


class StatusMonitor:
    """Judges the posterior of one image after the other.

    Args:
        model: aligns states with images and says how well images are explained.
        settings: of the particle filter: widths of the images, and whether a start pose is given.
        proof: what has to be given besides, in a world of areas; None: a scene.
    """

    def __init__(
        self,
        model: MeasurementModel,
        settings: LocalizerSettings,
        proof: AreaProof | None = None,
    ) -> None:
        self._model = model
        self._settings = settings
        self._proof = proof
        self._was_tracked = False
        self._images_in_favour = 0

    def judge(self, posterior: Posterior, observations: Observations) -> str:
        """The status after one image: one of ``run.STATUSES``.

        Args:
            posterior: the belief after the image.
            observations: the image.
        """
        if observations.is_blind:
            return "blind"
        if observations.is_stale:
            return "stale"
        main = posterior.modes[0]
        is_one_place = posterior.place_probability >= TRACKING_PROBABILITY and _is_narrow(main)
        is_proven = self._proof is None or self._proof.update(
            main if is_one_place else None, observations
        )
        if not is_one_place:
            self._images_in_favour = 0
        elif is_proven and not posterior.is_inconclusive and self._is_confirmed(main, observations):
            self._was_tracked = True
            return "tracking"
        is_search = (posterior.fits_a_place or is_one_place) and not self._was_tracked
        return "global" if posterior.inside >= LOST_PROBABILITY or is_search else "lost"

    def probability(self, posterior: Posterior) -> float:
        """Probability that the body is in the main place, after ``judge``.

        Args:
            posterior: the belief after the image.
        """
        if self._proof is None or self._proof.is_given:
            return posterior.place_probability
        return min(posterior.place_probability, UNPROVEN_PROBABILITY)

    def _is_confirmed(self, main: Mode, observations: Observations) -> bool:
        """Whether enough images, or one that leaves little unexplained, speak for the main mode."""
        if self._was_tracked:
            return True
        settings, model = self._settings, self._model
        state = model.aligned(
            main.state, observations, observations.widths_from(settings.fine_width)
        ).state
        if not is_same_place(model.space, state, main.state):
            state = main.state
        fine = observations.by_width[settings.fine_width]
        evidence = model.evidence_at(state, fine)
        # An image that shows nothing of a place does not speak for it.
        self._images_in_favour = self._images_in_favour + 1 if evidence > 0.0 else 0
        least = CONFIRMING_SHARE if settings.start is None else STARTING_SHARE
        is_explained = model.explained_by(evidence, fine) >= least
        return self._images_in_favour >= CONFIRMING_IMAGES or is_explained


def is_same_place(space: StateSpace, state: FloatArray, other: FloatArray) -> bool:
    """Whether two states ``(D,)`` are no farther apart than a tracked mode is wide."""
    metres, radians = magnitudes(space, space.difference(state, other))
    return bool(metres <= TRACKING_POSITION and radians <= TRACKING_HEADING)


def _is_narrow(mode: Mode) -> bool:
    """Whether a mode is narrow enough to be one place."""
    positions = state_space_of_dimension(len(mode.covariance)).positions
    variances = np.diag(mode.covariance)
    position = math.sqrt(float(variances[:positions].sum()))
    heading = math.sqrt(float(variances[positions:].sum()))
    return position <= TRACKING_POSITION and heading <= TRACKING_HEADING
