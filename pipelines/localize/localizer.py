"""The particle filter: image and odometry in, belief and estimates out, frame by frame.

Two strategies share the recursion of the paper's equation (2):

``condensation`` is the paper's filter, step by step: draw particles with probability proportional
to their weights, move each by a sample of the motion model, weight it with the likelihood of the
image, normalise; the number of particles is constant and the estimate is the heaviest one.

``coarse_to_fine`` finds the robot from anywhere: it starts with many particles and small images,
keeps the likelihood from killing all but one of them, spreads what it duplicates, and shrinks the
number of particles as the belief narrows.
"""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from pipelines.artifacts.array_types import FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.camera import Camera, Undistorter
from pipelines.geometry.pose import wrap_angle
from pipelines.lightfield.proxy import Quality, quality_named
from pipelines.lightfield.renderer import Renderer
from pipelines.lightfield.scene import Scene
from pipelines.localize.belief import (
    Belief,
    effective_sample_size,
    gaussian_belief,
    normalise_log_weights,
    uniform_belief,
)
from pipelines.localize.estimate import (
    Mode,
    confidence,
    find_modes,
    max_weight_state,
    mean_state,
    modes_table,
)
from pipelines.localize.likelihood import (
    Observation,
    costs_of_states,
    image_match,
    observe,
    tempered,
)
from pipelines.localize.motion import predict
from pipelines.localize.population import next_count, roughened
from pipelines.localize.resampling import resample
from pipelines.localize.run import FrameRecord
from pipelines.localize.settings import LocalizerSettings

# The view at the estimate explains the image worse than this (correlation): the robot is lost.
LOST_MATCH = 0.3
# One mode holds this share of the weight and is narrower than this: the search is over.
TRACKING_SHARE = 0.9
TRACKING_POSITION, TRACKING_HEADING = 0.35, math.radians(10.0)
# Photos are kept at so many times the width of the finest comparison.
VIEW_RESOLUTION_FACTOR = 4


Result = TypeVar("Result")


