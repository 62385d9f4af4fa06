"""A view-independent texture: one colour a surface point, from wherever it is viewed.

This is the best that a textured mesh can do: at each surface point, the mean or the median colour
over all photos that see the point.
"""

from typing import NamedTuple

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.geometry.camera import Intrinsics
from pipelines.lightfield.view_penalties import sees
from pipelines.lightfield.views import Views
from pipelines.render.blending import occluded
from pipelines.render.reference import sample_view
from pipelines.render.view_mapping import ViewMapping


class TextureColours(NamedTuple):
    """Colours of surface points.

    Attributes:
        mean: ``(P, 3)`` RGB, zero where no view sees the point.
        median: ``(P, 3)`` RGB, the median of each channel; zero where no view sees the point.
        seen_by: ``(P,)`` number of views that see the point.
    """

    mean: FloatArray
    median: FloatArray
    seen_by: FloatArray


def texture_colours(
    views: Views,
    usable: BoolArray,
    pixels: FloatArray,
    inverse_depth: FloatArray,
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
) -> TextureColours:
    """View-independent colours of the surface points behind some pixels of a virtual camera.

    A view sees a point that is inside its image, in front of its camera, and not occluded by its
    depth map, with the tolerance of the light field. Photos are sampled at the resolution of the
    virtual camera, as the light field does.

    Args:
        views: the photos.
        usable: ``(N,)`` True for views that are used.
        pixels: ``(P, 2)`` columns and rows in the virtual camera.
        inverse_depth: ``(P,)`` inverse depth of the surface at these pixels; 0: no surface.
        world_from_camera: ``(4, 4)`` pose of the virtual camera.
        intrinsics: of the virtual camera.
    """
    mapping = ViewMapping.of(views, world_from_camera, intrinsics)
    focal = 0.5 * (intrinsics.fx + intrinsics.fy)
    homogeneous = np.column_stack([pixels, np.ones(len(pixels))])
    colours = np.full((len(views), len(pixels), 3), np.inf, dtype=np.float32)
    seen = np.zeros((len(views), len(pixels)), dtype=bool)
    for view in np.flatnonzero(usable):
        target = mapping.into_view(int(view), homogeneous, inverse_depth)
        width, height = views.arrays.level_size[view, 0]
        shown = sees(target, int(width), int(height)) & (inverse_depth > 0.0)
        shown &= ~occluded(views, int(view), target, inverse_depth)
        sampled = sample_view(views, int(view), target, shown, focal)
        colours[view, shown] = sampled[shown]
        seen[view] = shown
    count = seen.sum(axis=0)
    total = np.where(seen[..., None], colours, 0.0).sum(axis=0)
    mean = total / np.maximum(count, 1)[:, None]
    # Missing colours are infinite, so that the first ``count`` sorted ones are those seen.
    ordered = np.sort(colours, axis=0)
    middle = [np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(views) - 1)]
    low, high = (np.take_along_axis(ordered, place[None, :, None], axis=0)[0] for place in middle)
    median = np.where(count[:, None] > 0, 0.5 * (low + high), 0.0)
    return TextureColours(mean, median.astype(np.float64), count.astype(np.float64))
