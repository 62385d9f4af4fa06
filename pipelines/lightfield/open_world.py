"""A world that is localized in: its areas' files are read view by view, when they are needed."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from pipelines.artifacts.arguments import PathLike, checked_number, checked_path
from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, OptionError
from pipelines.artifacts.kinds import is_world
from pipelines.geometry.camera import Camera
from pipelines.geometry.plane import Plane
from pipelines.lightfield.area_map import AreaMap
from pipelines.lightfield.area_recognition import AreaRecognition
from pipelines.lightfield.free_ground import FreeGround
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_part, load_scene
from pipelines.lightfield.world_file import World, area_path, load_recognition, load_world

# Side of the cells of the whole floor's free ground, metres.
GROUND_CELL = 0.1
# What localization may take of memory beside the program itself, unless it is told.
DEFAULT_MEGABYTES, MOST_MEGABYTES = 1000.0, 1e9
# Views that are read and decoded together.
TOGETHER = 8


@dataclass(frozen=True)
class OpenWorld:
    """A world, of whose areas only what does not grow with their photos is in memory.

    Attributes:
        path: the folder.
        index: areas, photos, and where these were taken.
        outlines: of each area its scene with one view, for cameras, surface and ground.
        ground: where on the floor a robot can be, in any area.
        recognition: finds the areas in which an image may have been taken.
        memory: megabytes that open areas and all that belongs to localizing in them may take.
    """

    path: Path
    index: World
    outlines: tuple[Scene, ...]
    ground: FreeGround
    recognition: AreaRecognition
    memory: float = DEFAULT_MEGABYTES

    @property
    def identifier(self) -> str:
        """Names this build of the world."""
        return self.index.identifier

    @cached_property
    def area_map(self) -> AreaMap:
        """Which place belongs to which area."""
        at_home = self.index.home >= 0
        return AreaMap(
            tuple(area.name for area in self.index.areas),
            self.index.world_from_camera[at_home, :2, 3],
            self.index.home[at_home],
        )

    @property
    def bounds(self) -> FloatArray:
        """``(4,)`` x_min, x_max, y_min, y_max in metres: where a robot can be."""
        return self.ground.bounds

    @property
    def world_from_camera(self) -> FloatArray:
        """``(N, 4, 4)`` where all photos were taken from, metres."""
        return self.index.world_from_camera

    @property
    def base_from_camera(self) -> FloatArray | None:
        """``(4, 4)`` mount of the recording robot; None where the map was not made by a robot."""
        return self.outlines[0].base_from_camera

    @property
    def has_depth(self) -> bool:
        """Whether the views have depth maps."""
        return all(outline.depth for outline in self.outlines)

    @property
    def plane(self) -> Plane | None:
        """The plane that is the surface of all areas; None where they have none in common."""
        planes = [outline.plane_if_any for outline in self.outlines]
        first = planes[0]
        if first is None or any(
            plane is None or not np.array_equal(plane.coefficients(), first.coefficients())
            for plane in planes
        ):
            return None
        return first

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras that took the photos, area by area."""
        return tuple(camera for outline in self.outlines for camera in outline.cameras)

    @property
    def largest_camera(self) -> tuple[int, int]:
        """Width and height of the cameras' largest photos, pixels."""
        return max(c.width for c in self.cameras), max(c.height for c in self.cameras)

    def scenes(self, area: int, photos: Sequence[int]) -> Iterator[tuple[tuple[int, ...], Scene]]:
        """Reads photos from an area's file, a few at a time.

        Args:
            area: its number.
            photos: their numbers in the world; the area holds them.

        Yields:
            The numbers of some of them, and a scene of these.

        Raises:
            InputError: the file is damaged, or cannot be read any more.
        """
        rows = np.searchsorted(self.index.areas[area].views, np.asarray(photos, dtype=np.int64))
        path = area_path(self.path, self.index.areas[area].name)
        for start in range(0, len(photos), TOGETHER):
            part = slice(start, start + TOGETHER)
            yield tuple(photos[part]), load_part(path, rows[part].tolist())

    def light_field(self, photos: Sequence[int]) -> Scene:
        """One scene of some photos, each as in the area in which it is at home.

        Args:
            photos: their numbers in the world; at least one, all of them at home somewhere.

        Returns:
            The photos, by area and number. Bounds and ground are those of one of the areas.

        Raises:
            InputError: a file is damaged, or cannot be read any more.
        """
        parts: list[Scene] = []
        for area in range(len(self.index.areas)):
            own = sorted(photo for photo in photos if self.index.home[photo] == area)
            parts += [scene for _, scene in self.scenes(area, own)]
        first_camera = np.cumsum([0, *(len(part.cameras) for part in parts)])
        shifted = [part.camera_index + first_camera[n] for n, part in enumerate(parts)]
        return replace(
            parts[0],
            image_names=tuple(name for part in parts for name in part.image_names),
            encoded_images=tuple(image for part in parts for image in part.encoded_images),
            timestamps=np.concatenate([part.timestamps for part in parts]),
            cameras=tuple(camera for part in parts for camera in part.cameras),
            camera_index=np.concatenate(shifted),
            world_from_camera=np.concatenate([part.world_from_camera for part in parts]),
            depth=tuple(depth for part in parts for depth in part.depth),
        )


