"""The robot's camera and where it sits, as a data set describes them."""

import numpy as np

from pipelines.artifacts.arguments import checked_instance
from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError
from pipelines.dataset.dataset import CAMERA_FILE, Dataset
from pipelines.geometry.camera import Camera
from pipelines.localize.state_space import StateSpace


def camera_and_mount(dataset: Dataset, space: StateSpace) -> tuple[Camera, FloatArray]:
    """The camera of a data set, and ``body_from_camera``, ``(4, 4)``.

    Args:
        dataset: what was recorded.
        space: what a state is; with six degrees of freedom the camera may be the body.

    Raises:
        InputError: the data set does not say.
        OptionError: no data set.
    """
    checked_instance(dataset, "the data set", Dataset)
    if dataset.camera is None:
        raise InputError(
            dataset.root / CAMERA_FILE, "is missing: localization needs the robot's camera"
        )
    if dataset.base_from_camera is None and space.angles == 3:
        return dataset.camera, np.eye(4)
    if dataset.base_from_camera is None:
        raise InputError(
            dataset.root / CAMERA_FILE,
            "has no [mount]: a planar robot needs to know where its camera sits",
            "add [mount] with x, y, z, roll, pitch, yaw, or give --dof 6 for a hand-held camera",
        )
    return dataset.camera, dataset.base_from_camera
