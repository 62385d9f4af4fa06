"""The localizer: image and odometry in, belief and estimates out, frame by frame.

``Localizer.step`` is the recursion of the paper, section 4: particles are resampled in proportion
to their weights, moved by the motion model, and weighted with the image; from them comes the
estimate. A strategy does the first three (``strategies``, ``mixture_mcl``), on an image that
``observation`` has prepared. Status (``status``), refined estimate (``tracking``) and confidence
(``confidence``) are what a posterior is worth to its user.
"""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from pipelines.artifacts.arguments import checked_instance, checked_number
from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray, checked_array
from pipelines.artifacts.errors import OptionError
from pipelines.dataset.dataset import Dataset
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import checked_poses
from pipelines.lightfield.open_world import OpenWorld, checked_scene
from pipelines.lightfield.scene import Scene
from pipelines.localize.area_proof import AreaProof
from pipelines.localize.area_search import AreaSearch
from pipelines.localize.area_window import AreaWindow
from pipelines.localize.belief import Region, effective_sample_size, region_of_area
from pipelines.localize.confidence import confidence
from pipelines.localize.estimate import max_weight_state, mean_state, modes_table
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.mixture_mcl import MixtureProposalMcl
from pipelines.localize.motion import checked_increment
from pipelines.localize.observation import Observations, Observer, camera_and_mount
from pipelines.localize.run import FrameRecord
from pipelines.localize.search import GlobalSearch
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import magnitudes, sigmas_of
from pipelines.localize.status import StatusMonitor
from pipelines.localize.strategies import CoarseToFine, Condensation, Posterior, Strategy
from pipelines.localize.tracking import PoseTracker
from pipelines.render.devices import Device

# A repeated image is stale once the body has moved so far since: metres and radians.
STALE_POSITION, STALE_ANGLE = 0.01, math.radians(0.3)
# A hand-held camera may be so many metres from where the recorded views were.
AROUND_VIEWS = 0.5
NO_PNP = "PnP takes the features of one scene; a world is localized in without"


