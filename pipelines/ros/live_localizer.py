"""A localizer that runs on: set to another pose, started again, given another camera."""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.camera import Camera
from pipelines.lightfield.open_world import OpenWorld
from pipelines.lightfield.scene import Scene
from pipelines.localize.area_window import AreaWindow
from pipelines.localize.localizer import Localizer, check_world_settings, region_of
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.run import FrameRecord
from pipelines.localize.settings import LocalizerSettings


@dataclass(frozen=True)
class MountedCamera:
    """A camera on a robot.

    Attributes:
        camera: model and intrinsics.
        base_from_camera: ``(4, 4)`` the mount, metres.
        mask: ``(height, width)``, True where images are to be used; None: everywhere.
    """

    camera: Camera
    base_from_camera: FloatArray
    mask: BoolArray | None = None


class LiveLocalizer:
    """Localizes a robot image by image; odometry is handed over as poses, not as increments.

    Args:
        scene: the light field, or a world of several.
        settings: of the particle filter.
        seed: of the filter's random numbers.
        mounted: the camera; None: handed over by ``mount`` before the first image.

    Raises:
        OptionError: settings that do not go with the scene.
    """

    def __init__(
        self,
        scene: Scene | OpenWorld,
        settings: LocalizerSettings,
        seed: int = 0,
        mounted: MountedCamera | None = None,
    ) -> None:
        if settings.method != "filter" or settings.uses_pnp:
            raise OptionError("a robot is localized by the filter alone: leave out method and PnP")
        if isinstance(scene, OpenWorld):
            check_world_settings(settings, None)
        region_of(scene, settings)
        self.settings = settings
        self.space = settings.state_space
        self._scene, self._seed = scene, seed
        self._start = settings
        self._localizer: Localizer | None = None
        self._mounted: MountedCamera | None = None
        self._shown: AreaWindow | MeasurementModel | None = None
        self._odom_from_base: FloatArray | None = None
        if mounted is not None:
            self.mount(mounted)

    @property
    def is_mounted(self) -> bool:
        """Whether the camera is known."""
        return self._mounted is not None

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of the images so far."""
        return () if self._localizer is None else self._localizer.notes

    def mount(self, mounted: MountedCamera) -> None:
        """Takes another camera; what is known of the pose is forgotten."""
        scene, settings = self._scene, self.settings
        if isinstance(scene, OpenWorld):
            self._shown = AreaWindow(scene, mounted.base_from_camera, settings)
        else:
            self._shown = MeasurementModel.of_scene(scene, mounted.base_from_camera, settings)
        self._mounted = mounted
        self._restart()

    def reset(self) -> None:
        """Starts again as at first: around the settings' start, or anywhere."""
        self._start = self.settings
        self._restart()

    def search(self) -> None:
        """Starts again with a search of the whole area."""
        self._start = replace(self.settings, start=None)
        self._restart()

    def set_pose(self, map_from_base: FloatArray, covariance: FloatArray) -> None:
        """Starts again around a pose.

        Args:
            map_from_base: ``(4, 4)``.
            covariance: ``(6, 6)`` of x, y, z and the rotations about them, metres and radians; all
                zeros: the settings' deviations.

        Raises:
            OptionError: numbers that are no pose or no covariance. Nothing is then changed.
        """
        if not np.all(np.isfinite(map_from_base)) or not np.all(np.isfinite(covariance)):
            raise OptionError("the pose has numbers that are not finite")
        state = tuple(float(value) for value in self.space.states(map_from_base))
        variances = np.diag(covariance)
        if np.any(variances < 0.0):
            raise OptionError("the pose has negative variances")
        settings = self.settings
        position, heading = float(np.sqrt(variances[:2].max())), float(np.sqrt(variances[5]))
        self._start = replace(
            settings,
            start=state,
            start_position_sigma=position or settings.start_position_sigma,
            start_heading_sigma=min(heading, math.pi) or settings.start_heading_sigma,
        )
        self._restart()

    def step(
        self, image: ImageArray, seconds: float, name: str, odom_from_base: FloatArray
    ) -> FrameRecord:
        """Takes an image and the robot's pose by odometry at that moment.

        Args:
            image: ``(height, width, 3)`` RGB, 8 bits.
            seconds: its time.
            name: of the image, for the record.
            odom_from_base: ``(4, 4)`` in odometry's own frame, which drifts.

        Raises:
            OptionError: an image of another size than the camera's, or no camera yet.
        """
        if self._localizer is None:
            raise OptionError("the camera is not known yet")
        increment = None
        if self._odom_from_base is not None:
            increment = self.space.increment(self._odom_from_base, odom_from_base)
        record = self._localizer.step(image, increment, seconds, name)
        self._odom_from_base = odom_from_base
        return record

    def _restart(self) -> None:
        """A new filter from the same seed, with what was decoded and learnt of the map's photos."""
        self._odom_from_base = None
        if self._mounted is None or self._shown is None:
            return
        camera, mount, mask = (
            self._mounted.camera,
            self._mounted.base_from_camera,
            self._mounted.mask,
        )
        rng = np.random.default_rng(self._seed)
        if isinstance(self._shown, AreaWindow):
            self._localizer = Localizer(self._shown, camera, mount, self._start, rng, mask=mask)
        elif isinstance(self._scene, Scene):
            self._localizer = Localizer(
                self._scene, camera, mount, self._start, rng, self._shown, mask
            )
