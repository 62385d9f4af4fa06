"""``model:WORLD``: a simulated robot whose camera images are rendered from the areas of a world."""

from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.robots.model import RenderedRobot, quality_of_model, side_of_model
from pipelines.dock.robots.noise import SensorNoise, SimulatedMotion
from pipelines.geometry.camera import Camera
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_part
from pipelines.lightfield.size_budget import view_bytes
from pipelines.lightfield.view_arena import ViewArena
from pipelines.lightfield.views import views_of_scene
from pipelines.lightfield.world_file import World, WorldArea, area_path
from pipelines.render.renderer import Renderer

# Areas farther away than this are not looked into, metres; nor are more than so many.
NEAR, MOST_AREAS = 2.0, 4
# As many areas are held as take no more than this, megabytes, and those that one image needs.
HELD = 300.0
# Views that are read and decoded together.
TOGETHER = 8


class WorldModelRobot(RenderedRobot):
    """A robot in a world of several areas.

    It sees what the area shows in which it is, and of what is left uncovered, what the areas next
    to it show, the nearest first. What none covers is grey, as a bare wall would be.

    Args:
        path: the world's folder.
        world: its index.
        camera: without distortion.
        base_from_camera: ``(4, 4)`` the camera's mount.
        motion: the robot's true pose, and its errors of movements and odometry.
        sensor: errors of its images.
        rng: the random numbers of its images.
    """

    def __init__(
        self,
        path: Path,
        world: World,
        camera: Camera,
        base_from_camera: FloatArray,
        motion: SimulatedMotion,
        sensor: SensorNoise,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(camera, base_from_camera, motion, sensor, rng)
        self._path, self._areas = path, world.areas
        self._rectangles = np.array([area.rectangle for area in world.areas])
        self._held = _HeldAreas(path, side_of_model(camera))

    def _renderers_here(self) -> Iterator[Renderer]:
        self._held.begin_image()
        # An area is opened only where those before it leave something uncovered.
        return map(self._held.renderer, self._areas_around(self._motion.state[:2]))

    def _areas_around(self, place: FloatArray) -> list[WorldArea]:
        """The areas at a place ``(2,)`` and next to it, the one around it first."""
        x_min, x_max, y_min, y_max = self._rectangles.T
        beyond = np.maximum(
            np.maximum(x_min - place[0], place[0] - x_max),
            np.maximum(y_min - place[1], place[1] - y_max),
        )
        order = np.argsort(beyond, kind="stable")[:MOST_AREAS]
        near = [int(index) for index in order if beyond[index] <= NEAR]
        return [self._areas[index] for index in near or [int(order[0])]]


class _HeldAreas:
    """Renderers of the areas that were used last.

    One area shows most images as a whole, and then as many are held as take ``HELD`` megabytes.
    Where one does not, all that an image needs are held for the next, which needs them too.

    Args:
        path: the world's folder.
        side: photos are area-averaged to so many pixels at most.
    """

    def __init__(self, path: Path, side: int) -> None:
        self._path, self._side = path, side
        self._renderers: OrderedDict[str, tuple[Renderer, float]] = OrderedDict()
        self._used: set[str] = set()
        self._used_before: set[str] = set()

    def begin_image(self) -> None:
        """What is used from now on is used by another image."""
        self._used_before = self._used if len(self._used) > 1 else set()
        self._used = set()

    def renderer(self, area: WorldArea) -> Renderer:
        """The renderer of an area's views.

        Raises:
            InputError: the area's file is damaged, or cannot be read any more.
        """
        if area.name not in self._renderers:
            self._renderers[area.name] = self._read(area)
        self._renderers.move_to_end(area.name)
        self._used.add(area.name)
        return self._renderers[area.name][0]

    def _make_room(self, size: float) -> None:
        """Lets go of the areas that were not used for longest, until so many megabytes fit."""
        kept = self._used | self._used_before
        for name in [name for name in self._renderers if name not in kept]:
            if size + sum(held for _, held in self._renderers.values()) > HELD:
                del self._renderers[name]

    def _read(self, area: WorldArea) -> tuple[Renderer, float]:
        """A new renderer and the megabytes that it takes."""
        file, count = area_path(self._path, area.name), len(area.views)
        first = load_part(file, [0])
        side = min(self._side, _longest_side(first))
        size = view_bytes(first.camera_of(0), side, 1, bool(first.depth)) * count / 1e6
        self._make_room(size)
        arena = ViewArena(count, side, 1)
        for start in range(0, count, TOGETHER):
            numbers = range(start, min(start + TOGETHER, count))
            colours = views_of_scene(load_part(file, numbers), side)
            for number, view in enumerate(numbers):
                arena.put(view, [colours], number)
        views = arena.views(range(count), 0)
        return Renderer(views, first.plane_if_any, quality=quality_of_model(first)), size


def _longest_side(scene: Scene) -> int:
    """Pixels of the longer side of a scene's photos and depth maps."""
    sides = [side for camera in scene.cameras for side in (camera.width, camera.height)]
    sides += [side for depth in scene.depth for side in depth.inverse_depth.shape]
    return max(sides)
