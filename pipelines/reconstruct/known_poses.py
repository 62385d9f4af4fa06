"""Camera poses that are known beforehand: integrated odometry, or a file of poses.

This is what the paper's experiment did: the recording positions come from the robot's odometry and
the camera's place on the robot. An image without a pose is dropped with a reason, never guessed.
"""

from dataclasses import dataclass
from pathlib import Path

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import InputError
from pipelines.dataset.dataset import Dataset
from pipelines.dataset.pairing import pair_images
from pipelines.geometry.camera import Camera
from pipelines.geometry.interpolation import MAX_GAP
from pipelines.geometry.trajectory import Trajectory, read_tum


@dataclass(frozen=True)
class KnownPoses:
    """The images of a data set that have a pose.

    Attributes:
        image_index: ``(N,)`` indices into the data set's images.
        world_from_camera: ``(N, 4, 4)``.
        dropped: name of an image without a pose -> the reason.
        notes: lines on poses that are not of an image's very time.
    """

    image_index: IntArray
    world_from_camera: FloatArray
    dropped: dict[str, str]
    notes: tuple[str, ...] = ()


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


def poses_from_odometry(dataset: Dataset, max_gap: float = MAX_GAP) -> KnownPoses:
    """Camera poses from integrated odometry and the camera's mount.

    Raises:
        InputError: the data set has no odometry, or none of its poses belongs to an image.
    """
    return pair_poses(dataset, odometry_of(dataset), dataset.root / "odometry.txt", max_gap)


def poses_from_file(dataset: Dataset, path: Path, max_gap: float = MAX_GAP) -> KnownPoses:
    """Camera poses from a TUM file of world_from_body and the camera's mount.

    Raises:
        InputError: the file cannot be read, or none of its poses belongs to an image.
    """
    return pair_poses(dataset, read_tum(path), path, max_gap)


def pair_poses(
    dataset: Dataset, trajectory: Trajectory, source: Path, max_gap: float = MAX_GAP
) -> KnownPoses:
    """Gives every image the pose at its time, if one is known.

    Args:
        dataset: the images and the mount.
        trajectory: world_from_body.
        source: the file of the trajectory, for error texts.
        max_gap: seconds between the two poses around an image at most.

    Raises:
        InputError: no pose belongs to any image.
    """
    found = pair_images(dataset, trajectory, source, max_gap)
    return KnownPoses(
        found.image_index,
        found.world_from_body @ dataset.body_from_camera,
        {dataset.image_names[index]: reason for index, reason in found.left_out.items()},
        found.notes,
    )
