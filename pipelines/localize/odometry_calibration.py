"""What the filter learns while it runs: how odometry errs.

``OdometryCalibration`` compares the motion between two estimates with what odometry said. What
errs in the same way all the time (wheels worn down, a bias of the gyroscope) is a linear function
of the motion, estimated by recursive least squares with forgetting, and is taken off; what is left
sets the noise of the motion model, up or down.
"""

from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray

# How fast what was learned is forgotten, a frame.
FORGETTING = 0.95
# A linear error is expected to be about so large, and a single motion is estimated so well
# (metres or radians): the ridge of the least squares.
EXPECTED_ERROR, MEASUREMENT_SIGMA = 0.15, 0.03
NOISE_RATE = 0.2
# A surprise beyond this is no error of odometry: the estimate has jumped to another place.
LARGEST_SURPRISE = 25.0
SMALLEST_NOISE_SCALE, LARGEST_NOISE_SCALE = 0.5, 3.0


@dataclass(frozen=True)
class OdometryCalibration:
    """The error of odometry, as far as it is known.

    Attributes:
        information: ``(D, D)`` weighted sum of products of motions.
        moments: ``(D, D)`` likewise of motions with errors.
        noise_scale: factor on the motion model's standard deviations.
    """

    information: FloatArray
    moments: FloatArray
    noise_scale: float

    @property
    def correction(self) -> FloatArray:
        """``(D, D)``: the error, a motion's unit."""
        ridge = (MEASUREMENT_SIGMA / EXPECTED_ERROR) ** 2 * np.eye(len(self.information))
        return np.asarray(np.linalg.solve(self.information + ridge, self.moments).T)

    def corrected(self, increment: FloatArray) -> FloatArray:
        """What odometry would have said without its systematic error, ``(D,)``."""
        return np.asarray(increment + self.correction @ increment, dtype=np.float64)

    def learned(
        self, increment: FloatArray, error: FloatArray, surprise: float
    ) -> "OdometryCalibration":
        """The calibration after one more motion.

        Args:
            increment: ``(D,)`` as odometry said.
            error: ``(D,)`` the estimated motion minus the increment.
            surprise: squared difference between estimate and prediction over what was expected of
                it; 1 on average where the noise is right.
        """
        wanted = np.clip(surprise, SMALLEST_NOISE_SCALE**2, LARGEST_NOISE_SCALE**2)
        variance = self.noise_scale**2 + NOISE_RATE * (wanted - self.noise_scale**2)
        if surprise > LARGEST_SURPRISE:
            return replace(self, noise_scale=float(np.sqrt(variance)))
        return OdometryCalibration(
            FORGETTING * self.information + np.outer(increment, increment),
            FORGETTING * self.moments + np.outer(increment, error),
            float(np.sqrt(variance)),
        )


def uncalibrated(dimension: int) -> OdometryCalibration:
    """Odometry about whose errors nothing is known yet."""
    nothing = np.zeros((dimension, dimension))
    return OdometryCalibration(nothing, nothing, 1.0)
