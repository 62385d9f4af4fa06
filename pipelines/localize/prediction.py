"""The prior p(x_t | H_t-1, m_t) of one frame as a density, not only as samples.

The paper draws one sample of the motion model for each particle. A proposal that looks at the image
(``proposal``) draws states from elsewhere, and their weights need the prior's density there
(marginal particle filter, Klaas, de Freitas, Doucet 2005): a mixture of the motion model's normal
distributions around the moved particles. A part of it, ``anywhere_share``, is uniform over the
region: all of it when nobody knows where the robot is, a little when it may have been carried away
(sensor resetting; Thrun, Burgard, Fox, *Probabilistic Robotics*, section 8.3.3).

Where nobody knows the motion, it is taken to go on as between the last two images, and the prior is
widened until the image is explained. An image that is explained much less than images usually are
proves no place, however much better it fits there than elsewhere: far away something may look like
it.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.belief import Region
from pipelines.localize.resampling import resample
from pipelines.localize.state_space import StateSpace
from pipelines.native import log_mixture_density

# Noise below this would make the density a row of needles; metres and radians.
SMALLEST_POSITION_SIGMA, SMALLEST_ANGLE_SIGMA = 1e-3, 1e-3
# Pairs of states are worked on in blocks of so many, so that memory stays bounded.
PAIRS_TOGETHER = 4_000_000
# The motion goes on as between the last two images, give or take this share of it.
SPEED_CHANGE = 0.5
# While the image does not fit, so many times that is tried, so often, at most as far as this angle:
# a hand turns a camera by half its view in a moment.
SPEED_GROWTH, SPEED_GROWTHS = 4.0, 2
LARGEST_WALK_ANGLE = math.pi / 2.0
# The body may be anywhere with this probability, twice that while the image does not fit. Every
# image is looked up all over the map as well, though more briefly.
UNKNOWN_MOTION_SHARE, UNKNOWN_MOTION_SEARCHED = 0.1, 8
# An image that is explained less than the first share of how well images usually are does not fit
# yet; less than the second, and it proves no place.
FITTING_SHARE, PROVING_SHARE = 0.7, 0.5


@dataclass(frozen=True)
class Prediction:
    """Where the body may be before the image is looked at.

    Attributes:
        space: what a state is.
        centres: ``(N, D)`` the particles of the last frame, moved by odometry without noise.
        log_weights: ``(N,)`` normalised.
        position_sigma: of the motion's noise along each axis, metres.
        angle_sigma: of its angles, radians.
        region: where the body may be if it was carried away.
        anywhere_share: probability of that, 0 to 1.
    """

    space: StateSpace
    centres: FloatArray
    log_weights: FloatArray
    position_sigma: float
    angle_sigma: float
    region: Region
    anywhere_share: float

    def sample(self, count: int, scheme: str, rng: np.random.Generator) -> FloatArray:
        """Draws ``(count, D)`` states; the uniform part gets its share of them exactly."""
        anywhere = round(self.anywhere_share * count)
        uniform = self.space.uniform(self.region.low, self.region.high, anywhere, rng)
        if anywhere == count:
            return uniform
        chosen = self.centres[resample(self.log_weights, count - anywhere, scheme, rng)]
        spread = np.array(
            [self.position_sigma] * self.space.positions + [self.angle_sigma] * self.space.angles
        )
        noise = spread * rng.standard_normal(chosen.shape)
        return np.concatenate([self.space.moved(chosen, noise), uniform])

    def log_density(self, states: FloatArray) -> FloatArray:
        """Logarithm of the density at states ``(M, D)``, a metre^P and radian^A."""
        if len(states) == 0:
            return np.zeros(0)
        with np.errstate(divide="ignore"):
            inside = np.where(self.region.contains(states), 0.0, -np.inf)
            anywhere = inside + math.log(self.anywhere_share or 1e-300)
        anywhere = anywhere + self.region.log_density(self.space)
        if self.anywhere_share >= 1.0:
            return anywhere
        block = max(1, PAIRS_TOGETHER // len(self.centres))
        near = np.concatenate(
            [
                self._log_density_of_motion(states[start : start + block])
                for start in range(0, len(states), block)
            ]
        )
        combined = np.logaddexp(math.log1p(-self.anywhere_share) + near, anywhere)
        return np.asarray(combined if self.anywhere_share > 0.0 else near, dtype=np.float64)

    def _log_density_of_motion(self, states: FloatArray) -> FloatArray:
        space, positions, angles = self.space, self.space.positions, self.space.angles
        position_sigma = max(self.position_sigma, SMALLEST_POSITION_SIGMA)
        angle_sigma = max(self.angle_sigma, SMALLEST_ANGLE_SIGMA)
        densities = log_mixture_density(
            np.ascontiguousarray(states[:, :positions]),
            np.ascontiguousarray(self.centres[:, :positions]),
            space.pair_angles(states, self.centres),
            self.log_weights,
            position_sigma,
            angle_sigma,
        )
        normal = positions * math.log(position_sigma) + angles * math.log(angle_sigma)
        normal += 0.5 * space.dimension * math.log(2.0 * math.pi)
        return np.asarray(densities - normal, dtype=np.float64)


def widened(prediction: Prediction, anywhere_share: float) -> Prediction:
    """The prior when the image does not fit where the body was thought to be."""
    return replace(
        prediction,
        position_sigma=SPEED_GROWTH * prediction.position_sigma,
        angle_sigma=min(SPEED_GROWTH * prediction.angle_sigma, LARGEST_WALK_ANGLE),
        anywhere_share=max(anywhere_share, 2.0 * UNKNOWN_MOTION_SHARE),
    )
