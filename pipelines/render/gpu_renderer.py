"""The renderer on a graphics card: the same costs and images as ``Renderer``, within rounding.

One program renders and compares: a workgroup takes one pose, chooses its views, shades its pixels,
sums up, and writes one number; poses, one camera image and those numbers are all that crosses the
bus. Where the surface comes from depth maps, a program before it projects them. The net of
triangles is cut on the CPU in between (``gpu_net``). Poses take turns in chunks that fit into the
card's limits. What is computed here in single precision, around the photos' middle, is computed on
the CPU in double precision.
"""

import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane
from pipelines.lightfield.views import Views
from pipelines.render.choices import Blending, Cost, Quality
from pipelines.render.comparison import PixelEvidence, evidence_table
from pipelines.render.gpu_device import (
    UNIFORM,
    Gpu,
    Program,
    Scratch,
    bind,
    card_errors,
    read_back,
)
from pipelines.render.gpu_mesh import MOST_POSES, cut_nets, largest_net_bytes, net_words
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
from pipelines.render.renderer import Renderer, Rendering, check_query
from pipelines.render.surface import cell_size

POSE_BYTES = 48
# So many poses and costs are on the card at a time.
POSES_KEPT = 1 << 20
LANES, BLOCK = 64, 8

# A program, its buffers, workgroups across and down; poses are the third dimension.
Dispatch = tuple[Program, Sequence[Any], tuple[int, int]]


