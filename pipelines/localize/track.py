"""The Kalman filter that joins alignments and odometry on the tangent space of a state.

An alignment moves a state until the rendered view fits the image best, and knows nothing of the
images before. Odometry links the images. The filter's prediction is the motion model's, its
measurement the alignment (Thrun, Burgard, Fox, *Probabilistic Robotics*, chapter 3).

In front of a wall a step aside and a rotation back look almost the same, and an alignment may end
decimetres away. The consistency gate is the normalised innovation squared (Bar-Shalom, Li,
Kirubarajan 2001, *Estimation with Applications to Tracking and Navigation*, section 5.4): an
alignment farther from the prediction than both covariances allow has ended in another minimum. An
alignment with the prediction as its prior (an iterated extended Kalman filter) stays in the nearest
one. After several rejected images in a row the track is not to be relied on: odometry errs.
"""

from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.alignment import Alignment, Prior
from pipelines.localize.consistency import chi_square_quantile
from pipelines.localize.state_space import StateSpace

# An alignment is rejected when a right one would be nearer with this probability.
GATE = 0.999
# After so many rejected alignments in a row odometry is wrong, or the track.
MOST_REJECTED = 6
# Alignments err by far more than usual now and then: in another minimum, beside a person, at the
# map's border. So their errors have heavier tails than a normal distribution, about those of
# Student's t with nine degrees of freedom, whose 95 % region has this factor in its covariance.
HEAVY_TAILS = 1.5
# Step of the numerical derivative of the motion, metres and radians.
STEP = 1e-5


@dataclass(frozen=True)
class Track:
    """A tracked state.

    Attributes:
        state: ``(D,)``.
        covariance: ``(D, D)`` of its error, without the map's own.
        rejected: how many alignments in a row were rejected.
        measured: ``(D,)`` state by the last image alone; None where it was not accepted.
        blur: factor on the covariance for errors that are common to successive images.
    """

    state: FloatArray
    covariance: FloatArray
    rejected: int = 0
    measured: FloatArray | None = None
    blur: float = 1.0

    @property
    def usual_covariance(self) -> FloatArray:
        """``(D, D)`` of the usual error, without the map's own: what is common included."""
        return self.blur * self.covariance

    @property
    def stated_covariance(self) -> FloatArray:
        """``(D, D)`` whose normal 95 % region holds the state as often, without the map's error."""
        return HEAVY_TAILS * self.usual_covariance

    def predicted(self, space: StateSpace, motion: FloatArray, sigmas: FloatArray) -> "Track":
        """After a motion.

        Args:
            space: what a state is.
            motion: ``(D,)`` in the body's frame.
            sigmas: ``(D,)`` standard deviations of its noise, metres and radians.
        """
        state = space.composed(self.state[None], motion)[0]
        steps = space.moved(
            np.repeat(self.state[None], space.dimension, axis=0), STEP * np.eye(space.dimension)
        )
        columns = space.difference(space.composed(steps, motion), state) / STEP
        covariance = columns.T @ self.covariance @ columns + np.diag(sigmas**2)
        covariance = 0.5 * (covariance + covariance.T)
        return replace(self, state=state, covariance=covariance, measured=None)

    def prior(self, inflation: float) -> Prior:
        """What it says of the state before an image is aligned.

        Args:
            inflation: factor on the covariance that the image's own tiles give an alignment.
        """
        information = np.asarray(np.linalg.inv(self.covariance), dtype=np.float64)
        return Prior(self.state, information, inflation)

    def accepts(self, space: StateSpace, aligned: Alignment, inflation: float) -> bool:
        """Whether an alignment by the image alone passes the consistency gate.

        Args:
            space: what a state is.
            aligned: without a prior.
            inflation: factor on its covariance.
        """
        innovation = space.difference(aligned.state, self.state)
        total = self.covariance + inflation * aligned.covariance
        return bool(
            innovation @ np.linalg.solve(total, innovation)
            <= chi_square_quantile(GATE, space.dimension)
        )

    def updated(self, space: StateSpace, aligned: Alignment, inflation: float) -> "Track":
        """After an alignment by the image alone that was accepted.

        Args:
            space: what a state is.
            aligned: without a prior.
            inflation: factor on its covariance.
        """
        innovation = space.difference(aligned.state, self.state)
        total = self.covariance + inflation * aligned.covariance
        state = space.moved(self.state, self.covariance @ np.linalg.solve(total, innovation))
        left = self.covariance - self.covariance @ np.linalg.solve(total, self.covariance)
        return Track(state, 0.5 * (left + left.T), 0, aligned.state)

    def held(self, space: StateSpace, aligned: Alignment) -> "Track":
        """After an image whose own alignment was rejected.

        Args:
            space: what a state is.
            aligned: with ``prior``.
        """
        innovation = space.difference(aligned.state, self.state)
        distance = innovation @ np.linalg.solve(self.covariance, innovation)
        if not aligned.converged or float(distance) > chi_square_quantile(GATE, space.dimension):
            return self.without_image()
        return Track(aligned.state, aligned.covariance, self.rejected + 1)

    def without_image(self) -> "Track":
        """After an image that was rejected."""
        return replace(self, rejected=self.rejected + 1)
