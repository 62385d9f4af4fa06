"""The renderer's path through the C++ core: surfaces and blending of all kinds."""

from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    Int32Array,
)
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane
from pipelines.lightfield.view_penalties import (
    BORDER_PENALTY,
    RESOLUTION_PENALTY,
    SMALLEST_MARGIN,
)
from pipelines.lightfield.views import Views
from pipelines.native import DepthSamples, LightField, VirtualViews
from pipelines.render.blending import (
    MOST_RANKED,
    OCCLUSION_FACTOR,
    SMALLEST_PENALTY,
    outlook_positions,
    tile_borders,
)
from pipelines.render.candidate_views import ViewIndex
from pipelines.render.choices import Blending, Cost, Quality
from pipelines.render.comparison import EVIDENCE_BIN, EVIDENCE_BINS, LIMITS, UNCOVERED
from pipelines.render.delaunay_mesh import MESH_LIMITS
from pipelines.render.reference import SMALLEST_WEIGHT, frustum_positions
from pipelines.render.sample_store import SampleStore
from pipelines.render.surface import (
    EDGE_FACTOR,
    LARGEST_GAP_SHARE,
    PINHOLE_FACTOR,
    PINHOLE_NEIGHBOURS,
    SOURCE_VIEWS,
    TURN_COST,
    cell_size,
)


@dataclass(frozen=True)
class Surfaces:
    """What the surfaces that are seen from B poses are made of.

    Attributes:
        samples: of depth maps; None: the surface is the plane.
        sources: ``(B, S)`` the views whose depth maps make each surface; -1 behind the last.
        spacing: of the vertices that approximate it, pixels.
    """

    samples: DepthSamples | None
    sources: Int32Array
    spacing: float

    def __getitem__(self, part: slice) -> "Surfaces":
        return replace(self, sources=self.sources[part])


class NativeRenderer:
    """Renders and compares views of a light field.

    Args:
        views: the photos.
        index: of those that may take part.
        usable: ``(N,)`` which these are.
        plane: the surface where ``quality`` is ``PLANE``.
        blending: the rule that chooses and weights the views.
        quality: how finely the surface follows the views' depth maps.
        usual_inverse_depth: of the depth maps, see ``proxy.usual_inverse_depth``.
    """

    def __init__(
        self,
        views: Views,
        index: ViewIndex,
        usable: BoolArray,
        plane: Plane,
        blending: Blending,
        quality: Quality,
        usual_inverse_depth: float,
    ) -> None:
        arrays = views.arrays
        self._views, self._quality = views, quality
        self._usual_inverse_depth = usual_inverse_depth
        self._light_field = LightField(
            texels=arrays.texels,
            level_start=arrays.level_start,
            level_size=arrays.level_size,
            projection=arrays.projection,
            rays=arrays.rays,
            centres=arrays.centres,
            focal=arrays.focal,
            inverse_depth=arrays.inverse_depth,
            depth_start=arrays.depth_start,
            depth_size=arrays.depth_size,
            pooled_depth=arrays.blocks,
            pooled_start=arrays.block_start,
            usable=usable,
            origin=index.origin,
            order=index.order,
            numbers=index.numbers,
            members=index.members,
            blocks=index.blocks,
            groups=index.groups,
            plane=plane.coefficients(),
            depth_settings=np.array(
                [
                    PINHOLE_FACTOR,
                    PINHOLE_NEIGHBOURS,
                    EDGE_FACTOR,
                    LARGEST_GAP_SHARE,
                    OCCLUSION_FACTOR,
                ]
            ),
            penalties=np.array(
                [RESOLUTION_PENALTY, BORDER_PENALTY, SMALLEST_MARGIN, SMALLEST_PENALTY]
            ),
            most_ranked=MOST_RANKED,
            smallest_weight=SMALLEST_WEIGHT,
            has_mesh=blending is Blending.DELAUNAY,
            mesh=MESH_LIMITS,
        )
        self._samples = SampleStore(arrays, self._light_field.depth_samples)

    def surfaces(self, poses: FloatArray, intrinsics: Intrinsics) -> Surfaces:
        """What the surfaces are made of that virtual cameras see from poses ``(B, 4, 4)``."""
        if self._quality is Quality.PLANE:
            return Surfaces(None, np.empty((len(poses), 0), np.int32), 1.0)
        sources = self._light_field.sources(
            poses, self._usual_inverse_depth, TURN_COST, SOURCE_VIEWS
        )
        is_source = np.zeros(len(self._views), np.bool_)
        is_source[sources[sources >= 0]] = True
        spacing = float(cell_size(self._views, intrinsics, self._quality))
        samples = self._samples(is_source, 0.5 * (intrinsics.fx + intrinsics.fy), spacing)
        return Surfaces(samples, sources, spacing)

    def draw(
        self, poses: FloatArray, surfaces: Surfaces, intrinsics: Intrinsics, chosen: Int32Array
    ) -> tuple[Float32Array, Float32Array]:
        """Views from poses ``(B, 4, 4)``.

        Args:
            poses: world_from_camera.
            surfaces: that are seen from there.
            intrinsics: of the virtual camera.
            chosen: ``(P,)`` which pixels, rising.

        Returns:
            ``(B, P, 4)`` RGB and whether the pixel is covered, and inverse depths ``(B, P)``.
        """
        return self._virtual_views(poses, surfaces, intrinsics, chosen).render()

    def costs(
        self,
        poses: FloatArray,
        surfaces: Surfaces,
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
            surfaces: that are seen from there.
            intrinsics: of the camera image.
            chosen: ``(P,)`` its pixels that are compared, rising.
            target: ``(h, w, 4)`` these pixels, see ``comparison.compare``.
            cost: the kind of comparison.
            fit_gain: whether a brightness factor is fitted for each pose.
            table: see there; empty but for EVIDENCE.
        """
        return self._virtual_views(poses, surfaces, intrinsics, chosen).costs(
            target,
            int(cost),
            fit_gain,
            LIMITS,
            UNCOVERED,
            table.reshape((-1, EVIDENCE_BINS)),
            EVIDENCE_BIN,
        )

    def _virtual_views(
        self, poses: FloatArray, surfaces: Surfaces, intrinsics: Intrinsics, chosen: Int32Array
    ) -> VirtualViews:
        """As the core takes them; see ``draw``."""
        width, height = intrinsics.width, intrinsics.height
        return self._light_field.views(
            poses,
            intrinsics.vector(),
            tile_borders(width),
            tile_borders(height),
            outlook_positions(width),
            outlook_positions(height),
            frustum_positions(width),
            frustum_positions(height),
            chosen,
            width,
            height,
            surfaces.samples,
            surfaces.sources,
            surfaces.spacing,
        )