class GpuRenderer(Renderer):
    """Renders and scores on a graphics card.

    ``costs``, ``render`` and ``render_many`` run on the card. ``render_with_surface`` runs on the
    CPU: what is aligned with it needs a surface of double precision.

    Args:
        views: the photos.
        plane: the scene's surface where ``quality`` is ``PLANE``.
        blending: the rule that chooses and weights the views.
        quality: how finely the surface follows the views' depth maps.
        threads: of what runs on the CPU.
        gpu: the card.

    Raises:
        OptionError: as for ``Renderer``.
        StageError: photos too large for the card, or it fails.
    """

    def __init__(
        self,
        views: Views,
        plane: Plane,
        blending: Blending = Blending.UNSTRUCTURED,
        quality: Quality = Quality.PLANE,
        threads: int | None = None,
        *,
        gpu: Gpu,
    ) -> None:
        super().__init__(views, plane, blending, quality, threads)
        self.gpu = gpu
        self._has_depth = quality is not Quality.PLANE
        self._has_net = blending is Blending.DELAUNAY
        self._programs = Programs(gpu, blending, self._has_depth)
        self._comparisons: dict[tuple[Cost, bool], Program] = {}
        self._drawing: dict[str, Program] = {}
        self._surface = self._programs.surface() if self._has_depth else None
        self._sight = self._programs.sight() if self._has_net else None
        self._scratch = Scratch(gpu)
        self._lock = threading.Lock()
        with card_errors():
            self._card = upload_views(gpu, self.views, self._usable)
        self._plane = plane.coefficients().copy()
        self._plane[3] += self._plane[:3] @ self._card.origin

    def render(self, world_from_camera: FloatArray, intrinsics: Intrinsics) -> Rendering:
        """Renders one virtual view; see ``Renderer.render``."""
        images, covered = self.render_many(world_from_camera[None], intrinsics)
        return Rendering(np.rint(images[0]).astype(np.uint8), covered[0])

    def render_many(
        self, world_from_camera: FloatArray, intrinsics: Intrinsics
    ) -> tuple[Float32Array, BoolArray]:
        """Renders many virtual views; see ``Renderer.render_many``."""
        sizes = self._sizes(intrinsics, has_images=True)
        shape = (len(world_from_camera), intrinsics.height, intrinsics.width)
        images = np.empty((*shape, 3), dtype=np.float32)
        covered = np.empty(shape, dtype=np.bool_)
        with self._lock, card_errors():
            if not self._drawing:
                self._drawing = self._programs.drawing()
            settings = self._settings(sizes)
            together = self._poses_at_a_time(sizes)
            for first in range(0, len(world_from_camera), together):
                part = world_from_camera[first : first + together]
                poses = self._scratch.buffer("poses", POSE_BYTES * len(part))
                self._write(poses, pose_table(part, self._card.origin))
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
        """Compares the views rendered at many poses with one image; see ``Renderer.costs``."""
        check_query(query, intrinsics)
        table = evidence_table(cost, evidence)
        sizes = self._sizes(intrinsics, needs_two_passes(cost, fit_gain))
        photo = photo_of(query)
        if evidence is not None:
            photo.pixels[..., 3] *= 1.0 + evidence.rows(photo.pixels[..., :3])
        result = np.empty(len(world_from_camera))
        with self._lock, card_errors():
            program = self._comparison(cost, fit_gain)
            settings = self._settings(sizes)
            settings["compared"] = photo.compared
            settings["compared_pairs"] = photo.compared_pairs
            settings["middle"] = photo.middle
            # The table of evidence stands behind the pixels.
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
        """Costs of as many poses ``(M, 4, 4)`` as are kept on the card; the photo is a buffer."""
        together = self._poses_at_a_time(sizes)
        poses = self._scratch.buffer("poses", POSE_BYTES * len(world_from_camera))
        costs = self._scratch.buffer("costs", 4 * len(world_from_camera))
        for first in range(0, len(world_from_camera), together):
            part = world_from_camera[first : first + together]
            settings["first"] = first
            # While the card is at work on a chunk, the next one is prepared here.
            self._write(poses, pose_table(part, self._card.origin), POSE_BYTES * first)
            self._prepare(sizes, settings, poses, part)
            resources = [*self._shading(sizes, poses, len(part)), photo, costs]
            self._submit(settings, [(program, resources, (1, 1))], len(part), by_pose=True)
        return read_back(self.gpu, costs, len(world_from_camera))

    def _sizes(self, intrinsics: Intrinsics, has_images: bool) -> Sizes:
        spacing = cell_size(self.views, intrinsics, self.quality) if self._has_depth else 0.0
        cells = tile_bytes(intrinsics)
        if self._has_net:
            cells = largest_net_bytes(intrinsics, self._card.count)
        return Sizes(intrinsics, cells, spacing, has_images)

    def _poses_at_a_time(self, sizes: Sizes) -> int:
        most = sizes.poses_at_a_time(self.gpu, self._card.count)
        return min(most, MOST_POSES) if self._has_net else most

    def _settings(self, sizes: Sizes) -> NDArray[np.void]:
        return settings_for(
            sizes, self._plane, self._card.count, self._card.levels, self._usual_inverse_depth
        )

    def _comparison(self, cost: Cost, fit_gain: bool) -> Program:
        """The program of a cost, compiled when it is first needed."""
        key = (cost, fit_gain)
        if key not in self._comparisons:
            self._comparisons[key] = self._programs.comparison(cost, fit_gain)
        return self._comparisons[key]

    def _written(self, name: str, values: NDArray[Any]) -> Any:
        """A buffer of the card with these values."""
        buffer = self._scratch.buffer(name, values.nbytes)
        self._write(buffer, values)
        return buffer

    def _write(self, buffer: Any, values: NDArray[Any], offset: int = 0) -> None:
        """Writes into a buffer, behind so many bytes, after what was sent to the card before."""
        self.gpu.device.queue.write_buffer(buffer, offset, np.ascontiguousarray(values))

    def _buffer(self, name: str, sizes: Sizes, count: int) -> Any:
        """Working memory for so many poses."""
        return self._scratch.buffer(name, sizes.bytes_per_pose()[name] * count)

    def _shared(self, poses: Any) -> list[Any]:
        """What every program takes at its first places."""
        settings = self._scratch.buffer("settings", SETTINGS.itemsize, UNIFORM)
        return [settings, poses, self._card.table, self._card.depths]

    def _shading(self, sizes: Sizes, poses: Any, count: int) -> list[Any]:
        """What programs that shade take at their first places."""
        return [
            *self._shared(poses),
            self._buffer("workspace", sizes, count),
            self._buffer("surfaces", sizes, count),
            self._card.areas,
            self._card.texels,
            self._buffer("images", sizes, count),
        ]

    def _drawing_steps(self, sizes: Sizes, poses: Any, count: int) -> list[Dispatch]:
        intrinsics = sizes.intrinsics
        across, down = tiles_of(intrinsics)
        groups = {
            "narrow": (1, 1),
            "weigh": (-(-corners_of(intrinsics) // LANES), 1),
            "join": (-(-across * down // LANES), 1),
            "draw": (-(-intrinsics.width // BLOCK), -(-intrinsics.height // BLOCK)),
        }
        resources = self._shading(sizes, poses, count)
        return [(program, resources, groups[name]) for name, program in self._drawing.items()]

    def _prepare(
        self, sizes: Sizes, settings: NDArray[np.void], poses: Any, part: FloatArray
    ) -> None:
        """What comes before a chunk is shaded: its surfaces, and its nets.

        Args:
            sizes: of the work.
            settings: changed: the nets' cells.
            poses: the buffer of poses, of which ``settings`` says where the chunk begins.
            part: ``(B, 4, 4)`` the chunk's poses.
        """
        count = len(part)
        if self._surface is not None:
            table = source_table(self._card, sizes.intrinsics, sizes.spacing)
            resources = [
                *self._shared(poses),
                self._written("sources", table),
                self._buffer("surfaces", sizes, count),
                self._buffer("meshes", sizes, count),
            ]
            self._submit(settings, [(self._surface, resources, (1, 1))], count, by_pose=True)
        if self._sight is not None:
            visible = self._visible(self._sight, sizes, settings, poses, count)
            centres = np.ascontiguousarray(self.views.centres[self._card.chosen])
            nets = cut_nets(self._pool.map, part, sizes.intrinsics, centres, visible)
            words, settings["cells"] = net_words(nets, visible)
            workspace = self._buffer("workspace", sizes, count)
            self._write(workspace, words)

    def _visible(
        self, sight: Program, sizes: Sizes, settings: NDArray[np.void], poses: Any, count: int
    ) -> BoolArray:
        """Which views see anything from each of so many poses, ``(B, N)``."""
        views = self._card.count
        if views == 0:
            return np.zeros((count, 0), dtype=bool)
        sights = self._scratch.buffer("sights", 4 * count * views)
        resources = [*self._shared(poses), sights, self._buffer("surfaces", sizes, count)]
        self._submit(settings, [(sight, resources, (-(-views // LANES), 1))], count)
        seen = read_back(self.gpu, sights, count * views).view(np.uint32)
        return seen.reshape(count, views) > 0

    def _submit(
        self,
        settings: NDArray[np.void],
        steps: Sequence[Dispatch],
        count: int,
        by_pose: bool = False,
    ) -> None:
        """Sends work to the card, which does it after what was sent before.

        Args:
            settings: for all of the steps.
            steps: in their order.
            count: poses.
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
