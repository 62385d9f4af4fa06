"""Stall and slip detection: whether a commanded movement happened, by odometry and by images.

Either source alone can be deceived: slipping wheels measure motion that did not happen, and a
repeated image hides motion that did.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from pipelines.artifacts.arrays import BoolArray, Float32Array, ImageArray
from pipelines.dataset.mask import used_in_small
from pipelines.dock.planar_motion import movement_between
from pipelines.dock.pose_estimate import PoseEstimate
from pipelines.dock.robot import Movement

# Shorter movements are within the noise: metres and radians.
LEAST_DISTANCE, LEAST_YAW = 0.03, 0.05
# A movement of which less than this share happened counts as a stall.
STALL_SHARE = 0.3
# Images that correlate more than this were taken from the same place, whatever the noise.
SAME_PLACE_CORRELATION = 0.98
# Images are compared at this width, pixels.
WIDTH = 40


@dataclass(frozen=True)
class Snapshot:
    """An image between two movements, reduced to what stall detection compares.

    Attributes:
        thumbnail: ``(N,)`` grey levels of the used pixels, the image being ``WIDTH`` pixels across.
        estimate: where the robot was by this image.
    """

    thumbnail: Float32Array
    estimate: PoseEstimate


def snapshot_of(
    image: ImageArray, estimate: PoseEstimate, mask: BoolArray | None = None
) -> Snapshot:
    """The snapshot of a camera image.

    Args:
        image: ``(H, W, 3)`` RGB.
        estimate: where the robot was by this image.
        mask: ``(H, W)``, True where the image is used; None: everywhere. What is fixed to the
            camera looks still while the robot moves.
    """
    height = max(1, round(image.shape[0] * WIDTH / image.shape[1]))
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    small = cv2.resize(grey, (WIDTH, height), interpolation=cv2.INTER_AREA)
    used = used_in_small(mask, WIDTH, height)
    return Snapshot(np.asarray(small[used], dtype=np.float32), estimate)


def is_stalled(commanded: Movement, measured: Movement, before: Snapshot, after: Snapshot) -> bool:
    """Whether odometry and images agree that a commanded movement did not happen.

    It is also a stall when the wheels turned but the images, by content and by estimated pose, show
    no motion (slip), and when the image is the previous one (the camera hangs). It is none when the
    movement was too small to tell.

    Args:
        commanded: the movement that the robot was told to make.
        measured: the same movement by odometry.
        before: of the image before the movement.
        after: of the image after it.
    """
    if commanded.distance < LEAST_DISTANCE and abs(commanded.turn) < LEAST_YAW:
        return False
    if after.estimate.is_stale:
        return True
    odometry_stalled = _share_done(measured, commanded) < STALL_SHARE
    if before.estimate.is_blind or after.estimate.is_blind:
        return odometry_stalled
    images_stalled = _correlation(before.thumbnail, after.thumbnail) > SAME_PLACE_CORRELATION
    if not (before.estimate.is_localized and after.estimate.is_localized):
        return odometry_stalled and images_stalled
    estimated = movement_between(before.estimate.state, after.estimate.state)
    estimates_stalled = _share_done(estimated, commanded) < STALL_SHARE
    return estimates_stalled and (odometry_stalled or images_stalled)


def _share_done(done: Movement, commanded: Movement) -> float:
    """Share of a commanded movement that was done; 1 where all of it was."""
    scale = np.array([LEAST_DISTANCE, LEAST_DISTANCE, LEAST_YAW])
    wanted, got = commanded.vector() / scale, done.vector() / scale
    return float(wanted @ got / (wanted @ wanted))


def _correlation(first: Float32Array, second: Float32Array) -> float:
    """Correlation of two thumbnails ``(N,)``; 1 where one of them is constant."""
    first, second = first - first.mean(), second - second.mean()
    scale = float(np.sqrt(np.sum(first**2) * np.sum(second**2)))
    return float(np.sum(first * second)) / scale if scale > 0.0 else 1.0
