"""Near the goal the robot's pose is aligned with the photos as sharp as they were recorded.

The filter compares small pictures, which is quick and sees the whole; what is left between its
estimate and the truth is a few centimetres. The last of them are found at a higher resolution and
in the pictures' local contrast, which reflections do not pull aside.

In front of a wall, a step to the side and a turn back look almost the same. The error hardly
changes along this direction and has several minima there, so that a descent ends in whichever is
next. Therefore the flattest direction is searched, and the best minimum taken.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipelines.artifacts.array_types import BoolArray, FloatArray, ImageArray
from pipelines.dock.fix import Fix
from pipelines.dock.geometry import distance_between, turn_between
from pipelines.dock.local_contrast import ContrastRenderer, contrast_of, correlation
from pipelines.geometry.camera import Camera
from pipelines.lightfield.proxy import Quality, quality_named
from pipelines.lightfield.renderer import Renderer
from pipelines.lightfield.scene import Scene
from pipelines.localize.localizer import MODEL_ERROR, TRACKING_HEADING, TRACKING_POSITION
from pipelines.localize.observation import Observation, Observer
from pipelines.localize.refinement import Refined, refine
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import PLANAR

# Photos are kept, and the camera's image compared, at so many pixels across.
PHOTO_SIDE, FINEST_WIDTH = 640, 320
# In narrower images a neighbourhood spans too much: brightness itself is compared there.
LEAST_CONTRAST_WIDTH = 100
# The flattest direction is searched so far to either side, in such steps, metres.
SEARCHED, SEARCH_STEP = 0.12, 0.01
# So many of the minima found there are followed up.
MOST_MINIMA = 3


class FineAlignment:
    """Aligns fixes with camera images at a high resolution.

    Args:
        scene: the light field.
        camera: the robot's.
        base_from_camera: ``(4, 4)`` its mount.
        settings: of the filter.
        goal: ``(3,)`` fixes farther than ``reach`` from it are left alone; None: no fix is.
        reach: metres.
        mask: ``(height, width)``, True where the camera's images are to be used; None: everywhere.
    """

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        base_from_camera: FloatArray,
        settings: LocalizerSettings,
        goal: FloatArray | None = None,
        reach: float = math.inf,
        mask: BoolArray | None = None,
    ) -> None:
        self._goal, self._reach = goal, reach
        self._renderer = Renderer.of_scene(
            scene,
            PHOTO_SIDE,
            settings.blending,
            quality_named(settings.quality, bool(scene.depth), Quality.MEDIUM),
            settings.threads,
        )
        self._contrasts = ContrastRenderer(self._renderer)
        finest = min(FINEST_WIDTH, camera.width)
        self._widths = tuple(sorted({max(4, finest // part) for part in (4, 2, 1)}))
        self._observer = Observer(camera, self._widths, mask)
        self._base_from_camera = base_from_camera
        sigmas = [settings.map_position_sigma] * 2 + [settings.map_heading_sigma]
        self._map_covariance = np.diag(np.square(sigmas))

    def __call__(self, fix: Fix, image: ImageArray) -> Fix:
        """The fix, aligned; as it was where that leads nowhere or elsewhere.

        Args:
            fix: to begin from.
            image: ``(H, W, 3)`` RGB as recorded.
        """
        is_far = self._goal is not None and distance_between(fix.state, self._goal) > self._reach
        if is_far or not fix.is_sure:
            return fix
        observations = self._observer(image)
        if observations.is_blind:
            return fix
        found = self._found(fix.state, [observations.by_width[width] for width in self._widths])
        is_elsewhere = (
            not math.isfinite(found.error)
            or distance_between(found.state, fix.state) > TRACKING_POSITION
            or abs(turn_between(found.state, fix.state)) > TRACKING_HEADING
        )
        if is_elsewhere:
            return fix
        covariance = MODEL_ERROR**2 * found.covariance + self._map_covariance
        return replace(
            fix, state=found.state, covariance=covariance, is_refined=True, is_aligned=True
        )

    def _found(self, start: FloatArray, images: Sequence[Observation]) -> Refined:
        """Where an image was taken, from coarse to fine."""
        if self._widths[-1] < LEAST_CONTRAST_WIDTH:
            return refine(self._renderer, PLANAR, start, self._base_from_camera, images[-2:])
        coarse = refine(self._renderer, PLANAR, start, self._base_from_camera, images[:-1])
        if not math.isfinite(coarse.error):
            return coarse
        contrasts = [contrast_of(image) for image in images[-2:]]
        ends = [
            refine(self._contrasts, PLANAR, state, self._base_from_camera, contrasts)
            for state in self._minima(coarse, contrasts[0])
        ]
        return max(ends, key=lambda end: self._correlation(end.state, contrasts[-1]))

    def _minima(self, coarse: Refined, image: Observation) -> list[FloatArray]:
        """States ``(3,)`` along the flattest direction where contrasts fit best, the best first."""
        direction = self._flattest(coarse, image)
        count = round(SEARCHED / SEARCH_STEP)
        steps = SEARCH_STEP * np.arange(-count, count + 1)
        states = [PLANAR.moved(coarse.state, step * direction) for step in steps]
        values = np.array([self._correlation(state, image) for state in states])
        padded = np.concatenate([[-np.inf], values, [-np.inf]])
        peaks = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:]))
        order = peaks[np.argsort(-values[peaks], kind="stable")]
        return [states[index] for index in order[:MOST_MINIMA]]

    def _flattest(self, coarse: Refined, image: Observation) -> FloatArray:
        """The direction ``(3,)`` in which the error grows least, a metre long on the floor."""
        pose = PLANAR.poses(coarse.state) @ self._base_from_camera
        view = self._renderer.render_with_surface(pose, image.intrinsics)
        # A metre at this distance moves the picture by as much as a turn of one over the distance.
        nearness = float(np.median(view.inverse_depth[view.covered]))
        scale = np.array([1.0 / nearness, 1.0 / nearness, 1.0])
        _, directions = np.linalg.eigh(coarse.curvature * np.outer(scale, scale))
        flattest = directions[:, 0] * scale
        return np.asarray(flattest / max(float(np.hypot(*flattest[:2])), 1e-9))

    def _correlation(self, state: FloatArray, image: Observation) -> float:
        pose = PLANAR.poses(state) @ self._base_from_camera
        return correlation(self._contrasts.render_with_surface(pose, image.intrinsics), image)
