"""Did a movement happen? Odometry and images are asked, since either alone may be deceived."""

from dataclasses import dataclass

import cv2
import numpy as np

from pipelines.artifacts.arrays import BoolArray, Float32Array, ImageArray
from pipelines.dock.planar_motion import movement_between
from pipelines.dock.pose_estimate import Fix
from pipelines.dock.robot import Movement

# Shorter movements are within the noise: metres and radians.
LEAST_DISTANCE, LEAST_TURN = 0.03, 0.05
# Less than this share of what was commanded is no movement.
STILL_SHARE = 0.3
# Images that correlate more than this were taken from the same place, whatever the noise.
STILL_CORRELATION = 0.98
WIDTH = 40
# A pixel of which a mask leaves more than this share counts as used.
FULLY_USED = 0.99


@dataclass(frozen=True)
class Moment:
    """What was seen between two movements.

    Attributes:
        picture: ``(N,)`` grey levels of the used pixels of the camera image at ``WIDTH`` pixels
            across.
        fix: where the robot was taken to be.
    """

    picture: Float32Array
    fix: Fix


def moment_of(image: ImageArray, fix: Fix, mask: BoolArray | None = None) -> Moment:
    """The moment of a camera image ``(H, W, 3)``, used where ``mask`` ``(H, W)`` is True."""
    height = max(1, round(image.shape[0] * WIDTH / image.shape[1]))
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    small = cv2.resize(grey, (WIDTH, height), interpolation=cv2.INTER_AREA)
    used = np.ones(small.shape, dtype=np.bool_)
    if mask is not None:
        # What is fixed to the camera looks still while the robot moves.
        shares = cv2.resize(mask.astype(np.float32), (WIDTH, height), interpolation=cv2.INTER_AREA)
        used = np.asarray(shares > FULLY_USED, dtype=np.bool_)
    return Moment(np.asarray(small[used], dtype=np.float32), fix)


def stood_still(commanded: Movement, measured: Movement, before: Moment, after: Moment) -> bool:
    """Whether odometry and images agree that a movement did not happen.

    Also true where the wheels turned and the images say, by what they show and by where they place
    the robot, that they turned in vain, or where the image is the one before: the wheels slip, or
    the camera hangs. False where the movement was too small to tell.
    """
    if commanded.distance < LEAST_DISTANCE and abs(commanded.turn) < LEAST_TURN:
        return False
    if after.fix.is_stale:
        return True
    odometry_still = _share(measured, commanded) < STILL_SHARE
    if before.fix.is_blind or after.fix.is_blind:
        return odometry_still
    images_still = _correlation(before.picture, after.picture) > STILL_CORRELATION
    if not (before.fix.is_sure and after.fix.is_sure):
        return odometry_still and images_still
    placed = movement_between(before.fix.state, after.fix.state)
    placed_still = _share(placed, commanded) < STILL_SHARE
    return placed_still and (odometry_still or images_still)


def _share(happened: Movement, commanded: Movement) -> float:
    """How much of a movement happened: 0 to 1 and beyond."""
    wanted = commanded.vector() / np.array([LEAST_DISTANCE, LEAST_DISTANCE, LEAST_TURN])
    got = happened.vector() / np.array([LEAST_DISTANCE, LEAST_DISTANCE, LEAST_TURN])
    return float(wanted @ got / (wanted @ wanted))


def _correlation(first: Float32Array, second: Float32Array) -> float:
    first, second = first - first.mean(), second - second.mean()
    scale = float(np.sqrt(np.sum(first**2) * np.sum(second**2)))
    return float(np.sum(first * second)) / scale if scale > 0.0 else 1.0
