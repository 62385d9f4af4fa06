"""``replay:DATASET``: a robot that sees, wherever it goes, the recorded frame nearest to it."""

import math

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import InputError
from pipelines.dataset.dataset import CAMERA_FILE, GROUNDTRUTH_FILE, Dataset, poses_at_images
from pipelines.dock.robot import Movement
from pipelines.dock.robots.noise import SimulatedMotion
from pipelines.geometry.pose import planar_state_of, wrap_angle

# A turn of one radian counts as much as so many metres.
METRES_A_RADIAN = 1.0


class ReplayRobot:
    """Its images are those of a data set; it is where the nearest of them was taken.

    So a docking can be tried out on recorded images. Movements shorter than the distance between
    recorded poses may have no effect, as with a robot that has to move in such steps.

    Args:
        dataset: with camera, mount and ground truth.
        motion: where the commands alone would have led it.

    Raises:
        InputError: the data set lacks camera, mount or ground truth.
    """

    def __init__(self, dataset: Dataset, motion: SimulatedMotion) -> None:
        if dataset.camera is None or dataset.base_from_camera is None:
            raise InputError(dataset.root / CAMERA_FILE, "is missing or has no [mount]")
        if dataset.groundtruth is None:
            raise InputError(
                dataset.root / GROUNDTRUTH_FILE,
                "is missing: a replay needs to know where its images were taken",
            )
        self.camera = dataset.camera
        self.base_from_camera = dataset.base_from_camera
        source = dataset.root / GROUNDTRUTH_FILE
        self._dataset = dataset
        self._states = planar_state_of(poses_at_images(dataset, dataset.groundtruth, source))
        self._motion = motion

    def take_image(self) -> ImageArray:
        """The nearest recorded image."""
        return self._dataset.read_image(self._nearest())

    def move(self, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """See ``Robot.move``; odometry tells the movement from frame to frame."""
        before = self.true_state()
        self._motion.move(Movement(forward, left, turn))
        after = self.true_state()
        cosine, sine = math.cos(before[2]), math.sin(before[2])
        x, y = after[:2] - before[:2]
        return (
            float(cosine * x + sine * y),
            float(cosine * y - sine * x),
            float(wrap_angle(after[2] - before[2])),
        )

    def stop(self) -> None:
        """It stands still already."""

    def true_state(self) -> FloatArray:
        """See ``KnowsTruth``."""
        return np.asarray(self._states[self._nearest()])

    def _nearest(self) -> int:
        offsets = self._states - self._motion.state
        turns = METRES_A_RADIAN * wrap_angle(offsets[:, 2])
        return int(np.argmin(np.sum(offsets[:, :2] ** 2, axis=1) + turns**2))
