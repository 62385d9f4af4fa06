"""The fast renderer: renders virtual views, and compares many of them with a camera image.

It shares the work of the C++ core (``native_renderer``) among threads.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arguments import checked_index, checked_instance, checked_number
from pipelines.artifacts.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    ImageArray,
    Shape,
    checked_array,
)
from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.processes import processor_count
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane
from pipelines.geometry.pose import checked_poses
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.views import Views, views_of_scene, without_depth, without_view
from pipelines.render.candidate_views import build_index
from pipelines.render.choices import Blending, Cost, Quality
from pipelines.render.comparison import PixelEvidence, every_pixel, prepare_query
from pipelines.render.native_renderer import NativeRenderer
from pipelines.render.surface import median_inverse_depth

# The most poses that are compared in one call of the core: enough to make its cost small, few
# enough to share work evenly between threads. Where images are kept it is a number of pixels.
POSES_A_CALL = 256
PIXELS_A_CALL = 80_000
MAX_THREADS = 4096


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

    As Heigl, Denzler, Niemann (2001), section 2, views are rendered directly from the photos over
    the scene's surface; which photos a pixel is blended from, ``Blending`` says. Cameras have the
    axes of OpenCV (x right, y down, z forward), worlds those of REP-103.

    Works on all processors of the process's affinity unless ``threads`` says otherwise; results do
    not depend on the number of threads.

    Args:
        views: the photos, as ``views_of_scene`` prepares them; from a scene: ``of_scene``.
        plane: the scene's surface where ``quality`` is ``PLANE``; None: a scene without a plane.
        blending: the rule that chooses and weights the views.
        quality: how finely the surface follows the views' depth maps.
        threads: how many work at the same time; None: one a processor.
        typical_inverse_depth: median of all depth maps' known values, 1 / metres; None: it is
            computed.

    Raises:
        OptionError: no threads, or a quality that needs depth maps where there are none; an
            argument of another type.
    """

    def __init__(
        self,
        views: Views,
        plane: Plane | None,
        blending: Blending = Blending.UNSTRUCTURED,
        quality: Quality = Quality.PLANE,
        threads: int | None = None,
        typical_inverse_depth: float | None = None,
    ) -> None:
        checked_instance(views, "views", Views)
        if plane is not None:
            checked_instance(plane, "plane", Plane)
        checked_instance(blending, "blending", Blending)
        checked_instance(quality, "quality", Quality)
        if threads is not None:
            checked_number(threads, "number of threads", 1, MAX_THREADS, whole=True)
        if quality is not Quality.PLANE and not views.has_depth:
            raise OptionError(
                f"quality {quality.name.lower()} needs depth maps, and the scene has none; "
                "make it with --geometry depth"
            )
        if quality is Quality.PLANE and plane is None:
            raise OptionError(
                "quality plane needs a plane, and the scene has none: its photos look in all "
                "directions; choose a quality that follows the depth maps"
            )
        # A plane hides nothing, whatever depth maps say.
        self.views = without_depth(views) if quality is Quality.PLANE else views
        self.plane = plane
        self.blending = blending
        self.quality = quality
        self.threads = threads or processor_count()
        self._pool = ThreadPoolExecutor(self.threads)
        self._usable = np.ones(len(views), dtype=np.bool_)
        if quality is Quality.PLANE and plane is not None:
            self._usable = plane.signed_distance(views.centres) > 0.0
        if typical_inverse_depth is None:
            typical_inverse_depth = median_inverse_depth(self.views)
        self._typical_inverse_depth = typical_inverse_depth
        self._native = NativeRenderer(
            self.views,
            build_index(self.views, self._usable),
            self._usable,
            plane,
            blending,
            quality,
            typical_inverse_depth,
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
        """A renderer of a scene's photos on the CPU; ``renderer_choice`` makes one on any device.

        Args:
            scene: the light field.
            largest_side: photos are area-averaged to so many pixels at most; None: as recorded.
            blending: the rule that chooses and weights the views.
            quality: how finely the surface follows the views' depth maps.
            threads: how many work at the same time; None: one a processor.
            views: the scene's photos in other channels, which are rendered in their place; None:
                they are rendered in colours.

        Raises:
            OptionError: no threads, a side without pixels, or a quality that needs depth maps where
                there are none; an argument of another type.
            InputError: a photo of the scene cannot be decoded.
        """
        checked_instance(scene, "the scene", Scene)
        if views is None:
            views = views_of_scene(scene, largest_side)
        return cls(views, scene.plane_if_any, blending, quality, threads)

    def without_view(self, index: int, threads: int | None = None) -> "Renderer":
        """A renderer of all other photos, on the CPU.

        Args:
            index: of the view that is left out, from 0.
            threads: how many work at the same time; None: as many as here.

        Raises:
            OptionError: no such view.
        """
        index = checked_index(index, "views", len(self.views))
        return Renderer(
            without_view(self.views, index),
            self.plane,
            self.blending,
            self.quality,
            threads or self.threads,
            # The depth maps stay as they are; to sort millions of depths again takes seconds.
            self._typical_inverse_depth,
        )

    def render(self, world_from_camera: FloatArray, intrinsics: Intrinsics) -> Rendering:
        """Renders one virtual view.

        Args:
            world_from_camera: ``(4, 4)`` where the virtual camera is, metres.
            intrinsics: of the virtual camera; they also set the size of the image.

        Raises:
            OptionError: a pose that is no rigid transform, or intrinsics of another type.
        """
        pose = checked_view(world_from_camera, intrinsics)
        images, _ = self._draw(pose[None], intrinsics)
        return Rendering(np.rint(images[0, ..., :3]).astype(np.uint8), images[0, ..., 3] > 0.0)

    def render_with_surface(
        self, world_from_camera: FloatArray, intrinsics: Intrinsics
    ) -> RenderingWithSurface:
        """Renders one virtual view together with the surface that it was rendered over.

        Args:
            world_from_camera: ``(4, 4)`` where the virtual camera is, metres.
            intrinsics: of the virtual camera; they also set the size of the image.

        Raises:
            OptionError: a pose that is no rigid transform, or intrinsics of another type.
        """
        pose = checked_view(world_from_camera, intrinsics)
        images, surfaces = self._draw(pose[None], intrinsics)
        return RenderingWithSurface(images[0], surfaces[0])

    def render_many(
        self, world_from_camera: FloatArray, intrinsics: Intrinsics
    ) -> tuple[Float32Array, BoolArray]:
        """Renders many virtual views.

        Args:
            world_from_camera: ``(M, 4, 4)`` where the virtual cameras are, metres.
            intrinsics: of all virtual cameras; they also set the size of the images.

        Returns:
            Images ``(M, H, W, 3)`` RGB, 0 to 255, zero where uncovered, and covered pixels
            ``(M, H, W)``.

        Raises:
            OptionError: a pose that is no rigid transform, or intrinsics of another type.
        """
        poses = np.ascontiguousarray(checked_view(world_from_camera, intrinsics, (None, 4, 4)))
        shape = (len(poses), intrinsics.height, intrinsics.width)
        images = np.empty((*shape, 3), dtype=np.float32)
        covered = np.empty(shape, dtype=np.bool_)

        def draw(part: slice) -> None:
            drawn, _ = self._draw(poses[part], intrinsics)
            images[part], covered[part] = drawn[..., :3], drawn[..., 3] > 0.0

        most = max(1, PIXELS_A_CALL // (intrinsics.width * intrinsics.height))
        self._run(draw, len(poses), most)
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
            world_from_camera: ``(M, 4, 4)`` where the camera may have been, metres.
            intrinsics: of the camera image.
            query: ``(H, W, 3)`` camera image, RGB, 0 to 255, undistorted; NaN where it is not to be
                compared.
            cost: the kind of comparison.
            fit_gain: whether a brightness factor is fitted for each pose.
            evidence: of the pixels' differences; needed for EVIDENCE and for no other cost.

        Returns:
            ``(M,)`` costs, in [0, 1] but for EVIDENCE.

        Raises:
            OptionError: poses that are not finite numbers of this shape, an image of another size
                than its intrinsics, EVIDENCE without a table, or another cost with one.
        """
        checked_instance(fit_gain, "fit_gain", bool)
        prepared = prepare_query(query, intrinsics, cost, fit_gain, evidence)
        # Of poses by the hundred, that they are rotations is left to whoever made them.
        poses = checked_array(world_from_camera, "world_from_camera", (None, 4, 4))
        poses = np.ascontiguousarray(poses)
        costs = np.empty(len(poses))
        surfaces = self._native.surfaces(poses, intrinsics)

        def compare(part: slice) -> None:
            costs[part] = self._native.costs(poses[part], surfaces[part], prepared)

        self._run(compare, len(poses), POSES_A_CALL)
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
        """Shares work among the threads.

        Args:
            work: takes the poses of a slice.
            count: number of all poses.
            most: poses of a slice.
        """
        size = min(most, max(1, -(-count // self.threads)))
        parts = [slice(start, start + size) for start in range(0, count, size)]
        remaining = iter(parts)

        def drain() -> None:
            # Threads may share a list's iterator: it yields each part once.
            for part in remaining:
                work(part)

        # This thread works too: to wake another one takes as long as some particles.
        helpers = [self._pool.submit(drain) for _ in range(min(self.threads, len(parts)) - 1)]
        drain()
        for helper in helpers:
            helper.result()


def checked_view(
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
    shape: Shape = (4, 4),
) -> FloatArray:
    """Poses of virtual cameras, as ``shape`` says, that are rigid transforms.

    Raises:
        OptionError: others, or intrinsics that are none.
    """
    checked_instance(intrinsics, "intrinsics", Intrinsics)
    return checked_poses(world_from_camera, "world_from_camera", shape)
