"""Near the goal the robot's pose is aligned with the photos as sharp as they were recorded.

The filter compares small pictures, which is quick and sees the whole; what is left between its
estimate and the truth is a few centimetres. The last of them are found at a higher resolution.
"""

import math
from dataclasses import replace

import numpy as np

from pipelines.artifacts.array_types import FloatArray, ImageArray
from pipelines.dock.fix import Fix
from pipelines.dock.geometry import distance_between, turn_between
from pipelines.geometry.camera import Camera
from pipelines.lightfield.proxy import Quality, quality_named
from pipelines.lightfield.renderer import Renderer
from pipelines.lightfield.scene import Scene
from pipelines.localize.localizer import MODEL_ERROR, TRACKING_HEADING, TRACKING_POSITION
from pipelines.localize.observation import Observer
from pipelines.localize.refinement import refine
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import PLANAR

# Photos are kept, and the camera's image compared, at so many pixels across.
PHOTO_SIDE, FINEST_WIDTH = 640, 320


class FineAlignment:
    """Aligns fixes with camera images at a high resolution.

    Args:
        scene: the light field.
        camera: the robot's.
        base_from_camera: ``(4, 4)`` its mount.
        settings: of the filter.
    """

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        base_from_camera: FloatArray,
        settings: LocalizerSettings,
    ) -> None:
        self._renderer = Renderer.of_scene(
            scene,
            PHOTO_SIDE,
            settings.blending,
            quality_named(settings.quality, bool(scene.depth), Quality.MEDIUM),
            settings.threads,
        )
        finest = min(FINEST_WIDTH, camera.width)
        self._widths = tuple(sorted({max(4, finest // 2), finest}))
        self._observer = Observer(camera, self._widths)
        self._base_from_camera = base_from_camera
        sigmas = [settings.map_position_sigma] * 2 + [settings.map_heading_sigma]
        self._map_covariance = np.diag(np.square(sigmas))

    def __call__(self, fix: Fix, image: ImageArray) -> Fix:
        """The fix, aligned; as it was where that leads nowhere or elsewhere.

        Args:
            fix: to begin from.
            image: ``(H, W, 3)`` RGB as recorded.
        """
        observations = self._observer(image)
        if observations.is_blind or not fix.is_sure:
            return fix
        images = [observations.by_width[width] for width in self._widths]
        found = refine(self._renderer, PLANAR, fix.state, self._base_from_camera, images)
        is_elsewhere = (
            not math.isfinite(found.error)
            or distance_between(found.state, fix.state) > TRACKING_POSITION
            or abs(turn_between(found.state, fix.state)) > TRACKING_HEADING
        )
        if is_elsewhere:
            return fix
        covariance = MODEL_ERROR**2 * found.covariance + self._map_covariance
        return replace(fix, state=found.state, covariance=covariance, is_refined=True)
