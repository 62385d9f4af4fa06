"""View selection: which photos a scene model keeps, where there are more than it shall hold.

The model has to render rays: here those of the photos themselves, at a coarse grid of their pixels.
How badly a view shows a ray is its penalty in unstructured-lumigraph rendering
(``view_penalties``): for the angle between both rays at the surface, for a coarser resolution, for
the border of its image. A set of views has the penalty of its best view, and where none sees the
point, ``UNSEEN_PENALTY``. The total over all rays is a facility location problem: by how
much a set lowers it is monotone and submodular, so that adding, one after the other, the view that
lowers it most reaches at least 1 - 1/e of the best possible (Nemhauser, Wolsey, Fisher 1978, "An
analysis of approximations for maximizing submodular set functions"). A view's gain never grows when
others are added, so that most need not be computed again ("lazy" greedy, Minoux 1978).
"""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import Float32Array, FloatArray, IntArray
from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.stages import Progress
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.pose import inverse
from pipelines.lightfield.scene import SceneDepth
from pipelines.lightfield.stereo_neighbours import MIN_POINTS, StandIn, stand_in_depths
from pipelines.lightfield.view_penalties import border_penalties, ray_penalties, sees

GRID_COLUMNS, GRID_ROWS = 6, 4
# More rays than this are thinned out: the table of benefits has a row for each view.
MAX_RAYS = 24_000
# Radians: a view that sees a point under a larger penalty is of no more use than none.
UNSEEN_PENALTY = 0.5


@dataclass(frozen=True)
class KnownSurface:
    """What is known of the scene's surface.

    Attributes:
        stand_in: used where nothing better is known.
        points: ``(P, 3)`` sparse points, world coordinates; may be empty.
        observations: ``(M, 2)`` rows (point, view).
        depth: a depth map a view; may be empty.
    """

    stand_in: StandIn
    points: FloatArray
    observations: IntArray
    depth: Sequence[SceneDepth] = ()


def select_views(
    world_from_camera: FloatArray,
    intrinsics: Sequence[Intrinsics],
    surface: KnownSurface,
    count: int,
    progress: Progress,
) -> IntArray:
    """The views that together show best what all of them show.

    Args:
        world_from_camera: ``(N, 4, 4)``.
        intrinsics: of the N undistorted photos.
        surface: what they show.
        count: the most views that are kept.
        progress: told how far the work is.

    Returns:
        Their indices, ascending: all N where ``count`` is not smaller; fewer than ``count`` where
        the others would add nothing, such as copies of those that are kept.

    Raises:
        OptionError: ``count`` is not positive.
    """
    if count < 1:
        raise OptionError(f"{count} views are no scene model; keep at least 1")
    if count >= len(world_from_camera):
        return np.arange(len(world_from_camera))
    rays = [
        _surface_points(view, world_from_camera[view], intrinsics[view], surface)
        for view in range(len(world_from_camera))
    ]
    benefit = _benefits(rays, world_from_camera, intrinsics, progress)
    return np.sort(greedy_cover(benefit, count))


def greedy_cover(benefit: Float32Array, count: int) -> IntArray:
    """Rows whose columnwise maximum has a large sum: lazy greedy facility location.

    Args:
        benefit: ``(N, Q)``, not negative: benefit of row n for column q.
        count: the most rows that are chosen.

    Returns:
        Their indices in the order in which they were chosen; of equally good ones the first.
    """
    reached = np.zeros(benefit.shape[1], dtype=benefit.dtype)
    # Negative gain, row, how many rows were chosen when the gain was computed.
    queue = [(-float(row.sum(dtype=np.float64)), index, 0) for index, row in enumerate(benefit)]
    heapq.heapify(queue)
    chosen: list[int] = []
    while queue and len(chosen) < count:
        gain, row, computed_at = heapq.heappop(queue)
        if gain >= 0.0:
            break
        if computed_at < len(chosen):
            gained = np.maximum(benefit[row] - reached, 0.0).sum(dtype=np.float64)
            heapq.heappush(queue, (-float(gained), row, len(chosen)))
            continue
        chosen.append(row)
        reached = np.maximum(reached, benefit[row])
    return np.array(chosen, dtype=np.int64)


def _surface_points(
    view: int, world_from_camera: FloatArray, intrinsics: Intrinsics, surface: KnownSurface
) -> FloatArray:
    """``(S, 3)`` where the rays of a grid of a photo's pixels meet the scene.

    The depth at a pixel is that of the photo's depth map, or of its nearest sparse point in the
    image; of a photo without either that of the stand-in.
    """
    rays, depths = stand_in_depths(
        world_from_camera, intrinsics, surface.stand_in, GRID_COLUMNS, GRID_ROWS
    )
    camera_from_world = inverse(world_from_camera)
    own = surface.points[surface.observations[surface.observations[:, 1] == view, 0]]
    seen = own @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
    seen = seen[seen[:, 2] > 0.0]
    if surface.depth:
        inverse_depth = surface.depth[view].inverse_depth
        rows = (np.arange(GRID_ROWS) + 0.5) / GRID_ROWS * inverse_depth.shape[0]
        columns = (np.arange(GRID_COLUMNS) + 0.5) / GRID_COLUMNS * inverse_depth.shape[1]
        values = inverse_depth[np.ix_(rows.astype(int), columns.astype(int))].ravel()
        depths = np.where(values > 0.0, 1.0 / np.where(values > 0.0, values, 1.0), depths)
    elif len(seen) >= MIN_POINTS:
        grid = rays @ camera_from_world[:3, :3].T
        offsets = grid[:, None, :2] - seen[:, :2] / seen[:, 2:]
        depths = seen[np.argmin(np.sum(offsets**2, axis=2), axis=1), 2]
    return np.asarray(world_from_camera[:3, 3] + rays * depths[:, None])


def _benefits(
    rays: Sequence[FloatArray],
    world_from_camera: FloatArray,
    intrinsics: Sequence[Intrinsics],
    progress: Progress,
) -> Float32Array:
    """``(N, Q)``: by how much each view's penalty for each ray lies below that of an unseen point.

    Args:
        rays: for each photo the surface points that its rays meet.
        world_from_camera: ``(N, 4, 4)``.
        intrinsics: of each.
        progress: told how far the work is.
    """
    centres = world_from_camera[:, :3, 3]
    matrices = np.stack([pinhole.matrix() for pinhole in intrinsics])
    projection = matrices @ inverse(world_from_camera)[:, :3]
    size = np.array([(pinhole.width, pinhole.height) for pinhole in intrinsics])
    step = -(-sum(map(len, rays)) // MAX_RAYS)
    thinned = [points[view % step :: step] for view, points in enumerate(rays)]
    benefit = np.zeros((len(rays), sum(map(len, thinned))), dtype=np.float32)
    start = 0
    for view, points in enumerate(progress(thinned, "select views", len(thinned))):
        # Of N views and S points: [N, S, 3].
        target = np.swapaxes(projection[:, :, :3] @ points.T + projection[:, :, 3:], 1, 2)
        inside = sees(target, size[:, None, 0], size[:, None, 1])
        penalty = ray_penalties(centres[:, None], centres[view], points)
        target[~inside] = 1.0
        penalty += border_penalties(target, size[:, None])
        own = np.where(inside, np.maximum(UNSEEN_PENALTY - penalty, 0.0), 0.0)
        benefit[:, start : start + len(points)] = own
        start += len(points)
    return benefit
