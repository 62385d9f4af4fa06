"""The track: what alignments and odometry say together about where a followed body is.

An alignment moves a state until the rendered view fits the image best, and knows nothing of the
images before. Between images stands odometry. Both are joined by a Kalman filter on the tangent
space of a state (Thrun, Burgard, Fox, *Probabilistic Robotics*, chapter 3): its prediction is the
motion model's, its measurement the alignment.

In front of a wall a step aside and a turn back look almost the same, and an alignment may end
decimetres away. The gate is the normalised innovation squared (Bar-Shalom, Li, Kirubarajan 2001,
*Estimation with Applications to Tracking and Navigation*, section 5.4): an alignment farther from
the prediction than both covariances allow has ended in another minimum. The image is then aligned
once more with the prediction as its prior (an iterated extended Kalman filter), which stays in the
nearest one. After several such images running the track is given up: it is odometry that errs.
"""

from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.alignment import Prior, Refined
from pipelines.localize.consistency import chi_square_quantile
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
        measured: ``(D,)`` where the last image alone had the body; None where it was not accepted.
        blur: factor on the covariance for errors that are common to successive images.
    """

    state: FloatArray
    covariance: FloatArray
    rejected: int = 0
    measured: FloatArray | None = None
    blur: float = 1.0

    def predicted(self, space: StateSpace, motion: FloatArray, sigmas: FloatArray) -> "Track":
        """After a motion ``(D,)`` in the body's frame with noise ``(D,)`` along each axis."""
        state = space.composed(self.state[None], motion)[0]
        steps = space.moved(
            np.repeat(self.state[None], space.dimension, axis=0), STEP * np.eye(space.dimension)
        )
        columns = space.difference(space.composed(steps, motion), state) / STEP
        covariance = columns.T @ self.covariance @ columns + np.diag(sigmas**2)
        covariance = 0.5 * (covariance + covariance.T)
        return replace(self, state=state, covariance=covariance, measured=None)

    def prior(self, doubt: float) -> Prior:
        """What it says of the state before an image is aligned; see ``Prior``."""
        information = np.asarray(np.linalg.inv(self.covariance), dtype=np.float64)
        return Prior(self.state, information, doubt)

    def accepts(self, space: StateSpace, aligned: Refined, doubt: float) -> bool:
        """Whether an alignment by the image alone ended where a right one may.

        Args:
            space: what a state is.
            aligned: without a prior.
            doubt: factor on its variances.
        """
        innovation = space.difference(aligned.state, self.state)
        total = self.covariance + doubt * aligned.covariance
        return bool(
            innovation @ np.linalg.solve(total, innovation)
            <= chi_square_quantile(GATE, space.dimension)
        )

    def updated(self, space: StateSpace, aligned: Refined, doubt: float) -> "Track":
        """After an alignment by the image alone that was accepted; see ``accepts``."""
        innovation = space.difference(aligned.state, self.state)
        total = self.covariance + doubt * aligned.covariance
        state = space.moved(self.state, self.covariance @ np.linalg.solve(total, innovation))
        left = self.covariance - self.covariance @ np.linalg.solve(total, self.covariance)
        return Track(state, 0.5 * (left + left.T), 0, aligned.state)

    def held(self, space: StateSpace, aligned: Refined) -> "Track":
        """After an alignment with its prior, where that by the image alone was not accepted."""
        innovation = space.difference(aligned.state, self.state)
        distance = innovation @ np.linalg.solve(self.covariance, innovation)
        if not aligned.converged or float(distance) > chi_square_quantile(GATE, space.dimension):
            return self.without_image()
        return Track(aligned.state, aligned.covariance, self.rejected + 1)

    def without_image(self) -> "Track":
        """After an image that was left out."""
        return replace(self, rejected=self.rejected + 1)
