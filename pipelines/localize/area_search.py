"""Search in a world of areas: first for the areas that may hold the body, then within these."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, IntArray
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import inverse
from pipelines.localize.area_window import AreaWindow
from pipelines.localize.belief import Region
from pipelines.localize.observation import Observations
from pipelines.localize.prediction import Prediction
from pipelines.localize.retrieval import (
    RetrievalIndex,
    best_distinct,
    joined,
    spread_around,
    spread_states,
    states_around_views,
)
from pipelines.localize.search import THOROUGH, GlobalSearch, SearchEffort, ViewDatabase, of_views
from pipelines.localize.settings import LocalizerSettings

# Areas are searched that together hold this share of the probability, and so many of them.
SEARCHED_SHARE, LEAST_AREAS, MOST_AREAS = 0.99, 2, 6
# States around so many photos that show most of an image, at least so many of each area, and so
# many around each.
ALIKE, ALIKE_OF_AREA, COPIES = 20, 6, 20
# So many of an area's best are aligned, and so many kept. Where these explain this share of the
# image, views all over the areas are not needed.
ALIGNED_OF_AREA, KEPT_OF_AREA, WELL_EXPLAINED = 2, 30, 0.5
# Views of a search are shared out to so many areas, whether or not so many are searched.
AREAS_A_SEARCH = 6
# An area is open while it holds this share of the predicted belief, or while the body is so near to
# a place from which it was photographed; metres. Areas that are not much farther are read ahead.
HELD_SHARE, NEAR, SOON = 0.01, 1.0, 3.0


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
        # Number of an image, states around the photos that show most of it, and whether these do.
        none = np.empty((0, window.model.space.dimension))
        self._around: tuple[int, FloatArray, bool] = (-1, none, False)
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
        self._open([*held, *near], area_map.near(heaviest, SOON).tolist())

    def everywhere(self, observations: Observations) -> ViewDatabase:
        """Where an image may have been taken in the areas that are likely; these are opened.

        States around the photos that show most of the image, where one of them explains it well;
        else views all over these areas.

        Args:
            observations: an image of the size that is searched for.
        """
        likely = self._likely(observations)
        # Where the body was thought to be is looked at, whatever the image looks like.
        self._open([*likely[:1], *self._held, *likely[1:]])
        is_open = set(self._window.open_areas)
        number = observations.by_width[self._settings.coarse_width].number
        if number != self._around[0]:
            opened = [area for area in likely if area in is_open]
            self._around = (number, *self._around_photos(opened, observations))
        if self._around[2]:
            return ViewDatabase(self._around[1], 1.0, None)
        indices = []
        for area in likely:
            if area not in is_open:
                continue
            if area not in self._views_of_area:
                self._views_of_area[area] = self._index(self._area_states(area), observations)
            indices.append(self._views_of_area[area])
        return of_views(joined(indices), 1.0)

    def retrieved(
        self, database: ViewDatabase, observations: Observations, effort: SearchEffort
    ) -> tuple[FloatArray, FloatArray]:
        """States ``(K, D)`` whose views look most like an image, and its evidence ``(K,)``.

        In a thorough search of rendered views also states around the photos of the world that show
        most of what the image shows.

        Args:
            database: the states.
            observations: the image.
            effort: how many states.
        """
        states, evidence = super().retrieved(database, observations, effort)
        if database.index is None:
            # Around the photos most states are none from which the image was taken.
            kept = evidence >= min(0.0, float(evidence.max()))
            return states[kept], evidence[kept]
        around = self._around[1]
        if effort is not THOROUGH or len(around) == 0:
            return states, evidence
        model = self._model
        fine = observations.by_width[self._settings.fine_width]
        found = model.evidence(around, fine, model.likelihood.pixel_subsampling)
        return np.concatenate([states, around]), np.concatenate([evidence, found])

    def _around_photos(
        self, areas: Sequence[int], observations: Observations
    ) -> tuple[FloatArray, bool]:
        """States ``(K, D)`` around the photos that show most of an image; whether one explains it.

        An area's states are kept whatever those of others explain: where areas are alike, one image
        must not decide.

        Args:
            areas: open areas in which the image may have been taken.
            observations: the image.
        """
        space, model, settings = self._model.space, self._model, self._settings
        fine = observations.by_width[settings.fine_width]
        homes = self._window.world.index.home[self._alike]
        kept, explained = [np.empty((0, space.dimension))], 0.0
        for area in areas:
            own = np.flatnonzero(homes == area)
            photos = self._alike[own[(own < ALIKE) | (np.arange(len(own)) < ALIKE_OF_AREA)]]
            if len(photos) == 0:
                continue
            poses = self._views[photos] @ inverse(model.body_from_camera)
            around = spread_around(space, space.states(poses), COPIES, self._rng)
            evidence = model.evidence(around, fine, model.likelihood.pixel_subsampling)
            best = best_distinct(space, around, evidence, ALIGNED_OF_AREA)
            # An image that speaks against the best of so many states is rarely from near them.
            found = self._aligned(around[best[evidence[best] > 0.0]], observations)
            if len(found) > 0:
                largest = float(model.evidence(found, fine).max())
                explained = max(explained, model.explained_by(largest, fine))
            rest = np.argsort(-evidence, kind="stable")[: KEPT_OF_AREA - len(found)]
            kept.append(np.concatenate([found, around[rest]]))
        ranks = np.concatenate([np.arange(len(states)) for states in kept])
        states = np.concatenate(kept)[np.argsort(ranks, kind="stable")]
        return states, explained >= WELL_EXPLAINED

    def _aligned(self, states: FloatArray, observations: Observations) -> FloatArray:
        """Those of the states ``(K, D)`` that can be aligned with an image, aligned with it."""
        widths = [self._settings.coarse_width, self._settings.fine_width]
        aligned = [self._model.aligned(state, observations, widths) for state in states]
        found = [alignment.state for alignment in aligned if math.isfinite(alignment.error)]
        return np.stack(found) if found else states[:0]

    def _open(self, areas: Iterable[int], soon: Iterable[int] = ()) -> None:
        self._window.need(areas, soon)
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
            self._alike = recognised.photos
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
