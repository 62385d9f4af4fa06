"""Fine alignment: near the goal, the pose is aligned with the photos at full resolution.

The filter compares small images: that is fast and sees the whole, and leaves an error of a few
centimetres. A higher resolution removes it. Compared is the same local contrast as in the filter
(``render.channels``), which is robust to other lamps and to reflections.

In front of a wall, a step to the side and a rotation back look almost the same. The error hardly
changes along this direction and has several minima there, and a descent ends in the nearest one.
Therefore the flattest direction is searched, and all good minima are returned. One image often
cannot tell which of them is right; ``competing_poses`` decides over several images.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray
from pipelines.dock.planar_motion import distance_between, is_near
from pipelines.dock.pose_estimate import PoseEstimate
from pipelines.geometry.camera import Camera
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.views import views_of_scene
from pipelines.localize.alignment import Alignment, align
from pipelines.localize.observation import Observation, Observer
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import PLANAR
from pipelines.localize.status import TRACKING_HEADING, TRACKING_POSITION
from pipelines.render.channels import SCALE, ZERO, views_in_channels
from pipelines.render.choices import Channels, Quality
from pipelines.render.renderer import Renderer, RenderingWithSurface
from pipelines.render.surface import quality_named

# Errors of the scene model are correlated beyond a tile of the image, so that standard deviations
# computed from tiles are too small by this factor. It is larger than the filter's, since docking
# acts on single images.
MODEL_ERROR = 3.3
# Photos are kept, and the camera's image compared, at these widths, pixels.
PHOTO_SIDE, FINEST_WIDTH = 640, 320
# In narrower images a neighbourhood covers too much of the scene: colours are compared instead.
LEAST_CONTRAST_WIDTH = 100
# The flattest direction is searched this far to either side, in steps of this size, metres.
SEARCHED, SEARCH_STEP = 0.12, 0.01
# At most this many of the minima found there are refined.
MOST_MINIMA = 3


@dataclass(frozen=True)
class Candidate:
    """A pose at which an image fits better than at all poses near it.

    Attributes:
        state: ``(3,)`` x and y in metres, heading in radians.
        covariance: ``(3, 3)`` of the state's error without the map's, metres and radians.
        fit: how well the image fits at the highest resolution, above 0. For local contrast it is
            the mean correlation of the neighbourhoods, uncovered pixels counting as 0; for colours,
            the reciprocal of the error.
    """

    state: FloatArray
    covariance: FloatArray
    fit: float


class FineAlignment:
    """Aligns pose estimates with camera images at a high resolution.

    Args:
        scene: the light field.
        camera: the robot's camera.
        base_from_camera: ``(4, 4)`` the camera's mount.
        settings: the filter's settings.
        goal: ``(3,)``; only estimates within ``reach`` of it are aligned; None: all are.
        reach: distance from the goal, metres.
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
        self, estimate: PoseEstimate, image: ImageArray, expected: Sequence[FloatArray] = ()
    ) -> list[Candidate]:
        """Poses near an estimate at which the image fits, the best first; empty where none does.

        Args:
            estimate: where the alignment starts.
            image: ``(H, W, 3)`` RGB as recorded.
            expected: states ``(3,)`` from which it starts as well.
        """
        is_far = (
            self._goal is not None and distance_between(estimate.state, self._goal) > self._reach
        )
        observations = self._observer(image)
        if is_far or not estimate.is_localized or observations.is_blind:
            return []
        images = [
            observations.by_width[width].in_channels(self._channels) for width in self._widths
        ]
        near = [state for state in expected if _is_same_place(state, estimate.state)]
        found = [
            Candidate(end.state, MODEL_ERROR**2 * end.covariance, self._fit(end, images[-1]))
            for end in self._ends([estimate.state, *near], images)
            if math.isfinite(end.error) and _is_same_place(end.state, estimate.state)
        ]
        fitting = [candidate for candidate in found if candidate.fit > 0.0]
        return sorted(fitting, key=lambda candidate: -candidate.fit)

    def _ends(self, starts: Sequence[FloatArray], images: Sequence[Observation]) -> list[Alignment]:
        """Minima of the error: several near the first start ``(3,)``, one at each of the others."""
        if self._channels is Channels.COLOUR:
            # The error of so small an image has one minimum.
            return [self._refined(state, images[-2:]) for state in starts]
        coarse = self._refined(starts[0], images[:-1])
        if not math.isfinite(coarse.error):
            return []
        near = [*self._minima(coarse, images[-2]), *starts[1:]]
        return [self._refined(state, images[-2:]) for state in near]

    def _refined(self, start: FloatArray, images: Sequence[Observation]) -> Alignment:
        """The minimum that a descent from a state ``(3,)`` ends in, coarse image first."""
        return align(self._renderer, PLANAR, start, self._base_from_camera, images)

    def _minima(self, coarse: Alignment, image: Observation) -> list[FloatArray]:
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

    def _flattest(self, coarse: Alignment, image: Observation) -> FloatArray:
        """The direction ``(3,)`` in which the error grows least, a metre long on the floor."""
        pose = PLANAR.poses(coarse.state) @ self._base_from_camera
        view = self._renderer.render_with_surface(pose, image.intrinsics)
        # At distance d, a translation by d moves the image as much as a rotation by one radian.
        inverse_depth = float(np.median(view.inverse_depth[view.covered]))
        scale = np.array([1.0 / inverse_depth, 1.0 / inverse_depth, 1.0])
        _, directions = np.linalg.eigh(coarse.curvature * np.outer(scale, scale))
        flattest = directions[:, 0] * scale
        return np.asarray(flattest / max(float(np.hypot(*flattest[:2])), 1e-9))

    def _fit(self, end: Alignment, image: Observation) -> float:
        """How well an image fits at a minimum, as ``Candidate.fit`` says."""
        if self._channels is Channels.COLOUR:
            return 1.0 / max(end.error, 1.0)
        return self._correlation(end.state, image)

    def _correlation(self, state: FloatArray, image: Observation) -> float:
        """``correlation`` of the view at a state ``(3,)`` with an image."""
        pose = PLANAR.poses(state) @ self._base_from_camera
        view = self._renderer.render_with_surface(pose, image.intrinsics)
        return correlation(view, image)


def correlation(view: RenderingWithSurface, observation: Observation) -> float:
    """Mean correlation of the neighbourhoods of two local contrasts; uncovered pixels count as 0.

    Args:
        view: rendered view in the channels ``CONTRAST``.
        observation: camera image in the same channels.
    """
    products = ((view.image - ZERO) * (observation.image - ZERO)).mean(axis=2)
    return float(np.nanmean(np.where(view.covered, products, 0.0 * products))) / SCALE**2


def _is_same_place(state: FloatArray, estimate: FloatArray) -> bool:
    """Whether two states ``(3,)`` are one place to the filter."""
    return is_near(state, estimate, TRACKING_POSITION, TRACKING_HEADING)