class Localizer:
    """Follows one body through one scene, by a particle filter.

    The filter of Heigl, Denzler, Niemann (2001), equations (1) and (2): particles are moved by
    odometry, and weighted by comparing the camera image with the view that the light field shows at
    each of them. Search, statuses and confidence go beyond the paper: ``docs/localization.md``.

    Args:
        scene: the light field, or a world of several; or areas of one that are open already.
        camera: of the robot; need not be the one that recorded the scene.
        body_from_camera: ``(4, 4)`` the camera's mount on the robot, metres; the identity where the
            camera is the body.
        settings: of the particle filter; None: the defaults.
        rng: the only source of randomness; None: one of seed 0.
        model: compares states with images; built from the scene when None. Open areas have their
            own.
        mask: ``(height, width)``, True where the camera's images as recorded are to be used; None:
            everywhere.

    Raises:
        OptionError: an area that does not touch the scene's bounds, a mask that does not go with
            the camera, a device or depth maps that are asked for and not there, settings that a
            world does not take, too little memory for one, or an argument of another type or shape.
        InputError: a photo of the scene cannot be decoded.
    """

    def __init__(
        self,
        scene: Scene | OpenWorld | AreaWindow,
        camera: Camera,
        body_from_camera: FloatArray,
        settings: LocalizerSettings | None = None,
        rng: np.random.Generator | None = None,
        model: MeasurementModel | None = None,
        mask: BoolArray | None = None,
    ) -> None:
        settings = LocalizerSettings() if settings is None else settings
        rng = np.random.default_rng(0) if rng is None else rng
        if not isinstance(scene, AreaWindow):
            checked_scene(scene)
        checked_instance(camera, "the camera", Camera)
        checked_instance(settings, "settings", LocalizerSettings)
        checked_instance(rng, "rng", np.random.Generator)
        body_from_camera = checked_poses(body_from_camera, "body_from_camera")
        if model is not None:
            checked_instance(model, "model", MeasurementModel)
        self.settings = settings
        self.space = settings.state_space
        self._observer = Observer(camera, settings.widths, mask)
        self._window: AreaWindow | None = None
        if isinstance(scene, OpenWorld):
            check_world_settings(settings, model)
            scene = AreaWindow(scene, body_from_camera, settings)
        if isinstance(scene, AreaWindow):
            self._window = scene
            scene, model = self._window.world, self._window.model
        elif model is None:
            model = MeasurementModel.of_scene(scene, body_from_camera, settings)
        if settings.refine_width > 0 and model.renderer.threads > 1:
            # A body that is followed needs all of them: they are learnt while it is looked for.
            model.learn_pixels([width for width in settings.widths if width >= settings.fine_width])
        region = region_of(scene, settings)
        if self._window is None:
            search = GlobalSearch(model, region, scene.world_from_camera, settings, rng)
        else:
            search = AreaSearch(self._window, region, settings, camera, mask, rng)
        self._strategy = _strategy(model, region, search, settings, rng)
        is_found = self._window is not None and settings.start is None
        proof = AreaProof(model, settings) if is_found else None
        self._status = StatusMonitor(model, settings, proof)
        self._tracker = PoseTracker(model, settings)
        sigmas = sigmas_of(self.space, settings.map_position_sigma, settings.map_heading_sigma)
        self._map_covariance = np.diag(sigmas**2)
        self._moved = np.zeros(self.space.dimension)

    @classmethod
    def of_dataset(
        cls,
        scene: Scene | OpenWorld,
        dataset: Dataset,
        settings: LocalizerSettings | None = None,
        *,
        seed: int = 0,
        model: MeasurementModel | None = None,
    ) -> "Localizer":
        """A localizer of the camera of a data set, with its mount and mask.

        Args:
            scene: the light field, or a world of several.
            dataset: whose ``camera.toml`` describes the robot; its images are not read.
            settings: of the filter; None: the defaults.
            seed: of the filter's random numbers, not negative.
            model: compares states with images; made here when None.

        Raises:
            InputError: the data set lacks the camera, or the mount that a robot on a floor needs;
                a photo of the scene cannot be decoded.
            OptionError: an area that does not touch the scene's bounds, a device or depth maps that
                are asked for and not there, or an argument of another type.
        """
        settings = LocalizerSettings() if settings is None else settings
        checked_instance(settings, "settings", LocalizerSettings)
        checked_number(seed, "seed", 0, whole=True)
        camera, mount = camera_and_mount(dataset, settings.state_space)
        mask = None if dataset.mask is None else dataset.mask.used
        rng = np.random.default_rng(seed)
        return cls(scene, camera, mount, settings, rng, model, mask)

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
            image: ``(height, width, 3)`` RGB, 8 bits, as recorded (not undistorted). The array may
                be filled anew afterwards.
            odometry_increment: ``(D,)``: metres along the body's axes and radians about them (for
                a robot on the floor: forward, left, counter-clockwise), in the body's frame before
                the motion; None: nobody knows, a random walk. Not used for the first image.
            timestamp: seconds, kept in the record.
            image_name: kept in the record.
            hypotheses: ``(K, D)`` states found by other means, from which the search starts as
                well, in the world, metres and radians (strategy ``mixture`` only).

        Returns:
            The belief, the estimates drawn from it, and how sure they are.

        Raises:
            OptionError: an image of another size than the camera's or that is not of 8 bits, or a
                motion, time or hypotheses that are not finite numbers of these shapes. The filter
                is then as it was before.
        """
        checked_array(timestamp, "timestamp", ())
        checked_instance(image_name, "image name", str)
        if hypotheses is not None:
            states = (None, self.space.dimension)
            hypotheses = checked_array(hypotheses, "hypotheses", states)
        # First, since what is refused must leave no trace.
        motion = checked_increment(self.space, odometry_increment)
        seconds: dict[str, float] = {}
        with _timed(seconds, "prepare"):
            observations = self._observe(image, motion)
        with _timed(seconds, "filter"):
            self._strategy.resample()
            self._strategy.predict(motion)
            posterior = self._strategy.weight(observations, hypotheses)
        with _timed(seconds, "estimate"):
            record = self._estimate(posterior, observations, timestamp, image_name)
        return replace(record, seconds=seconds)

    def _observe(self, image: ImageArray, motion: FloatArray | None) -> Observations:
        """The image, and whether it can be of where the body is now."""
        observations = self._observer(image)
        if not observations.is_repeated:
            self._moved = np.zeros(self.space.dimension)
            return observations
        if motion is not None:
            self._moved = self._moved + motion
        metres, radians = magnitudes(self.space, self._moved)
        return replace(observations, is_stale=metres > STALE_POSITION or radians > STALE_ANGLE)

    def _estimate(
        self, posterior: Posterior, observations: Observations, timestamp: float, image_name: str
    ) -> FrameRecord:
        """Status, estimates, and how sure they are; the times that it took are left open."""
        belief, main = posterior.belief, posterior.modes[0]
        status = self._status.judge(posterior, observations)
        self._tracker.predict(posterior)
        estimates: dict[str, FloatArray] = {}
        if status != "lost":
            best = max_weight_state(belief)
            estimates = {"max_weight": best, "mean": mean_state(belief), "mode": main.state}
        covariance, refined_covariance = main.covariance, None
        if status == "tracking" and self.settings.refine_width > 0:
            track = self._tracker.update(main, observations)
            if track is not None:
                estimates["refined"] = track.state
                # How often errors are small is a matter of the usual ones, not of the tails.
                covariance = track.usual_covariance + self._map_covariance
                refined_covariance = track.stated_covariance + self._map_covariance
            if track is not None and track.measured is not None:
                self._strategy.learn(track.measured)
        probability = self._status.probability(posterior) if observations.is_informative else 0.0
        return FrameRecord(
            timestamp=timestamp,
            image_name=image_name,
            particles=belief.states,
            log_weights=belief.log_weights,
            estimates=estimates,
            modes=modes_table(posterior.modes),
            covariance=main.covariance,
            effective_sample_size=effective_sample_size(belief.log_weights),
            confidence=confidence(probability, covariance),
            status=status,
            seconds={},
            refined_covariance=refined_covariance,
            area_belief=self._area_belief(posterior),
        )

    def _area_belief(self, posterior: Posterior) -> FloatArray | None:
        """Probability ``(A,)`` of each area of a world; what is left is that of none."""
        if self._window is None:
            return None
        belief = posterior.belief
        shares = self._window.world.area_map.shares(belief.states[:, :2], belief.weights)
        return posterior.inside * shares


def check_world_settings(settings: LocalizerSettings, model: MeasurementModel | None) -> None:
    """Refuses what goes with one light field only.

    Raises:
        OptionError: a setting that a world does not take.
    """
    if model is not None:
        raise OptionError("a measurement model is of one scene; a world has one for all its areas")
    if settings.strategy != "mixture":
        raise OptionError(f"a world takes strategy mixture, not {settings.strategy}")
    if settings.uses_pnp:
        raise OptionError(NO_PNP)
    if settings.device is Device.GPU:
        raise OptionError("a world of areas is localized in on the CPU, not on a GPU")


def region_of(scene: Scene | OpenWorld, settings: LocalizerSettings) -> Region:
    """Where the body may be: the scene's free ground or bounds, and the settings' area.

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
    ground = scene.ground
    if ground is not None and settings.area is not None:
        ground = ground.within(area)
        if ground is None:
            raise OptionError("the area holds nothing of the scene model's free ground")
        # The corners enclose every free cell, cut by the area's sides or not.
        area = ground.bounds
    if space.positions == 2:
        return replace(region_of_area(area), ground=ground)
    centres = scene.world_from_camera[:, :3, 3]
    low, high = centres.min(axis=0) - AROUND_VIEWS, centres.max(axis=0) + AROUND_VIEWS
    if settings.area is not None:
        low[:2], high[:2] = area[[0, 2]], area[[1, 3]]
    if ground is not None:
        low[:2], high[:2] = ground.bounds[[0, 2]], ground.bounds[[1, 3]]
    return Region(low, high, ground)


def _strategy(
    model: MeasurementModel,
    region: Region,
    search: GlobalSearch,
    settings: LocalizerSettings,
    rng: np.random.Generator,
) -> Strategy:
    if settings.strategy == "condensation":
        return Condensation(model, region, settings, rng)
    if settings.strategy == "coarse_to_fine":
        return CoarseToFine(model, region, settings, rng)
    return MixtureProposalMcl(model, region, search, settings, rng)


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Notes the wall time of a block."""
    start = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - start
