"""The areas of a world that are open, as the measurement model sees them."""

from collections.abc import Iterable

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import StageError
from pipelines.lightfield.open_world import OpenWorld
from pipelines.localize.measurement_model import (
    VIEW_RESOLUTION_FACTOR,
    MeasurementModel,
    channels_of,
)
from pipelines.localize.settings import LocalizerSettings
from pipelines.render.area_renderers import AreaRenderers
from pipelines.render.choices import Quality
from pipelines.render.surface import quality_named


class AreaWindow:
    """Keeps a measurement model at the areas that are open.

    Args:
        world: whose areas they are.
        body_from_camera: ``(4, 4)`` the camera's mount on the robot, metres.
        settings: of the filter.
        reserved: megabytes of the world's budget that are needed for other things.

    Attributes:
        model: compares states with images, by the views of the open areas.

    Raises:
        OptionError: memory that is too small for one of the areas, or a surface that is not the
            same in all of them.
        InputError: an area's file is damaged.
    """

    def __init__(
        self,
        world: OpenWorld,
        body_from_camera: FloatArray,
        settings: LocalizerSettings,
        reserved: float = 0.0,
    ) -> None:
        self._areas = AreaRenderers(
            world,
            VIEW_RESOLUTION_FACTOR * settings.fine_width,
            channels_of(settings.likelihood),
            settings.blending,
            quality_named(settings.quality, world.has_depth, Quality.MEDIUM),
            settings.threads,
            reserved,
        )
        sizes = np.array([len(area.views) for area in world.index.areas])
        # A world that fits is there from the first image on, as a scene is; of a larger one nobody
        # knows yet where to begin.
        if self._areas.fits_as_a_whole:
            self._areas.open_all()
        else:
            self._areas.need([int(np.argmax(sizes))])
        if self._areas.colours is None:
            raise StageError("no area is open")
        self.model = MeasurementModel(
            self._areas.colours,
            self._areas.renderers,
            settings.state_space,
            body_from_camera,
            settings.likelihood,
        )
        # Learnt from the largest area, once and for all: areas differ in what they show, and not in
        # how well their photos agree.
        for width in settings.widths:
            if width >= settings.fine_width:
                self.model.pixels(width)
        # What finds the area of a place is made now, not while a robot waits for an estimate.
        world.area_map.areas_of(world.world_from_camera[:1, :2, 3])

    @property
    def world(self) -> OpenWorld:
        """The world."""
        return self._areas.world

    @property
    def open_areas(self) -> tuple[int, ...]:
        """Numbers of the open areas, rising."""
        return self._areas.open_areas

    def need(self, areas: Iterable[int], soon: Iterable[int] = ()) -> None:
        """Opens areas, and closes others where memory is short.

        Args:
            areas: their numbers, the most important first.
            soon: areas that may be needed next, which are read beside other work.
        """
        if self._areas.need(areas, soon) and self._areas.colours is not None:
            self.model.show(self._areas.colours, self._areas.renderers)
