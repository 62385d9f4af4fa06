"""The renderer on a GPU: the same costs and images as ``Renderer``, within rounding.

One program renders and compares: a workgroup takes one pose, selects its views, shades its pixels,
sums up, and writes one number; only poses, one camera image and those numbers are transferred.
Where the surface comes from depth maps, a program before it projects them. The Delaunay mesh is
built on the CPU in between (``gpu_mesh``). Poses are processed in chunks that fit into the GPU's
limits. The GPU computes in single precision, with the origin amid the photos; the CPU path computes
the same in double precision.
"""

import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipelines.artifacts.arguments import checked_instance
from pipelines.artifacts.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    ImageArray,
    checked_array,
)
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane
from pipelines.lightfield.views import Views
from pipelines.render.choices import Blending, Cost, Quality
from pipelines.render.comparison import PixelEvidence, check_query, evidence_table
from pipelines.render.gpu_device import (
    UNIFORM,
    Gpu,
    Program,
    Scratch,
    bind,
    gpu_errors,
    read_back,
)
from pipelines.render.gpu_mesh import MOST_POSES, build_meshes, largest_mesh_bytes, pack_meshes
from pipelines.render.gpu_programs import Programs, needs_two_passes
from pipelines.render.gpu_views import pose_table, source_table, upload_views
from pipelines.render.gpu_work import (
    SETTINGS,
    Sizes,
    corners_of,
    photo_of,
    settings_for,
    tile_bytes,
    tiles_of,
)
from pipelines.render.renderer import Renderer, Rendering, checked_view
from pipelines.render.surface import grid_spacing

POSE_BYTES = 48
# The most poses and costs that are on the GPU at a time.
POSES_KEPT = 1 << 20
# Threads of a workgroup: in a row, and along the side of a square of pixels.
LANES, BLOCK = 64, 8

# A program, its bindings, workgroups across and down; poses are the third dimension.
Dispatch = tuple[Program, Sequence[Any], tuple[int, int]]


