"""``replay:DATASET``: a simulated robot whose camera shows the nearest recorded frame."""

import math

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import InputError
from pipelines.dataset.dataset import CAMERA_FILE, GROUNDTRUTH_FILE, Dataset
from pipelines.dataset.pairing import poses_at_images
from pipelines.dock.robot import Movement
from pipelines.dock.robots.noise import SimulatedMotion
from pipelines.geometry.pose import planar_state_of, wrap_angle

# In the distance of two poses, one radian counts as much as this many metres.
METRES_A_RADIAN = 1.0


class ReplayRobot:
    """A robot that stands where the recorded frame nearest to its simulated pose was taken.

    Docking can thus be tried on recorded images. A movement shorter than the distance between
    recorded poses may have no effect.

    Args:
        dataset: data set with camera, mount and ground truth.
        motion: the simulated pose, to which the nearest frame is found.

    Raises:
        InputError: the data set lacks camera, mount or ground truth.
    """

    def __init__(self, dataset: Dataset, motion: SimulatedMotion) -> None:
        if dataset.camera is None or dataset.base_from_camera is None:
            raise InputError(dataset.root / CAMERA_FILE, "is missing or has no [mount]")
        truth = dataset.true_poses("is missing: a replay needs to know where its images were taken")
        self.camera = dataset.camera
        self.base_from_camera = dataset.base_from_camera
        source = dataset.root / GROUNDTRUTH_FILE
        self._dataset = dataset
        self._states = planar_state_of(poses_at_images(dataset, truth, source))
        self._motion = motion

    def take_image(self) -> ImageArray:
        """The nearest recorded image, ``(H, W, 3)`` RGB."""
        return self._dataset.read_image(self._nearest())

    def move(self, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Moves as ``Robot.move`` says; odometry is exact from frame to frame."""
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
        """Does nothing: the robot stands still between movements."""

    def true_state(self) -> FloatArray:
        """State ``(3,)`` at which the nearest frame was taken."""
        return np.asarray(self._states[self._nearest()])

    def _nearest(self) -> int:
        """Number of the frame nearest to the simulated pose."""
        offsets = self._states - self._motion.state
        yaws = METRES_A_RADIAN * wrap_angle(offsets[:, 2])
        return int(np.argmin(np.sum(offsets[:, :2] ** 2, axis=1) + yaws**2))
