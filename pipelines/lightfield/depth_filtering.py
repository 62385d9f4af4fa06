"""Depth-map fusion across neighbouring views.

After Merrell et al. (2007), "Real-time visibility-based fusion of depth maps": the depths that the
neighbours found are seen from the view; at each pixel the depth is taken that most neighbours see
and fewest see through.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import cv2
import numpy as np

from pipelines import native
from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.stages import Progress, no_progress
from pipelines.lightfield.depth_completion import complete_depth
from pipelines.lightfield.packed_depth import PackedDepthMaps
from pipelines.lightfield.stereo_depth import DepthMap, DepthSettings, pixel_transfer

# Rounds of fusion: the second works on the maps that the first has corrected.
ROUNDS = 2
# Weight of a neighbour's depth where it is not confident itself.
UNSURE_TRUST = 0.5


def refine_depth_maps(
    maps: Sequence[DepthMap],
    world_from_camera: FloatArray,
    neighbours: Sequence[IntArray],
    settings: DepthSettings,
    workers: int = 1,
    progress: Progress = no_progress,
) -> PackedDepthMaps:
    """Depth maps that agree with each other: fused in rounds, then completed.

    Args:
        maps: of the N views, as ``estimate_depth`` found them.
        world_from_camera: ``(N, 4, 4)``.
        neighbours: of each view, as ``choose_neighbours`` found them.
        settings: of the fusion: agreement and supporters.
        workers: threads; their number does not change the result.
        progress: told how far the work is.

    Returns:
        For each view depth everywhere; confident where enough neighbours see the same surface.

    Raises:
        OptionError: not as many maps as poses and neighbours.
    """
    if not len(maps) == len(world_from_camera) == len(neighbours):
        raise OptionError(
            f"{len(maps)} depth maps, {len(world_from_camera)} poses and {len(neighbours)} lists "
            "of neighbours do not belong together"
        )
    count = len(maps)
    with ThreadPoolExecutor(max_workers=max(1, workers)) as pool:
        for number in range(ROUNDS):
            fuse = partial(_fuse_view, maps, world_from_camera, neighbours, settings)
            fused = pool.map(fuse, range(count))
            maps = PackedDepthMaps(progress(fused, f"fuse depth {number + 1}/{ROUNDS}", count))
        # One after the other: a sequence that is handed over would be unpacked at once.
        completed = pool.map(partial(_complete_view, maps), range(count))
        return PackedDepthMaps(progress(completed, "complete depth", count))


def _complete_view(maps: Sequence[DepthMap], view: int) -> DepthMap:
    return complete_depth(maps[view])


def _fuse_view(
    maps: Sequence[DepthMap],
    world_from_camera: FloatArray,
    neighbours: Sequence[IntArray],
    settings: DepthSettings,
    view: int,
) -> DepthMap:
    return fuse_depth(maps, world_from_camera, view, neighbours[view], settings)


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
        settings: of the fusion: agreement and supporters.

    Returns:
        Depth everywhere; confident where enough neighbours see the same surface.
    """
    own = maps[view]
    others = [maps[index] for index in neighbours]
    poses = world_from_camera[neighbours]
    pinhole, pose = own.intrinsics, world_from_camera[view]
    to_view = [
        pixel_transfer(other.intrinsics, place, pinhole, pose)
        for other, place in zip(others, poses, strict=True)
    ]
    from_view = [
        pixel_transfer(pinhole, pose, other.intrinsics, place)
        for other, place in zip(others, poses, strict=True)
    ]
    fused, votes = native.fuse_depth(
        own.inverse_depth,
        [other.inverse_depth for other in others],
        [other.confident for other in others],
        np.reshape(to_view, (-1, 3, 4)),
        np.reshape(from_view, (-1, 3, 4)),
        UNSURE_TRUST,
        settings.agreement,
    )
    supporters = max(1, min(settings.supporters, len(neighbours)))
    smooth = np.asarray(cv2.medianBlur(fused, 3), dtype=np.float32)
    return DepthMap(smooth, votes >= supporters, own.intrinsics)
