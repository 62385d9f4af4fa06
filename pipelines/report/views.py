"""The pictures beside the top view: the camera image, and rendered views at poses."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray
from pipelines.dataset.images import decode_image
from pipelines.geometry.camera import Intrinsics, Undistorter
from pipelines.lightfield.open_world import OpenWorld
from pipelines.lightfield.scene import Scene
from pipelines.localize.run import Run
from pipelines.render.area_renderers import colour_renderers
from pipelines.render.choices import Blending, Quality
from pipelines.render.renderer import Renderer, Rendering
from pipelines.render.surface import quality_named
from pipelines.report.style import UNCOVERED_DARK, UNCOVERED_LIGHT

# The largest pictures are four inches wide at 120 pixels an inch.
MAX_PICTURE_SIDE = 480
# Width of a pair of stripes relative to the longer side of the picture.
STRIPE_PERIOD = 1.0 / 32.0


@dataclass(frozen=True)
class ModelView:
    """A rendered view beside the camera's.

    Attributes:
        picture: ``(H, W, 3)`` RGB; pixels that no recorded view covers are striped.
        covered: ``(H, W)`` pixels that a recorded view covers.
        mean_difference: mean absolute grey-level difference from the camera image over the covered
            pixels, 0 to 255; NaN where no pixel is covered.
        difference: ``(H, W)`` absolute differences, mean over the colours; NaN where uncovered.
    """

    picture: ImageArray
    covered: BoolArray
    mean_difference: float
    difference: FloatArray


@dataclass(frozen=True)
class FrameViews:
    """The pictures of one frame, all of the same size.

    Attributes:
        real: ``(H, W, 3)`` undistorted camera image.
        at_estimate: view rendered at the estimate; None without an estimate.
        at_odometry: view rendered at the pose by odometry; None without odometry.
    """

    real: ImageArray
    at_estimate: ModelView | None
    at_odometry: ModelView | None


class ViewMaker:
    """Makes the pictures of frames: undistorted camera images and views rendered like them.

    Args:
        run: the run, which holds the camera images, the camera and its mount.
        renderer_at: the renderer of what is seen from a pose ``(4, 4)``.
    """

    def __init__(self, run: Run, renderer_at: Callable[[FloatArray], Renderer]) -> None:
        self._run = run
        self._renderer_at = renderer_at
        self._undistort = Undistorter(run.camera)
        self._intrinsics = picture_intrinsics(self._undistort.intrinsics)

    def views(self, index: int, estimate: FloatArray, odometry: FloatArray | None) -> FrameViews:
        """The pictures of a frame.

        Args:
            index: number of the frame.
            estimate: state ``(D,)``; NaN where there is none.
            odometry: state ``(D,)``; None without odometry.

        Raises:
            InputError: the stored camera image cannot be decoded.
        """
        image = decode_image(self._run.encoded_images[index], self._run.frames[index].image_name)
        size = (self._intrinsics.width, self._intrinsics.height)
        undistorted = self._undistort(image)
        real = np.asarray(cv2.resize(undistorted, size, interpolation=cv2.INTER_AREA), np.uint8)
        return FrameViews(real, self._model_view(real, estimate), self._model_view(real, odometry))

    def _model_view(self, real: ImageArray, state: FloatArray | None) -> ModelView | None:
        if state is None or not np.all(np.isfinite(state)):
            return None
        world_from_camera = self._run.space.poses(state) @ self._run.base_from_camera
        renderer = self._renderer_at(world_from_camera)
        return model_view(real, renderer.render(world_from_camera, self._intrinsics))


def renderer_at(scene: Scene | OpenWorld) -> Callable[[FloatArray], Renderer]:
    """What says which renderer shows what is seen from a pose ``(4, 4)``, in pictures for people.

    Args:
        scene: the light field, or a world of several.

    Raises:
        InputError: a photo of the scene cannot be decoded.
    """
    if isinstance(scene, Scene):
        quality = quality_named(None, bool(scene.depth), Quality.FINE)
        renderer = Renderer.of_scene(scene, MAX_PICTURE_SIDE, quality=quality)
        return lambda _: renderer
    quality = quality_named(None, scene.has_depth, Quality.FINE)
    return colour_renderers(scene, MAX_PICTURE_SIDE, Blending.UNSTRUCTURED, quality)


def picture_intrinsics(intrinsics: Intrinsics) -> Intrinsics:
    """Intrinsics of the picture shown: the camera's, reduced where it is larger than needed."""
    scale = min(1.0, MAX_PICTURE_SIDE / max(intrinsics.width, intrinsics.height))
    width = max(1, round(intrinsics.width * scale))
    height = max(1, round(intrinsics.height * scale))
    return intrinsics.resized(width, height)


def model_view(real: ImageArray, rendering: Rendering) -> ModelView:
    """A rendering prepared for showing beside the camera image ``(H, W, 3)`` of the same size."""
    absolute = np.abs(real.astype(np.float64) - rendering.image.astype(np.float64)).mean(axis=2)
    covered = rendering.covered
    mean = float(absolute[covered].mean()) if covered.any() else float("nan")
    return ModelView(
        picture=mark_uncovered(rendering.image, covered),
        covered=covered,
        mean_difference=mean,
        difference=np.where(covered, absolute, np.nan),
    )


def mark_uncovered(image: ImageArray, covered: BoolArray) -> ImageArray:
    """The image ``(H, W, 3)`` with diagonal stripes where ``covered`` ``(H, W)`` is false."""
    height, width = covered.shape
    return np.where(covered[..., None], image, stripes(width, height)).astype(np.uint8)


def stripes(width: int, height: int) -> ImageArray:
    """``(height, width, 3)``: the pattern that marks pixels which no recorded view covers."""
    period = max(4, round(max(width, height) * STRIPE_PERIOD))
    rows, columns = np.mgrid[0:height, 0:width]
    dark = ((rows + columns) % period) < period // 2
    return np.where(dark[..., None], UNCOVERED_DARK, UNCOVERED_LIGHT).astype(np.uint8)
