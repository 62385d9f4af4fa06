"""Camera poses that are known beforehand: integrated odometry, or a file of poses.

This is what the paper's experiment did: the recording positions come from the robot's odometry and
the camera's place on the robot. An image without a pose is dropped with a reason, never guessed.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import InputError
from pipelines.dataset.dataset import Dataset
from pipelines.geometry.camera import Camera
from pipelines.geometry.interpolation import PAIRING_TOLERANCE
from pipelines.geometry.trajectory import Trajectory, read_tum


@dataclass(frozen=True)
class KnownPoses:
    """The images of a data set that have a pose.

    Attributes:
        image_index: ``(N,)`` indices into the data set's images.
        world_from_camera: ``(N, 4, 4)``.
        dropped: name of an image without a pose -> the reason.
    """

    image_index: IntArray
    world_from_camera: FloatArray
    dropped: dict[str, str]


def odometry_of(dataset: Dataset) -> Trajectory:
    """The data set's integrated odometry, world_from_body.

    Raises:
        InputError: it has none.
    """
    if dataset.odometry is None:
        raise InputError(
            dataset.root / "odometry.txt",
            "does not exist, and --method odometry takes the poses from it",
            "use --method sfm, or --method poses --poses FILE",
        )
    return dataset.odometry


def known_camera(dataset: Dataset) -> Camera:
    """The data set's camera.

    Raises:
        InputError: it has no camera.toml.
    """
    if dataset.camera is None:
        raise InputError(
            dataset.root / "camera.toml",
            "does not exist, and known poses need a known camera",
            "write it, or use --method sfm, which estimates the camera",
        )
    return dataset.camera


def poses_from_odometry(dataset: Dataset) -> KnownPoses:
    """Camera poses from integrated odometry and the camera's mount.

    Raises:
        InputError: the data set has no odometry, or none of its poses belongs to an image.
    """
    return pair_poses(dataset, odometry_of(dataset), dataset.root / "odometry.txt")


def poses_from_file(dataset: Dataset, path: Path) -> KnownPoses:
    """Camera poses from a TUM file of world_from_body and the camera's mount.

    Raises:
        InputError: the file cannot be read, or none of its poses belongs to an image.
    """
    return pair_poses(dataset, read_tum(path), path)


def pair_poses(dataset: Dataset, trajectory: Trajectory, source: Path) -> KnownPoses:
    """Gives every image the pose nearest in time, if it is near enough.

    Args:
        dataset: the images and the mount.
        trajectory: world_from_body.
        source: the file of the trajectory, for error texts.

    Raises:
        InputError: no pose belongs to any image.
    """
    nearest = trajectory.nearest(dataset.timestamps, PAIRING_TOLERANCE)
    paired = np.flatnonzero(nearest >= 0)
    if len(paired) == 0:
        first, last = trajectory.timestamps[[0, -1]]
        raise InputError(
            source,
            f"none of its poses (time {first:.3f} to {last:.3f}) lies within "
            f"{PAIRING_TOLERANCE} s of an image (time {dataset.timestamps[0]:.3f} to "
            f"{dataset.timestamps[-1]:.3f})",
        )
    dropped = {
        dataset.image_names[index]: f"no pose within {PAIRING_TOLERANCE} s of time "
        f"{dataset.timestamps[index]:.6f} in {source.name}"
        for index in np.flatnonzero(nearest < 0).tolist()
    }
    world_from_body = trajectory.poses[nearest[paired]]
    return KnownPoses(paired, world_from_body @ dataset.body_from_camera, dropped)
