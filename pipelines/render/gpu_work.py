"""The settings of a dispatch on the GPU: sizes, memory, and how many poses it can take."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.camera import Intrinsics
from pipelines.render.blending import CANDIDATE_POINTS, VIEWS_PER_TILE, tile_count
from pipelines.render.comparison import prepared
from pipelines.render.gpu_device import UNIT_BYTES, Gpu
from pipelines.render.surface import LARGEST_GAP_SHARE

# ``Settings`` of ``geometry.wgsl``.
SETTINGS = np.dtype(
    [
        ("size", np.uint32, 2),
        ("tiles", np.uint32, 2),
        ("pinhole", np.float32, 4),
        ("plane", np.float32, 4),
        ("first", np.uint32),
        ("view_count", np.uint32),
        ("levels", np.uint32),
        ("grid_rounds", np.uint32),
        ("grid_size", np.uint32, 2),
        ("spacing", np.float32),
        ("focal", np.float32),
        ("compared", np.float32),
        ("compared_pairs", np.float32),
        ("middle", np.float32),
        ("typical_inverse_depth", np.float32),
        ("regions", np.uint32),
        ("padding", np.uint32, 3),
    ]
)
# Scratch memory of one dispatch, bytes; the GPU may allow less for one buffer.
MEMORY_AT_A_TIME = 256 * 1024 * 1024
# Largest product of pixels and views of one dispatch. Systems stop a GPU that does not answer for
# some seconds, and the worst pixel evaluates all views.
WORK_AT_A_TIME = 1 << 32


@dataclass(frozen=True)
class Sizes:
    """Sizes of the buffers that one pose needs.

    Attributes:
        intrinsics: of the virtual camera.
        region_bytes: bytes of the views and weights of one pose's tiles or mesh.
        spacing: of the depth grid, virtual pixels; 0: a plane, without a grid.
        has_images: whether the rendered images are kept.
    """

    intrinsics: Intrinsics
    region_bytes: int
    spacing: float
    has_images: bool

    @property
    def grid_size(self) -> tuple[int, int]:
        """Vertices of the depth grid, across and down."""
        if self.spacing == 0.0:
            return 0, 0
        width, height = self.intrinsics.width, self.intrinsics.height
        return (
            math.ceil((width - 1) / self.spacing) + 1,
            math.ceil((height - 1) / self.spacing) + 1,
        )

    @property
    def grid_rounds(self) -> int:
        """The most rounds in which holes of the grid are filled."""
        return int(LARGEST_GAP_SHARE * max(self.grid_size)) + 1

    def bytes_per_pose(self) -> dict[str, int]:
        """Name of each buffer that holds all poses -> bytes of one pose."""
        pixels = self.intrinsics.width * self.intrinsics.height
        return {
            "regions": self.region_bytes,
            "images": UNIT_BYTES * pixels if self.has_images else 0,
            "surfaces": 4 * pixels if self.spacing else 0,
            "grids": 2 * 4 * math.prod(self.grid_size),
        }

    def poses_at_a_time(self, gpu: Gpu, view_count: int) -> int:
        """How many poses one dispatch takes.

        Args:
            gpu: which does the work.
            view_count: views that may take part.

        Raises:
            OptionError: not even one.
        """
        each = self.bytes_per_pose()
        pixels = self.intrinsics.width * self.intrinsics.height
        if max(each.values()) > gpu.largest_binding:
            raise OptionError(
                f"an image of {self.intrinsics.width}x{self.intrinsics.height} pixels is too large "
                "for this GPU; use device cpu"
            )
        most = min(
            gpu.limits["max-compute-workgroups-per-dimension"],
            gpu.largest_binding // max(each.values()),
            MEMORY_AT_A_TIME // sum(each.values()),
            WORK_AT_A_TIME // (pixels * max(view_count, 1)),
        )
        return max(1, most)


def tiles_of(intrinsics: Intrinsics) -> tuple[int, int]:
    """Tiles across and down an image."""
    return tile_count(intrinsics.width), tile_count(intrinsics.height)


def corners_of(intrinsics: Intrinsics) -> int:
    """Number of corners of an image's tiles."""
    across, down = tiles_of(intrinsics)
    return (across + 1) * (down + 1)


def tile_bytes(intrinsics: Intrinsics) -> int:
    """Bytes of one pose's candidate points, tile corners and tiles, as in ``weights.wgsl``."""
    units = 2 * (CANDIDATE_POINTS**2 + corners_of(intrinsics)) + math.prod(tiles_of(intrinsics)) * (
        VIEWS_PER_TILE // 4 + VIEWS_PER_TILE
    )
    return UNIT_BYTES * units


@dataclass(frozen=True)
class Photo:
    """A camera image as the comparison on the GPU takes it.

    Attributes:
        pixels: ``(H, W, 4)`` as ``comparison.prepared`` returns it.
        compared: how many pixels are compared.
        compared_pairs: how many pairs of neighbours are both compared.
        middle: mean of the pixels that are compared, grey levels.
    """

    pixels: Float32Array
    compared: int
    compared_pairs: int
    middle: float


def photo_of(query: ImageArray | Float32Array) -> Photo:
    """Prepares a camera image ``(H, W, 3)``, NaN where it is not to be compared."""
    pixels = prepared(query)
    counts: BoolArray = pixels[..., 3] > 0.0
    across = counts[:, :-1] & counts[:, 1:]
    down = counts[:-1] & counts[1:]
    return Photo(
        pixels=pixels,
        compared=int(counts.sum()),
        compared_pairs=int(across.sum()) + int(down.sum()),
        middle=float(pixels[counts, :3].mean(dtype=np.float64)) if counts.any() else 0.0,
    )


def settings_for(
    sizes: Sizes, plane: FloatArray, view_count: int, levels: int, typical_inverse_depth: float
) -> NDArray[np.void]:
    """The settings ``(1,)``, but for those that depend on a camera image.

    Args:
        sizes: of the buffers.
        plane: ``(4,)`` unit normal and offset, in the GPU's coordinates.
        view_count: number of views on the GPU.
        levels: number of levels of their pyramids.
        typical_inverse_depth: median of all depth maps' known values, 1 / metres.
    """
    intrinsics = sizes.intrinsics
    settings = np.zeros(1, dtype=SETTINGS)
    settings["size"] = intrinsics.width, intrinsics.height
    settings["tiles"] = tiles_of(intrinsics)
    settings["pinhole"] = intrinsics.vector()
    settings["plane"] = plane
    settings["view_count"] = view_count
    settings["levels"] = levels
    settings["grid_rounds"] = sizes.grid_rounds
    settings["grid_size"] = sizes.grid_size
    settings["spacing"] = sizes.spacing
    settings["focal"] = 0.5 * (intrinsics.fx + intrinsics.fy)
    settings["typical_inverse_depth"] = typical_inverse_depth
    return settings
