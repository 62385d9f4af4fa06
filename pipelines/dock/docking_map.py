"""The map that a robot docks in: what docking takes of a scene, or of a world of areas.

In a world the robot is followed by the areas that are open; its road map, obstacles and free ground
are those of all areas, and the goal is seen by the photos around it, which are one small scene.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.dock.clearance import TOP_ABOVE_CAMERA, Clearance
from pipelines.dock.exploration import RendersViews
from pipelines.dock.fine_alignment import PHOTO_SIDE
from pipelines.dock.road_map import RoadMap, road_map_of_scene, road_map_of_world
from pipelines.geometry.camera import Intrinsics
from pipelines.lightfield.area_map import AreaMap
from pipelines.lightfield.free_ground import FreeGround
from pipelines.lightfield.obstacle_points import obstacle_points_of_world
from pipelines.lightfield.open_world import OpenWorld
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.size_budget import view_bytes
from pipelines.localize.area_window import AreaWindow
from pipelines.localize.localizer import check_world_settings
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.settings import LocalizerSettings
from pipelines.render.area_renderers import NEAR

# A world shows a goal by so many photos at most, those that were taken nearest to it.
GOAL_VIEWS = 100
# The goal's photos are held twice while the goal is judged: in colours, and as they are aligned.
KINDS_OF_GOAL_VIEWS = 2


@dataclass(frozen=True)
class Followed:
    """What a robot is followed in.

    Attributes:
        where: what a ``Localizer`` takes.
        model: compares states with images; that of the localizer.
        views: renders small views of what is in memory of the map; None: as the goal is seen.
    """

    where: Scene | AreaWindow
    model: MeasurementModel
    views: RendersViews | None = None


class DockingMap(Protocol):
    """What docking takes of the map."""

    @property
    def bounds(self) -> FloatArray:
        """``(4,)`` x_min, x_max, y_min, y_max in metres: where a robot can be."""

    @property
    def ground(self) -> FreeGround | None:
        """The part of the bounds where a robot can be; None: all of it."""

    @property
    def areas(self) -> AreaMap | None:
        """Which place of a world belongs to which area; None: the map is one scene."""

    def road_map(self) -> RoadMap | None:
        """Places that can be driven; None: not known."""

    def around(self, places: FloatArray) -> Scene:
        """What the map shows around places ``(K, 2)`` or more columns, metres."""

    def clearance(self, around: Scene, camera_height: float) -> Clearance:
        """Distances from the surface.

        Args:
            around: what the map shows around the goal.
            camera_height: of the robot, metres above the floor.
        """

    def follow(
        self, around: Scene, body_from_camera: FloatArray, settings: LocalizerSettings
    ) -> Followed:
        """What a robot is followed in, open around the goal.

        Args:
            around: what the map shows around the goal.
            body_from_camera: ``(4, 4)`` the camera's mount, metres.
            settings: of the filter.

        Raises:
            OptionError: settings that the map does not take, or too little memory.
        """


def docking_map(scene: Scene | OpenWorld) -> DockingMap:
    """The map that a scene or a world is for docking."""
    return _WorldMap(scene) if isinstance(scene, OpenWorld) else _SceneMap(scene)


class _SceneMap:
    """One scene, all of which is in memory."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.bounds, self.ground = scene.bounds, scene.ground
        self.areas: AreaMap | None = None

    def road_map(self) -> RoadMap | None:
        return road_map_of_scene(self._scene)

    def around(self, places: FloatArray) -> Scene:
        return self._scene

    def clearance(self, around: Scene, camera_height: float) -> Clearance:
        return Clearance(around, camera_height)

    def follow(
        self, around: Scene, body_from_camera: FloatArray, settings: LocalizerSettings
    ) -> Followed:
        return Followed(around, MeasurementModel.of_scene(around, body_from_camera, settings))


class _WorldMap:
    """A world, of which what is needed is in memory."""

    def __init__(self, world: OpenWorld) -> None:
        self._world = world
        self.bounds: FloatArray = world.bounds
        self.ground: FreeGround | None = world.ground
        self.areas: AreaMap | None = world.area_map

    def road_map(self) -> RoadMap | None:
        return road_map_of_world(self._world.index) if self._world.has_depth else None

    def around(self, places: FloatArray) -> Scene:
        index, places = self._world.index, places[:, :2]
        own = self._world.area_map.areas_of(places).tolist()
        near = [self._world.area_map.near(place, NEAR) for place in places]
        is_near = np.isin(index.home, np.unique(np.concatenate([own, *near])))
        photos = np.flatnonzero(is_near & self._world.held)
        if len(photos) == 0:
            raise OptionError("the areas there hold none of their own photos; give another goal")
        apart = index.world_from_camera[photos, None, :2, 3] - places
        nearest = np.argsort(np.linalg.norm(apart, axis=2).min(axis=1), kind="stable")
        return self._world.light_field(sorted(photos[nearest[:GOAL_VIEWS]].tolist()))

    def clearance(self, around: Scene, camera_height: float) -> Clearance:
        points = obstacle_points_of_world(self._world, camera_height + TOP_ABOVE_CAMERA)
        return Clearance(around, camera_height, points)

    def follow(
        self, around: Scene, body_from_camera: FloatArray, settings: LocalizerSettings
    ) -> Followed:
        check_world_settings(settings, None)
        of_view = max(
            view_bytes(camera, PHOTO_SIDE, KINDS_OF_GOAL_VIEWS, self._world.has_depth)
            for camera in around.cameras
        )
        reserved = len(around) * of_view / 1e6
        window = AreaWindow(self._world, body_from_camera, settings, reserved)
        window.need(np.unique(self._world.area_map.areas_of(around.world_from_camera[:, :2, 3])))
        return Followed(window, window.model, _OpenAreas(window.model))


class _OpenAreas:
    """Small views of the areas that are open, in the channels in which the robot is followed."""

    def __init__(self, model: MeasurementModel) -> None:
        self._model = model

    def render_many(
        self, world_from_camera: FloatArray, intrinsics: Intrinsics
    ) -> tuple[Float32Array, BoolArray]:
        return self._model.renderer.render_many(world_from_camera, intrinsics)
