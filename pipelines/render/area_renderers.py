"""The areas of a world that are open, as one light field: what is rendered at the moment.

It is one light field of the views of all open areas, so that a border between two of them is none
for what is rendered there. A photo that several areas hold is taken once, from the area in which it
is at home where that one is open. Areas are opened when they are needed, and closed when their
places are: first the one that has not been needed for longest. Where there are places for all of
the world, all is read once, and areas that were not needed for some time are no longer open: photos
on the other side of a wall show nothing, but each has to be asked whether it does.
"""

import math
import weakref
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from threading import Event

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.lightfield.depth_storage import Depths
from pipelines.lightfield.open_world import OpenWorld
from pipelines.lightfield.size_budget import view_bytes
from pipelines.lightfield.view_arena import ViewArena
from pipelines.lightfield.views import Views, views_of_scene
from pipelines.lightfield.world_file import WorldArea
from pipelines.render.channels import views_in_channels
from pipelines.render.choices import Blending, Channels, Quality
from pipelines.render.renderer import Renderer

# What is needed beside the views, megabytes: samples of depth maps, small views that are searched
# among, and reading some views.
BESIDE_VIEWS = 188.0
# Areas with a photo so near to a place are rendered there; metres.
NEAR = 1.0
# Where all views have places, an area is open for so many requests after the last that needed it.
KEPT_OPEN = 10
# What areas that are open at once may take where pictures are made for people; megabytes.
AT_ONCE_MEGABYTES = 4000.0


@dataclass(frozen=True)
class RecordedViews(Views):
    """Views of which no colours are kept: these are read again from the areas' files.

    Attributes:
        world: where they are read from.
        keys: photo and area of each view.
    """

    world: OpenWorld
    keys: tuple[tuple[int, int], ...]

    def level(self, view: int, level: int) -> ImageArray:
        """``(height, width, 3)`` RGB of one pyramid level of one view."""
        photo, area = self.keys[view]
        side = int(self.arrays.level_size[view, 0].max())
        _, scene = next(self.world.scenes(area, [photo], Depths.NONE))
        return views_of_scene(scene, side).level(0, level)