class Localizer:
    """Follows one robot through one scene.

    The state is planar: x, y on the ground and the heading; the camera sits on its mount.

    Args:
        scene: the light field.
        camera: of the robot; need not be the one that recorded the scene.
        base_from_camera: ``(4, 4)`` its mount on the robot.
        settings: the filter's settings.
        rng: the only source of randomness.
        renderer: of the scene; made here when None.

    Raises:
        OptionError: an area that does not touch the scene's bounds.
    """

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        base_from_camera: FloatArray,
        settings: LocalizerSettings,
        rng: np.random.Generator,
        renderer: Renderer | None = None,
    ) -> None:
        self.settings = settings
        self._camera = camera
        self._base_from_camera = base_from_camera
        self._undistorter = Undistorter(camera)
        self._rng = rng
        if renderer is None:
            renderer = Renderer.of_scene(
                scene,
                VIEW_RESOLUTION_FACTOR * settings.fine_width,
                settings.blending,
                quality_named(settings.quality, bool(scene.depth), Quality.MEDIUM),
                settings.threads,
            )
        self._renderer = renderer
        self._belief = self._start(scene)
        self._drawn = self._belief
        self._is_first = True
        self._is_searching = settings.start is None

    @property
    def belief(self) -> Belief:
        """The belief after the last image, before resampling."""
        return self._belief

    def step(
        self,
        image: ImageArray,
        odometry_increment: FloatArray | None = None,
        timestamp: float = 0.0,
        image_name: str = "",
    ) -> FrameRecord:
        """Takes one camera image and the motion since the one before.

        Args:
            image: ``(height, width, 3)`` RGB as recorded.
            odometry_increment: ``(3,)``: metres forward, metres to the left and radians
                counter-clockwise, in the robot's frame before the motion; None: it did not move, or
                nobody knows (for the first image it is not used).
            timestamp: seconds, kept in the record.
            image_name: kept in the record.

        Returns:
            The belief, the estimates drawn from it, and how sure they are.

        Raises:
            OptionError: an image of another size than the camera, or a motion that is not finite.
        """
        seconds: dict[str, float] = {}
        width = self.settings.fine_width
        if self._is_coarse():
            width = self.settings.coarse_width
        observation = _timed(
            seconds, "prepare", lambda: observe(image, self._camera, self._undistorter, width)
        )
        states = _timed(seconds, "motion", lambda: self._predicted(odometry_increment))
        self._belief = _timed(seconds, "likelihood", lambda: self._weighted(states, observation))
        record = _timed(
            seconds,
            "estimate",
            lambda: self._concluded(observation, timestamp, image_name),
        )
        self._drawn = _timed(seconds, "resampling", self._resampled)
        self._is_first = False
        return replace(record, seconds=seconds)

    def _start(self, scene: Scene) -> Belief:
        settings = self.settings
        count = settings.start_particles if settings.is_coarse_to_fine else settings.particles
        if settings.start is not None:
            state = np.array(settings.start, dtype=np.float64)
            return gaussian_belief(
                state,
                settings.start_position_sigma,
                settings.start_heading_sigma,
                settings.particles,
                self._rng,
            )
        area = scene.bounds if settings.area is None else np.array(settings.area)
        low_x, high_x, low_y, high_y = scene.bounds
        if area[0] >= high_x or area[1] <= low_x or area[2] >= high_y or area[3] <= low_y:
            raise OptionError(
                "the area lies outside of the scene model, which covers "
                f"x {low_x:.2f} to {high_x:.2f} m, y {low_y:.2f} to {high_y:.2f} m"
            )
        return uniform_belief(area, count, self._rng)

    def _is_coarse(self) -> bool:
        enough = 4 * self.settings.particles
        return self.settings.is_coarse_to_fine and len(self._drawn) > enough

    def _predicted(self, increment: FloatArray | None) -> FloatArray:
        """Samples of p(x_t | x_t-1, m_t): every particle moved by odometry and noise."""
        states = self._drawn.states
        if self._is_first:
            return states
        motion = np.zeros(3) if increment is None else np.asarray(increment, dtype=np.float64)
        if motion.shape != (3,) or not np.all(np.isfinite(motion)):
            raise OptionError(f"odometry increment {motion} is not three finite numbers")
        moved = predict(states, motion, self.settings.motion, self._rng)
        if not self.settings.is_coarse_to_fine:
            return moved
        return roughened(moved, self.settings.roughening, self._rng)

    def _weighted(self, states: FloatArray, observation: Observation) -> Belief:
        """The prior weights times the likelihood of the image."""
        settings = self.settings
        costs = costs_of_states(
            self._renderer, states, self._base_from_camera, observation, settings.likelihood
        )
        log_likelihoods = -settings.likelihood.sharpness * costs
        prior = self._drawn.log_weights
        if settings.is_coarse_to_fine:
            log_weights, _ = tempered(prior, log_likelihoods, settings.smallest_effective_share)
        else:
            log_weights, _ = normalise_log_weights(prior + log_likelihoods)
        return Belief(states, log_weights)

    def _concluded(
        self, observation: Observation, timestamp: float, image_name: str
    ) -> FrameRecord:
        """Estimates, their covariance, and whether they can be relied on."""
        belief = self._belief
        modes = find_modes(belief)
        main = modes[0]
        best = max_weight_state(belief)
        match = max(
            image_match(self._renderer, state, self._base_from_camera, observation)
            for state in (best, main.state)
        )
        effective = effective_sample_size(belief.log_weights)
        self._is_searching = self._is_searching and not _is_settled(main)
        status = "global" if self._is_searching else "tracking"
        estimates = {"max_weight": best, "mean": mean_state(belief), "mode": main.state}
        if match < LOST_MATCH and not self._is_searching:
            status, estimates = "lost", {}
        return FrameRecord(
            timestamp=timestamp,
            image_name=image_name,
            particles=belief.states,
            log_weights=belief.log_weights,
            estimates=estimates,
            modes=modes_table(modes),
            covariance=main.covariance,
            effective_sample_size=effective,
            confidence=confidence(effective, main.covariance, main.share, match),
            status=status,
            seconds={},
        )

    def _resampled(self) -> Belief:
        """Particles drawn with probability proportional to their weights."""
        settings, belief = self.settings, self._belief
        count = settings.particles
        if settings.is_coarse_to_fine:
            count = next_count(belief, settings.particles, settings.shrink_factor)
            enough = settings.resampling_threshold * len(belief)
            if count == len(belief) and effective_sample_size(belief.log_weights) > enough:
                return belief
        indices = resample(belief.log_weights, count, settings.resampling, self._rng)
        states = belief.states[indices]
        states[:, 2] = wrap_angle(states[:, 2])
        return Belief(states, np.full(count, -math.log(count)))


def _is_settled(main: Mode) -> bool:
    """Whether one narrow mode holds nearly all of the weight."""
    position = math.sqrt(float(main.covariance[0, 0] + main.covariance[1, 1]))
    heading = math.sqrt(float(main.covariance[2, 2]))
    return (
        main.share >= TRACKING_SHARE
        and position <= TRACKING_POSITION
        and heading <= TRACKING_HEADING
    )


def _timed(seconds: dict[str, float], name: str, work: Callable[[], Result]) -> Result:
    """Runs ``work`` and notes its wall time."""
    start = time.perf_counter()
    result = work()
    seconds[name] = time.perf_counter() - start
    return result