class GpuRenderer(Renderer):
    """Renders and compares on a GPU.

    ``costs``, ``render`` and ``render_many`` run on the GPU. ``render_with_surface`` runs on the
    CPU: alignment needs a surface of double precision.

    Args:
        views: the photos.
        plane: the scene's surface where ``quality`` is ``PLANE``; None: a scene without a plane.
        blending: the rule that chooses and weights the views.
        quality: how finely the surface follows the views' depth maps.
        threads: of the work on the CPU; None: one a processor.
        gpu: the GPU.

    Raises:
        OptionError: no threads, or a quality that needs depth maps where there are none.
        StageError: photos too large for the GPU, or it fails.
    """

    def __init__(
        self,
        views: Views,
        plane: Plane | None,
        blending: Blending = Blending.UNSTRUCTURED,
        quality: Quality = Quality.PLANE,
        threads: int | None = None,
        *,
        gpu: Gpu,
    ) -> None:
        super().__init__(views, plane, blending, quality, threads)
        self.gpu = gpu
        self._has_depth = quality is not Quality.PLANE
        self._has_mesh = blending is Blending.DELAUNAY
        self._programs = Programs(gpu, blending, self._has_depth)
        self._comparisons: dict[tuple[Cost, bool], Program] = {}
        self._drawing: dict[str, Program] = {}
        self._surface = self._programs.surface() if self._has_depth else None
        self._visibility = self._programs.visibility() if self._has_mesh else None
        self._scratch = Scratch(gpu)
        self._lock = threading.Lock()
        with gpu_errors():
            self._gpu_views = upload_views(gpu, self.views, self._usable)
        self._plane = np.zeros(4) if plane is None else plane.coefficients().copy()
        self._plane[3] += self._plane[:3] @ self._gpu_views.origin

    def render(self, world_from_camera: FloatArray, intrinsics: Intrinsics) -> Rendering:
        """Renders one virtual view.

        Args:
            world_from_camera: ``(4, 4)``.
            intrinsics: of the virtual camera; they also set the size of the image.
        """
        pose = checked_view(world_from_camera, intrinsics)
        images, covered = self.render_many(pose[None], intrinsics)
        return Rendering(np.rint(images[0]).astype(np.uint8), covered[0])

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
        world_from_camera = checked_view(world_from_camera, intrinsics, (None, 4, 4))
        sizes = self._sizes(intrinsics, has_images=True)
        shape = (len(world_from_camera), intrinsics.height, intrinsics.width)
        images = np.empty((*shape, 3), dtype=np.float32)
        covered = np.empty(shape, dtype=np.bool_)
        with self._lock, gpu_errors():
            if not self._drawing:
                self._drawing = self._programs.drawing()
            settings = self._settings(sizes)
            together = self._poses_at_a_time(sizes)
            for first in range(0, len(world_from_camera), together):
                part = world_from_camera[first : first + together]
                poses = self._scratch.buffer("poses", POSE_BYTES * len(part))
                self._write(poses, pose_table(part, self._gpu_views.origin))
                self._prepare(sizes, settings, poses, part)
                self._submit(settings, self._drawing_steps(sizes, poses, len(part)), len(part))
                numbers = 4 * len(part) * shape[1] * shape[2]
                buffer = self._scratch.buffer("images", 4 * numbers)
                pixels = read_back(self.gpu, buffer, numbers).reshape(-1, *shape[1:], 4)
                images[first : first + together] = pixels[..., :3]
                covered[first : first + together] = pixels[..., 3] > 0.0
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
            evidence: of the pixels' differences; needed for EVIDENCE and for no other cost.

        Returns:
            ``(M,)`` costs, in [0, 1] but for EVIDENCE.

        Raises:
            OptionError: another size than the intrinsics', EVIDENCE without a table, or another
                cost with one.
            StageError: the GPU fails.
        """
        checked_instance(fit_gain, "fit_gain", bool)
        check_query(query, intrinsics)
        table = evidence_table(cost, evidence)
        world_from_camera = checked_array(world_from_camera, "world_from_camera", (None, 4, 4))
        sizes = self._sizes(intrinsics, needs_two_passes(cost, fit_gain))
        photo = photo_of(query)
        if evidence is not None:
            photo.pixels[..., 3] *= 1.0 + evidence.rows(photo.pixels[..., :3])
        result = np.empty(len(world_from_camera))
        with self._lock, gpu_errors():
            program = self._comparison(cost, fit_gain)
            settings = self._settings(sizes)
            settings["compared"] = photo.compared
            settings["compared_pairs"] = photo.compared_pairs
            settings["middle"] = photo.middle
            # The table of evidence follows the pixels.
            pixels = self._written("photo", np.append(photo.pixels.reshape(-1), table))
            for start in range(0, len(result), POSES_KEPT):
                own = slice(start, start + POSES_KEPT)
                result[own] = self._scored(program, sizes, settings, world_from_camera[own], pixels)
        return result

    def _scored(
        self,
        program: Program,
        sizes: Sizes,
        settings: NDArray[np.void],
        world_from_camera: FloatArray,
        photo: Any,
    ) -> Float32Array:
        """Costs of at most ``POSES_KEPT`` poses ``(M, 4, 4)``; the photo is a buffer."""
        together = self._poses_at_a_time(sizes)
        poses = self._scratch.buffer("poses", POSE_BYTES * len(world_from_camera))
        costs = self._scratch.buffer("costs", 4 * len(world_from_camera))
        for first in range(0, len(world_from_camera), together):
            part = world_from_camera[first : first + together]
            settings["first"] = first
            # While the GPU works on a chunk, the next one is prepared here.
            self._write(poses, pose_table(part, self._gpu_views.origin), POSE_BYTES * first)
            self._prepare(sizes, settings, poses, part)
            resources = [*self._shading(sizes, poses, len(part)), photo, costs]
            self._submit(settings, [(program, resources, (1, 1))], len(part), by_pose=True)
        return read_back(self.gpu, costs, len(world_from_camera))

    def _sizes(self, intrinsics: Intrinsics, has_images: bool) -> Sizes:
        spacing = grid_spacing(self.views, intrinsics, self.quality) if self._has_depth else 0.0
        region_bytes = tile_bytes(intrinsics)
        if self._has_mesh:
            region_bytes = largest_mesh_bytes(intrinsics, self._gpu_views.count)
        return Sizes(intrinsics, region_bytes, spacing, has_images)

    def _poses_at_a_time(self, sizes: Sizes) -> int:
        most = sizes.poses_at_a_time(self.gpu, self._gpu_views.count)
        return min(most, MOST_POSES) if self._has_mesh else most

    def _settings(self, sizes: Sizes) -> NDArray[np.void]:
        own = self._gpu_views
        return settings_for(sizes, self._plane, own.count, own.levels, self._typical_inverse_depth)

    def _comparison(self, cost: Cost, fit_gain: bool) -> Program:
        """The program of a cost, compiled when it is first needed."""
        key = (cost, fit_gain)
        if key not in self._comparisons:
            self._comparisons[key] = self._programs.comparison(cost, fit_gain)
        return self._comparisons[key]

    def _written(self, name: str, values: NDArray[Any]) -> Any:
        """A scratch buffer with these values."""
        buffer = self._scratch.buffer(name, values.nbytes)
        self._write(buffer, values)
        return buffer

    def _write(self, buffer: Any, values: NDArray[Any], offset: int = 0) -> None:
        """Writes into a buffer from ``offset`` bytes on, after all work submitted before."""
        self.gpu.device.queue.write_buffer(buffer, offset, np.ascontiguousarray(values))

    def _buffer(self, name: str, sizes: Sizes, count: int) -> Any:
        """A scratch buffer for so many poses."""
        return self._scratch.buffer(name, sizes.bytes_per_pose()[name] * count)

    def _shared(self, poses: Any) -> list[Any]:
        """The first bindings of every program."""
        settings = self._scratch.buffer("settings", SETTINGS.itemsize, UNIFORM)
        return [settings, poses, self._gpu_views.table, self._gpu_views.depths]

    def _shading(self, sizes: Sizes, poses: Any, count: int) -> list[Any]:
        """The first bindings of programs that shade."""
        return [
            *self._shared(poses),
            self._buffer("regions", sizes, count),
            self._buffer("surfaces", sizes, count),
            self._gpu_views.areas,
            self._gpu_views.texels,
            self._buffer("images", sizes, count),
        ]

    def _drawing_steps(self, sizes: Sizes, poses: Any, count: int) -> list[Dispatch]:
        intrinsics = sizes.intrinsics
        across, down = tiles_of(intrinsics)
        groups = {
            "select_candidates": (1, 1),
            "weight_corners": (-(-corners_of(intrinsics) // LANES), 1),
            "join_tiles": (-(-across * down // LANES), 1),
            "draw": (-(-intrinsics.width // BLOCK), -(-intrinsics.height // BLOCK)),
        }
        resources = self._shading(sizes, poses, count)
        return [(program, resources, groups[name]) for name, program in self._drawing.items()]

    def _prepare(
        self, sizes: Sizes, settings: NDArray[np.void], poses: Any, part: FloatArray
    ) -> None:
        """Makes the surfaces and meshes of a chunk of poses, before it is shaded.

        Args:
            sizes: of the buffers.
            settings: changed: the number of regions of the meshes.
            poses: the buffer of poses; ``settings`` holds the first one of the chunk.
            part: ``(B, 4, 4)`` the chunk's poses.
        """
        count = len(part)
        if self._surface is not None:
            table = source_table(self._gpu_views, sizes.intrinsics, sizes.spacing)
            resources = [
                *self._shared(poses),
                self._written("sources", table),
                self._buffer("surfaces", sizes, count),
                self._buffer("grids", sizes, count),
            ]
            self._submit(settings, [(self._surface, resources, (1, 1))], count, by_pose=True)
        if self._visibility is not None:
            visible = self._visible(self._visibility, sizes, settings, poses, count)
            centres = np.ascontiguousarray(self.views.centres[self._gpu_views.chosen])
            meshes = build_meshes(self._pool.map, part, sizes.intrinsics, centres, visible)
            words, settings["regions"] = pack_meshes(meshes, visible)
            self._write(self._buffer("regions", sizes, count), words)

    def _visible(
        self, program: Program, sizes: Sizes, settings: NDArray[np.void], poses: Any, count: int
    ) -> BoolArray:
        """Which views see any of the frustum of each of so many poses, ``(B, N)``."""
        views = self._gpu_views.count
        if views == 0:
            return np.zeros((count, 0), dtype=bool)
        visible = self._scratch.buffer("visible", 4 * count * views)
        resources = [*self._shared(poses), visible, self._buffer("surfaces", sizes, count)]
        self._submit(settings, [(program, resources, (-(-views // LANES), 1))], count)
        seen = read_back(self.gpu, visible, count * views).view(np.uint32)
        return seen.reshape(count, views) > 0

    def _submit(
        self,
        settings: NDArray[np.void],
        steps: Sequence[Dispatch],
        count: int,
        by_pose: bool = False,
    ) -> None:
        """Submits work to the GPU, which does it after all work submitted before.

        Args:
            settings: of all steps.
            steps: in their order.
            count: number of poses.
            by_pose: whether a workgroup takes a pose; else poses are the third dimension.
        """
        device = self.gpu.device
        buffer = self._scratch.buffer("settings", SETTINGS.itemsize, UNIFORM)
        self._write(buffer, settings)
        encoder = device.create_command_encoder()
        work = encoder.begin_compute_pass()
        for program, resources, groups in steps:
            work.set_pipeline(program.pipeline)
            work.set_bind_group(0, bind(self.gpu, program, resources))
            work.dispatch_workgroups(*((count, 1, 1) if by_pose else (*groups, count)))
        work.end()
        device.queue.submit([encoder.finish()])
