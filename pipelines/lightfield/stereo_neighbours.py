"""Stereo neighbours: from which photos a depth map is computed, and its range of depths.

Both questions are asked of *samples*: points of the scene that a view sees. They are its sparse
points where structure from motion found some, else points of a stand-in: the scene's plane, or
where it has none, the depths that its photos usually show.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import OptionError, StageError
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane
from pipelines.geometry.pose import inverse

# Fewer sparse points than this say too little about what a view sees.
MIN_POINTS = 30
# More samples than this cost time and change nothing.
MAX_SAMPLES = 600
GRID_COLUMNS, GRID_ROWS = 12, 9
# Degrees between two rays to a point: below the first, depth is uncertain; above it, windows look
# more and more different, with this standard deviation.
BEST_ANGLE, ANGLE_SPREAD = 5.0, 8.0
# Weight of a sample that lies in a view's frustum, but that the view did not match.
UNMATCHED_WEIGHT = 0.3
# Weight of a sample once a good neighbour is chosen that sees it.
REPEATED_WEIGHT = 0.4
# Rays that meet the plane farther away than this multiple of the median see something else.
FARTHEST_MULTIPLE = 3.0
POINT_PERCENTILES = (1.0, 99.0)
NEAR_OF_POINTS, FAR_OF_POINTS = 0.85, 1.25
# Things stand in front of a plane, and a mirror in it shows what lies behind.
NEAR_OF_PLANE, FAR_OF_PLANE = 0.4, 2.5


@dataclass(frozen=True)
class UsualDepths:
    """Depths along the optical axis that the photos of a scene usually show, metres.

    Attributes:
        near: nearly nothing is nearer.
        typical: the median.
        far: nearly nothing is farther.
    """

    near: float
    typical: float
    far: float

    @classmethod
    def of_depths(cls, depths: FloatArray) -> "UsualDepths":
        """Those of depths ``(P,)``, positive, in metres, with a margin for what they miss."""
        farthest, typical, nearest = np.percentile(
            1.0 / depths, [POINT_PERCENTILES[0], 50.0, POINT_PERCENTILES[1]]
        )
        return cls(
            float(NEAR_OF_POINTS / nearest), float(1.0 / typical), float(FAR_OF_POINTS / farthest)
        )


# What is taken for the surface where nothing better is known of it.
StandIn = Plane | UsualDepths


def choose_neighbours(
    world_from_camera: FloatArray,
    intrinsics: Sequence[Intrinsics],
    stand_in: StandIn,
    points: FloatArray,
    observations: IntArray,
    count: int,
) -> tuple[IntArray, ...]:
    """The views from which the depth of each view is best found.

    One after the other, the view is taken that sees most of the samples under a good angle and from
    a like distance; samples that a neighbour sees already count less, so that the neighbours stand
    on all sides and cover the whole image.

    Args:
        world_from_camera: ``(N, 4, 4)``.
        intrinsics: of the N pinhole images.
        stand_in: used in the scene's place where a view has too few sparse points.
        points: ``(P, 3)`` sparse points, world coordinates; may be empty.
        observations: ``(M, 2)`` rows (point, view).
        count: the most neighbours of a view.

    Returns:
        For each view the indices of its neighbours, the best first; fewer than ``count``, even
        none, where no more views see any of it.

    Raises:
        StageError: fewer than two views.
        OptionError: ``count`` is not positive.
    """
    if len(world_from_camera) < 2:
        raise StageError("depth needs at least two photos of the same place")
    if count < 1:
        raise OptionError(f"{count} neighbours are not enough for depth; at least 1")
    camera_from_world = inverse(world_from_camera)
    matrices = np.stack([pinhole.matrix() for pinhole in intrinsics])
    limits = np.array([(pinhole.width, pinhole.height) for pinhole in intrinsics]) - 0.5
    chosen = []
    for view in range(len(world_from_camera)):
        samples, matched = _samples(
            view, world_from_camera, intrinsics[view], stand_in, points, observations
        )
        pixels = (camera_from_world[:, :3, :3] @ samples.T + camera_from_world[:, :3, 3:]).swapaxes(
            1, 2
        ) @ matrices.swapaxes(1, 2)
        in_front = pixels[..., 2] > 0.0
        pixels = pixels[..., :2] / np.where(in_front, pixels[..., 2], 1.0)[..., None]
        seen = in_front & np.all((pixels >= -0.5) & (pixels <= limits[:, None]), axis=2)
        worth = seen * matched * _worth(world_from_camera[:, :3, 3], view, samples)
        worth[view] = 0.0
        chosen.append(_greedy(worth, count))
    return tuple(chosen)


def depth_range(
    view: int,
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
    stand_in: StandIn,
    points: FloatArray,
    observations: IntArray,
) -> tuple[float, float]:
    """The depths (metres along z, near and far) between which a view's scene lies.

    From the sparse points that the view observes; where it observes too few, from the plane, with
    wider margins, or from what the scene's photos usually show.

    Args:
        view: index of the view.
        world_from_camera: ``(N, 4, 4)``.
        intrinsics: of this view.
        stand_in: the scene's plane, or its usual depths.
        points: ``(P, 3)`` sparse points; may be empty.
        observations: ``(M, 2)`` rows (point, view).

    Raises:
        OptionError: the range is empty or not finite.
    """
    observed = points[observations[observations[:, 1] == view, 0]]
    camera_from_world = inverse(world_from_camera[view])
    depth = observed @ camera_from_world[2, :3] + camera_from_world[2, 3]
    depth = depth[depth > 0.0]
    if len(depth) >= MIN_POINTS:
        farthest, nearest = np.percentile(1.0 / depth, POINT_PERCENTILES)
        near, far = NEAR_OF_POINTS / nearest, FAR_OF_POINTS / farthest
    elif isinstance(stand_in, UsualDepths):
        near, far = stand_in.near, stand_in.far
    else:
        on_plane = stand_in_depths(world_from_camera[view], intrinsics, stand_in)[1]
        near, far = NEAR_OF_PLANE * np.min(on_plane), FAR_OF_PLANE * np.max(on_plane)
    return checked_range(float(near), float(far))


def checked_range(near: float, far: float) -> tuple[float, float]:
    """The range itself.

    Raises:
        OptionError: it is empty, not positive or not finite.
    """
    if not (np.isfinite(near) and np.isfinite(far) and 0.0 < near < far * (1.0 - 1e-6)):
        raise OptionError(f"depths from {near:g} m to {far:g} m are no range to search")
    return near, far


def _samples(
    view: int,
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
    stand_in: StandIn,
    points: FloatArray,
    observations: IntArray,
) -> tuple[FloatArray, FloatArray]:
    """Points ``(S, 3)`` that a view sees, and how sure it is ``(N, S)`` that the others do."""
    views = len(world_from_camera)
    own = np.unique(observations[observations[:, 1] == view, 0])
    if len(own) < MIN_POINTS:
        rays, depths = stand_in_depths(world_from_camera[view], intrinsics, stand_in)
        samples = world_from_camera[view, :3, 3] + rays * depths[:, None]
        return samples, np.ones((views, len(samples)))
    own = own[:: -(-len(own) // MAX_SAMPLES)]
    matched = np.full((views, len(own)), UNMATCHED_WEIGHT)
    place = np.searchsorted(own, observations[:, 0])
    shared = own[np.minimum(place, len(own) - 1)] == observations[:, 0]
    matched[observations[shared, 1], place[shared]] = 1.0
    return points[own], matched


def stand_in_depths(
    world_from_camera: FloatArray,
    intrinsics: Intrinsics,
    stand_in: StandIn,
    columns: int = GRID_COLUMNS,
    rows: int = GRID_ROWS,
) -> tuple[FloatArray, FloatArray]:
    """A grid of rays ``(S, 3)`` with z = 1 in the camera, and the depths ``(S,)`` of the stand-in.

    Rays that miss a plane, or meet it far behind the rest of the image, get the median depth of
    the others; a view that looks away from the plane gets its distance from it.
    """
    u = (np.arange(columns) + 0.5) / columns * intrinsics.width - 0.5
    v = (np.arange(rows) + 0.5) / rows * intrinsics.height - 0.5
    pixels = np.stack([*(grid.ravel() for grid in np.meshgrid(u, v)), np.ones(u.size * v.size)])
    rays = (world_from_camera[:3, :3] @ np.linalg.inv(intrinsics.matrix()) @ pixels).T
    if isinstance(stand_in, UsualDepths):
        return rays, np.full(len(rays), stand_in.typical)
    height = float(stand_in.signed_distance(world_from_camera[:3, 3]))
    slope = rays @ stand_in.normal
    with np.errstate(divide="ignore"):
        depths = np.where(slope * height < 0.0, -height / slope, np.inf)
    met = np.isfinite(depths)
    typical = float(np.median(depths[met])) if np.any(met) else abs(height)
    return rays, np.where(depths <= FARTHEST_MULTIPLE * typical, depths, typical)


def _worth(centres: FloatArray, view: int, samples: FloatArray) -> FloatArray:
    """How good ``(N, S)`` each view's ray to each sample is for triangulating it with ``view``."""
    rays = samples - centres[:, None]
    distance = np.linalg.norm(rays, axis=2)
    cosine = np.sum(rays * rays[view], axis=2) / np.maximum(distance * distance[view], 1e-12)
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    too_wide = np.exp(-0.5 * ((angle - BEST_ANGLE) / ANGLE_SPREAD) ** 2)
    by_angle = np.where(angle < BEST_ANGLE, angle / BEST_ANGLE, too_wide)
    nearer, farther = np.minimum(distance, distance[view]), np.maximum(distance, distance[view])
    return np.asarray(by_angle * (nearer / np.maximum(farther, 1e-12)) ** 2)


def _greedy(worth: FloatArray, count: int) -> IntArray:
    """Views, the best first, each judged by what it adds to those before it."""
    open_share = np.ones(worth.shape[1])
    chosen: list[int] = []
    while len(chosen) < count:
        gain = worth @ open_share
        gain[chosen] = 0.0
        best = int(np.argmax(gain))
        if gain[best] <= 0.0:
            break
        chosen.append(best)
        open_share = open_share * (1.0 - (1.0 - REPEATED_WEIGHT) * worth[best])
    return np.array(chosen, dtype=np.int64)
