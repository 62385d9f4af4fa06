"""The scene's dominant plane, from sparse points or from the photos alone, and its uncertainty.

From points: RANSAC with a truncated quadratic score (MSAC, Torr and Zisserman 2000), then least
squares on the inliers. From photos: plane-induced homographies between pairs of views; the plane is
the one under which the pairs agree best in local ZNCC (zero-mean normalised cross-correlation).
"""

from dataclasses import dataclass

import numpy as np
import scipy

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import StageError
from pipelines.artifacts.stages import Progress
from pipelines.geometry.plane import Plane, angle_between, plane_from_coefficients
from pipelines.lightfield.photo_consistency import (
    PairwiseViews,
    choose_pairs,
    grey_views,
    pair_correlation,
    plane_correlation,
    spread_evenly,
)
from pipelines.lightfield.scene import PlaneEstimate
from pipelines.lightfield.views import Views

# A plane seen at a smaller angle than this (sine) is no surface to render from: a floor, a side
# wall.
SMALLEST_INCIDENCE = 0.25
MIN_POINTS = 30
RANSAC_ROUNDS = 2000
# Inliers lie nearer to the plane than this share of the median distance from the cameras.
INLIER_SHARE_OF_DISTANCE = 0.02
COARSE_WIDTH, MIDDLE_WIDTH, FINE_WIDTH = 80, 160, 320
COARSE_PAIRS, FINE_PAIRS = 14, 30
# Below this correlation the photos do not agree on any plane.
SMALLEST_CORRELATION = 0.25
JACKKNIFE_GROUPS = 6
# Radians, and share of the distance.
JACKKNIFE_STEP = 0.01
_AXIS_PAIRS = ((0, 1), (0, 2), (1, 2))


class NoDominantPlaneError(StageError):
    """No single plane stands for what the photos show; depth maps can do without one."""


def plane_from_points(
    points: FloatArray, world_from_camera: FloatArray, rng: np.random.Generator
) -> PlaneEstimate:
    """The dominant plane of sparse points that the cameras look at.

    Args:
        points: ``(P, 3)`` world coordinates.
        world_from_camera: ``(N, 4, 4)``.
        rng: for the random samples.

    Raises:
        NoDominantPlaneError: none of the sampled planes is seen from the front.
        StageError: too few points.
    """
    if len(points) < MIN_POINTS:
        raise StageError(
            f"{len(points)} points are too few for a plane (at least {MIN_POINTS}); give --plane"
        )
    centres, axes = world_from_camera[:, :3, 3], world_from_camera[:, :3, 2]
    middle = np.median(centres, axis=0)
    distance = np.linalg.norm(points - middle, axis=1)
    threshold = INLIER_SHARE_OF_DISTANCE * float(np.median(distance))
    samples = points[rng.integers(0, len(points), (RANSAC_ROUNDS, 3))]
    normals = np.cross(samples[:, 1] - samples[:, 0], samples[:, 2] - samples[:, 0])
    length = np.linalg.norm(normals, axis=1)
    normals = normals[length > 0.0] / length[length > 0.0, None]
    offsets = -np.sum(normals * samples[length > 0.0, 0], axis=1)
    incidence = np.abs(normals @ axes.mean(axis=0))
    scores = np.full(len(normals), np.inf)
    for index in np.flatnonzero(incidence >= SMALLEST_INCIDENCE):
        gaps = np.abs(points @ normals[index] + offsets[index]) / threshold
        scores[index] = np.sum(np.minimum(gaps, 1.0) ** 2)
    if not np.isfinite(scores).any():
        raise NoDominantPlaneError(
            "no plane of the points is seen from the front; give --plane a,b,c,d"
        )
    best = int(np.argmin(scores))
    plane = Plane(normals[best], float(offsets[best]))
    for _ in range(10):
        inliers = np.abs(plane.signed_distance(points)) < threshold
        if np.count_nonzero(inliers) < 3:
            raise NoDominantPlaneError("the points lie on no plane; give --plane a,b,c,d")
        plane = fit_plane(points[inliers])
    # The fit follows the points: a steep slice through a floor ends up as the floor.
    if abs(float(plane.normal @ axes.mean(axis=0))) < SMALLEST_INCIDENCE:
        raise NoDominantPlaneError(
            "no plane of the points is seen from the front; give --plane a,b,c,d"
        )
    inliers = np.abs(plane.signed_distance(points)) < threshold
    offset_sigma, angle_sigma = _least_squares_sigmas(points[inliers], plane, middle)
    share = float(np.mean(inliers))
    return PlaneEstimate(plane.facing(centres), offset_sigma, angle_sigma, "points", share)


def fit_plane(points: FloatArray) -> Plane:
    """The plane through points ``(P, 3)``, P >= 3, with the least squared distances."""
    middle = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - middle, full_matrices=False)
    return Plane(axes[2], -float(axes[2] @ middle))


