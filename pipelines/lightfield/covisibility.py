"""Co-visibility: which photos see the same surface, and how much of it.

Where structure from motion found points, two photos share what both of them observe. Where there
are none, what can be known is where the cameras were and looked: points are set into each photo's
frustum at distances at which things stand in a room, and two photos share those that lie in both
frusta. Walls are not known then, but the recording went round them: photos share the less, the
longer the way from one to the other is, and nothing where it is a way round.
"""

from collections.abc import Sequence

import numpy as np
import scipy.sparse
import scipy.spatial

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.pose import inverse
from pipelines.lightfield.recorded_paths import RecordedPaths

# Metres from the camera: a photo's grid of rays meets a point at each of them, and other photos are
# taken to see it up to REACH.
VIEWING_DISTANCES, REACH = (0.75, 1.5, 3.0), 4.0
GRID_COLUMNS, GRID_ROWS = 6, 4
# A way is no way round as long as it is not longer than this multiple of the straight line.
DETOUR = 1.2
# Metres of way after which photos share 1/e of what their frusta do. On a floor of eight rooms,
# 1 and 2 m give areas that are rooms, and without it corners of three rooms come together.
WAY_SCALE = 2.0
# Photos from one place belong together although they may look away from each other: a robot that
# stands there may turn. Linked positions share at least so much.
LINK_WEIGHT = 0.5


def covisibility(
    world_from_camera: FloatArray,
    intrinsics: Sequence[Intrinsics],
    points: FloatArray,
    observations: IntArray,
    paths: RecordedPaths,
) -> scipy.sparse.csr_array:
    """How much of what a photo sees others see, between 0 and 1.

    Args:
        world_from_camera: ``(N, 4, 4)``.
        intrinsics: of the N undistorted photos.
        points: ``(P, 3)`` sparse points; may be empty.
        observations: ``(M, 2)`` rows (point, view).
        paths: links between the positions of the photos.

    Returns:
        Symmetric ``(N, N)``, nothing on the diagonal.
    """
    count = len(world_from_camera)
    if len(observations):
        shared = _shared_points(observations, len(points), count)
    else:
        shared = _shared_frusta(world_from_camera, intrinsics, paths)
    first, second = paths.links.T
    links = scipy.sparse.csr_array(
        (np.full(len(first), LINK_WEIGHT), (first, second)), shape=(count, count)
    )
    total = scipy.sparse.csr_array(shared + links + links.T)
    total.setdiag(0.0)
    total.eliminate_zeros()
    total.sort_indices()
    return total


def _shared_points(observations: IntArray, points: int, views: int) -> scipy.sparse.csr_array:
    """Shared points by the geometric mean of the numbers that both photos observe."""
    pairs = np.unique(observations, axis=0)
    seen = scipy.sparse.csr_array(
        (np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(points, views)
    )
    norms = np.sqrt(np.maximum(seen.sum(axis=0), 1.0))
    scaled = scipy.sparse.csr_array(seen @ scipy.sparse.diags_array(1.0 / norms))
    return scipy.sparse.csr_array(scaled.T @ scaled)


def _shared_frusta(
    world_from_camera: FloatArray, intrinsics: Sequence[Intrinsics], paths: RecordedPaths
) -> scipy.sparse.csr_array:
    """Share of the points in one photo's frustum that lie in the other's, mean of both ways."""
    count = len(world_from_camera)
    camera_from_world = inverse(world_from_camera)
    focal = np.array([(pinhole.fx, pinhole.fy) for pinhole in intrinsics])
    centre = np.array([(pinhole.cx, pinhole.cy) for pinhole in intrinsics])
    size = np.array([(pinhole.width, pinhole.height) for pinhole in intrinsics])
    tree = scipy.spatial.KDTree(paths.positions)
    rows, columns, values = [], [], []
    for block, walking in paths.walking_distances(DETOUR * REACH + paths.step):
        for view, ways in zip(block.tolist(), walking, strict=True):
            near = np.array(sorted(tree.query_ball_point(paths.positions[view], REACH)))
            straight = np.linalg.norm(paths.positions[near] - paths.positions[view], axis=1)
            others = near[ways[near] <= DETOUR * straight + paths.step]
            points = _frustum_points(world_from_camera[view], intrinsics[view])
            # Of V other photos and S points: [V, S, 3].
            local = points @ camera_from_world[others, :3, :3].swapaxes(1, 2)
            local += camera_from_world[others, None, :3, 3]
            ahead = (local[..., 2] > 0.0) & (local[..., 2] <= REACH)
            pixels = local[..., :2] / np.where(ahead, local[..., 2], 1.0)[..., None]
            pixels = pixels * focal[others, None] + centre[others, None]
            inside = np.all((pixels > -0.5) & (pixels < size[others, None] - 0.5), axis=2)
            share = (inside & ahead).mean(axis=1) * np.exp(-ways[others] / WAY_SCALE)
            rows.append(np.full(np.count_nonzero(share), view))
            columns.append(others[share > 0.0])
            values.append(share[share > 0.0])
    one_way = scipy.sparse.csr_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
        shape=(count, count),
    )
    return scipy.sparse.csr_array(0.5 * (one_way + one_way.T))


def _frustum_points(world_from_camera: FloatArray, intrinsics: Intrinsics) -> FloatArray:
    """``(S, 3)`` points on a grid of a photo's rays, world coordinates."""
    u = (np.arange(GRID_COLUMNS) + 0.5) / GRID_COLUMNS * intrinsics.width - 0.5
    v = (np.arange(GRID_ROWS) + 0.5) / GRID_ROWS * intrinsics.height - 0.5
    columns, rows = (grid.ravel() for grid in np.meshgrid(u, v))
    pixels = np.stack([columns, rows, np.ones(columns.size)])
    rays = (world_from_camera[:3, :3] @ np.linalg.inv(intrinsics.matrix()) @ pixels).T
    reached = np.array(VIEWING_DISTANCES)[:, None, None] * rays
    return np.asarray(world_from_camera[:3, 3] + reached.reshape(-1, 3))
