"""``model:SCENE.h5``: a simulated robot whose camera images are rendered from a scene model."""

from collections.abc import Iterator

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.dock.robots.noise import SensorNoise, SimulatedMotion, SimulatedRobot, as_recorded
from pipelines.geometry.camera import Camera, Undistorter
from pipelines.lightfield.scene import Scene
from pipelines.render.choices import Quality
from pipelines.render.renderer import Renderer
from pipelines.render.surface import quality_named

# The colour of what a model does not show, grey levels.
NOTHING = 128


class RenderedRobot(SimulatedRobot):
    """A robot whose camera images are rendered from what subclasses say.

    Args:
        camera: without distortion.
        base_from_camera: ``(4, 4)`` the camera's mount.
        motion: the robot's true pose, and its errors of movements and odometry.
        sensor: errors of its images.
        rng: the random numbers of its images.
    """

    def __init__(
        self,
        camera: Camera,
        base_from_camera: FloatArray,
        motion: SimulatedMotion,
        sensor: SensorNoise,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(camera, base_from_camera, motion, sensor, rng)
        self._intrinsics = Undistorter(camera).intrinsics

    def take_image(self) -> ImageArray:
        """The view at the true pose, ``(H, W, 3)`` RGB."""
        shape = (self.camera.height, self.camera.width)
        image = np.full((*shape, 3), NOTHING, dtype=np.uint8)
        is_open = np.ones(shape, dtype=np.bool_)
        for renderer in self._renderers_here():
            view = renderer.render(self._world_from_camera, self._intrinsics)
            image = np.where((is_open & view.covered)[..., None], view.image, image)
            is_open &= ~view.covered
            if not is_open.any():
                break
        return as_recorded(image.astype(np.uint8), self._sensor, self._rng)

    def _renderers_here(self) -> Iterator[Renderer]:
        """Renderers of what is around the robot; each shows what those before leave uncovered."""
        raise NotImplementedError


def side_of_model(camera: Camera) -> int:
    """Pixels of the longer side of a model's photos, at most, for a simulated robot's camera."""
    return 4 * camera.width


def quality_of_model(scene: Scene) -> Quality:
    """How finely a simulated robot's images follow a model's depth maps."""
    return quality_named(None, bool(scene.depth), Quality.FINE)


class ModelRobot(RenderedRobot):
    """A robot in a scene model. What the model does not cover is grey, as a bare wall would be.

    Args:
        scene: the robot's world; not the scene that it is localized in.
        camera: without distortion.
        base_from_camera: ``(4, 4)`` the camera's mount.
        motion: the robot's true pose, and its errors of movements and odometry.
        sensor: errors of its images.
        rng: the random numbers of its images.
    """

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        base_from_camera: FloatArray,
        motion: SimulatedMotion,
        sensor: SensorNoise,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(camera, base_from_camera, motion, sensor, rng)
        self._renderer = Renderer.of_scene(
            scene, side_of_model(camera), quality=quality_of_model(scene)
        )

    def _renderers_here(self) -> Iterator[Renderer]:
        yield self._renderer
