"""Depth maps of neighbouring views brought to agree.

After Merrell et al. (2007), "Real-time visibility-based fusion of depth maps": the depths that the
neighbours found are seen from the view; at each pixel the depth is taken that most neighbours see
and fewest see through.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from pipelines.artifacts.array_types import FloatArray, IntArray
from pipelines.geometry.pose import inverse
from pipelines.lightfield import depth_fusion_kernels
from pipelines.lightfield.depth import DepthMap, DepthSettings

# What a neighbour's depth counts where it is not confident itself.
UNSURE_TRUST = 0.5


def fuse_depth(
    maps: Sequence[DepthMap],
    world_from_camera: FloatArray,
    view: int,
    neighbours: IntArray,
    settings: DepthSettings,
) -> DepthMap:
    """One view's depth map, corrected by its neighbours' and with its confidence.

    Args:
        maps: of the N views.
        world_from_camera: ``(N, 4, 4)``.
        view: index of the view.
        neighbours: indices of the views to compare it with.
        settings: how.

    Returns:
        Depth everywhere; confident where enough neighbours see the same surface.
    """
    own = maps[view]
    shape = (len(neighbours) + 1, *own.inverse_depth.shape)
    candidates = np.zeros(shape, np.float32)
    support, violation = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    candidates[0] = own.inverse_depth
    for number, index in enumerate(neighbours, start=1):
        depth_fusion_kernels.project_depth(
            maps[index].inverse_depth,
            *_pixel_mapping(maps, world_from_camera, int(index), view),
            candidates[number],
        )
    for index in neighbours:
        rays, shift = _pixel_mapping(maps, world_from_camera, view, int(index))
        trust = np.where(maps[index].confident, 1.0, UNSURE_TRUST).astype(np.float32)
        for candidate, supported, violated in zip(candidates, support, violation, strict=True):
            depth_fusion_kernels.judge(
                candidate,
                rays,
                shift,
                maps[index].inverse_depth,
                trust,
                settings.agreement,
                supported,
                violated,
            )
    chosen, votes = np.empty(shape[1:], np.float32), np.empty(shape[1:], np.float32)
    depth_fusion_kernels.choose(candidates, support, violation, settings.agreement, chosen, votes)
    smooth = np.asarray(cv2.medianBlur(chosen, 3), dtype=np.float32)
    return DepthMap(smooth, votes >= min(settings.supporters, len(neighbours)), own.intrinsics)


def _pixel_mapping(
    maps: Sequence[DepthMap], world_from_camera: FloatArray, source: int, target: int
) -> tuple[FloatArray, FloatArray]:
    """A and b: pixel p of ``source`` with inverse depth q lies at pixel A p + q b of ``target``."""
    target_from_source = inverse(world_from_camera[target]) @ world_from_camera[source]
    from_matrix, to_matrix = maps[source].intrinsics.matrix(), maps[target].intrinsics.matrix()
    rays = to_matrix @ target_from_source[:3, :3] @ np.linalg.inv(from_matrix)
    return rays, to_matrix @ target_from_source[:3, 3]
