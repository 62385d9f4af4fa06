"""The front of the fast path: renders virtual views, compares many of them with a camera image."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    ImageArray,
    Int32Array,
)
from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.processes import processor_count
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.views import Views, views_of_scene, without_depth, without_view
from pipelines.render.candidate_views import build_index
from pipelines.render.choices import Blending, Cost, Quality
from pipelines.render.comparison import PixelEvidence, evidence_table, prepared, prepared_pixels
from pipelines.render.native_renderer import NativeRenderer
from pipelines.render.surface import usual_inverse_depth as median_inverse_depth

# So many poses are compared in one call: enough to make its cost small, few enough to share work
# evenly between threads. Rendered images are kept; there it is so many pixels.
POSES_TOGETHER = 256
PIXELS_TOGETHER = 80_000
ONE = np.float32(1.0)


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
        rgba: ``(H, W, 4)`` RGB, 0 to 255, not rounded; and 1 where at least one view shows the
            pixel. All zero where none does.
        inverse_depth: ``(H, W)`` 1 / metres along the optical axis.
    """

    rgba: Float32Array
    inverse_depth: Float32Array

    @property
    def image(self) -> Float32Array:
        """``(H, W, 3)`` RGB, 0 to 255, not rounded; zero where uncovered."""
        return self.rgba[..., :3]

    @property
    def covered(self) -> BoolArray:
        """``(H, W)`` pixels that at least one view shows."""
        return np.asarray(self.rgba[..., 3] > 0.0)


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
        usual_inverse_depth: of the depth maps, see ``proxy.usual_inverse_depth``; None: not known
            yet.

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
        usual_inverse_depth: float | None = None,
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
        self.threads = threads or processor_count()
        self._pool = ThreadPoolExecutor(self.threads)
        self._usable = np.ones(len(views), dtype=np.bool_)
        if quality is Quality.PLANE:
            self._usable = plane.signed_distance(views.centres) > 0.0
        if usual_inverse_depth is None:
            usual_inverse_depth = median_inverse_depth(self.views)
        self._usual_inverse_depth = usual_inverse_depth
        self._native = NativeRenderer(
            self.views,
            build_index(self.views, self._usable),
            self._usable,
            plane,
            blending,
            quality,
            usual_inverse_depth,
        )

    @classmethod
    def of_scene(
        cls,
        scene: Scene,
        largest_side: int | None = None,
        blending: Blending = Blending.UNSTRUCTURED,
        quality: Quality = Quality.PLANE,
        threads: int | None = None,
        views: Views | None = None,
    ) -> "Renderer":
        """A renderer of a scene's photos, on the CPU; on a device of choice: ``renderer_choice``.

        Args:
            scene: the light field.
            largest_side: photos are area-averaged to so many pixels at most.
            blending: the rule that chooses and weights the views.
            quality: how finely the surface follows the views' depth maps.
            threads: None: one a processor.
            views: rendered in the place of the scene's own photos where they are given: the same
                photos in other channels.

        Raises:
            OptionError: as for the class.
        """
        if views is None:
            views = views_of_scene(scene, largest_side)
        return cls(views, scene.plane, blending, quality, threads)

    def without_view(self, index: int) -> "Renderer":
        """A renderer of all other photos, on the CPU."""
        return Renderer(
            without_view(self.views, index),
            self.plane,
            self.blending,
            self.quality,
            self.threads,
            # The depth maps stay as they are; to sort millions of depths again takes seconds.
            self._usual_inverse_depth,
        )

    def render(self, world_from_camera: FloatArray, intrinsics: Intrinsics) -> Rendering:
        """Renders one virtual view.

        Args:
            world_from_camera: ``(4, 4)``.
            intrinsics: of the virtual camera; they also set the size of the image.
        """
        images, _ = self._draw(world_from_camera[None], intrinsics)
        return Rendering(np.rint(images[0, ..., :3]).astype(np.uint8), images[0, ..., 3] > 0.0)

    def render_with_surface(
        self, world_from_camera: FloatArray, intrinsics: Intrinsics
    ) -> RenderingWithSurface:
        """Renders one virtual view together with the surface that it was rendered over.

        Args:
            world_from_camera: ``(4, 4)``.
            intrinsics: of the virtual camera.
        """
        images, surfaces = self._draw(world_from_camera[None], intrinsics)
        return RenderingWithSurface(images[0], surfaces[0])

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

        def draw(part: slice) -> None:
            drawn, _ = self._draw(poses[part], intrinsics)
            images[part], covered[part] = drawn[..., :3], drawn[..., 3] > 0.0

        together = max(1, PIXELS_TOGETHER // (intrinsics.width * intrinsics.height))
        self._run(draw, len(poses), together)
        return images, covered

    def costs(
        self,
        world_from_camera: FloatArray,
        intrinsics: Intrinsics,
        query: ImageArray | Float32Array,
        cost: Cost,
        fit_gain: bool,
        evidence: PixelEvidence | None = None,
    ) -> FloatArray:
        """Compares the views rendered at many poses with one camera image.

        Args:
            world_from_camera: ``(M, 4, 4)``.
            intrinsics: of the camera image.
            query: ``(H, W, 3)`` camera image, RGB, undistorted; NaN where it is not to be compared.
            cost: the kind of comparison.
            fit_gain: whether a brightness factor is fitted for each pose.
            evidence: what differences say; of EVIDENCE alone, and needed there.

        Returns:
            ``(M,)`` costs, in [0, 1] but for EVIDENCE.

        Raises:
            OptionError: the image has another size than its intrinsics, or EVIDENCE without a
                table.
        """
        check_query(query, intrinsics)
        table = evidence_table(cost, evidence)
        poses = np.ascontiguousarray(world_from_camera, dtype=np.float64)
        costs = np.empty(len(poses))
        # Gradients are differences between neighbours; else what is not compared is not rendered.
        if cost is Cost.GRADIENT:
            chosen, target = every_pixel(intrinsics), prepared(query)
        else:
            chosen, target = prepared_pixels(query)
        if evidence is not None:
            target[..., 3] *= ONE + evidence.rows(target[..., :3])
        surfaces = self._native.surfaces(poses, intrinsics)

        def compare(part: slice) -> None:
            costs[part] = self._native.costs(
                poses[part], surfaces[part], intrinsics, chosen, target, cost, fit_gain, table
            )

        self._run(compare, len(poses), POSES_TOGETHER)
        return costs

    def _draw(
        self, world_from_camera: FloatArray, intrinsics: Intrinsics
    ) -> tuple[Float32Array, Float32Array]:
        """Views from poses ``(B, 4, 4)``.

        Returns:
            Images ``(B, H, W, 4)``, RGB and whether the pixel is covered, and inverse depths
            ``(B, H, W)``.
        """
        poses = np.ascontiguousarray(world_from_camera, dtype=np.float64)
        shape = (len(poses), intrinsics.height, intrinsics.width)
        surfaces = self._native.surfaces(poses, intrinsics)
        drawn, depths = self._native.draw(poses, surfaces, intrinsics, every_pixel(intrinsics))
        return drawn.reshape((*shape, 4)), depths.reshape(shape)

    def _run(self, work: Callable[[slice], None], count: int, most: int) -> None:
        """Does work on all of so many poses: at most so many in one call, some for every thread."""
        together = min(most, max(1, -(-count // self.threads)))
        parts = [slice(start, start + together) for start in range(0, count, together)]
        remaining = iter(parts)

        def drain() -> None:
            # Threads may share a list's iterator: it hands out each part once.
            for part in remaining:
                work(part)

        # This thread takes its share: to wake another one takes as long as some particles.
        helpers = [self._pool.submit(drain) for _ in range(min(self.threads, len(parts)) - 1)]
        drain()
        for helper in helpers:
            helper.result()


def every_pixel(intrinsics: Intrinsics) -> Int32Array:
    """Indices ``(H W,)`` of all pixels of an image."""
    return np.arange(intrinsics.width * intrinsics.height, dtype=np.int32)


def check_query(query: ImageArray | Float32Array, intrinsics: Intrinsics) -> None:
    """Refuses a camera image that is not ``(H, W, 3)`` of its intrinsics.

    Raises:
        OptionError: another size.
    """
    if query.shape != (intrinsics.height, intrinsics.width, 3):
        raise OptionError(
            f"camera image of shape {query.shape} for intrinsics of "
            f"{intrinsics.width}x{intrinsics.height} pixels"
        )
