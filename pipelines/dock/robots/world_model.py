"""``model:WORLD``: a simulated robot whose camera images are rendered from the areas of a world."""

from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.robots.model import RenderedRobot, renderer_of_model
from pipelines.dock.robots.noise import SensorNoise, SimulatedMotion
from pipelines.geometry.camera import Camera
from pipelines.lightfield.scene_file import load_scene
from pipelines.lightfield.world_file import World, area_path
from pipelines.render.renderer import Renderer

# Areas farther away than this are not looked into, metres; so many are held open.
NEAR, OPEN = 2.0, 4


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
        self._renderers: OrderedDict[str, Renderer] = OrderedDict()

    def _renderers_here(self) -> Iterator[Renderer]:
        # An area is opened only where those before it leave something uncovered.
        return map(self._renderer, self._areas_around(self._motion.state[:2]))

    def _areas_around(self, place: FloatArray) -> list[str]:
        """Names of the areas at a place ``(2,)`` and next to it, the one around it first."""
        x_min, x_max, y_min, y_max = self._rectangles.T
        beyond = np.maximum(
            np.maximum(x_min - place[0], place[0] - x_max),
            np.maximum(y_min - place[1], place[1] - y_max),
        )
        order = np.argsort(beyond, kind="stable")[:OPEN]
        near = [int(index) for index in order if beyond[index] <= NEAR]
        return [self._areas[index].name for index in near or [int(order[0])]]

    def _renderer(self, name: str) -> Renderer:
        """The renderer of an area; that of the one that was longest not needed is dropped."""
        if name not in self._renderers:
            scene = load_scene(area_path(self._path, name))
            self._renderers[name] = renderer_of_model(scene, self.camera)
        self._renderers.move_to_end(name)
        while len(self._renderers) > OPEN:
            self._renderers.popitem(last=False)
        return self._renderers[name]
