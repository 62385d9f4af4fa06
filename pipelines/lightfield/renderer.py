"""The front of the fast path: renders virtual views, compares many of them with a camera image."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.array_types import BoolArray, Float32Array, FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane
from pipelines.lightfield.blending import VIEWS_PER_TILE, Blending, tile_count
from pipelines.lightfield.comparison import Cost, compare_all
from pipelines.lightfield.kernels import blend_cells, net_cells, prepare, tile_cells
from pipelines.lightfield.proxy import Quality, cell_size, usual_inverse_depth
from pipelines.lightfield.proxy_kernels import depth_surfaces, plane_surfaces
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.views import Views, views_of_scene, without_depth

# So many poses, or pixels, are worked on together: enough to make the calls' cost small, few enough
# that what one step writes is still in the processor's cache when the next one reads it.
POSES_TOGETHER = 16
PIXELS_TOGETHER = 20_000


@dataclass(frozen=True)
class Rendering:
    """A virtual view.

    Attributes:
        image: ``(H, W, 3)`` RGB; zero where uncovered.
        covered: ``(H, W)`` pixels that at least one view shows.
    """

    image: ImageArray
    covered: BoolArray

    @property
    def coverage(self) -> float:
        """Share of the pixels that are covered."""
        return float(self.covered.mean())


@dataclass(frozen=True)
class RenderingWithSurface:
    """A virtual view and how far away what it shows is.

    Attributes:
        image: ``(H, W, 3)`` RGB, 0 to 255, not rounded; zero where uncovered.
        covered: ``(H, W)`` pixels that at least one view shows.
        inverse_depth: ``(H, W)`` 1 / metres along the optical axis.
    """

    image: Float32Array
    covered: BoolArray
    inverse_depth: FloatArray


class Renderer:
    """Renders virtual views of a light field and scores them against camera images.

    Works on all processors of the process's affinity unless ``threads`` says otherwise; results do
    not depend on the number of threads.

    Args:
        views: the photos.
        plane: the scene's surface where ``quality`` is ``PLANE``.
        blending: the rule that chooses and weights the views.
        quality: how finely the surface follows the views' depth maps.
        threads: None: one a processor.

    Raises:
        OptionError: no threads, or a quality that needs depth maps where there are none.
    """

    def __init__(
        self,
        views: Views,
        plane: Plane,
        blending: Blending = Blending.UNSTRUCTURED,
        quality: Quality = Quality.PLANE,
        threads: int | None = None,
    ) -> None:
        if threads is not None and threads < 1:
            raise OptionError(f"{threads} threads cannot do any work; give at least 1")
        if quality is not Quality.PLANE and not views.has_depth:
            raise OptionError(
                f"quality {quality.name.lower()} needs depth maps, and the scene has none; "
                "make it with --geometry depth"
            )
        # A plane hides nothing, whatever depth maps say.
        self.views = without_depth(views) if quality is Quality.PLANE else views
        self.plane = plane
        self.blending = blending
        self.quality = quality
        self.threads = threads or len(os.sched_getaffinity(0))
        self._pool = ThreadPoolExecutor(self.threads)
        self._usual_inverse_depth = usual_inverse_depth(self.views)
        self._in_front = plane.signed_distance(views.centres) > 0.0

    @classmethod
    def of_scene(
        cls,
        scene: Scene,
        largest_side: int | None = None,
        blending: Blending = Blending.UNSTRUCTURED,
        quality: Quality = Quality.PLANE,
        threads: int | None = None,
    ) -> "Renderer":
        """A renderer of a scene's photos, area-averaged to ``largest_side`` pixels at most."""
        return cls(views_of_scene(scene, largest_side), scene.plane, blending, quality, threads)

    def render(self, world_from_camera: FloatArray, intrinsics: Intrinsics) -> Rendering:
        """Renders one virtual view.

        Args:
            world_from_camera: ``(4, 4)``.
            intrinsics: of the virtual camera; they also set the size of the image.
        """
        poses = np.ascontiguousarray(world_from_camera[None], dtype=np.float64)
        images, covered, _ = self._render(poses, intrinsics)
        return Rendering(np.rint(images[0]).astype(np.uint8), covered[0])

    def render_with_surface(
        self, world_from_camera: FloatArray, intrinsics: Intrinsics
    ) -> RenderingWithSurface:
        """Renders one virtual view together with the surface that it was rendered over.

        Args:
            world_from_camera: ``(4, 4)``.
            intrinsics: of the virtual camera.
        """
        poses = np.ascontiguousarray(world_from_camera[None], dtype=np.float64)
        images, covered, surfaces = self._render(poses, intrinsics)
        return RenderingWithSurface(images[0], covered[0], surfaces[0])

    def render_many(
        self, world_from_camera: FloatArray, intrinsics: Intrinsics
    ) -> tuple[Float32Array, BoolArray]:
        """Renders many virtual views.

        Args:
            world_from_camera: ``(M, 4, 4)``.
            intrinsics: of the virtual camera.

        Returns:
            Images ``(M, H, W, 3)`` RGB, 0 to 255, zero where uncovered, and covered pixels
            ``(M, H, W)``.
        """
        poses = np.ascontiguousarray(world_from_camera, dtype=np.float64)
        shape = (len(poses), intrinsics.height, intrinsics.width)
        images = np.empty((*shape, 3), dtype=np.float32)
        covered = np.empty(shape, dtype=np.bool_)
        together = _poses_together(intrinsics)

        def draw(start: int) -> None:
            part = slice(start, start + together)
            images[part], covered[part], _ = self._render(poses[part], intrinsics)

        list(self._pool.map(draw, range(0, len(poses), together)))
        return images, covered

    def costs(
        self,
        world_from_camera: FloatArray,
        intrinsics: Intrinsics,
        query: ImageArray | Float32Array,
        cost: Cost,
        fit_gain: bool,
    ) -> FloatArray:
        """Compares the views rendered at many poses with one camera image.

        Args:
            world_from_camera: ``(M, 4, 4)``.
            intrinsics: of the camera image.
            query: ``(H, W, 3)`` camera image, RGB, undistorted; NaN where it is not to be compared.
            cost: the kind of comparison.
            fit_gain: whether a brightness factor is fitted for each pose.

        Returns:
            ``(M,)`` costs in [0, 1].

        Raises:
            OptionError: the image has another size than its intrinsics.
        """
        if query.shape != (intrinsics.height, intrinsics.width, 3):
            raise OptionError(
                f"camera image of shape {query.shape} for intrinsics of "
                f"{intrinsics.width}x{intrinsics.height} pixels"
            )
        poses = np.ascontiguousarray(world_from_camera, dtype=np.float64)
        target = np.ascontiguousarray(query, dtype=np.float32)
        costs = np.empty(len(poses))
        together = _poses_together(intrinsics)

        def score(start: int) -> None:
            images, covered, _ = self._render(poses[start : start + together], intrinsics)
            own = costs[start : start + together]
            compare_all(int(cost), images, covered, target, fit_gain, own)

        list(self._pool.map(score, range(0, len(poses), together)))
        return costs

    def _render(
        self, poses: FloatArray, intrinsics: Intrinsics
    ) -> tuple[Float32Array, BoolArray, FloatArray]:
        """Views from poses ``(B, 4, 4)``.

        Returns:
            Images ``(B, H, W, 3)``, covered pixels ``(B, H, W)`` and inverse depths ``(B, H, W)``.
        """
        arrays, vector = self.views.arrays, intrinsics.vector()
        shape = (len(poses), intrinsics.height, intrinsics.width)
        rays = np.empty((len(poses), 3, 3))
        maps = np.empty((len(poses), len(self.views), 3, 3))
        shifts = np.empty((len(poses), len(self.views), 3))
        prepare(poses, vector, arrays.projection, rays, maps, shifts)
        surfaces = np.empty(shape)
        usable = np.ones((len(poses), len(self.views)), dtype=np.bool_)
        has_depth = self.quality is not Quality.PLANE
        if has_depth:
            spacing = cell_size(self.views, intrinsics, self.quality)
            depth_surfaces(arrays, self._usual_inverse_depth, poses, vector, spacing, surfaces)
        else:
            plane_surfaces(poses, rays, self.plane.coefficients(), surfaces)
            usable[:] = self._in_front
        cells = 4 * len(self.views) + 8
        if self.blending is Blending.UNSTRUCTURED:
            cells = tile_count(shape[1]) * tile_count(shape[2])
        cell_views = np.empty((len(poses), cells, VIEWS_PER_TILE), dtype=np.int64)
        cell_weights = np.empty((len(poses), cells, VIEWS_PER_TILE, 4))
        labels = np.empty(shape, dtype=np.int64)
        built = (maps, shifts, usable, cell_views, cell_weights, labels)
        if self.blending is Blending.UNSTRUCTURED:
            tile_cells(poses, rays, surfaces, arrays, *built)
        else:
            net_cells(poses, vector, surfaces, arrays, *built)
        images = np.empty((*shape, 3), dtype=np.float32)
        covered = np.empty(shape, dtype=np.bool_)
        blend_cells(poses, vector, has_depth, surfaces, arrays, *built, images, covered)
        return images, covered, surfaces


def _poses_together(intrinsics: Intrinsics) -> int:
    return max(1, min(POSES_TOGETHER, PIXELS_TOGETHER // (intrinsics.width * intrinsics.height)))
