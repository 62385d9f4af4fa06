"""The localizer: image and odometry in, belief and estimates out, frame by frame.

A frame's way: the image is prepared (``observation``), a strategy carries the belief on
(``strategies``, ``mixture_mcl``), and from the belief come the estimates, their covariance, and
whether they can be relied on.
"""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.camera import Camera
from pipelines.lightfield.scene import Scene
from pipelines.localize.belief import Region, effective_sample_size, region_of_area
from pipelines.localize.confidence import confidence
from pipelines.localize.estimate import (
    Mode,
    max_weight_state,
    mean_state,
    modes_table,
)
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.mixture_mcl import Informed
from pipelines.localize.motion import checked_increment
from pipelines.localize.observation import Observation, Observations, Observer
from pipelines.localize.run import FrameRecord
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import sigmas_of, state_space_of_dimension
from pipelines.localize.strategies import CoarseToFine, Condensation, Strategy, Update
from pipelines.localize.track import MOST_REJECTED, Track

# The body is followed while it is in one place of the map with this probability, all alternatives
# counted (other places, outside of the map), and that place is narrower than this.
TRACKING_PROBABILITY = 0.9
# A body that has not been found yet is followed after so many such images running, or one of which
# this share is explained (``MeasurementModel.explained``); less of it where a start pose is given.
CONFIRMING_IMAGES, CONFIRMING_SHARE, STARTING_SHARE = 2, 0.4, 0.25
# States whose evidence differs by less, or by less than this share, fit an image equally well.
EVEN, EVEN_SHARE = 1.0, 0.03
# It is lost while the image more probably does not show the map at all.
LOST_PROBABILITY = 0.5
TRACKING_POSITION, TRACKING_HEADING = 0.35, math.radians(10.0)
# Errors of the model (reflections, a surface that is not quite there) reach farther than a tile of
# the image: the alignment's standard deviations times this cover the truth as often as they should.
MODEL_ERROR = 2.0
# An image that is the one before does not belong to where the body is once it has moved so far:
# metres and radians.
STALE_POSITION, STALE_ANGLE = 0.01, math.radians(0.3)
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
        model: compares states with images; made here when None.
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
        model: MeasurementModel | None = None,
        mask: BoolArray | None = None,
    ) -> None:
        self.settings = settings
        self.space = settings.state_space
        self._camera = camera
        self._observer = Observer(camera, settings.widths, mask)
        if model is None:
            model = MeasurementModel.of_scene(scene, body_from_camera, settings)
        self._model = model
        region = region_of(scene, settings)
        views = scene.world_from_camera
        self._strategy = _strategy(self._model, region, views, settings, rng)
        self._track: Track | None = None
        self._has_been_found = False
        self._likely_images = 0
        sigmas = sigmas_of(self.space, settings.map_position_sigma, settings.map_heading_sigma)
        self._map_covariance = np.diag(sigmas**2)
        self._moved = np.zeros(self.space.dimension)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of the images so far, a line each."""
        return self._strategy.notes

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
            hypotheses: ``(K, D)`` states worth a look, found by other means (``mixture`` only).

        Returns:
            The belief, the estimates drawn from it, and how sure they are.

        Raises:
            OptionError: an image of another size than the camera, or a motion that is not finite.
        """
        # Before anything is remembered of the image: what is refused leaves no trace.
        motion = checked_increment(self.space, odometry_increment)
        seconds: dict[str, float] = {}
        observations = _timed(seconds, "prepare", lambda: self._observed(image, motion))
        update = _timed(
            seconds, "filter", lambda: self._strategy.update(observations, motion, hypotheses)
        )
        record = _timed(
            seconds,
            "estimate",
            lambda: self._concluded(update, observations, timestamp, image_name),
        )
        return replace(record, seconds=seconds)

    def _observed(self, image: ImageArray, motion: FloatArray | None) -> Observations:
        """The image, and whether it can be of where the body is now."""
        observations = self._observer(image)
        if not observations.is_repeated:
            self._moved = np.zeros(self.space.dimension)
            return observations
        if motion is not None:
            self._moved = self._moved + motion
        p = self.space.positions
        metres, radians = np.linalg.norm(self._moved[:p]), np.linalg.norm(self._moved[p:])
        return replace(
            observations, is_stale=bool(metres > STALE_POSITION or radians > STALE_ANGLE)
        )

    def _concluded(
        self, update: Update, observations: Observations, timestamp: float, image_name: str
    ) -> FrameRecord:
        """Estimates, their covariance, and whether they can be relied on."""
        belief = update.belief
        main = update.modes[0]
        status = self._status(update, main, observations)
        self._track = self._predicted_track(update)
        estimates: dict[str, FloatArray] = {}
        covariance = None
        if status != "lost":
            best = max_weight_state(belief)
            estimates = {"max_weight": best, "mean": mean_state(belief), "mode": main.state}
        if status == "tracking" and self.settings.refine_width > 0:
            self._track = self._followed(main, observations)
            if self._track is not None:
                estimates["refined"] = self._track.state
                covariance = self._track.blur * self._track.covariance + self._map_covariance
        if status == "tracking" and self._track is not None and self._track.measured is not None:
            self._strategy.learn(self._track.measured)
        probability = update.inside * main.share if observations.is_informative else 0.0
        return FrameRecord(
            timestamp=timestamp,
            image_name=image_name,
            particles=belief.states,
            log_weights=belief.log_weights,
            estimates=estimates,
            modes=modes_table(update.modes),
            covariance=main.covariance,
            effective_sample_size=effective_sample_size(belief.log_weights),
            confidence=confidence(
                probability, main.covariance if covariance is None else covariance
            ),
            status=status,
            seconds={},
            refined_covariance=covariance,
        )

    def _is_confirmed(self, main: Mode, observations: Observations) -> bool:
        """Whether more than one image speaks for a place, or one that leaves little unexplained.

        A place may have aliases all over the map, which fit one image tolerably.
        """
        if self._has_been_found:
            return True
        state = self._model.aligned(main.state, observations, self._alignment_widths).state
        if not self._is_same_place(state, main.state):
            state = main.state
        fine = observations.by_width[self.settings.fine_width]
        evidence = self._evidence(state, fine)
        # A place of which the image shows nothing is not spoken for.
        self._likely_images = self._likely_images + 1 if evidence > 0.0 else 0
        least = CONFIRMING_SHARE if self.settings.start is None else STARTING_SHARE
        share = self._model.explained_by(evidence, fine)
        return self._likely_images >= CONFIRMING_IMAGES or share >= least

    def _evidence(self, state: FloatArray, observation: Observation) -> float:
        """What an image says for one state ``(D,)``."""
        return float(self._model.evidence(state[None], observation)[0])

    @property
    def _alignment_widths(self) -> list[int]:
        """Widths of the images, coarse to fine, in which states are aligned."""
        return [width for width in self.settings.widths if width >= self.settings.fine_width]

    def _predicted_track(self, update: Update) -> Track | None:
        """The track after the motion before this image."""
        if self._track is None or update.motion is None:
            return None
        sigmas = sigmas_of(self.space, update.position_sigma, update.angle_sigma)
        return self._track.predicted(self.space, update.motion, sigmas)

    def _followed(self, main: Mode, observations: Observations) -> Track | None:
        """The track after the image; None where neither it nor an alignment is in the main mode."""
        track = self._track
        if track is not None and not (
            track.rejected < MOST_REJECTED and self._is_same_place(track.state, main.state)
        ):
            track = None
        widths = self._alignment_widths
        start, before = main.state, -math.inf
        if track is not None:
            finest = observations.by_width[widths[-1]]
            start, before = self._explained_start(main.state, track, finest)
        aligned = self._model.aligned(start, observations, widths)
        is_usable = math.isfinite(aligned.error) and bool(np.all(np.isfinite(aligned.covariance)))
        # Where light or contents have changed, errors are larger than an image's own tiles tell.
        # Where the image was aligned: at the prediction it would be motion that is not explained.
        images = [observations.by_width[width] for width in widths]
        evidence = [self._evidence(aligned.state, image) for image in images]
        shares = list(map(self._model.explained_by, evidence, images))
        usual = MODEL_ERROR**2
        doubt = usual / shares[0] ** 2
        # A blurred image is explained from afar, but aligned by its blurred details: errors of
        # which the track knows nothing, since they are the same in the next image.
        blur = max(1.0, shares[0] * len(shares) / sum(shares)) ** 2
        if track is None:
            # Another place is not a finer answer to the same question.
            if not (is_usable and self._is_same_place(aligned.state, main.state)):
                return None
            return Track(aligned.state, doubt * aligned.covariance, 0, aligned.state, blur)
        # What is minimised is not what says where the body is: an alignment that loses evidence
        # has given up what fits for a compromise with what does not.
        least = before - _even(before)
        # An image that is explained less counts less, but is left out as soon as any other.
        if is_usable and evidence[-1] >= least and track.accepts(self.space, aligned, usual):
            return replace(track.updated(self.space, aligned, doubt), blur=blur)
        held = self._model.aligned(start, observations, widths, track.prior(doubt))
        if self._evidence(held.state, images[-1]) < least:
            return track.without_image()
        return replace(track.held(self.space, held), blur=blur)

    def _explained_start(
        self, mode: FloatArray, track: Track, observation: Observation
    ) -> tuple[FloatArray, float]:
        """Where an alignment begins, ``(D,)``, and the image's evidence for it.

        That is where the track is predicted, unless the image speaks against that and for the
        particles' mode: wheels that mislead while the camera sees nothing take the track so far
        that an alignment from there would end in another minimum.
        """
        predicted = self._evidence(track.state, observation)
        if predicted < 0.0:
            found = self._evidence(mode, observation)
            if found > _even(predicted):
                return mode, found
        return track.state, predicted

    def _is_same_place(self, state: FloatArray, other: FloatArray) -> bool:
        """Whether two states are not farther apart than a followed mode is wide."""
        offset = self.space.difference(state, other)
        p = self.space.positions
        metres, radians = np.linalg.norm(offset[:p]), np.linalg.norm(offset[p:])
        return bool(metres <= TRACKING_POSITION and radians <= TRACKING_HEADING)

    def _status(self, update: Update, main: Mode, observations: Observations) -> str:
        if observations.is_blind:
            return "blind"
        if observations.is_stale:
            return "stale"
        is_likely = update.inside * main.share >= TRACKING_PROBABILITY and _is_narrow(main)
        if not is_likely:
            self._likely_images = 0
        elif not update.proves_nothing and self._is_confirmed(main, observations):
            self._has_been_found = True
            return "tracking"
        is_search = (update.is_promising or is_likely) and not self._has_been_found
        return "global" if update.inside >= LOST_PROBABILITY or is_search else "lost"


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
    model: MeasurementModel,
    region: Region,
    world_from_camera: FloatArray,
    settings: LocalizerSettings,
    rng: np.random.Generator,
) -> Strategy:
    if settings.strategy == "condensation":
        return Condensation(model, region, settings, rng)
    if settings.strategy == "coarse_to_fine":
        return CoarseToFine(model, region, settings, rng)
    return Informed(model, region, world_from_camera, settings, rng)


def _even(evidence: float) -> float:
    """Differences of evidence that say nothing."""
    return max(EVEN, EVEN_SHARE * abs(evidence))


def _is_narrow(main: Mode) -> bool:
    """Whether a mode is narrow enough to be called a place."""
    positions = state_space_of_dimension(len(main.covariance)).positions
    variances = np.diag(main.covariance)
    position = math.sqrt(float(variances[:positions].sum()))
    heading = math.sqrt(float(variances[positions:].sum()))
    return position <= TRACKING_POSITION and heading <= TRACKING_HEADING


def _timed(seconds: dict[str, float], name: str, work: Callable[[], Result]) -> Result:
    """Runs ``work`` and notes its wall time."""
    start = time.perf_counter()
    result = work()
    seconds[name] = time.perf_counter() - start
    return result
