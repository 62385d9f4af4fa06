"""The renderer's path through the C++ core: one plane, views blended by either rule."""

import numpy as np

from pipelines.artifacts.array_types import (
    BoolArray,
    Float32Array,
    FloatArray,
    Int32Array,
    IntArray,
)
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane
from pipelines.lightfield.blending import (
    BORDER_PENALTY,
    MOST_RANKED,
    RESOLUTION_PENALTY,
    SMALLEST_MARGIN,
    SMALLEST_PENALTY,
    Blending,
    outlook_positions,
    tile_borders,
)
from pipelines.lightfield.comparison import (
    EVIDENCE_BIN,
    EVIDENCE_BINS,
    GRADIENT_LIMIT,
    LARGEST_GAIN,
    ROBUST_LIMIT,
    UNCOVERED_GRADIENT,
    UNCOVERED_ROBUST,
    UNCOVERED_SQUARED,
    UNCOVERED_ZNCC,
    Cost,
)
from pipelines.lightfield.net import MESH_LIMITS
from pipelines.lightfield.reference import SMALLEST_WEIGHT, frustum_positions
from pipelines.lightfield.view_index import ViewIndex
from pipelines.lightfield.views import ViewArrays
from pipelines.native import PlaneScene

LIMITS = np.array([ROBUST_LIMIT, GRADIENT_LIMIT, LARGEST_GAIN])
UNCOVERED = np.array([UNCOVERED_SQUARED, UNCOVERED_ROBUST, UNCOVERED_ZNCC, UNCOVERED_GRADIENT])


class NativePlane:
    """Renders and compares views of a light field whose surface is a plane.

    Args:
        arrays: the photos.
        index: of those that may take part.
        usable: ``(N,)`` which these are.
        plane: the surface.
        blending: the rule that chooses and weights the views.
    """

    def __init__(
        self,
        arrays: ViewArrays,
        index: ViewIndex,
        usable: BoolArray,
        plane: Plane,
        blending: Blending,
    ) -> None:
        self._scene = PlaneScene(
            texels=arrays.texels,
            level_start=arrays.level_start,
            level_size=arrays.level_size,
            projection=arrays.projection,
            centres=arrays.centres,
            focal=arrays.focal,
            usable=usable,
            origin=index.origin,
            order=index.order,
            numbers=index.numbers,
            members=index.members,
            blocks=index.blocks,
            groups=index.groups,
            plane=plane.coefficients(),
            penalties=np.array(
                [RESOLUTION_PENALTY, BORDER_PENALTY, SMALLEST_MARGIN, SMALLEST_PENALTY]
            ),
            most_ranked=MOST_RANKED,
            smallest_weight=SMALLEST_WEIGHT,
            has_mesh=blending is Blending.DELAUNAY,
            mesh=MESH_LIMITS,
        )

    def draw(
        self, poses: FloatArray, intrinsics: Intrinsics, chosen: Int32Array
    ) -> tuple[Float32Array, Float32Array]:
        """Views from poses ``(B, 4, 4)``.

        Args:
            poses: world_from_camera.
            intrinsics: of the virtual camera.
            chosen: ``(P,)`` which pixels, rising.

        Returns:
            ``(B, P, 4)`` RGB and whether the pixel is covered, and inverse depths ``(B, P)``.
        """
        return self._scene.render(
            poses,
            intrinsics.vector(),
            *_grid(intrinsics),
            chosen,
            intrinsics.width,
            intrinsics.height,
        )

    def costs(
        self,
        poses: FloatArray,
        intrinsics: Intrinsics,
        chosen: Int32Array,
        target: Float32Array,
        cost: Cost,
        fit_gain: bool,
        table: Float32Array,
    ) -> FloatArray:
        """Costs ``(B,)`` of the views from poses ``(B, 4, 4)``.

        Args:
            poses: world_from_camera.
            intrinsics: of the camera image.
            chosen: ``(P,)`` its pixels that are compared, rising.
            target: ``(h, w, 4)`` these pixels, see ``comparison.compare``.
            cost: the kind of comparison.
            fit_gain: whether a brightness factor is fitted for each pose.
            table: see there; empty but for EVIDENCE.
        """
        return self._scene.costs(
            poses,
            intrinsics.vector(),
            *_grid(intrinsics),
            chosen,
            intrinsics.width,
            intrinsics.height,
            target,
            int(cost),
            fit_gain,
            LIMITS,
            UNCOVERED,
            table.reshape((-1, EVIDENCE_BINS)),
            EVIDENCE_BIN,
        )


def _grid(intrinsics: Intrinsics) -> list[IntArray]:
    """Columns and rows: of the tiles' corners, of points of the outlook and of the frustum."""
    return [
        positions(size)
        for positions in (tile_borders, outlook_positions, frustum_positions)
        for size in (intrinsics.width, intrinsics.height)
    ]
