"""Fixes of several places held against each other by odometry.

What an alignment is off by comes mostly from the model (a reflection, a surface that is not quite
there) and is the same whenever the robot looks from the same place. Averaging images taken there
gains nothing; images from other places do, and over a few short movements odometry ties these
together to a centimetre. This is an extended Kalman filter over the fixes of the last movements, in
which an image counts the less the nearer it was taken to the one before.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.planar_motion import movement_between
from pipelines.dock.pose_estimate import Fix
from pipelines.dock.robot import Movement
from pipelines.localize.odometry_calibration import OdometryCalibration, uncalibrated
from pipelines.localize.state_space import PLANAR

# What calibrated odometry errs by: metres, of the distance, radians, a metre, of the turn.
STEP_POSITION, POSITION_SHARE = 0.002, 0.04
STEP_HEADING, HEADING_A_METRE, HEADING_SHARE = math.radians(0.5), math.radians(1.5), 0.03
# From so far apart, metres and radians, errors of two images have nothing to do with each other.
INDEPENDENT_DISTANCE, INDEPENDENT_TURN = 0.2, 0.2
# Odometry's own errors add up in a row of small movements: an image always counts for something.
LEAST_NOVELTY = 0.15
# A fix this far (squared, in standard deviations) from what was expected begins anew.
LARGEST_SURPRISE = 25.0
# What the calibration takes a motion between two fixes to be uncertain by.
PAIR_POSITION, PAIR_HEADING = 0.03, math.radians(1.0)


@dataclass(frozen=True)
class Track:
    """What is known from the fixes so far.

    Attributes:
        state: ``(3,)``.
        covariance: ``(3, 3)``.
        novelty: how much the next image is worth, 0 to 1, from the movement since the last one.
    """

    state: FloatArray
    covariance: FloatArray
    novelty: float


class Smoother:
    """Follows a robot from fix to fix."""

    def __init__(self) -> None:
        self._track: Track | None = None
        self._last: FloatArray | None = None
        self._calibration: OdometryCalibration = uncalibrated(3)

    def __call__(self, fix: Fix, measured: Movement) -> Fix:
        """The fix in the light of those before it.

        Args:
            fix: from this image.
            measured: the movement since the image before, as odometry says.
        """
        if not (fix.is_sure and fix.is_refined):
            self._track, self._last = None, None
            return fix
        self._learn(fix.state, measured)
        if not fix.is_aligned:
            # Far from the goal the filter's estimate will do; it must not weigh on better ones.
            self._track, self._last = None, fix.state
            return fix
        track = self._updated(fix, measured)
        self._track, self._last = track, fix.state
        return replace(fix, state=track.state, covariance=track.covariance)

    def _learn(self, state: FloatArray, measured: Movement) -> None:
        if self._last is None:
            return
        error = movement_between(self._last, state).vector() - measured.vector()
        left = error - self._calibration.correction @ measured.vector()
        noise = np.array([PAIR_POSITION, PAIR_POSITION, PAIR_HEADING])
        surprise = float(np.mean((left / noise) ** 2))
        self._calibration = self._calibration.learned(measured.vector(), error, surprise)

    def _updated(self, fix: Fix, measured: Movement) -> Track:
        if self._track is None:
            return Track(fix.state, fix.covariance, 0.0)
        moved = self._predicted(self._track, measured)
        novelty = max(moved.novelty, LEAST_NOVELTY)
        seen = fix.covariance / novelty
        difference = PLANAR.difference(fix.state, moved.state)
        total = moved.covariance + seen
        if float(difference @ np.linalg.solve(total, difference)) > LARGEST_SURPRISE:
            return Track(fix.state, fix.covariance, 0.0)
        gain = np.linalg.solve(total, moved.covariance).T
        covariance = (np.eye(3) - gain) @ moved.covariance
        state = PLANAR.moved(moved.state, gain @ difference)
        return Track(state, 0.5 * (covariance + covariance.T), 0.0)

    def _predicted(self, track: Track, measured: Movement) -> Track:
        """After a movement, before the image."""
        increment = self._calibration.corrected(measured.vector())
        state = PLANAR.composed(track.state, increment)
        across = np.eye(3)
        across[0, 2] = -(state[1] - track.state[1])
        across[1, 2] = state[0] - track.state[0]
        distance, turn = measured.distance, abs(measured.turn)
        position = STEP_POSITION + POSITION_SHARE * distance
        heading = STEP_HEADING + HEADING_A_METRE * distance + HEADING_SHARE * turn
        if distance == 0.0 and turn == 0.0:
            position = heading = 0.0
        noise = np.diag([position**2, position**2, heading**2])
        novelty = math.hypot(distance / INDEPENDENT_DISTANCE, turn / INDEPENDENT_TURN)
        return Track(
            state, across @ track.covariance @ across.T + noise, min(1.0, track.novelty + novelty)
        )
