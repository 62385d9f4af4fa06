"""The localizer: image and odometry in, belief and estimates out, frame by frame.

A frame's way: the image is prepared (``observation``), a strategy carries the belief on
(``strategies``, ``informed``), and from the belief come the estimates, their covariance, and
whether they can be relied on.
"""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from pipelines.artifacts.array_types import BoolArray, FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.camera import Camera
from pipelines.lightfield.proxy import Quality, quality_named
from pipelines.lightfield.renderer import Renderer
from pipelines.lightfield.scene import Scene
from pipelines.localize.belief import Belief, Region, effective_sample_size, region_of_area
from pipelines.localize.estimate import (
    Mode,
    confidence,
    find_modes,
    max_weight_state,
    mean_state,
    modes_table,
)
from pipelines.localize.informed import Informed
from pipelines.localize.likelihood import Comparison
from pipelines.localize.motion import checked_increment
from pipelines.localize.observation import Observations, Observer
from pipelines.localize.refinement import Refined
from pipelines.localize.run import FrameRecord
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import state_space_of_dimension
from pipelines.localize.strategies import CoarseToFine, Condensation, Strategy

# The view at the estimate explains the image worse than this (correlation): the robot is lost.
LOST_MATCH = 0.3
# One mode holds this share of the weight and is narrower than this: the search is over.
TRACKING_SHARE = 0.9
TRACKING_POSITION, TRACKING_HEADING = 0.35, math.radians(10.0)
# Errors of the model (reflections, a surface that is not quite there) reach farther than a tile of
# the image: the alignment's standard deviations times this cover the truth as often as they should.
MODEL_ERROR = 3.3
# Photos are kept at so many times the width of the finest comparison.
VIEW_RESOLUTION_FACTOR = 4
# A hand-held camera may be so many metres from where the recorded views were.
AROUND_VIEWS = 0.5


Result = TypeVar("Result")


