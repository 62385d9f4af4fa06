"""What a card is told for one kind of work: sizes, and how many poses it can take at a time."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.camera import Intrinsics
from pipelines.render.blending import OUTLOOK_POINTS, VIEWS_PER_TILE, tile_count
from pipelines.render.comparison import prepared
from pipelines.render.gpu_device import Gpu
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
        ("mesh_rounds", np.uint32),
        ("mesh_size", np.uint32, 2),
        ("spacing", np.float32),
        ("focal", np.float32),
        ("compared", np.float32),
        ("compared_pairs", np.float32),
        ("middle", np.float32),
        ("usual_inverse_depth", np.float32),
        ("cells", np.uint32),
        ("padding", np.uint32, 3),
    ]
)
WORD_OF_FOUR = 16
# Working memory for one turn; the card may have less in one piece.
MEMORY_AT_A_TIME = 256 * 1024 * 1024
# Of one dispatch: pixels times views. Systems stop a card that does not answer for some seconds,
# and the worst pixel looks at all views.
WORK_AT_A_TIME = 1 << 32


@dataclass(frozen=True)
class Sizes:
    """Bytes that one pose needs, by the name of the buffer; and what the sizes follow from.

    Attributes:
        intrinsics: of the virtual camera.
        cell_bytes: what the views and weights of one pose's cells take.
        spacing: of the surface's mesh, virtual pixels; 0: a plane, without a mesh.
        has_images: whether the rendered images are kept.
    """

    intrinsics: Intrinsics
    cell_bytes: int
    spacing: float
    has_images: bool

    @property
    def mesh_size(self) -> tuple[int, int]:
        """Corners of the mesh, across and down."""
        if self.spacing == 0.0:
            return 0, 0
        width, height = self.intrinsics.width, self.intrinsics.height
        return (
            math.ceil((width - 1) / self.spacing) + 1,
            math.ceil((height - 1) / self.spacing) + 1,
        )

    @property
    def mesh_rounds(self) -> int:
        """In how many steps gaps are closed at most."""
        return int(LARGEST_GAP_SHARE * max(self.mesh_size)) + 1

    def bytes_per_pose(self) -> dict[str, int]:
        """Of each buffer that poses share."""
        pixels = self.intrinsics.width * self.intrinsics.height
        return {
            "workspace": self.cell_bytes,
            "images": WORD_OF_FOUR * pixels if self.has_images else 0,
            "surfaces": 4 * pixels if self.spacing else 0,
            "meshes": 2 * 4 * math.prod(self.mesh_size),
        }

    def poses_at_a_time(self, gpu: Gpu, view_count: int) -> int:
        """How many poses one dispatch takes.

        Raises:
            OptionError: not even one.
        """
        each = self.bytes_per_pose()
        pixels = self.intrinsics.width * self.intrinsics.height
        if max(each.values()) > gpu.largest_binding:
            raise OptionError(
                f"an image of {self.intrinsics.width}x{self.intrinsics.height} pixels is too large "
                "for this graphics card; use device cpu"
            )
        most = min(
            gpu.limits["max-compute-workgroups-per-dimension"],
            gpu.largest_binding // max(each.values()),
            MEMORY_AT_A_TIME // sum(each.values()),
            WORK_AT_A_TIME // (pixels * max(view_count, 1)),
        )
        return max(1, most)


def tiles_of(intrinsics: Intrinsics) -> tuple[int, int]:
    """Tiles across and down."""
    return tile_count(intrinsics.width), tile_count(intrinsics.height)


def corners_of(intrinsics: Intrinsics) -> int:
    """Corners of the tiles."""
    across, down = tiles_of(intrinsics)
    return (across + 1) * (down + 1)


def tile_bytes(intrinsics: Intrinsics) -> int:
    """What one pose's points and tiles take; see ``weights.wgsl``."""
    words = 2 * (OUTLOOK_POINTS**2 + corners_of(intrinsics)) + math.prod(tiles_of(intrinsics)) * (
        VIEWS_PER_TILE // 4 + VIEWS_PER_TILE
    )
    return WORD_OF_FOUR * words


@dataclass(frozen=True)
class Photo:
    """A camera image as the comparison on the card takes it.

    Attributes:
        pixels: ``(H, W, 4)``, see ``comparison.prepared``.
        compared: how many pixels are.
        compared_pairs: how many pairs of neighbours are.
        middle: mean of what is compared, grey levels.
    """

    pixels: Float32Array
    compared: int
    compared_pairs: int
    middle: float


def photo_of(query: ImageArray | Float32Array) -> Photo:
    """Of a camera image ``(H, W, 3)``, NaN where it is not to be compared."""
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
    sizes: Sizes, plane: FloatArray, view_count: int, levels: int, usual_inverse_depth: float
) -> NDArray[np.void]:
    """The settings ``(1,)`` of what does not depend on a camera image.

    Args:
        sizes: of the work.
        plane: ``(4,)`` unit normal and offset, in the card's coordinates.
        view_count: of the views on the card.
        levels: of their pyramids.
        usual_inverse_depth: the median of all depth maps.
    """
    intrinsics = sizes.intrinsics
    settings = np.zeros(1, dtype=SETTINGS)
    settings["size"] = intrinsics.width, intrinsics.height
    settings["tiles"] = tiles_of(intrinsics)
    settings["pinhole"] = intrinsics.vector()
    settings["plane"] = plane
    settings["view_count"] = view_count
    settings["levels"] = levels
    settings["mesh_rounds"] = sizes.mesh_rounds
    settings["mesh_size"] = sizes.mesh_size
    settings["spacing"] = sizes.spacing
    settings["focal"] = 0.5 * (intrinsics.fx + intrinsics.fy)
    settings["usual_inverse_depth"] = usual_inverse_depth
    return settings
