"""The track: what alignments and odometry say together about where a followed body is.

An alignment moves a state until the rendered view fits the image best, and knows nothing of the
images before. Between images stands odometry. Both are joined by a Kalman filter on the tangent
space of a state (Thrun, Burgard, Fox, *Probabilistic Robotics*, chapter 3): its prediction is the
motion model's, its measurement the alignment.

The gate is the normalised innovation squared (Bar-Shalom, Li, Kirubarajan 2001, *Estimation with
Applications to Tracking and Navigation*, section 5.4). An alignment that lies farther from the
prediction than both their covariances allow has ended in another minimum: in front of a wall, a
step aside and a turn back look almost the same. It is left out, and what odometry says stands,
until several images running agree that it is odometry that errs.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincinv

from pipelines.artifacts.array_types import FloatArray
from pipelines.localize.state_space import StateSpace

# An alignment is left out when a right one would be nearer with this probability.
GATE = 0.999
# So many alignments running that do not fit: odometry is wrong, or the track.
MOST_REJECTED = 6
# Step of the numerical derivative of the motion, metres and radians.
STEP = 1e-5


@dataclass(frozen=True)
class Track:
    """A followed state.

    Attributes:
        state: ``(D,)``.
        covariance: ``(D, D)`` of its error, the map's apart.
        rejected: alignments running that were left out.
    """

    state: FloatArray
    covariance: FloatArray
    rejected: int = 0

    def predicted(self, space: StateSpace, motion: FloatArray, sigmas: FloatArray) -> "Track":
        """After a motion ``(D,)`` in the body's frame with noise ``(D,)`` along each axis."""
        state = space.composed(self.state[None], motion)[0]
        steps = space.moved(
            np.repeat(self.state[None], space.dimension, axis=0), STEP * np.eye(space.dimension)
        )
        columns = space.difference(space.composed(steps, motion), state) / STEP
        covariance = columns.T @ self.covariance @ columns + np.diag(sigmas**2)
        return replace(self, state=state, covariance=0.5 * (covariance + covariance.T))

    def updated(
        self, space: StateSpace, aligned: FloatArray, covariance: FloatArray, explained: float
    ) -> "Track":
        """After an alignment.

        Args:
            space: what a state is.
            aligned: ``(D,)`` where it ended.
            covariance: ``(D, D)`` of its error, as far as the image itself tells.
            explained: how much of the image is explained, 0 to 1; with less of it an alignment
                counts less, but is left out as soon as if all were.

        Returns:
            The track, unchanged where the alignment does not fit; after ``MOST_REJECTED`` of them
            running it begins anew there.
        """
        innovation = space.difference(aligned, self.state)
        distance = np.linalg.solve(self.covariance + covariance, innovation) @ innovation
        covariance = covariance / explained**2
        if float(distance) > _gate(space.dimension):
            if self.rejected + 1 >= MOST_REJECTED:
                return Track(aligned, covariance)
            return replace(self, rejected=self.rejected + 1)
        total = self.covariance + covariance
        weighted = np.linalg.solve(total, innovation)
        state = space.moved(self.state, self.covariance @ weighted)
        left = self.covariance - self.covariance @ np.linalg.solve(total, self.covariance)
        return Track(state, 0.5 * (left + left.T))


def _gate(dimension: int) -> float:
    """Quantile of the chi-square distribution."""
    return float(2.0 * gammaincinv(0.5 * dimension, GATE))