def open_world(path: PathLike, memory: float = DEFAULT_MEGABYTES) -> OpenWorld:
    """Opens a world to localize in it.

    Args:
        path: the folder, made by ``lfnav model --areas``.
        memory: megabytes that open areas and all that belongs to localizing in them may take,
            beyond the program itself.

    Raises:
        InputError: missing, half built, damaged, of a newer schema, or with an area whose file is
            missing or of another build.
        StageError: in compact storage, and Pillow was built without WebP.
        OptionError: ``path`` is no path, or ``memory`` no positive number.
    """
    path = checked_path(path, "the world's path")
    checked_number(memory, "--memory", 1.0, MOST_MEGABYTES)
    index = load_world(path)
    outlines = []
    for area in index.areas:
        file = area_path(path, area.name)
        outline = load_part(file, [0])
        if outline.image_names[0] != index.image_names[area.views[0]]:
            raise InputError(file, "holds other photos than the world's index says")
        outlines.append(outline)
    recognition = load_recognition(path, index)
    ground = _united_ground(outlines)
    return OpenWorld(path, index, tuple(outlines), ground, recognition, float(memory))


def scene_or_world(path: Path, memory: float | None) -> Scene | OpenWorld:
    """Opens a scene model or a world of several.

    Args:
        path: the file of the one, or the folder of the other.
        memory: megabytes for a world, as ``open_world`` takes them; None: the default.

    Raises:
        InputError, StageError: it cannot be used.
        OptionError: a bound on memory for a scene, or one that is no positive number.
    """
    if is_world(path):
        return open_world(path, DEFAULT_MEGABYTES if memory is None else memory)
    if memory is not None:
        raise OptionError("--memory bounds what a world opens of its areas; a scene is one piece")
    return load_scene(path)


def _united_ground(outlines: Sequence[Scene]) -> FreeGround:
    """Cells that are free in one of the areas, at least."""
    bounds = np.stack([outline.bounds for outline in outlines])
    corner = bounds[:, [0, 2]].min(axis=0)
    size = np.ceil((bounds[:, [1, 3]].max(axis=0) - corner) / GROUND_CELL).astype(np.int64)
    cells = np.zeros((int(size[1]), int(size[0])), dtype=np.bool_)
    for outline in outlines:
        low_x, high_x, low_y, high_y = outline.bounds
        first = np.floor((np.array([low_x, low_y]) - corner) / GROUND_CELL).astype(np.int64)
        end = np.ceil((np.array([high_x, high_y]) - corner) / GROUND_CELL).astype(np.int64)
        columns, rows = (np.arange(first[axis], end[axis]) for axis in (0, 1))
        x, y = (
            corner[axis] + GROUND_CELL * (numbers + 0.5)
            for axis, numbers in enumerate((columns, rows))
        )
        inside = np.ones((len(rows), len(columns)), dtype=np.bool_)
        if outline.ground is not None:
            places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
            inside = outline.ground.contains(places).reshape(inside.shape)
        part = np.s_[int(first[1]) : int(end[1]), int(first[0]) : int(end[0])]
        cells[part] |= inside[: cells[part].shape[0], : cells[part].shape[1]]
    return FreeGround(corner, GROUND_CELL, cells)
