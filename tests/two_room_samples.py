"""The room with a partition, photographed on both sides of it, and a robot in it."""

import functools
import math
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.dataset.images import encode_png
from pipelines.dock.robot import Movement
from pipelines.dock.robots.noise import MotionNoise, SimulatedMotion
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import base_from_camera_mount, world_from_base_planar
from pipelines.lightfield.ground_carving import free_ground
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import identifier_of
from tests.lightfield_samples import looking
from tests.room_samples import (
    CAMERA,
    CAMERA_HEIGHT,
    DOOR_HIGH,
    DOOR_LOW,
    PARTITION_X,
    exact_depth,
    seen,
)

MOUNT = base_from_camera_mount((0.0, 0.0, CAMERA_HEIGHT), (0.0, 0.0, 0.0))
ROBOT_CAMERA = Camera(
    "PINHOLE", CAMERA.width, CAMERA.height, (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)
)
DOOR = (PARTITION_X, 0.5 * (DOOR_LOW + DOOR_HIGH))
DIRECTIONS = 8


@functools.cache
def two_rooms() -> Scene:
    """Photos in all directions in both parts and in the doorway, with exact depth."""
    places = [(x, y) for x in (0.7, 1.3, 1.9, 2.5) for y in (0.7, 1.4, 2.1)]
    places += [(x, DOOR[1]) for x in (3.0, 3.35, 3.85, 4.2)]
    places += [(x, y) for x in (4.6, 5.2) for y in (0.7, 1.4, 2.1)]
    poses = []
    for x, y in places:
        for angle in np.arange(DIRECTIONS) * 2.0 * np.pi / DIRECTIONS + 0.1 * x:
            place = np.array([x, y, CAMERA_HEIGHT])
            poses.append(looking(place, place + np.array([np.cos(angle), np.sin(angle), -0.05])))
    stacked = np.array(poses)
    images = tuple(encode_png(seen(pose)[0]) for pose in stacked)
    index, depth = np.zeros(len(poses), dtype=np.int64), exact_depth(stacked)
    ground = free_ground(stacked, [CAMERA] * len(poses), depth)
    cameras = (ROBOT_CAMERA,)
    return Scene(
        image_names=tuple(f"{number:04d}.png" for number in range(len(poses))),
        encoded_images=images,
        timestamps=np.arange(len(poses), dtype=np.float64),
        cameras=cameras,
        camera_index=index,
        world_from_camera=stacked,
        surface=None,
        base_from_camera=MOUNT,
        bounds=ground.bounds,
        scale_source="true poses",
        identifier=identifier_of(images, cameras, index, stacked, None, MOUNT, depth),
        depth=depth,
        ground=ground,
    )


class RoomRobot:
    """Its images are computed ray by ray, so that its world is not our own renderer's."""

    def __init__(self, start: FloatArray) -> None:
        self.camera = ROBOT_CAMERA
        self.base_from_camera = MOUNT
        self.motion = SimulatedMotion(start, MotionNoise(), np.random.default_rng(5))
        self.rng = np.random.default_rng(11)
        self.states = [self.motion.state]

    def take_image(self) -> ImageArray:
        """What the camera sees, with a little noise."""
        image = seen(world_from_base_planar(self.motion.state) @ MOUNT)[0]
        noisy = image + self.rng.normal(0.0, 1.0, image.shape)
        return np.rint(np.clip(noisy, 0.0, 255.0)).astype(np.uint8)

    def move(self, forward: float, left: float, turn: float) -> Any:
        """See ``Robot.move``."""
        measured = self.motion.move(Movement(forward, left, turn))
        self.states.append(self.motion.state)
        return measured.forward, measured.left, measured.turn

    def stop(self) -> None:
        """See ``Robot.stop``."""

    def true_state(self) -> FloatArray:
        """See ``KnowsTruth``."""
        return self.motion.state


def distance_from_walls(place: FloatArray) -> float:
    """Metres from a place ``(2,)`` to the nearest wall of the room or part of its partition."""
    x, y = float(place[0]), float(place[1])
    outer = min(x, 6.0 - x, y, 3.0 - y)
    if DOOR_LOW < y < DOOR_HIGH:
        aside = min(y - DOOR_LOW, DOOR_HIGH - y)
        return min(outer, math.hypot(x - PARTITION_X, aside))
    return min(outer, abs(x - PARTITION_X))
