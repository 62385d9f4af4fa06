"""Global search: states from which the map looks like an image, all over it or around a prior.

Image retrieval over small rendered views tells in milliseconds where an image could have been taken
(``retrieval``). The best of these states, and others around them, are then weighed by the image's
evidence, in larger images.
"""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.belief import Region
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import Observation, Observations
from pipelines.localize.prediction import Prediction
from pipelines.localize.retrieval import (
    RetrievalIndex,
    best_distinct,
    build_index,
    spread_around,
    spread_states,
    states_around_views,
)
from pipelines.localize.settings import LocalizerSettings

# States around a retrieved one: standard deviations in metres and radians.
AROUND_POSITION, AROUND_ANGLE = 0.2, 0.08
# A prior that is so uncertain, metres or radians, is searched as coarsely as a whole map is.
PRIOR_POSITION, PRIOR_ANGLE = 0.6, 0.5
# Views rendered at so many states drawn from a prior.
PRIOR_STATES = 3_000
# States of the map that are less likely than this quantile of those are not searched.
PRIOR_QUANTILE = 0.01


@dataclass(frozen=True)
class SearchEffort:
    """How thoroughly an image is searched for.

    Attributes:
        retrieved: states that image retrieval ranks first, whose evidence is evaluated.
        copies: states around each of them, whose evidence is evaluated too.
    """

    retrieved: int
    copies: int


THOROUGH = SearchEffort(300, 8)
# For a mirrored or inverted image, or where only the motion is unknown.
QUICK = SearchEffort(100, 3)


@dataclass(frozen=True)
class ViewDatabase:
    """States among which an image is searched for.

    Attributes:
        states: ``(N, D)``; without an index the likeliest first.
        scale: distances between hypotheses, as a share of those in a search of the whole map.
        index: the views rendered at the states; None where these are so few that nothing need be
            rendered to choose among them.
    """

    states: FloatArray
    scale: float
    index: RetrievalIndex | None

    def most_alike(self, image: Observation, count: int) -> FloatArray:
        """States ``(count or fewer, D)`` whose views look most like an image, best first."""
        if self.index is None:
            return self.states[:count]
        best = np.argsort(-self.index.scores(image), kind="stable")
        return self.states[best[:count]]


def of_views(index: RetrievalIndex, scale: float) -> ViewDatabase:
    """The database of rendered views."""
    return ViewDatabase(index.states, scale, index)


class GlobalSearch:
    """Searches a map for the states from which an image could have been taken.

    Args:
        model: compares states with images.
        region: where the body may be.
        world_from_camera: ``(N, 4, 4)`` of the recorded views; hypotheses with six degrees of
            freedom are taken from around them.
        settings: of the particle filter: widths of the images, number of views.
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
        self._everywhere: ViewDatabase | None = None

    def prepare(self, prediction: Prediction) -> None:
        """Says where the body may be when the next image is weighed; a scene is there already.

        Args:
            prediction: the prior of that image.
        """

    def everywhere(self, observations: Observations) -> ViewDatabase:
        """Views all over the region; rendered when they are first needed.

        Args:
            observations: an image of the size that is searched for.
        """
        if self._everywhere is None:
            self._everywhere = of_views(self._index(self._map_states(), observations), 1.0)
        return self._everywhere

    def around(self, prior: Prediction, observations: Observations) -> ViewDatabase:
        """Views at states drawn from a prior, and at those of the whole map that it allows.

        Args:
            prior: where the body may be.
            observations: an image of the size that is searched for.
        """
        drawn = prior.sample(PRIOR_STATES, self._settings.resampling, self._rng)
        everywhere = self._map_states()
        log_densities = prior.log_density(np.concatenate([drawn, everywhere]))
        least = np.quantile(log_densities[:PRIOR_STATES], PRIOR_QUANTILE)
        states = np.concatenate([everywhere[log_densities[PRIOR_STATES:] >= least], drawn])
        uncertainty = max(prior.position_sigma / PRIOR_POSITION, prior.angle_sigma / PRIOR_ANGLE)
        return of_views(self._index(states, observations), min(1.0, uncertainty))

    def retrieved(
        self, database: ViewDatabase, observations: Observations, effort: SearchEffort
    ) -> tuple[FloatArray, FloatArray]:
        """States ``(K, D)`` whose views look most like an image, others around them, and evidence.

        Args:
            database: the views.
            observations: the image.
            effort: how many states.

        Returns:
            The states and the image's evidence ``(K,)`` for each.
        """
        space = self._model.space
        coarse = observations.by_width[self._settings.coarse_width]
        fine = observations.by_width[self._settings.fine_width]
        found = database.most_alike(coarse.in_channels(self._model.channels), effort.retrieved)
        position, angle = database.scale * AROUND_POSITION, database.scale * AROUND_ANGLE
        around = spread_around(space, found, effort.copies, self._rng, position, angle)
        states = np.concatenate([found, around])
        return states, self._model.evidence(states, fine, self._model.likelihood.pixel_subsampling)

    def largest_evidence(self, database: ViewDatabase, observations: Observations) -> float:
        """The largest evidence of an image for any state, by a quick search."""
        return float(np.max(self.retrieved(database, observations, QUICK)[1]))

    def distinct(
        self, database: ViewDatabase, states: FloatArray, evidence: FloatArray, count: int
    ) -> FloatArray:
        """The best of the states ``(K, D)`` that were retrieved, not near a better one, best first.

        Args:
            database: where they were found.
            states: ``(N, D)``.
            evidence: ``(N,)`` of the image for them.
            count: at most so many.
        """
        space = self._model.space
        return states[best_distinct(space, states, evidence, count, database.scale)]

    def _index(self, states: FloatArray, observations: Observations) -> RetrievalIndex:
        model = self._model
        intrinsics = observations.by_width[self._settings.coarse_width].intrinsics
        return build_index(model.renderer, model.space, model.body_from_camera, intrinsics, states)

    def _map_states(self) -> FloatArray:
        """States ``(N, D)`` all over the region at which views are rendered."""
        space, count = self._model.space, self._settings.search_particles
        if space.angles == 1:
            return spread_states(space, self._region, count)
        mount = self._model.body_from_camera
        return states_around_views(space, self._views, mount, count, self._rng)
