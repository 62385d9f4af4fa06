"""The C++ core's renderer: the light field, its surfaces and its rules as the core takes them."""

from dataclasses import dataclass, replace
from functools import partial

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
from pipelines.native import LightField, VirtualViews
from pipelines.render.blending import (
    MOST_RANKED,
    OCCLUSION_FACTOR,
    SMALLEST_PENALTY,
    candidate_positions,
    tile_borders,
)
from pipelines.render.candidate_views import ViewIndex
from pipelines.render.choices import Blending, Quality
from pipelines.render.comparison import (
    EVIDENCE_BIN,
    EVIDENCE_BINS,
    LIMITS,
    UNCOVERED,
    PreparedQuery,
)
from pipelines.render.delaunay_mesh import MESH_LIMITS
from pipelines.render.depth_samples import DepthSamples, joined_samples, take_samples
from pipelines.render.reference import SMALLEST_WEIGHT, frustum_positions
from pipelines.render.sample_store import SampleStore
from pipelines.render.surface import (
    EDGE_FACTOR,
    LARGEST_GAP_SHARE,
    PINHOLE_FACTOR,
    PINHOLE_NEIGHBOURS,
    ROTATION_COST,
    SOURCE_VIEWS,
    grid_spacing,
)


@dataclass(frozen=True)
class Surfaces:
    """What the surfaces seen from B poses are made of.

    Attributes:
        samples: samples of depth maps; None: the surface is the plane.
        sources: ``(B, S)`` the views whose depth maps make each surface; -1 after the last.
        spacing: of the depth grid's vertices, virtual pixels.
    """

    samples: DepthSamples | None
    sources: Int32Array
    spacing: float

    def __getitem__(self, part: slice) -> "Surfaces":
        return replace(self, sources=self.sources[part])


class NativeRenderer:
    """Renders and compares views of a light field.

    Args:
        views: the light field's photos.
        index: of the views that may take part.
        usable: ``(N,)`` views that may take part.
        plane: the surface where ``quality`` is ``PLANE``; else None will do.
        blending: the rule that chooses and weights the views.
        quality: how finely the surface follows the views' depth maps.
        typical_inverse_depth: median of all depth maps' known values, 1 / metres.
    """

    def __init__(
        self,
        views: Views,
        index: ViewIndex,
        usable: BoolArray,
        plane: Plane | None,
        blending: Blending,
        quality: Quality,
        typical_inverse_depth: float,
    ) -> None:
        arrays = views.arrays
        self._views, self._quality = views, quality
        self._typical_inverse_depth = typical_inverse_depth
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
            pooled_depth=arrays.pooled_depth,
            pooled_start=arrays.pooled_start,
            usable=usable,
            origin=index.origin,
            order=index.order,
            numbers=index.numbers,
            members=index.members,
            blocks=index.blocks,
            groups=index.groups,
            plane=np.zeros(4) if plane is None else plane.coefficients(),
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
        self._samples = SampleStore(arrays, partial(take_samples, arrays), joined_samples)

    def surfaces(self, poses: FloatArray, intrinsics: Intrinsics) -> Surfaces:
        """What the surfaces seen by virtual cameras are made of.

        Args:
            poses: ``(B, 4, 4)`` world_from_camera.
            intrinsics: of the virtual cameras.
        """
        if self._quality is Quality.PLANE:
            return Surfaces(None, np.empty((len(poses), 0), np.int32), 1.0)
        sources = self._light_field.sources(
            poses, self._typical_inverse_depth, ROTATION_COST, SOURCE_VIEWS
        )
        is_source = np.zeros(len(self._views), np.bool_)
        is_source[sources[sources >= 0]] = True
        spacing = float(grid_spacing(self._views, intrinsics, self._quality))
        samples = self._samples(is_source, 0.5 * (intrinsics.fx + intrinsics.fy), spacing)
        return Surfaces(samples, sources, spacing)

    def draw(
        self, poses: FloatArray, surfaces: Surfaces, intrinsics: Intrinsics, pixels: Int32Array
    ) -> tuple[Float32Array, Float32Array]:
        """Renders pixels of virtual views.

        Args:
            poses: ``(B, 4, 4)`` world_from_camera.
            surfaces: seen from these poses.
            intrinsics: of the virtual camera.
            pixels: ``(P,)`` indices of the pixels, rising.

        Returns:
            ``(B, P, 4)`` RGB and whether the pixel is covered, and inverse depths ``(B, P)``.
        """
        return self._virtual_views(poses, surfaces, intrinsics, pixels).render()

    def costs(self, poses: FloatArray, surfaces: Surfaces, query: PreparedQuery) -> FloatArray:
        """Costs ``(B,)`` of virtual views compared with a camera image.

        Args:
            poses: ``(B, 4, 4)`` world_from_camera.
            surfaces: seen from these poses.
            query: the camera image.
        """
        return self._virtual_views(poses, surfaces, query.intrinsics, query.pixels).costs(
            query=query.target,
            cost=int(query.cost),
            fit_gain=query.fit_gain,
            limits=LIMITS,
            uncovered=UNCOVERED,
            table=query.table.reshape((-1, EVIDENCE_BINS)),
            evidence_bin=EVIDENCE_BIN,
        )

    def _virtual_views(
        self, poses: FloatArray, surfaces: Surfaces, intrinsics: Intrinsics, pixels: Int32Array
    ) -> VirtualViews:
        """Pixels of virtual views as the core takes them."""
        width, height = intrinsics.width, intrinsics.height
        return self._light_field.views(
            poses=poses,
            intrinsics=intrinsics.vector(),
            across=tile_borders(width),
            down=tile_borders(height),
            probes_across=candidate_positions(width),
            probes_down=candidate_positions(height),
            frustum_across=frustum_positions(width),
            frustum_down=frustum_positions(height),
            pixels=pixels,
            width=width,
            height=height,
            samples=surfaces.samples,
            sources=surfaces.sources,
            spacing=surfaces.spacing,
        )