class AreaRenderers:
    """Opens and closes areas within the world's budget of memory.

    Args:
        world: whose areas they are.
        side: photos are area-averaged to so many pixels at most.
        channels: in which photos are rendered.
        blending: the rule that chooses and weights the views.
        quality: how finely the surface follows the views' depth maps.
        threads: how many work at the same time; None: one a processor.
        reserved: megabytes of the world's budget that are needed for other things.

    Attributes:
        world: the areas.
        colours: the photos of the open areas.
        renderers: of these in each of the channels.

    Raises:
        OptionError: memory that is too small for one of the areas, or a surface that is not the
            same in all of them.
        InputError: an area's file is damaged.
    """

    def __init__(
        self,
        world: OpenWorld,
        side: int,
        channels: Sequence[Channels],
        blending: Blending,
        quality: Quality,
        threads: int | None,
        reserved: float = 0.0,
    ) -> None:
        if quality is Quality.PLANE and world.plane is None:
            raise OptionError(
                "the areas of the world have no plane in common; make it with --geometry depth, "
                "or with --plane for all of them"
            )
        self.world = world
        self._side, self._channels = side, tuple(channels)
        self._blending, self._quality, self._threads = blending, quality, threads
        self._places = _places_within_budget(world, side, len(self._channels), reserved)
        self._arena = ViewArena(self._places, side, len(self._channels))
        whole = self._taken_from(range(len(world.index.areas)))
        self._whole = whole if len(whole) <= self._places else None
        self._open: tuple[int, ...] = ()
        self._needed_at: dict[int, int] = {}
        self._requests = 0
        self._reader = ThreadPoolExecutor(1)
        self._reading: Future[None] | None = None
        self._stop = Event()
        # Who closes the program need not wait for what nobody needs any more.
        weakref.finalize(self, self._stop.set)
        self.colours: Views | None = None
        self.renderers: dict[Channels, Renderer] = {}

    @property
    def open_areas(self) -> tuple[int, ...]:
        """Numbers of the open areas, rising."""
        return self._open

    @property
    def fits_as_a_whole(self) -> bool:
        """Whether all areas may be open at once."""
        return self._whole is not None

    def open_all(self) -> None:
        """Opens all areas of a world that fits as a whole; none of them is needed by that."""
        self._arrange(tuple(range(len(self.world.index.areas))))

    def need(self, areas: Iterable[int], soon: Iterable[int] = ()) -> bool:
        """Opens areas, and closes others where memory is short.

        Args:
            areas: their numbers, the most important first; those that do not fit beside more
                important ones stay closed.
            soon: areas that may be needed next. They are read beside other work as far as there is
                room, so that opening them takes no time then; nothing shows them yet.

        Returns:
            Whether ``colours`` and ``renderers`` are other ones now.
        """
        self._requests += 1
        wanted: list[int] = []
        for area in areas:
            if area not in wanted and self._fit([*wanted, area]):
                wanted.append(area)
                self._needed_at[area] = self._requests
        ahead: list[int] = []
        for area in soon:
            if area not in wanted and self._fit([*wanted, *ahead, area]):
                ahead.append(area)
        wanted += self._left_open(wanted, ahead)
        ahead = [area for area in ahead if area not in wanted]
        is_other = set(wanted) != set(self._open)
        if is_other:
            self._arrange(tuple(sorted(wanted)))
        if ahead:
            self._read_ahead(ahead)
        return is_other

    def _left_open(self, wanted: Sequence[int], ahead: Sequence[int]) -> list[int]:
        """Areas that are open and stay so, beside those that are needed now or read ahead."""
        latest = {area: self._needed_at.get(area, -KEPT_OPEN) for area in self._open}
        others = sorted(latest.keys() - set(wanted), key=lambda area: (-latest[area], area))
        if self._whole is not None and wanted:
            return [area for area in others if self._requests - latest[area] < KEPT_OPEN]
        left: list[int] = []
        for area in others:
            if self._fit([*wanted, *ahead, *left, area]):
                left.append(area)
        return left

    def finish_reading(self) -> None:
        """Waits until what is read ahead is there."""
        if self._reading is not None:
            wait([self._reading])

    def at(self, place: FloatArray, channels: Channels) -> Renderer:
        """A renderer of what is seen from a place, whose areas are opened.

        Args:
            place: ``(2,)`` or more coordinates, of which the first two count, metres.
            channels: one of those that were asked for.
        """
        area_map = self.world.area_map
        own = area_map.areas_of(place[None, :2]).tolist()
        self.need([*own, *area_map.near(place[:2], NEAR).tolist()])
        return self.renderers[channels]

    def _fit(self, areas: Sequence[int]) -> bool:
        """Whether the views of these areas have places for all of them at once."""
        return self._whole is not None or len(self._sources(areas)) <= self._places

    def _sources(self, areas: Sequence[int]) -> dict[int, int]:
        """Photo -> the area from which it is taken while these areas are open."""
        whole = self._whole
        if whole is None:
            return self._taken_from(areas)
        # Not from another one than while all are open: then nothing is read twice.
        views = [self.world.index.areas[area].views.tolist() for area in areas]
        return {photo: whole[photo] for own in views for photo in own}

    def _taken_from(self, areas: Sequence[int]) -> dict[int, int]:
        """Photo -> the area in which it is at home, or else the last of these that hold it."""
        home = self.world.index.home
        sources: dict[int, int] = {}
        for area in sorted(areas):
            for photo in self.world.index.areas[area].views.tolist():
                if photo not in sources or home[photo] == area:
                    sources[photo] = area
        return sources

    def _arrange(self, areas: tuple[int, ...]) -> None:
        """Puts the views of these areas into the arena, and makes renderers of them."""
        self._stop_reading()
        keys = sorted(self._sources(areas).items())
        missing = [key for key in keys if key not in self._arena]
        # What is drawn with these must not see the places change.
        self.colours, self.renderers = None, {}
        was_shown = set(self._sources(self._open).items())
        unused = sorted(set(self._arena.keys) - set(keys), key=lambda key: key not in was_shown)
        for key in unused:
            # What was read ahead stays while nothing else needs its place.
            is_closed = key in was_shown and self._whole is None
            if is_closed or self._arena.free < len(missing):
                self._arena.drop(key)
        _read(self.world, missing, self._arena, self._side, self._channels)
        self._open = areas
        views = [self._arena.views(keys, number) for number in range(len(self._channels))]
        typical = self._arena.typical_inverse_depth(keys)
        self.colours = RecordedViews(views[0].arrays, views[0].intrinsics, self.world, tuple(keys))
        for channels, of_channels in zip(self._channels, views, strict=True):
            self.renderers[channels] = Renderer(
                of_channels,
                self.world.plane,
                self._blending,
                self._quality,
                self._threads,
                typical,
            )

    def _read_ahead(self, areas: Sequence[int]) -> None:
        """Reads views of these areas into places that are free, beside other work."""
        if self._reading is not None and not self._reading.done():
            return
        shown = self._sources(self._open)
        keys = self._sources([*self._open, *areas]).items()
        missing = [key for key in keys if key not in self._arena]
        # A photo that another area shows already is the last to need a place of its own.
        missing.sort(key=lambda key: (key[0] in shown, key[1], key[0]))
        missing = missing[: self._arena.free]
        if missing:
            self._stop.clear()
            self._reading = self._reader.submit(
                _read, self.world, missing, self._arena, self._side, self._channels, self._stop
            )

    def _stop_reading(self) -> None:
        """Waits until nothing is put into the arena; a file that is damaged is met again."""
        self._stop.set()
        self.finish_reading()
        self._reading = None