def _least_squares_sigmas(
    points: FloatArray, plane: Plane, reference: FloatArray
) -> tuple[float, float]:
    """Standard deviations of the plane's distance from a point and of its direction.

    Linear regression of the distances from the plane on the position in it, taking the points'
    errors as independent.
    """
    middle = points.mean(axis=0)
    variance = float(np.mean(plane.signed_distance(points) ** 2))
    _, spread, axes = np.linalg.svd(points - middle, full_matrices=False)
    slope_variance = variance / np.maximum(spread[:2] ** 2, 1e-24)
    lever = axes[:2] @ (reference - middle)
    offset_variance = variance / len(points) + float(slope_variance @ lever**2)
    return float(np.sqrt(offset_variance)), float(np.sqrt(slope_variance.sum()))


def plane_from_photos(
    views: Views, world_from_camera: FloatArray, progress: Progress
) -> PlaneEstimate:
    """The plane over which pairs of photos agree best.

    A grid over the plane's direction and distance at low resolution, then a simplex search at
    higher ones; the uncertainty comes from a jackknife over groups of pairs.

    Args:
        views: the photos.
        world_from_camera: ``(N, 4, 4)``.
        progress: shown during the search.

    Raises:
        NoDominantPlaneError: the photos look in all directions, or agree on no plane.
        StageError: fewer than two photos.
    """
    pairs = choose_pairs(world_from_camera)
    if not pairs:
        raise StageError(
            "the photos' positions are too few or too close together to estimate a plane; "
            "give --plane a,b,c,d"
        )
    frame = _SearchFrame.of_poses(world_from_camera)
    coarse = grey_views(views, world_from_camera, spread_evenly(pairs, COARSE_PAIRS), COARSE_WIDTH)
    candidates = _grid()
    scores = np.array(
        [
            plane_correlation(coarse, frame.plane(candidate))
            for candidate in progress(candidates, "search plane", len(candidates))
        ]
    )
    starts = _distinct_best(candidates, scores, 3)
    pairs = spread_evenly(pairs, FINE_PAIRS)
    middle = grey_views(views, world_from_camera, pairs, MIDDLE_WIDTH)
    refined = [_refine(middle, frame, start, 0.15, 60) for start in progress(starts, "refine", 3)]
    best = max(refined, key=lambda candidate: plane_correlation(middle, frame.plane(candidate)))
    fine = grey_views(views, world_from_camera, pairs, FINE_WIDTH)
    best = _refine(fine, frame, best, 0.03, 40)
    plane = frame.plane(best)
    quality = plane_correlation(fine, plane)
    if quality < SMALLEST_CORRELATION:
        raise NoDominantPlaneError(
            f"the photos do not agree on a plane (best correlation {quality:.2f}); "
            "give --plane a,b,c,d"
        )
    offset_sigma, angle_sigma = _jackknife(middle, frame, best, progress)
    centres = world_from_camera[:, :3, 3]
    return PlaneEstimate(plane.facing(centres), offset_sigma, angle_sigma, "photos", quality)


@dataclass(frozen=True)
class _SearchFrame:
    """Planes as (azimuth, elevation, log distance) around the mean viewing direction.

    Attributes:
        origin: ``(3,)`` mean recording centre.
        axes: ``(3, 3)`` rows: right, up, backwards (against the mean viewing direction).
        scale: metres; a length of the order of the distances between the recording centres.
    """

    origin: FloatArray
    axes: FloatArray
    scale: float

    @classmethod
    def of_poses(cls, world_from_camera: FloatArray) -> "_SearchFrame":
        centres = world_from_camera[:, :3, 3]
        backwards = -world_from_camera[:, :3, 2].mean(axis=0)
        length = np.linalg.norm(backwards)
        if length < 0.2:
            raise NoDominantPlaneError(
                "the photos look in all directions: no single plane can show their scene; "
                "give --plane a,b,c,d"
            )
        backwards = backwards / length
        up = -world_from_camera[:, :3, 1].mean(axis=0)
        up = up - (up @ backwards) * backwards
        up = up / np.linalg.norm(up)
        spread = centres - centres.mean(axis=0)
        scale = float(np.sqrt(np.mean(np.sum(spread**2, axis=1))))
        axes = np.stack([np.cross(up, backwards), up, backwards])
        return cls(centres.mean(axis=0), axes, scale)

    def plane(self, parameters: FloatArray) -> Plane:
        azimuth, elevation, log_distance = parameters
        local = np.array(
            [
                np.sin(azimuth) * np.cos(elevation),
                np.sin(elevation),
                np.cos(azimuth) * np.cos(elevation),
            ]
        )
        normal = local @ self.axes
        # The distance counts along the viewing direction, not along the normal: planes of different
        # direction then still show about the same distance in the middle of the photos.
        depth = self.scale * np.exp(log_distance)
        foot = self.origin - depth * self.axes[2]
        return plane_from_coefficients(np.append(normal, -normal @ foot))


