"""Usual depths: how far away what the photos of a scene show is, where no plane says it.

Photos that look in all directions have no dominant plane. The depth sweep still needs a range, and
neighbours a distance at which they are compared. Sparse points or given depth maps tell; without
them, small depth maps of some photos do, whose range is corrected until they agree with it.
"""

from collections.abc import Sequence

import numpy as np
import scipy

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import StageError
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.pose import inverse
from pipelines.lightfield.scene import SceneDepth
from pipelines.lightfield.stereo_depth import DepthSettings, estimate_depth
from pipelines.lightfield.stereo_neighbours import MIN_POINTS, UsualDepths, choose_neighbours
from pipelines.lightfield.views import shrink
from pipelines.reconstruct.reconstruction import Reconstruction

# Small depth maps: longer side in pixels, inverse depths of the sweep, and of how many photos.
SMALL_SIDE, SMALL_PLANES, SAMPLED_VIEWS = 160, 96, 24
# The first guess, in distances from one photo to the nearest other one: rays to a point so far away
# meet at the angle at which depth is found best.
FIRST_GUESS = 6.0
# Recording positions nearer to each other than this share of their extent are one place.
SAME_PLACE = 1e-3
# A sweep reaches from the typical depth over, to the typical depth times, this factor.
REACH = 8.0
# The guess is right once it changes by less than this factor; a scene far larger than the distance
# between its photos takes some rounds.
SETTLED, ROUNDS = 1.3, 8
# Every so many pixels of a depth map.
STRIDE = 7


def depths_of_points(source: Reconstruction) -> UsualDepths | None:
    """From the sparse points, each in the photos that observe it; None where there are too few."""
    point, view = source.observations.T
    camera_from_world = inverse(source.world_from_camera)[view]
    depths = np.einsum("mi,mi->m", camera_from_world[:, 2, :3], source.points[point])
    depths = depths + camera_from_world[:, 2, 3]
    depths = depths[depths > 0.0]
    return UsualDepths.of_depths(depths) if len(depths) >= MIN_POINTS else None


def depths_of_maps(depth: Sequence[SceneDepth]) -> UsualDepths | None:
    """From depth maps; None where there are none."""
    known = [view.inverse_depth[view.inverse_depth > 0.0][::STRIDE] for view in depth]
    values = np.concatenate([np.empty(0), *known]).astype(np.float64)
    return UsualDepths.of_depths(1.0 / values) if len(values) else None


def depths_of_photos(
    photos: Sequence[ImageArray], intrinsics: Sequence[Intrinsics], world_from_camera: FloatArray
) -> UsualDepths:
    """From small depth maps of some photos, computed from all.

    Args:
        photos: N undistorted photos, ``(h, w, 3)`` RGB.
        intrinsics: of each.
        world_from_camera: ``(N, 4, 4)``.

    Raises:
        StageError: fewer than two photos, all of them taken at one place, or none of them sees
            what another one sees.
    """
    if len(photos) < 2:
        raise StageError("depth needs at least two photos of the same place")
    small = [
        shrink(photo, pinhole, SMALL_SIDE)
        for photo, pinhole in zip(photos, intrinsics, strict=True)
    ]
    images, pinholes = [image for image, _ in small], [pinhole for _, pinhole in small]
    settings = DepthSettings(largest_side=SMALL_SIDE, planes=SMALL_PLANES)
    no_points, no_observations = np.empty((0, 3)), np.empty((0, 2), dtype=np.int64)
    sampled = np.unique(np.linspace(0, len(photos) - 1, SAMPLED_VIEWS).round().astype(np.int64))
    guess = _around(FIRST_GUESS * _spacing(world_from_camera[:, :3, 3]))
    for _ in range(ROUNDS):
        neighbours = choose_neighbours(
            world_from_camera, pinholes, guess, no_points, no_observations, settings.neighbours
        )
        found = []
        for view in sampled.tolist():
            if len(neighbours[view]) == 0:
                continue
            limits = guess.near, guess.far
            depth = estimate_depth(
                images, pinholes, world_from_camera, view, neighbours[view], limits, settings
            )
            found.append(1.0 / depth.inverse_depth[depth.confident].astype(np.float64))
        depths = np.concatenate([np.empty(0), *found])
        if len(depths) < MIN_POINTS:
            # Nothing is common to two photos at this distance: they see each other's farther away.
            guess = _around(REACH * guess.typical)
            continue
        typical = 1.0 / float(np.median(1.0 / depths))
        is_settled = 1.0 / SETTLED < typical / guess.typical < SETTLED
        guess = _around(typical)
        if is_settled:
            return UsualDepths.of_depths(depths)
    raise StageError("the photos do not tell how far away what they show is; give --plane a,b,c,d")


def _spacing(centres: FloatArray) -> float:
    """Metres from a recording position to the nearest other one, in the median.

    Photos taken at one place in several directions count once, however their poses are rounded.

    Raises:
        StageError: all of them were taken at one place.
    """
    extent = float(np.max(np.ptp(centres, axis=0)))
    if extent <= 0.0:
        raise StageError("all photos were taken at one place, which leaves depth open")
    places = np.unique(np.round(centres / (SAME_PLACE * extent)), axis=0) * (SAME_PLACE * extent)
    distances, _ = scipy.spatial.cKDTree(places).query(places, k=2)
    return float(np.median(np.asarray(distances)[:, 1]))


def _around(typical: float) -> UsualDepths:
    """A wide range around a typical depth, metres."""
    return UsualDepths(typical / REACH, typical, typical * REACH)
