"""From the pixels of a virtual camera, with their depths, to those of the recorded views.

A virtual pixel p at inverse depth d lies at C + R K^-1 p / d. Multiplied by d this is linear in p
and d, so that a view sees it at the homogeneous pixel H p + d e: H is the infinite homography, e
the epipole, which is where the view sees the virtual centre. For a plane d is linear in p too, and
both together are the paper's B_i B_V^-1.
"""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.camera import Intrinsics
from pipelines.lightfield.views import Views


@dataclass(frozen=True)
class ViewMapping:
    """The mapping from a virtual camera into N views.

    Homogeneous pixels are those of the views' finest levels; their third component is the depth in
    the view divided by the virtual depth.

    Attributes:
        world_from_camera: ``(4, 4)`` the virtual camera.
        intrinsics: of the virtual camera.
        homographies: ``(N, 3, 3)`` infinite homographies.
        epipoles: ``(N, 3)``.
    """

    world_from_camera: FloatArray
    intrinsics: Intrinsics
    homographies: FloatArray
    epipoles: FloatArray

    @classmethod
    def of(
        cls, views: Views, world_from_camera: FloatArray, intrinsics: Intrinsics
    ) -> "ViewMapping":
        """The mapping into a light field's views.

        Args:
            views: the photos.
            world_from_camera: ``(4, 4)`` the virtual camera.
            intrinsics: of the virtual camera.
        """
        rays = world_from_camera[:3, :3] @ np.linalg.inv(intrinsics.matrix())
        projection = views.arrays.projection
        homographies = projection[:, :, :3] @ rays
        epipoles = projection[:, :, :3] @ world_from_camera[:3, 3] + projection[:, :, 3]
        return cls(world_from_camera, intrinsics, homographies, epipoles)

    def into_view(self, view: int, pixels: FloatArray, inverse_depth: FloatArray) -> FloatArray:
        """Homogeneous pixels ``(..., 3)`` in one view.

        Args:
            view: which.
            pixels: ``(..., 3)`` homogeneous pixels of the virtual camera.
            inverse_depth: ``(...)`` their virtual inverse depths.
        """
        linear = pixels @ self.homographies[view].T
        return np.asarray(linear + inverse_depth[..., None] * self.epipoles[view])

    def into_all_views(self, pixel: FloatArray, inverse_depth: float) -> FloatArray:
        """Homogeneous pixels ``(N, 3)`` of one virtual pixel ``(3,)`` in all views."""
        return np.asarray(self.homographies @ pixel + self.epipoles * inverse_depth)