def _grid() -> list[FloatArray]:
    angles = np.radians(np.arange(-60.0, 61.0, 12.0))
    tilts = np.radians([-30.0, 0.0, 30.0])
    distances = np.log(np.geomspace(0.4, 40.0, 24))
    return [np.array([a, t, d]) for a in angles for t in tilts for d in distances]


def _distinct_best(
    candidates: list[FloatArray], scores: FloatArray, count: int
) -> list[FloatArray]:
    """The best candidates that are not neighbours of a better one."""
    chosen: list[FloatArray] = []
    for index in np.argsort(-scores):
        step = np.array([0.25, 0.4, 0.25])
        if all(np.any(np.abs(candidates[index] - other) > step) for other in chosen):
            chosen.append(candidates[index])
        if len(chosen) == count:
            break
    return chosen


def _refine(
    photos: PairwiseViews, frame: _SearchFrame, start: FloatArray, step: float, evaluations: int
) -> FloatArray:
    """Simplex search from ``start`` with steps of size ``step`` in all three parameters."""
    simplex = np.vstack([start, start + step * np.eye(3)])

    def disagreement(candidate: FloatArray) -> float:
        return -plane_correlation(photos, frame.plane(candidate))

    result = scipy.optimize.minimize(
        disagreement,
        start,
        method="Nelder-Mead",
        options={
            "initial_simplex": simplex,
            "xatol": 5e-4,
            "fatol": 1e-5,
            "maxfev": evaluations,
        },
    )
    return np.asarray(result.x, dtype=np.float64)


def _jackknife(
    photos: PairwiseViews, frame: _SearchFrame, best: FloatArray, progress: Progress
) -> tuple[float, float]:
    """Standard deviations of offset (metres) and direction (radians), leaving out pairs.

    The correlation is taken as quadratic around the best plane; the maximum of each subset of the
    pairs is then one Newton step away. What all pairs together are still off their maximum at this
    resolution counts as an error, too.
    """
    groups = min(JACKKNIFE_GROUPS, len(photos.pairs))
    if groups < 2:
        return float("inf"), float("inf")
    steps = [np.zeros(3), *(sign * axis for axis in np.eye(3) for sign in (1.0, -1.0))]
    steps += [sign * (np.eye(3)[i] + np.eye(3)[j]) for i, j in _AXIS_PAIRS for sign in (1.0, -1.0)]
    values = np.empty((len(steps), len(photos.pairs), 2))
    for row, step in enumerate(progress(steps, "judge plane", len(steps))):
        plane = frame.plane(best + JACKKNIFE_STEP * step)
        for number, (first, second) in enumerate(photos.pairs):
            values[row, number] = pair_correlation(photos, first, second, plane)
    group = np.arange(len(photos.pairs)) % groups
    subsets = [np.ones(len(group), dtype=bool), *(group != number for number in range(groups))]
    sums = np.stack([values[:, subset].sum(axis=1) for subset in subsets])  # [1 + G, S, 2]
    if np.any(sums[..., 1] <= 0.0):
        return float("inf"), float("inf")
    correlation = sums[..., 0] / sums[..., 1]
    curvature = _curvature(correlation[0])
    if np.linalg.eigvalsh(curvature).max() >= 0.0:
        return float("inf"), float("inf")
    slopes = (correlation[:, 1:7:2] - correlation[:, 2:7:2]) / 2.0
    offsets = -JACKKNIFE_STEP * np.linalg.solve(curvature, slopes.T).T
    planes = [frame.plane(best + offset) for offset in offsets]
    distance = np.array([float(plane.signed_distance(frame.origin)) for plane in planes])
    mean_normal = np.mean([plane.normal for plane in planes[1:]], axis=0)
    mean = Plane(mean_normal / np.linalg.norm(mean_normal), 0.0)
    angles = np.array([angle_between(plane, mean) for plane in planes[1:]])
    at_best = frame.plane(best)
    offset_rest = distance[0] - float(at_best.signed_distance(frame.origin))
    angle_rest = angle_between(planes[0], at_best)
    factor = groups - 1.0
    return (
        float(np.sqrt(factor * np.var(distance[1:]) + offset_rest**2)),
        float(np.sqrt(factor * np.mean(angles**2) + angle_rest**2)),
    )


def _curvature(values: FloatArray) -> FloatArray:
    """Second derivatives ``(3, 3)`` from the values at the steps of ``_jackknife``, step 1."""
    curvature = np.diag(values[1:7:2] + values[2:7:2] - 2.0 * values[0])
    for number, (i, j) in enumerate(_AXIS_PAIRS):
        both = values[7 + 2 * number] + values[8 + 2 * number] - 2.0 * values[0]
        curvature[i, j] = curvature[j, i] = (both - curvature[i, i] - curvature[j, j]) / 2.0
    return curvature
