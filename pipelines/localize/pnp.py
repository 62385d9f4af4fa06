"""Localization by features, for comparison with the light field: SIFT and perspective-n-point.

Features of the scene's photos that are landmarks (``landmarks``) are matched with those of a camera
image, and the camera's pose is computed from the pairs (``feature_pose``). Here it becomes the
body's. At least ``MIN_INLIERS`` features have to agree on it; otherwise there is no pose, and
neither an earlier pose nor a photo's is given in its place.
"""

import math
import os
import time
from dataclasses import dataclass

import cv2
import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.stages import Progress
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import inverse, pose_from_rotation
from pipelines.lightfield.scene import Scene
from pipelines.localize.feature_pose import FeatureSettings, FoundPose, PoseFinder
from pipelines.localize.landmarks import LandmarkSource
from pipelines.localize.observation import check_mask
from pipelines.localize.state_space import StateSpace

# Random matches agreed on a pose with up to five features; thirty do not agree by chance.
MIN_INLIERS = 30
MAX_SIZE = 960
MAX_FEATURES = 2048
MAX_THREADS = 16
MAX_SEED = 2**31 - 1
# A robot on the floor neither hovers nor leans: poses beyond this are wrong, metres and radians.
LARGEST_HEIGHT, LARGEST_TILT = 0.3, math.radians(10.0)


@dataclass(frozen=True)
class PnpAnswer:
    """The pose by features of one image.

    Attributes:
        state: ``(D,)`` of the body; None: no pose.
        covariance: ``(D, D)`` of its error, if landmarks were exact; None where there is no
            pose.
        inliers: features of the image that agree on the pose.
        matches: features that match a landmark.
        seconds: wall time.
    """

    state: FloatArray | None
    covariance: FloatArray | None
    inliers: int
    matches: int
    seconds: float

    @property
    def confidence(self) -> float:
        """N / (n + 30) of n inliers, 0 to 1; 0 without a pose."""
        return 0.0 if self.state is None else self.inliers / (self.inliers + MIN_INLIERS)

    @property
    def hypotheses(self) -> FloatArray | None:
        """The pose as ``(1, D)`` states, or None."""
        return None if self.state is None else self.state[None]


@dataclass(frozen=True)
class MountedCamera:
    """A camera on a body.

    Attributes:
        camera: of the robot.
        body_from_camera: ``(4, 4)`` its mount.
        mask: ``(height, width)``, True where images of the camera are to be used; None: everywhere.

    Raises:
        OptionError: a mask of another size than the camera.
    """

    camera: Camera
    body_from_camera: FloatArray
    mask: BoolArray | None = None

    def __post_init__(self) -> None:
        if self.mask is not None:
            check_mask(self.mask, self.camera)


class PnpLocalizer:
    """Finds poses in one scene, each image for itself.

    The same images and seed give the same answers, with any number of threads.

    Args:
        scene: the map.
        landmarks: where features of its photos are.
        mounted: camera of the robot.
        space: what a state is. In ``planar`` the pose is projected to the floor; one that hovers or
            leans is rejected.
        seed: of RANSAC.
        threads: the most that are used; None: one a processor.
        progress: shown while the features of the photos are detected.

    Raises:
        InputError: a photo of the scene cannot be decoded.
    """

    def __init__(
        self,
        scene: Scene,
        landmarks: LandmarkSource,
        mounted: MountedCamera,
        space: StateSpace,
        *,
        seed: int,
        threads: int | None,
        progress: Progress,
    ) -> None:
        self._camera = mounted.camera
        self._body_from_camera = mounted.body_from_camera
        self._space = space
        settings = FeatureSettings(
            max_size=MAX_SIZE,
            max_features=MAX_FEATURES,
            min_inliers=MIN_INLIERS,
            seed=seed % MAX_SEED,
            threads=min(MAX_THREADS, threads or os.cpu_count() or 1),
        )
        self._finder = PoseFinder(mounted.camera, settings)
        for view in progress(range(len(scene)), "features of the scene", len(scene)):
            found = landmarks.landmarks(view, self._finder.describe(_grey(scene.image(view))))
            self._finder.place(found.rows, found.points)
        if mounted.mask is not None:
            self._finder.use_only(mounted.mask.astype(np.uint8))

    def locate(self, image: ImageArray) -> PnpAnswer:
        """The body's pose when the camera took an image ``(height, width, 3)``, RGB as recorded.

        Raises:
            OptionError: an image of another size than the camera.
        """
        self._check(image)
        start = time.perf_counter()
        found = self._finder.locate(_grey(image))
        state, covariance = self._of_body(found)
        seconds = time.perf_counter() - start
        return PnpAnswer(state, covariance, found.inliers, found.matches, seconds)

    def focal_length(self, image: ImageArray) -> float | None:
        """The camera's focal length, pixels, where the one that it was made with is only a guess.

        Args:
            image: ``(height, width, 3)`` RGB as recorded.

        Returns:
            Mean of both axes; None where features show no pose.

        Raises:
            OptionError: an image of another size than the camera.
        """
        self._check(image)
        return self._finder.locate(_grey(image), find_focal_length=True).focal_length

    def _check(self, image: ImageArray) -> None:
        if image.shape[:2] != (self._camera.height, self._camera.width):
            raise OptionError(
                f"image is {image.shape[1]}x{image.shape[0]}, "
                f"its camera {self._camera.width}x{self._camera.height}"
            )

    def _of_body(self, found: FoundPose) -> tuple[FloatArray, FloatArray] | tuple[None, None]:
        """State and covariance of the body; None where a robot on the floor cannot be there."""
        camera_from_world = found.camera_from_world
        if camera_from_world is None or found.covariance is None:
            return None, None
        world_from_camera = inverse(
            pose_from_rotation(camera_from_world[:, :3], camera_from_world[:, 3])
        )
        pose = world_from_camera @ inverse(self._body_from_camera)
        is_planar = self._space.angles == 1
        if is_planar and not _is_on_floor(pose):
            return None, None
        lever = pose[:3, 3] - world_from_camera[:3, 3]
        covariance = covariance_at(lever, found.covariance)
        if is_planar:
            kept = [0, 1, 5]
            covariance = covariance[np.ix_(kept, kept)]
        return self._space.states(pose), covariance


def covariance_at(lever: FloatArray, covariance: FloatArray) -> FloatArray:
    """The pose covariance of the camera taken to another point of the same rigid body.

    Args:
        lever: ``(3,)`` from the camera's centre to the point, metres, world axes.
        covariance: ``(6, 6)`` of the camera's position and rotation, world axes.

    Returns:
        ``(6, 6)`` of the point's position and rotation.
    """
    transfer = np.eye(6)
    # A small rotation w moves the point by w x lever.
    transfer[:3, 3:] = np.cross(np.eye(3), lever).T
    return np.asarray(transfer @ covariance @ transfer.T)


def _is_on_floor(pose: FloatArray) -> bool:
    tilt = math.acos(min(1.0, max(-1.0, float(pose[2, 2]))))
    return abs(float(pose[2, 3])) <= LARGEST_HEIGHT and tilt <= LARGEST_TILT


def _grey(image: ImageArray) -> ImageArray:
    """Brightness ``(height, width)`` of an RGB image."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
