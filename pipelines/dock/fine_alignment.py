"""Near the goal the robot's pose is aligned with the photos as sharp as they were recorded.

The filter compares small pictures, which is quick and sees the whole; what is left between its
estimate and the truth is a few centimetres. The last of them are found at a higher resolution, in
the same local contrast (``render.channels``), which neither another lamp nor reflections pull
aside.

In front of a wall, a step to the side and a turn back look almost the same. The error hardly
changes along this direction and has several minima there, so that a descent ends in whichever is
next. Therefore the flattest direction is searched, and all good minima are handed over: which of
them is right is often not for one image to say (``competing_poses``).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray
from pipelines.dock.planar_motion import distance_between, turn_between
from pipelines.dock.pose_estimate import Fix
from pipelines.geometry.camera import Camera
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.views import views_of_scene
from pipelines.localize.alignment import Refined, refine
from pipelines.localize.localizer import TRACKING_HEADING, TRACKING_POSITION
from pipelines.localize.observation import Observation, Observer
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import PLANAR
from pipelines.render.channels import SCALE, ZERO, views_in_channels
from pipelines.render.choices import Channels, Quality
from pipelines.render.renderer import Renderer, RenderingWithSurface
from pipelines.render.surface import quality_named

# Errors of the model reach farther than a tile of the image: standard deviations that tiles tell
# are this much too small. Wider than the filter's, since docking drives by a single image.
MODEL_ERROR = 3.3
# Photos are kept, and the camera's image compared, at so many pixels across.
PHOTO_SIDE, FINEST_WIDTH = 640, 320
# In narrower images a neighbourhood spans too much: brightness itself is compared there.
LEAST_CONTRAST_WIDTH = 100
# The flattest direction is searched so far to either side, in such steps, metres.
SEARCHED, SEARCH_STEP = 0.12, 0.01
# So many of the minima found there are followed up.
MOST_MINIMA = 3


@dataclass(frozen=True)
class Candidate:
    """A pose at which an image fits best, among those near it.

    Attributes:
        state: ``(3,)``.
        covariance: ``(3, 3)`` of its error there, metres and radians, the map's own left aside.
        fit: how well it fits at the highest resolution, above 0: mean correlation of the
            neighbourhoods, uncovered pixels counting as 0; of brightness, the reciprocal error.
    """

    state: FloatArray
    covariance: FloatArray
    fit: float


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
        finest = min(FINEST_WIDTH, camera.width)
        self._widths = tuple(sorted({max(4, finest // part) for part in (4, 2, 1)}))
        is_narrow = finest < LEAST_CONTRAST_WIDTH
        self._channels = Channels.COLOUR if is_narrow else Channels.CONTRAST
        self._renderer = Renderer.of_scene(
            scene,
            PHOTO_SIDE,
            settings.blending,
            quality_named(settings.quality, bool(scene.depth), Quality.MEDIUM),
            settings.threads,
            views=views_in_channels(views_of_scene(scene, PHOTO_SIDE), self._channels),
        )
        self._observer = Observer(camera, self._widths, mask)
        self._base_from_camera = base_from_camera

    def __call__(
        self, fix: Fix, image: ImageArray, expected: Sequence[FloatArray] = ()
    ) -> list[Candidate]:
        """Where the image fits near a fix, the best first; none where that leads nowhere.

        Args:
            fix: to begin from.
            image: ``(H, W, 3)`` RGB as recorded.
            expected: states ``(3,)`` that are looked at besides.
        """
        is_far = self._goal is not None and distance_between(fix.state, self._goal) > self._reach
        observations = self._observer(image)
        if is_far or not fix.is_sure or observations.is_blind:
            return []
        images = [
            observations.by_width[width].in_channels(self._channels) for width in self._widths
        ]
        near = [state for state in expected if _is_near(state, fix.state)]
        found = [
            Candidate(end.state, MODEL_ERROR**2 * end.covariance, self._fit(end, images[-1]))
            for end in self._ends([fix.state, *near], images)
            if math.isfinite(end.error) and _is_near(end.state, fix.state)
        ]
        fitting = [candidate for candidate in found if candidate.fit > 0.0]
        return sorted(fitting, key=lambda candidate: -candidate.fit)

    def _ends(self, starts: Sequence[FloatArray], images: Sequence[Observation]) -> list[Refined]:
        """Minima of the error near the first of some states, and next to the others."""
        if self._channels is Channels.COLOUR:
            # So small a picture has one minimum.
            return [self._refined(state, images[-2:]) for state in starts]
        coarse = self._refined(starts[0], images[:-1])
        if not math.isfinite(coarse.error):
            return []
        near = [*self._minima(coarse, images[-2]), *starts[1:]]
        return [self._refined(state, images[-2:]) for state in near]

    def _refined(self, start: FloatArray, images: Sequence[Observation]) -> Refined:
        return refine(self._renderer, PLANAR, start, self._base_from_camera, images)

    def _minima(self, coarse: Refined, image: Observation) -> list[FloatArray]:
        """States ``(3,)`` along the flattest direction where the image fits, the best first."""
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

    def _fit(self, end: Refined, image: Observation) -> float:
        """See ``Candidate.fit``."""
        if self._channels is Channels.COLOUR:
            return 1.0 / max(end.error, 1.0)
        return self._correlation(end.state, image)

    def _correlation(self, state: FloatArray, image: Observation) -> float:
        """Mean correlation of the neighbourhoods; uncovered pixels count as 0."""
        pose = PLANAR.poses(state) @ self._base_from_camera
        view = self._renderer.render_with_surface(pose, image.intrinsics)
        return correlation(view, image)


def correlation(view: RenderingWithSurface, observation: Observation) -> float:
    """Mean correlation of the neighbourhoods of two local contrasts; uncovered pixels count as 0.

    Args:
        view: rendered in the channels ``CONTRAST``.
        observation: in the same channels.
    """
    products = ((view.image - ZERO) * (observation.image - ZERO)).mean(axis=2)
    return float(np.nanmean(np.where(view.covered, products, 0.0 * products))) / SCALE**2


def _is_near(state: FloatArray, fix: FloatArray) -> bool:
    """Whether a state is another answer to the same question, and not another place."""
    return (
        distance_between(state, fix) <= TRACKING_POSITION
        and abs(turn_between(state, fix)) <= TRACKING_HEADING
    )
