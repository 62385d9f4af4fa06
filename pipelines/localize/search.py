"""Looking for states, all over the map or around a start, from where it looks like the image.

Small views tell in milliseconds where an image could have been taken (``retrieval``). The best of
these places, and states around them, are compared with the image once more, in larger images.
"""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.belief import Region
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import Observations
from pipelines.localize.prediction import Prediction
from pipelines.localize.retrieval import (
    RetrievalIndex,
    best_distinct,
    build_index,
    spread_states,
    states_around_views,
)
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import sigmas_of

# States around a place that looks like the image: standard deviations in metres and radians.
AROUND_POSITION, AROUND_ANGLE = 0.2, 0.08
# A start pose that is so uncertain, metres or radians, is searched around as a whole map is.
START_POSITION, START_ANGLE = 0.6, 0.5
# Around a start pose so many states are looked at.
START_STATES = 3_000
# Places less likely than this quantile of them are not around it.
START_QUANTILE = 0.01


@dataclass(frozen=True)
class Effort:
    """How thoroughly an image is looked up.

    Attributes:
        retrieved: so many of the places that look like it are looked at once more.
        copies: so many states around each of them as well.
    """

    retrieved: int
    copies: int


THOROUGH = Effort(300, 8)
# At a picture the other way round, or where the motion is unknown.
GLANCE = Effort(100, 3)


@dataclass(frozen=True)
class Gallery:
    """Where an image is looked up.

    Attributes:
        index: small views.
        scale: how near to each other hypotheses are looked for, as a share of the usual.
    """

    index: RetrievalIndex
    scale: float


class Search:
    """Looks images up in a map.

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
        self._views = world_from_camera
        self._settings = settings
        self._rng = rng
        self._everywhere: Gallery | None = None

    def everywhere(self, observations: Observations) -> Gallery:
        """Small views all over the region; made when they are first needed."""
        if self._everywhere is None:
            self._everywhere = Gallery(self._index(self._places(), observations), 1.0)
        return self._everywhere

    def around(self, start: Prediction, observations: Observations) -> Gallery:
        """Small views around a start pose: drawn from it, and those of the map that it allows."""
        drawn = start.sample(START_STATES, self._settings.resampling, self._rng)
        places = self._places()
        log_densities = start.log_density(np.concatenate([drawn, places]))
        least = np.quantile(log_densities[:START_STATES], START_QUANTILE)
        states = np.concatenate([places[log_densities[START_STATES:] >= least], drawn])
        uncertainty = max(start.position_sigma / START_POSITION, start.angle_sigma / START_ANGLE)
        return Gallery(self._index(states, observations), min(1.0, uncertainty))

    def found(
        self, gallery: Gallery, observations: Observations, effort: Effort
    ) -> tuple[FloatArray, FloatArray]:
        """States ``(K, D)`` that look most like an image, others around them, their evidence."""
        space = self._model.space
        coarse = observations.by_width[self._settings.coarse_width]
        fine = observations.by_width[self._settings.fine_width]
        scores = gallery.index.scores(coarse.in_channels(self._model.channels))
        best = np.argsort(-scores, kind="stable")
        found = gallery.index.states[best[: effort.retrieved]]
        position, angle = gallery.scale * AROUND_POSITION, gallery.scale * AROUND_ANGLE
        sigma = sigmas_of(space, position, angle)
        around = np.repeat(found, effort.copies, axis=0)
        around = space.moved(around, sigma * self._rng.standard_normal(around.shape))
        states = np.concatenate([found, around])
        return states, self._model.evidence(states, fine, self._model.likelihood.pixel_subsampling)

    def most_evidence(self, gallery: Gallery, observations: Observations) -> float:
        """The most that an image says for any state, by a glance."""
        return float(np.max(self.found(gallery, observations, GLANCE)[1]))

    def distinct(
        self, gallery: Gallery, states: FloatArray, evidence: FloatArray, count: int
    ) -> FloatArray:
        """The best of the states ``(K, D)`` that were found, no two of one place, best first."""
        space = self._model.space
        return states[best_distinct(space, states, evidence, count, gallery.scale)]

    def _index(self, states: FloatArray, observations: Observations) -> RetrievalIndex:
        model = self._model
        intrinsics = observations.by_width[self._settings.coarse_width].intrinsics
        return build_index(model.renderer, model.space, model.body_from_camera, intrinsics, states)

    def _places(self) -> FloatArray:
        """States ``(N, D)`` at which small views are rendered."""
        space, count = self._model.space, self._settings.search_particles
        if space.angles == 1:
            return spread_states(space, self._region, count)
        mount = self._model.body_from_camera
        return states_around_views(space, self._views, mount, count, self._rng)
