"""The prior p(x_t | H_t-1, m_t) of one frame as a density, not only as samples.

The paper draws one sample of the motion model for each particle. A proposal that looks at the image
(``proposal``) draws states from elsewhere, and their weights need the prior's density there
(marginal particle filter, Klaas, de Freitas, Doucet 2005): a mixture of the motion model's normal
distributions around the moved particles. A part of it, ``anywhere_share``, is uniform over the
region: all of it when nobody knows where the robot is, a little when it may have been carried away
(sensor resetting; Thrun, Burgard, Fox, *Probabilistic Robotics*, section 8.3.3).

Odometry moves the particles, less the systematic errors that have been learnt of it
(``odometry_calibration``). Where nobody knows the motion, a constant velocity model takes it to go
on as between the last two images, and the prior is widened until the image is explained.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.belief import Belief, Region
from pipelines.localize.motion import checked_increment
from pipelines.localize.odometry_calibration import uncalibrated
from pipelines.localize.resampling import resample
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import StateSpace, magnitudes, sigmas_of
from pipelines.native import log_mixture_density

# Noise below this would make the density a row of needles; metres and radians.
SMALLEST_POSITION_SIGMA, SMALLEST_ANGLE_SIGMA = 1e-3, 1e-3
# Pairs of states are evaluated in chunks of so many, so that memory stays bounded.
PAIRS_IN_A_CHUNK = 4_000_000
# Standard deviation of the constant velocity model, as a share of the motion that goes on.
SPEED_CHANGE = 0.5
# The prior is widened by this factor, so often, at most to this angle: a hand rotates a camera by
# half its view between two images.
WIDENING, WIDENINGS = 4.0, 2
LARGEST_WALK_ANGLE = math.pi / 2.0
# Where nobody knows the motion the body may be anywhere with this probability, twice that once the
# prior is widened.
UNKNOWN_MOTION_SHARE = 0.1
# Standard deviation of an estimate, metres and radians: what two of them contribute to the error of
# the motion between them.
ESTIMATE_POSITION, ESTIMATE_ANGLE = 0.02, math.radians(0.5)


@dataclass(frozen=True)
class Prediction:
    """Where the body may be before the image is looked at.

    Attributes:
        space: what a state is.
        centres: ``(N, D)`` the particles of the last frame, moved without noise.
        log_weights: ``(N,)`` normalised.
        position_sigma: standard deviation of the motion's noise along each axis, metres.
        angle_sigma: standard deviation of its noise in each angle, radians.
        region: where the body may be if it was carried away.
        anywhere_share: probability of that, 0 to 1.
        motion: ``(D,)`` the measured motion, without odometry's known errors; None: before the
            first image, or nobody knows.
        is_start: whether no image has come before.
    """

    space: StateSpace
    centres: FloatArray
    log_weights: FloatArray
    position_sigma: float
    angle_sigma: float
    region: Region
    anywhere_share: float
    motion: FloatArray | None = None
    is_start: bool = False

    @property
    def is_walk(self) -> bool:
        """Whether a belief is carried on without knowing the motion."""
        return self.motion is None and not self.is_start

    @property
    def is_search(self) -> bool:
        """Whether there is a reason to search everywhere, beyond the motion being unknown."""
        return self.is_start or self.anywhere_share > (
            UNKNOWN_MOTION_SHARE if self.is_walk else 0.0
        )

    def sample(self, count: int, scheme: str, rng: np.random.Generator) -> FloatArray:
        """Draws ``(count, D)`` states; the uniform part gets its share of them exactly.

        Args:
            count: how many.
            scheme: how particles are resampled, a key of ``resampling.SCHEMES``.
            rng: source of the draws.
        """
        anywhere = round(self.anywhere_share * count)
        uniform = self.region.sample(self.space, anywhere, rng)
        if anywhere == count:
            return uniform
        chosen = self.centres[resample(self.log_weights, count - anywhere, scheme, rng)]
        spread = sigmas_of(self.space, self.position_sigma, self.angle_sigma)
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
        chunk = max(1, PAIRS_IN_A_CHUNK // len(self.centres))
        near = np.concatenate(
            [
                self._log_density_of_motion(states[start : start + chunk])
                for start in range(0, len(states), chunk)
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

    def widened(self, anywhere_share: float) -> "Prediction":
        """The prior when the image does not fit where the body was thought to be.

        Args:
            anywhere_share: probability that it is anywhere in the region; more where the motion is
                unknown.
        """
        return replace(
            self,
            position_sigma=WIDENING * self.position_sigma,
            angle_sigma=min(WIDENING * self.angle_sigma, LARGEST_WALK_ANGLE),
            anywhere_share=max(anywhere_share, 2.0 * UNKNOWN_MOTION_SHARE),
        )


class MotionPredictor:
    """Carries beliefs on by the motion between images, and learns how odometry errs.

    Args:
        space: what a state is.
        region: where the body may be.
        settings: of the particle filter: motion model, start pose and its uncertainty.
    """

    def __init__(self, space: StateSpace, region: Region, settings: LocalizerSettings) -> None:
        self._space = space
        self._region = region
        self._settings = settings
        self._calibration = uncalibrated(space.dimension)
        self._increment: FloatArray | None = None
        self._velocity: FloatArray | None = None
        self._estimate: FloatArray | None = None
        self._last_estimate: FloatArray | None = None

    def start(self) -> Prediction:
        """Before the first image: around the start pose, or anywhere."""
        settings, space = self._settings, self._space
        start = np.zeros(space.dimension) if settings.start is None else np.array(settings.start)
        return Prediction(
            space,
            start[None],
            np.zeros(1),
            settings.start_position_sigma,
            settings.start_heading_sigma,
            self._region,
            1.0 if settings.start is None else 0.0,
            is_start=True,
        )

    def predicted(
        self, belief: Belief, increment: FloatArray | None, anywhere_share: float
    ) -> Prediction:
        """After the motion since the image before.

        Args:
            belief: after that image.
            increment: ``(D,)`` as odometry measured it, in the body's frame; None: nobody knows.
            anywhere_share: probability that the body is anywhere in the region instead.
        """
        space = self._space
        self._increment = checked_increment(space, increment)
        self._last_estimate, self._estimate = self._estimate, None
        centres, motion, scale = belief.states, None, 1.0
        position_sigma, angle_sigma = self._settings.motion.standard_deviations(space, increment)
        if self._increment is not None:
            motion = self._calibration.corrected(self._increment)
            centres = space.composed(centres, motion)
            scale = self._calibration.noise_scale
        elif self._velocity is not None:
            centres = space.composed(centres, self._velocity)
            metres, radians = magnitudes(space, self._velocity)
            position_sigma = max(position_sigma, SPEED_CHANGE * metres)
            angle_sigma = max(angle_sigma, SPEED_CHANGE * radians)
        return Prediction(
            space,
            centres,
            belief.log_weights,
            scale * position_sigma,
            scale * angle_sigma,
            self._region,
            anywhere_share,
            motion,
        )

    def learn(self, estimate: FloatArray) -> None:
        """Compares the motion between two estimates with odometry; without any, keeps it.

        Args:
            estimate: ``(D,)`` the best of this frame.
        """
        space, before, increment = self._space, self._last_estimate, self._increment
        self._estimate = estimate
        if before is None:
            return
        poses = space.poses(np.stack([before, estimate]))
        moved = space.increment(poses[0], poses[1])
        if increment is None:
            self._velocity = moved
            return
        error = space.difference(moved, increment)
        left = error - self._calibration.correction @ increment
        sigmas = sigmas_of(space, *self._settings.motion.standard_deviations(space, increment))
        expected = sigmas**2 + sigmas_of(space, ESTIMATE_POSITION, ESTIMATE_ANGLE) ** 2
        surprise = float(np.mean(left**2 / expected))
        self._calibration = self._calibration.learned(increment, error, surprise)
