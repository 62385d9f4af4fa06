"""Smoothing: an extended Kalman filter over the aligned poses of the last movements.

Errors of an alignment come mostly from the scene model (a reflection, an inexact surface) and are
the same for all images taken from one place. Averaging such images gains nothing. Images from
different places have independent errors, and over a few short movements odometry relates their
poses to within a centimetre. An image therefore counts the less the nearer it was taken to the
previous one.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.planar_motion import (
    movement_between,
    normalised_innovation,
    propagated_covariance,
)
from pipelines.dock.pose_estimate import PoseEstimate
from pipelines.dock.robot import Movement
from pipelines.localize.odometry_calibration import OdometryCalibration, uncalibrated
from pipelines.localize.state_space import PLANAR

# Standard deviations of calibrated odometry: metres plus a share of the distance; radians, radians
# a metre, and a share of the rotation.
STEP_POSITION, POSITION_SHARE = 0.002, 0.04
STEP_HEADING, HEADING_A_METRE, HEADING_SHARE = math.radians(0.5), math.radians(1.5), 0.03
# Movements from which errors of two images are independent: metres and radians.
INDEPENDENT_DISTANCE, INDEPENDENT_YAW = 0.2, 0.2
# An image counts with at least this, since odometry's errors add up over many small movements.
LEAST_NOVELTY = 0.15
# A normalised innovation above this resets the filter.
LARGEST_INNOVATION = 25.0
# Standard deviations of the motion between two estimates, for the calibration: metres, radians.
PAIR_POSITION, PAIR_HEADING = 0.03, math.radians(1.0)


@dataclass(frozen=True)
class _Track:
    """State of the Kalman filter.

    Attributes:
        state: ``(3,)`` x and y in metres, heading in radians.
        covariance: ``(3, 3)`` of the state's error, metres and radians.
        novelty: how much the next image counts, 0 to 1, by the movement since the last one.
    """

    state: FloatArray
    covariance: FloatArray
    novelty: float


class Smoother:
    """Smooths the estimates of consecutive images."""

    def __init__(self) -> None:
        self._track: _Track | None = None
        self._last: FloatArray | None = None
        self._calibration: OdometryCalibration = uncalibrated(3)

    def __call__(self, estimate: PoseEstimate, measured: Movement) -> PoseEstimate:
        """The estimate of an image, smoothed with those of the images before.

        Args:
            estimate: by this image alone.
            measured: movement since the previous image by odometry.
        """
        if not (estimate.is_localized and estimate.is_refined):
            self._track, self._last = None, None
            return estimate
        self._learn(estimate.state, measured)
        if not estimate.is_aligned:
            # Far from the goal the filter's estimate is enough; keep it out of more accurate ones.
            self._track, self._last = None, estimate.state
            return estimate
        track = self._updated(estimate, measured)
        self._track, self._last = track, estimate.state
        return replace(estimate, state=track.state, covariance=track.covariance)

    def _learn(self, state: FloatArray, measured: Movement) -> None:
        """Calibrates odometry by the motion between the last two estimates."""
        if self._last is None:
            return
        error = movement_between(self._last, state).vector() - measured.vector()
        left = error - self._calibration.correction @ measured.vector()
        noise = np.array([PAIR_POSITION, PAIR_POSITION, PAIR_HEADING])
        surprise = float(np.mean((left / noise) ** 2))
        self._calibration = self._calibration.learned(measured.vector(), error, surprise)

    def _updated(self, estimate: PoseEstimate, measured: Movement) -> _Track:
        """The Kalman filter after a movement and an image."""
        if self._track is None:
            return _Track(estimate.state, estimate.covariance, 0.0)
        moved = self._predicted(self._track, measured)
        novelty = max(moved.novelty, LEAST_NOVELTY)
        seen = estimate.covariance / novelty
        difference = PLANAR.difference(estimate.state, moved.state)
        total = moved.covariance + seen
        if normalised_innovation(estimate.state, moved.state, total) > LARGEST_INNOVATION:
            return _Track(estimate.state, estimate.covariance, 0.0)
        gain = np.linalg.solve(total, moved.covariance).T
        covariance = (np.eye(3) - gain) @ moved.covariance
        state = PLANAR.moved(moved.state, gain @ difference)
        return _Track(state, 0.5 * (covariance + covariance.T), 0.0)

    def _predicted(self, track: _Track, measured: Movement) -> _Track:
        """The Kalman filter after a movement, before the image."""
        increment = self._calibration.corrected(measured.vector())
        state = PLANAR.composed(track.state, increment)
        distance, yaw = measured.distance, abs(measured.turn)
        position = STEP_POSITION + POSITION_SHARE * distance
        heading = STEP_HEADING + HEADING_A_METRE * distance + HEADING_SHARE * yaw
        if distance == 0.0 and yaw == 0.0:
            position = heading = 0.0
        covariance = propagated_covariance(track.covariance, track.state, state, position, heading)
        novelty = math.hypot(distance / INDEPENDENT_DISTANCE, yaw / INDEPENDENT_YAW)
        return _Track(state, covariance, min(1.0, track.novelty + novelty))
