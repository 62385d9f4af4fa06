"""Search in a world of areas: first for the areas that may hold the body, then within these."""

from collections.abc import Iterable

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, IntArray
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import inverse
from pipelines.localize.area_window import AreaWindow
from pipelines.localize.belief import Region
from pipelines.localize.observation import Observations
from pipelines.localize.prediction import Prediction
from pipelines.localize.retrieval import RetrievalIndex, joined, spread_states, states_around_views
from pipelines.localize.search import THOROUGH, GlobalSearch, SearchEffort, ViewDatabase
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import sigmas_of

# Areas are searched that together hold this share of the probability, and so many of them.
SEARCHED_SHARE, LEAST_AREAS, MOST_AREAS = 0.99, 2, 6
# States around so many photos that show most of an image, so many around each; metres and radians.
ALIKE, COPIES = 20, 20
AROUND_POSITION, AROUND_ANGLE = 0.3, 0.2
# Views of a search are shared out to so many areas, whether or not so many are searched.
AREAS_A_SEARCH = 6
# An area is open while it holds this share of the predicted belief, or while the body is so near to
# a place from which it was photographed; metres.
HELD_SHARE, NEAR = 0.01, 1.0


class AreaSearch(GlobalSearch):
    """Searches a world for the states from which an image could have been taken.

    Args:
        window: of the areas that are open.
        region: where the body may be: anywhere in the world.
        settings: of the particle filter: widths of the images, number of views.
        camera: the robot's.
        mask: ``(height, width)``, True where its images are to be used; None: everywhere.
        rng: the only source of randomness.
    """

    def __init__(
        self,
        window: AreaWindow,
        region: Region,
        settings: LocalizerSettings,
        camera: Camera,
        mask: BoolArray | None,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(window.model, region, window.world.world_from_camera, settings, rng)
        self._window = window
        self._camera = camera
        self._used = None if mask is None else mask.astype(np.uint8)
        self._ranked: tuple[int, tuple[int, ...]] = (-1, ())
        self._alike: IntArray = np.empty(0, dtype=np.int64)
        self._held: tuple[int, ...] = ()
        self._views_of_area: dict[int, RetrievalIndex] = {}

    def prepare(self, prediction: Prediction) -> None:
        """Opens the areas where the body is predicted to be, and those that it may enter next.

        Args:
            prediction: the prior of the next image.
        """
        if prediction.anywhere_share == 1.0:
            self._held = ()
            return
        area_map = self._window.world.area_map
        places = prediction.centres[:, :2]
        shares = area_map.shares(places, np.exp(prediction.log_weights))
        held = [int(area) for area in np.argsort(-shares, kind="stable")]
        held = [area for area in held if shares[area] >= HELD_SHARE]
        heaviest = places[int(np.argmax(prediction.log_weights))]
        near = [area for area in area_map.near(heaviest, NEAR).tolist() if area not in held]
        self._held = tuple(held)
        self._open([*held, *near])

    def everywhere(self, observations: Observations) -> ViewDatabase:
        """Views all over the areas in which an image may have been taken; these are opened.

        Args:
            observations: an image of the size that is searched for.
        """
        likely = self._likely(observations)
        # Where the body was thought to be is looked at, whatever the image looks like.
        self._open([*likely[:1], *self._held, *likely[1:]])
        is_open = set(self._window.open_areas)
        indices = []
        for area in likely:
            if area not in is_open:
                continue
            if area not in self._views_of_area:
                self._views_of_area[area] = self._index(self._area_states(area), observations)
            indices.append(self._views_of_area[area])
        return ViewDatabase(joined(indices), 1.0)

    def retrieved(
        self, database: ViewDatabase, observations: Observations, effort: SearchEffort
    ) -> tuple[FloatArray, FloatArray]:
        """States ``(K, D)`` whose views look most like an image, and its evidence ``(K,)``.

        In a thorough search also states around the photos of the world that show most of what the
        image shows.

        Args:
            database: the views.
            observations: the image.
            effort: how many states.
        """
        states, evidence = super().retrieved(database, observations, effort)
        if effort is not THOROUGH or len(self._alike) == 0:
            return states, evidence
        space, model = self._model.space, self._model
        poses = self._views[self._alike] @ inverse(model.body_from_camera)
        around = np.repeat(space.states(poses), COPIES, axis=0)
        sigma = sigmas_of(space, AROUND_POSITION, AROUND_ANGLE)
        around = space.moved(around, sigma * self._rng.standard_normal(around.shape))
        fine = observations.by_width[self._settings.fine_width]
        found = model.evidence(around, fine, model.likelihood.pixel_subsampling)
        return np.concatenate([states, around]), np.concatenate([evidence, found])

    def _open(self, areas: Iterable[int]) -> None:
        self._window.need(areas)
        is_open = set(self._window.open_areas)
        for area in set(self._views_of_area) - is_open:
            del self._views_of_area[area]

    def _likely(self, observations: Observations) -> tuple[int, ...]:
        """Numbers of the areas in which an image may have been taken, the likeliest first."""
        number = observations.by_width[self._settings.coarse_width].number
        # Several priors are tried on one image, which says the same of areas each time.
        if number != self._ranked[0] and observations.recorded is not None:
            recognised = self._window.world.recognition.recognise(
                observations.recorded, self._camera, self._used
            )
            count = len(recognised.likely_areas(SEARCHED_SHARE))
            ranked = np.argsort(-recognised.areas, kind="stable")
            likely = ranked[: min(max(count, LEAST_AREAS), MOST_AREAS)]
            self._ranked = (number, tuple(likely.tolist()))
            self._alike = recognised.photos[:ALIKE]
        return self._ranked[1]

    def _area_states(self, area: int) -> FloatArray:
        """States all over an area at which views are rendered."""
        space, window = self._model.space, self._window
        count = max(1, self._settings.search_particles // AREAS_A_SEARCH)
        outline = window.world.outlines[area]
        own: IntArray = window.world.index.areas[area].views
        if space.angles == 1:
            ground = self._region.ground
            if outline.ground is not None:
                ground = outline.ground
            low, high = outline.bounds[[0, 2]], outline.bounds[[1, 3]]
            return spread_states(space, Region(low, high, ground), count)
        mount = self._model.body_from_camera
        return states_around_views(space, self._views[own], mount, count, self._rng)
