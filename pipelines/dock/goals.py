"""The goal by other means than a pose: where a view was taken, or where an image was."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.artifacts.errors import InputError, OptionError
from pipelines.dataset.images import decode_image, read_image_bytes
from pipelines.dock.fine_alignment import FineAlignment
from pipelines.dock.pose_estimate import pose_estimate_of
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import inverse, planar_state_of
from pipelines.lightfield.scene import Scene
from pipelines.localize.localizer import Localizer
from pipelines.localize.settings import LocalizerSettings

# The filter sees the goal image this many times before the image counts as not found.
MOST_STEPS = 6


def goal_of_view(scene: Scene, index: int, base_from_camera: FloatArray) -> FloatArray:
    """The state ``(3,)`` at which the robot's camera stands where view ``index`` was taken.

    Args:
        scene: the light field.
        index: number of the view, from 0.
        base_from_camera: ``(4, 4)`` the robot camera's mount; it may be at another height than the
            camera of the view.

    Raises:
        OptionError: no such view.
    """
    if not 0 <= index < len(scene):
        raise OptionError(f"the scene has no view {index}; its views are 0 to {len(scene) - 1}")
    return planar_state_of(scene.world_from_camera[index] @ inverse(base_from_camera))


def goal_of_image(
    scene: Scene,
    path: Path,
    camera: Camera,
    base_from_camera: FloatArray,
    settings: LocalizerSettings,
    rng: np.random.Generator,
    mask: BoolArray | None = None,
) -> FloatArray:
    """The state ``(3,)`` from which the robot's camera sees an image.

    Args:
        scene: the light field.
        path: image file, taken with the robot's camera.
        camera: the robot's camera.
        base_from_camera: ``(4, 4)`` the camera's mount.
        settings: the filter's settings; the image is searched for in their area.
        rng: the filter's random numbers.
        mask: ``(height, width)``, True where images of the camera are to be used; None: everywhere.

    Raises:
        InputError: unreadable, of another size than the camera's, or not found in the scene.
    """
    image = decode_image(read_image_bytes(path), path)
    if image.shape[:2] != (camera.height, camera.width):
        raise InputError(
            path,
            f"is {image.shape[1]}x{image.shape[0]} pixels, the robot's camera "
            f"{camera.width}x{camera.height}",
            "take it with the robot's camera",
        )
    anywhere = replace(settings, start=None)
    localizer = Localizer(scene, camera, base_from_camera, anywhere, rng, mask=mask)
    alignment = FineAlignment(scene, camera, base_from_camera, settings, mask=mask)
    for number in range(MOST_STEPS):
        frame = localizer.step(image, np.zeros(3) if number else None, float(number))
        candidates = alignment(pose_estimate_of(frame), image)
        if candidates:
            return candidates[0].state
    raise InputError(
        path,
        "shows no place in the scene that could be told from all others",
        "give the goal as --goal X,Y,HEADING_DEG",
    )
