"""The front of the fast path: renders virtual views, compares many of them with a camera image."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.array_types import BoolArray, Float32Array, FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane
from pipelines.lightfield.blending import Blending
from pipelines.lightfield.comparison import Cost, compare
from pipelines.lightfield.compiled import compiled
from pipelines.lightfield.kernels import render_view
from pipelines.lightfield.proxy import Quality, cell_size, usual_inverse_depth
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.views import ViewArrays, Views, views_of_scene, without_depth

# Poses that one task of the thread pool works on: few enough to balance, enough to cost no time.
POSES_PER_TASK = 32


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
        shape = (intrinsics.height, intrinsics.width)
        image = np.empty((*shape, 3), dtype=np.float32)
        covered = np.empty(shape, dtype=np.bool_)
        render_view(
            np.ascontiguousarray(world_from_camera, dtype=np.float64),
            intrinsics.vector(),
            int(self.blending),
            self._cell_size(intrinsics),
            self._usual_inverse_depth,
            self.plane.coefficients(),
            self._in_front,
            self.views.arrays,
            image,
            covered,
        )
        return Rendering(np.rint(image).astype(np.uint8), covered)

    def costs(
        self,
        world_from_camera: FloatArray,
        intrinsics: Intrinsics,
        query: ImageArray,
        cost: Cost,
        fit_gain: bool,
    ) -> FloatArray:
        """Compares the views rendered at many poses with one camera image.

        Args:
            world_from_camera: ``(M, 4, 4)``.
            intrinsics: of the camera image.
            query: ``(H, W, 3)`` camera image, RGB, undistorted.
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
        tasks = [
            self._pool.submit(
                _score_poses,
                poses[start : start + POSES_PER_TASK],
                intrinsics.vector(),
                int(self.blending),
                self._cell_size(intrinsics),
                self._usual_inverse_depth,
                self.plane.coefficients(),
                self._in_front,
                self.views.arrays,
                target,
                int(cost),
                fit_gain,
                costs[start : start + POSES_PER_TASK],
            )
            for start in range(0, len(poses), POSES_PER_TASK)
        ]
        for task in tasks:
            task.result()
        return costs

    def _cell_size(self, intrinsics: Intrinsics) -> float:
        """Side of the surface's cells in virtual pixels; 0 stands for the plane."""
        if self.quality is Quality.PLANE:
            return 0.0
        return cell_size(self.views, intrinsics, self.quality)


@compiled
def _score_poses(
    poses: FloatArray,
    intrinsics: FloatArray,
    blending: int,
    cell: float,
    usual_inverse_depth: float,
    plane: FloatArray,
    view_is_in_front: BoolArray,
    views: ViewArrays,
    query: Float32Array,
    kind: int,
    fit_gain: bool,
    costs: FloatArray,
) -> None:
    """Renders and compares one pose after the other in one buffer."""
    image = np.empty(query.shape, dtype=np.float32)
    covered = np.empty(query.shape[:2], dtype=np.bool_)
    for index in range(len(poses)):
        render_view(
            poses[index],
            intrinsics,
            blending,
            cell,
            usual_inverse_depth,
            plane,
            view_is_in_front,
            views,
            image,
            covered,
        )
        costs[index] = compare(kind, image, covered, query, fit_gain)
