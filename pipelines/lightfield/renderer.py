"""The front of the fast path: renders virtual views, compares many of them with a camera image."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.array_types import (
    BoolArray,
    Float32Array,
    FloatArray,
    ImageArray,
    IntArray,
)
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane
from pipelines.lightfield.blending import Blending
from pipelines.lightfield.comparison import Cost, compare
from pipelines.lightfield.compiled import compiled
from pipelines.lightfield.kernels import render_view
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.views import Views, views_of_scene

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
    """

    def __init__(
        self,
        views: Views,
        plane: Plane,
        blending: Blending = Blending.UNSTRUCTURED,
        threads: int | None = None,
    ) -> None:
        if threads is not None and threads < 1:
            raise OptionError(f"{threads} threads cannot do any work; give at least 1")
        self.views = views
        self.plane = plane
        self.threads = threads or len(os.sched_getaffinity(0))
        self._pool = ThreadPoolExecutor(self.threads)
        self.blending = blending
        self._light_field = (
            int(blending),
            plane.coefficients(),
            plane.signed_distance(views.centres) > 0.0,
            views.projection,
            views.centres,
            views.texels,
            views.level_start,
            views.level_size,
        )

    @classmethod
    def of_scene(
        cls,
        scene: Scene,
        largest_side: int | None = None,
        blending: Blending = Blending.UNSTRUCTURED,
        threads: int | None = None,
    ) -> "Renderer":
        """A renderer of a scene's photos, area-averaged to ``largest_side`` pixels at most."""
        return cls(views_of_scene(scene, largest_side), scene.plane, blending, threads)

    def render(self, world_from_camera: FloatArray, intrinsics: Intrinsics) -> Rendering:
        """Renders one virtual view.

        Args:
            world_from_camera: ``(4, 4)``.
            intrinsics: of the virtual camera; they also set the size of the image.
        """
        shape = (intrinsics.height, intrinsics.width)
        image = np.empty((*shape, 3), dtype=np.float32)
        covered = np.empty(shape, dtype=np.bool_)
        pose = np.ascontiguousarray(world_from_camera, dtype=np.float64)
        render_view(pose, intrinsics.vector(), *self._light_field, image, covered)
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
        vector = intrinsics.vector()
        costs = np.empty(len(poses))
        tasks = [
            self._pool.submit(
                _score_poses,
                poses[start : start + POSES_PER_TASK],
                vector,
                *self._light_field,
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


@compiled
def _score_poses(
    poses: FloatArray,
    intrinsics: FloatArray,
    blending: int,
    plane: FloatArray,
    view_is_in_front: BoolArray,
    projection: FloatArray,
    centres: FloatArray,
    texels: ImageArray,
    level_start: IntArray,
    level_size: IntArray,
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
            plane,
            view_is_in_front,
            projection,
            centres,
            texels,
            level_start,
            level_size,
            image,
            covered,
        )
        costs[index] = compare(kind, image, covered, query, fit_gain)
