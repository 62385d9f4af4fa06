"""Clearance: the distance from a place on the floor to the scene's surface.

In a scene with depth maps the surface is the obstacle points that they show between the floor and
the top of the robot. In a scene with a plane alone it is that plane, if the plane is a wall.
"""

import numpy as np
import scipy

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.camera import Undistorter
from pipelines.geometry.plane import Plane
from pipelines.lightfield.obstacle_points import obstacle_points
from pipelines.lightfield.scene import Scene

# A plane whose normal rises less than this is a wall.
LARGEST_TILT = 0.3
# The robot's top is this far above its camera, metres; it passes below anything higher.
TOP_ABOVE_CAMERA = 0.2
# A place farther from a view than the view's depth by more than this is behind the surface, metres.
HIDDEN_BY = 0.1


class Clearance:
    """Distances from the surface of a scene.

    Args:
        scene: the light field.
        camera_height: height of the robot's camera above the floor, metres.
        obstacles: ``(M, 2)`` obstacle points, metres, where the scene is a part of what the robot
            drives in; None: those that the scene shows.
    """

    def __init__(
        self, scene: Scene, camera_height: float, obstacles: FloatArray | None = None
    ) -> None:
        self._plane = scene.plane_if_any
        self._scene = scene
        self._height = camera_height
        top = camera_height + TOP_ABOVE_CAMERA
        points = obstacle_points(scene, top) if obstacles is None else obstacles
        self._obstacles = None if points is None else scipy.spatial.cKDTree(points)

    def distance(self, state: FloatArray) -> float:
        """Metres from a state ``(3,)`` to the surface; negative behind a plane."""
        if self._obstacles is not None:
            return float(self._obstacles.query(state[:2])[0])
        if self._plane is None or abs(float(self._plane.normal[2])) >= LARGEST_TILT:
            return float("inf")
        return _wall_distance(self._plane, state, self._height)

    def distances(self, places: FloatArray) -> FloatArray:
        """Metres from places ``(M, 2)`` to the surface: ``(M,)``, as ``distance`` says."""
        if self._obstacles is not None:
            return np.asarray(self._obstacles.query(places)[0])
        states = np.pad(places, ((0, 0), (0, 1)))
        return np.array([self.distance(state) for state in states])

    def is_inside(self, state: FloatArray) -> bool:
        """Whether the robot's camera at a state ``(3,)`` would be inside the surface."""
        if self._obstacles is None:
            return self.distance(state) <= 0.0
        place = np.array([state[0], state[1], self._height, 1.0])
        seen, hidden = 0, 0
        for index, depth in enumerate(self._scene.depth):
            pinhole = Undistorter(self._scene.camera_of(index)).intrinsics
            x, y, z, _ = np.linalg.inv(self._scene.world_from_camera[index]) @ place
            height, width = depth.inverse_depth.shape
            small = pinhole.resized(width, height)
            if z <= 0.0:
                continue
            column, row = round(small.fx * x / z + small.cx), round(small.fy * y / z + small.cy)
            if 0 <= column < width and 0 <= row < height:
                inverse = float(depth.inverse_depth[row, column])
                seen += inverse > 0.0
                hidden += inverse > 0.0 and z > 1.0 / inverse + HIDDEN_BY
        return seen > 0 and hidden == seen


def _wall_distance(plane: Plane, state: FloatArray, camera_height: float) -> float:
    """Metres from a state ``(3,)`` to a wall; to its nearest point where the wall leans."""
    places = np.array([[state[0], state[1], z] for z in (0.0, camera_height)])
    return float(plane.signed_distance(places).min())