class Localizer:
    """Follows one body through one scene.

    Args:
        scene: the light field.
        camera: of the robot; need not be the one that recorded the scene.
        body_from_camera: ``(4, 4)`` its mount on the robot; the identity where the camera is the
            body.
        settings: the filter's settings.
        rng: the only source of randomness.
        renderer: of the scene; made here when None.
        mask: ``(height, width)``, True where the camera's images as recorded are to be used; None:
            everywhere.

    Raises:
        OptionError: an area that does not touch the scene's bounds, or a mask that does not go with
            the camera.
    """

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        body_from_camera: FloatArray,
        settings: LocalizerSettings,
        rng: np.random.Generator,
        renderer: Renderer | None = None,
        mask: BoolArray | None = None,
    ) -> None:
        self.settings = settings
        self.space = settings.state_space
        self._camera = camera
        self._observer = Observer(camera, settings.widths, mask)
        if renderer is None:
            renderer = Renderer.of_scene(
                scene,
                VIEW_RESOLUTION_FACTOR * settings.fine_width,
                settings.blending,
                quality_named(settings.quality, bool(scene.depth), Quality.MEDIUM),
                settings.threads,
                settings.device,
            )
        self._comparison = Comparison(renderer, self.space, body_from_camera, settings.likelihood)
        region = region_of(scene, settings)
        views = scene.world_from_camera
        self._strategy = _strategy(self._comparison, region, views, settings, rng)
        self._is_searching = settings.start is None

    def step(
        self,
        image: ImageArray,
        odometry_increment: FloatArray | None = None,
        timestamp: float = 0.0,
        image_name: str = "",
        hypotheses: FloatArray | None = None,
    ) -> FrameRecord:
        """Takes one camera image and the motion since the one before.

        Args:
            image: ``(height, width, 3)`` RGB as recorded.
            odometry_increment: ``(D,)``: metres along the body's axes and radians about them (for
                a robot on the floor: forward, left, counter-clockwise), in the body's frame before
                the motion; None: nobody knows, a random walk. Not used for the first image.
            timestamp: seconds, kept in the record.
            image_name: kept in the record.
            hypotheses: ``(K, D)`` states worth a look, found by other means (``informed`` only).

        Returns:
            The belief, the estimates drawn from it, and how sure they are.

        Raises:
            OptionError: an image of another size than the camera, or a motion that is not finite.
        """
        # Before anything is remembered of the image: what is refused leaves no trace.
        motion = checked_increment(self.space, odometry_increment)
        seconds: dict[str, float] = {}
        observations = _timed(seconds, "prepare", lambda: self._observer(image))
        belief = _timed(
            seconds, "filter", lambda: self._strategy.update(observations, motion, hypotheses)
        )
        record = _timed(
            seconds,
            "estimate",
            lambda: self._concluded(belief, observations, timestamp, image_name),
        )
        return replace(record, seconds=seconds)

    def _concluded(
        self, belief: Belief, observations: Observations, timestamp: float, image_name: str
    ) -> FrameRecord:
        """Estimates, their covariance, and whether they can be relied on."""
        modes = find_modes(belief)
        main = modes[0]
        best = max_weight_state(belief)
        effective = effective_sample_size(belief.log_weights)
        self._is_searching = self._is_searching and not _is_settled(main)
        match = 0.0
        if not observations.is_blind:
            observation = observations.by_width[self.settings.fine_width]
            match = self._comparison.match(np.stack([best, main.state]), observation)
        status = self._status(observations, match)
        estimates: dict[str, FloatArray] = {}
        refined = None
        if status != "lost":
            estimates = {"max_weight": best, "mean": mean_state(belief), "mode": main.state}
        if status == "tracking":
            refined = self._refined(main, observations)
            if refined is not None:
                estimates["refined"] = refined.state
            self._strategy.learn(main.state if refined is None else refined.state)
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
            refined_covariance=None if refined is None else refined.covariance,
        )

    def _status(self, observations: Observations, match: float) -> str:
        if self._is_searching:
            return "global"
        if observations.is_blind:
            return "blind"
        return "lost" if match < LOST_MATCH else "tracking"

    def _refined(self, main: Mode, observations: Observations) -> Refined | None:
        """The main mode aligned with the image; None where that leads nowhere or elsewhere."""
        settings = self.settings
        if settings.refine_width == 0:
            return None
        widths = [width for width in settings.widths if width >= settings.fine_width]
        refined = self._comparison.aligned(main.state, observations, widths)
        if not math.isfinite(refined.error):
            return None
        positions, angles = self.space.positions, self.space.angles
        offset = self.space.difference(refined.state, main.state)
        metres = float(np.linalg.norm(offset[:positions]))
        radians = float(np.linalg.norm(offset[positions:]))
        # Another place is not a finer answer to the same question.
        if metres > TRACKING_POSITION or radians > TRACKING_HEADING:
            return None
        sigmas = [settings.map_position_sigma] * positions + [settings.map_heading_sigma] * angles
        covariance = MODEL_ERROR**2 * refined.covariance + np.diag(np.square(sigmas))
        return replace(refined, covariance=covariance)


def region_of(scene: Scene, settings: LocalizerSettings) -> Region:
    """Where the body may be.

    Raises:
        OptionError: the area does not touch what the scene covers.
    """
    space = settings.state_space
    bounds = np.asarray(scene.bounds, dtype=np.float64)
    area = bounds if settings.area is None else np.array(settings.area)
    if area[0] >= bounds[1] or area[1] <= bounds[0] or area[2] >= bounds[3] or area[3] <= bounds[2]:
        raise OptionError(
            "the area lies outside of the scene model, which covers "
            f"x {bounds[0]:.2f} to {bounds[1]:.2f} m, y {bounds[2]:.2f} to {bounds[3]:.2f} m"
        )
    if space.positions == 2:
        return region_of_area(area)
    centres = scene.world_from_camera[:, :3, 3]
    low, high = centres.min(axis=0) - AROUND_VIEWS, centres.max(axis=0) + AROUND_VIEWS
    if settings.area is not None:
        low[:2], high[:2] = area[[0, 2]], area[[1, 3]]
    return Region(low, high)


def _strategy(
    comparison: Comparison,
    region: Region,
    world_from_camera: FloatArray,
    settings: LocalizerSettings,
    rng: np.random.Generator,
) -> Strategy:
    if settings.strategy == "condensation":
        return Condensation(comparison, region, settings, rng)
    if settings.strategy == "coarse_to_fine":
        return CoarseToFine(comparison, region, settings, rng)
    return Informed(comparison, region, world_from_camera, settings, rng)


def _is_settled(main: Mode) -> bool:
    """Whether one narrow mode holds nearly all of the weight."""
    positions = state_space_of_dimension(len(main.covariance)).positions
    variances = np.diag(main.covariance)
    position = math.sqrt(float(variances[:positions].sum()))
    heading = math.sqrt(float(variances[positions:].sum()))
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
