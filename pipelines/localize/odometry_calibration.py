"""Online calibration of odometry: its systematic error and the size of its noise.

The motion between two estimates is compared with the increment of odometry. The systematic error
(worn wheels, a biased gyroscope) is taken to be linear in the motion, and is estimated by recursive
least squares with forgetting. The size of what remains scales the noise of the motion model.
"""

from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray

# Weight of the past in the least squares, from one frame to the next.
FORGETTING = 0.95
# Expected size of the linear error, and standard deviation of one motion's estimate (metres or
# radians): their ratio regularises the least squares.
EXPECTED_ERROR, MEASUREMENT_SIGMA = 0.15, 0.03
# Share of the latest frame in the noise scale.
NOISE_RATE = 0.2
# A normalised error beyond this is none of odometry: the estimate has jumped to another place.
LARGEST_SURPRISE = 25.0
SMALLEST_NOISE_SCALE, LARGEST_NOISE_SCALE = 0.5, 3.0


@dataclass(frozen=True)
class OdometryCalibration:
    """The error of odometry, as far as it is known.

    Attributes:
        information: ``(D, D)`` weighted sum of the outer products of increments.
        moments: ``(D, D)`` weighted sum of the outer products of increments and errors.
        noise_scale: factor on the motion model's standard deviations.
    """

    information: FloatArray
    moments: FloatArray
    noise_scale: float

    @property
    def correction(self) -> FloatArray:
        """``(D, D)`` matrix that takes an increment to its systematic error."""
        ridge = (MEASUREMENT_SIGMA / EXPECTED_ERROR) ** 2 * np.eye(len(self.information))
        return np.asarray(np.linalg.solve(self.information + ridge, self.moments).T)

    def corrected(self, increment: FloatArray) -> FloatArray:
        """An increment ``(D,)`` without its systematic error."""
        return np.asarray(increment + self.correction @ increment, dtype=np.float64)

    def learned(
        self, increment: FloatArray, error: FloatArray, surprise: float
    ) -> "OdometryCalibration":
        """The calibration after one more motion.

        Args:
            increment: ``(D,)`` by odometry.
            error: ``(D,)`` the estimated motion minus the increment.
            surprise: normalised error squared: the squared difference between estimated and
                corrected motion over its expectation; 1 on average where the noise is right.
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
