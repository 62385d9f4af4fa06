"""The camera of a robot that is served: from a file, from a request, or that of the map."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.artifacts.errors import InputError
from pipelines.dataset.camera_file import CameraFile, camera_file_of, read_camera_file
from pipelines.dataset.mask import read_mask
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import mount_of
from pipelines.lightfield.open_world import OpenWorld
from pipelines.lightfield.scene import Scene
from pipelines.localize.state_space import StateSpace

# How errors name what a request says of a camera.
REQUEST = Path("camera")
_MOUNT_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")


@dataclass(frozen=True)
class RobotCamera:
    """A camera on a body.

    Attributes:
        camera: of the robot.
        body_from_camera: ``(4, 4)`` its mount, metres.
        mask: ``(height, width)``, True where its images are to be used; None: everywhere.
    """

    camera: Camera
    body_from_camera: FloatArray
    mask: BoolArray | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types, as ``camera_of_request`` takes them: metres and degrees."""
        position, angles = mount_of(self.body_from_camera)
        values = (*position.tolist(), *angles.tolist())
        return {**self.camera.to_dict(), "mount": dict(zip(_MOUNT_KEYS, values, strict=True))}


def camera_of_file(path: Path, mask: Path | None, space: StateSpace) -> RobotCamera:
    """The camera that a ``camera.toml`` describes.

    Args:
        path: the file.
        mask: picture of what its images show of the robot; None: nothing.
        space: what a state is; with six degrees of freedom the camera may be the body.

    Raises:
        InputError: a file that cannot be used, or a mount that is missing.
    """
    robot = _mounted(read_camera_file(path), path, space)
    if mask is None:
        return robot
    size = (robot.camera.width, robot.camera.height)
    return RobotCamera(
        robot.camera, robot.body_from_camera, read_mask(mask, size, f"{path} says").used
    )


def camera_of_request(table: Mapping[str, Any], space: StateSpace) -> RobotCamera:
    """The camera that a client describes, with the keys of a ``camera.toml``.

    Args:
        table: plain JSON types.
        space: what a state is.

    Raises:
        InputError: a key missing, unknown or of the wrong type, or numbers that no camera has.
    """
    return _mounted(camera_file_of(table, REQUEST), REQUEST, space)


def camera_of_map(scene: Scene | OpenWorld, space: StateSpace) -> RobotCamera | None:
    """The camera that recorded the map; None where there were several, or its mount is unknown.

    Args:
        scene: the map.
        space: what a state is.
    """
    parts = scene.outlines if isinstance(scene, OpenWorld) else (scene,)
    cameras = {camera for part in parts for camera in part.cameras}
    mount = scene.base_from_camera
    if mount is None and space.angles == 3:
        mount = np.eye(4)
    if len(cameras) != 1 or mount is None:
        return None
    return RobotCamera(cameras.pop(), mount)


def _mounted(content: CameraFile, path: Path, space: StateSpace) -> RobotCamera:
    mount = content.base_from_camera
    if mount is None and space.angles == 1:
        raise InputError(path, "has no mount: of a robot on a floor it has to be known")
    return RobotCamera(content.camera, np.eye(4) if mount is None else mount)