def _read(
    world: OpenWorld,
    keys: Sequence[tuple[int, int]],
    arena: ViewArena,
    side: int,
    channels: Sequence[Channels],
    stop: Event | None = None,
) -> None:
    """Puts views into free places of an arena.

    Args:
        world: whose views they are.
        keys: photo and area of each.
        arena: the places.
        side: photos are area-averaged to so many pixels at most.
        channels: in which photos are rendered.
        stop: set when this shall end; None: never.

    Raises:
        InputError: an area's file is damaged.
    """
    for area in dict.fromkeys(area for _, area in keys):
        own = [photo for photo, of in keys if of == area]
        for photos, scene in world.scenes(area, own, Depths.VALUES):
            colours = views_of_scene(scene, side)
            kinds = [views_in_channels(colours, channel) for channel in channels]
            for number, photo in enumerate(photos):
                arena.put((photo, area), kinds, number)
            if stop is not None and stop.is_set():
                return


def colour_renderers(
    world: OpenWorld, side: int | None, blending: Blending, quality: Quality
) -> Callable[[FloatArray], Renderer]:
    """What says which renderer shows, in colours, what is seen from a pose ``(4, 4)``.

    Args:
        world: the areas; they are opened as poses need them.
        side: photos are area-averaged to so many pixels at most; None: as recorded.
        blending: the rule that chooses and weights the views.
        quality: how finely the surface follows the views' depth maps.

    Raises:
        OptionError: an area too large to be opened, or a surface that is not the same in all.
    """
    side = max(world.largest_camera) if side is None else side
    area, least = _largest_area(world, side, 1, BESIDE_VIEWS)
    if least > AT_ONCE_MEGABYTES:
        # Who asks for pictures cannot give them more memory.
        raise OptionError(
            f"the {len(area.views)} views of area {area.name} take {least} MB at {side} pixels, "
            f"and pictures of a world at most {AT_ONCE_MEGABYTES:g}; make the world with a "
            "smaller --area-views"
        )
    world = replace(world, memory=AT_ONCE_MEGABYTES)
    areas = AreaRenderers(world, side, (Channels.COLOUR,), blending, quality, None)
    return lambda pose: areas.at(pose[:2, 3], Channels.COLOUR)


def _places_within_budget(world: OpenWorld, side: int, channels: int, reserved: float) -> int:
    """How many views fit into the world's budget, and not more than it has.

    Raises:
        OptionError: fewer than the largest area has.
    """
    beside = BESIDE_VIEWS + reserved
    places = int((world.memory - beside) / _megabytes_of_view(world, side, channels))
    largest, least = _largest_area(world, side, channels, beside)
    if places < len(largest.views):
        raise OptionError(
            f"--memory {world.memory:g} is too small for area {largest.name} and its "
            f"{len(largest.views)} views, which take {least} MB; "
            "give more, or make the world with a smaller --area-views"
        )
    return min(places, len(world.index.image_names))


def _largest_area(
    world: OpenWorld, side: int, channels: int, beside: float
) -> tuple[WorldArea, int]:
    """The area with the most views, and the megabytes that it takes, with those beside them."""
    largest = max(world.index.areas, key=lambda area: len(area.views))
    of_view = _megabytes_of_view(world, side, channels)
    return largest, math.ceil(beside + len(largest.views) * of_view)


def _megabytes_of_view(world: OpenWorld, side: int, channels: int) -> float:
    """What the largest of a world's views takes."""
    cameras = [camera for outline in world.outlines for camera in outline.cameras]
    return max(view_bytes(camera, side, channels, world.has_depth) for camera in cameras) / 1e6
