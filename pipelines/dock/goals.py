"""The goal by other means than a pose: where a view was taken, or where an image was."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pipelines.artifacts.arguments import check_fields, checked_number
from pipelines.artifacts.arrays import BoolArray, FloatArray, checked_array
from pipelines.artifacts.errors import InputError, OptionError
from pipelines.dataset.images import decode_image, read_image_bytes
from pipelines.dock.docking_map import docking_map
from pipelines.dock.fine_alignment import FineAlignment
from pipelines.dock.pose_estimate import pose_estimate_of
from pipelines.dock.robot import CheckedRobot
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import inverse, planar_state_of
from pipelines.lightfield.open_world import OpenWorld
from pipelines.lightfield.scene import Scene
from pipelines.localize.localizer import Localizer
from pipelines.localize.settings import LocalizerSettings

# The filter sees the goal image this many times before the image counts as not found.
MOST_STEPS = 6


@dataclass(frozen=True)
class Goal:
    """Where to dock: exactly one of the three.

    Attributes:
        pose: x, y in metres and heading in radians, in the scene's world; None: not given so.
        view: number of a view of the scene, from 0: the robot's camera is to stand where it was
            taken; None: not given so.
        image: file of an image taken with the robot's camera; None: not given so.

    Raises:
        OptionError: none or several, or a pose that is not three finite numbers.
    """

    pose: tuple[float, float, float] | None = None
    view: int | None = None
    image: Path | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if [self.pose, self.view, self.image].count(None) != 2:
            raise OptionError("give one goal: --goal, --goal-view or --goal-image")
        if self.pose is not None:
            checked_array(self.pose, "the goal's pose", (3,))


def goal_state(
    goal: Goal,
    scene: Scene | OpenWorld,
    robot: CheckedRobot,
    settings: LocalizerSettings,
    seed: int,
    mask: BoolArray | None = None,
) -> FloatArray:
    """The state ``(3,)`` of a goal: x, y in metres and heading in radians.

    Args:
        goal: where to.
        scene: the light field, or a world of several.
        robot: that is to dock.
        settings: of the filter that searches for an image's place.
        seed: of that filter's random numbers.
        mask: ``(height, width)``, True where images of the robot's camera are to be used; None:
            everywhere.

    Raises:
        InputError: an image that is unreadable, of another size than the camera's, or not found.
        OptionError: no such view.
    """
    if goal.pose is not None:
        return np.array(goal.pose, dtype=np.float64)
    if goal.view is not None:
        return goal_of_view(scene, goal.view, robot.base_from_camera)
    if goal.image is None:
        raise OptionError("there is no goal")
    rng = np.random.default_rng([seed, 4])
    return goal_of_image(
        scene, goal.image, robot.camera, robot.base_from_camera, settings, rng, mask
    )


def goal_of_view(scene: Scene | OpenWorld, index: int, base_from_camera: FloatArray) -> FloatArray:
    """The state ``(3,)`` at which the robot's camera stands where view ``index`` was taken.

    Args:
        scene: the light field, or a world of several.
        index: number of the view, from 0; in a world, of the photo.
        base_from_camera: ``(4, 4)`` the robot camera's mount; it may be at another height than the
            camera of the view.

    Raises:
        OptionError: no such view.
    """
    checked_number(index, "view", whole=True)
    count = len(scene.world_from_camera)
    if not 0 <= index < count:
        raise OptionError(f"the scene has no view {index}; its views are 0 to {count - 1}")
    return planar_state_of(scene.world_from_camera[index] @ inverse(base_from_camera))


def goal_of_image(
    scene: Scene | OpenWorld,
    path: Path,
    camera: Camera,
    base_from_camera: FloatArray,
    settings: LocalizerSettings,
    rng: np.random.Generator,
    mask: BoolArray | None = None,
) -> FloatArray:
    """The state ``(3,)`` from which the robot's camera sees an image.

    Args:
        scene: the light field, or a world of several.
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
    alignment: FineAlignment | None = None
    for number in range(MOST_STEPS):
        frame = localizer.step(image, np.zeros(3) if number else None, float(number))
        estimate = pose_estimate_of(frame)
        if not estimate.is_localized:
            continue
        if alignment is None:
            around = docking_map(scene).around(estimate.state[None])
            alignment = FineAlignment(around, camera, base_from_camera, settings, mask=mask)
        candidates = alignment(estimate, image)
        if candidates:
            return candidates[0].state
    raise InputError(
        path,
        "shows no place in the scene that could be told from all others",
        "give the goal as --goal X,Y,HEADING_DEG",
    )
