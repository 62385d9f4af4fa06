"""``model:SCENE.h5``: a robot whose world is a light field, not the one that it is localized in."""

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.dock.robot import Movement
from pipelines.dock.robots.noise import SensorNoise, SimulatedMotion, as_recorded
from pipelines.geometry.camera import Camera, Undistorter
from pipelines.geometry.pose import world_from_base_planar
from pipelines.lightfield.scene import Scene
from pipelines.render.choices import Quality
from pipelines.render.renderer import Renderer
from pipelines.render.surface import quality_named


class ModelRobot:
    """Its camera images are rendered from a scene model.

    What no view of the model shows is grey, as a bare wall would be.

    Args:
        scene: the robot's world.
        camera: without distortion.
        base_from_camera: ``(4, 4)``.
        motion: where it is and how it moves.
        sensor: errors of the images.
        rng: of these.
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
        self.camera = camera
        self.base_from_camera = base_from_camera
        self._intrinsics = Undistorter(camera).intrinsics
        quality = quality_named(None, bool(scene.depth), Quality.FINE)
        self._renderer = Renderer.of_scene(scene, 4 * camera.width, quality=quality)
        self._motion, self._sensor, self._rng = motion, sensor, rng

    def take_image(self) -> ImageArray:
        """The view at the true pose."""
        pose = world_from_base_planar(self._motion.state) @ self.base_from_camera
        view = self._renderer.render(pose, self._intrinsics)
        image = np.where(view.covered[..., None], view.image, np.uint8(128)).astype(np.uint8)
        return as_recorded(image, self._sensor, self._rng)

    def move(self, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """See ``Robot.move``."""
        measured = self._motion.move(Movement(forward, left, turn))
        return measured.forward, measured.left, measured.turn

    def stop(self) -> None:
        """It stands still already."""

    def true_state(self) -> FloatArray:
        """See ``KnowsTruth``."""
        return self._motion.state
