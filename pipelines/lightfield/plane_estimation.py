"""The scene's dominant plane, from sparse points or from the photos alone, and how sure it is.

From points: RANSAC with a truncated quadratic score (MSAC, Torr and Zisserman 2000), then least
squares on the inliers. From photos: plane-induced homographies between pairs of views; the plane is
the one under which the pairs agree best in local zero-mean normalised cross-correlation.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import minimize

from pipelines.artifacts.array_types import BoolArray, Float32Array, FloatArray
from pipelines.artifacts.errors import StageError
from pipelines.artifacts.progress import Progress
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane, angle_between, plane_from_coefficients
from pipelines.geometry.pose import inverse
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
WINDOW = 7
# Windows with less contrast (grey levels, standard deviation) say nothing about the plane.
SMALLEST_CONTRAST = 3.0
COARSE_PAIRS, FINE_PAIRS = 14, 30
# Below this correlation the photos do not agree on any plane.
SMALLEST_CORRELATION = 0.25
JACKKNIFE_GROUPS = 6


def plane_from_points(
    points: FloatArray, world_from_camera: FloatArray, rng: np.random.Generator
) -> PlaneEstimate:
    """The dominant plane of sparse points that the cameras look at.

    Args:
        points: ``(P, 3)`` world coordinates.
        world_from_camera: ``(N, 4, 4)``.
        rng: for the random samples.

    Raises:
        StageError: too few points, or none of the sampled planes is seen from the front.
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
        raise StageError("no plane of the points is seen from the front; give --plane a,b,c,d")
    best = int(np.argmin(scores))
    plane = Plane(normals[best], float(offsets[best]))
    for _ in range(10):
        inliers = np.abs(plane.signed_distance(points)) < threshold
        if np.count_nonzero(inliers) < 3:
            raise StageError("the points lie on no plane; give --plane a,b,c,d")
        plane = fit_plane(points[inliers])
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
    points: FloatArray, plane: Plane, place: FloatArray
) -> tuple[float, float]:
    """Standard deviations of the plane's distance from ``place`` and of its direction.

    Linear regression of the distances from the plane on the position in it, taking the points'
    errors as independent.
    """
    middle = points.mean(axis=0)
    variance = float(np.mean(plane.signed_distance(points) ** 2))
    _, spread, axes = np.linalg.svd(points - middle, full_matrices=False)
    slope_variance = variance / np.maximum(spread[:2] ** 2, 1e-24)
    lever = axes[:2] @ (place - middle)
    offset_variance = variance / len(points) + float(slope_variance @ lever**2)
    return float(np.sqrt(offset_variance)), float(np.sqrt(slope_variance.sum()))


@dataclass(frozen=True)
class _PairwiseViews:
    """Grey photos at one resolution and the pairs of them that are compared."""

    images: tuple[Float32Array, ...]
    intrinsics: tuple[Intrinsics, ...]
    world_from_camera: FloatArray
    pairs: tuple[tuple[int, int], ...]


def plane_from_photos(
    views: Views, world_from_camera: FloatArray, progress: Progress
) -> PlaneEstimate:
    """The plane over which pairs of photos agree best.

    A grid over the plane's direction and distance at low resolution, then a simplex search at
    higher ones; how sure the result is comes from a jackknife over groups of pairs.

    Args:
        views: the photos.
        world_from_camera: ``(N, 4, 4)``.
        progress: shown during the search.

    Raises:
        StageError: fewer than two photos, or no plane under which they agree.
    """
    pairs = _choose_pairs(world_from_camera)
    if not pairs:
        raise StageError(
            "the photos' positions are too few or too close together to estimate a plane; "
            "give --plane a,b,c,d"
        )
    frame = _SearchFrame.of_poses(world_from_camera)
    coarse = _grey_views(views, world_from_camera, _spread(pairs, COARSE_PAIRS), COARSE_WIDTH)
    candidates = _grid()
    scores = np.array(
        [
            _correlation(coarse, frame.plane(candidate))
            for candidate in progress(candidates, "search plane", len(candidates))
        ]
    )
    starts = _distinct_best(candidates, scores, 3)
    pairs = _spread(pairs, FINE_PAIRS)
    middle = _grey_views(views, world_from_camera, pairs, MIDDLE_WIDTH)
    refined = [_refine(middle, frame, start, 0.15, 60) for start in progress(starts, "refine", 3)]
    best = max(refined, key=lambda candidate: _correlation(middle, frame.plane(candidate)))
    fine = _grey_views(views, world_from_camera, pairs, FINE_WIDTH)
    best = _refine(fine, frame, best, 0.03, 40)
    plane = frame.plane(best)
    quality = _correlation(fine, plane)
    if quality < SMALLEST_CORRELATION:
        raise StageError(
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
            raise StageError(
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
    photos: _PairwiseViews, frame: _SearchFrame, start: FloatArray, step: float, evaluations: int
) -> FloatArray:
    """Simplex search from ``start`` with steps of size ``step`` in all three parameters."""
    simplex = np.vstack([start, start + step * np.eye(3)])

    def disagreement(candidate: FloatArray) -> float:
        return -_correlation(photos, frame.plane(candidate))

    result = minimize(
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
    photos: _PairwiseViews, frame: _SearchFrame, best: FloatArray, progress: Progress
) -> tuple[float, float]:
    """Standard deviations of offset (metres) and direction (radians), leaving out pairs."""
    groups = min(JACKKNIFE_GROUPS, len(photos.pairs))
    if groups < 2:
        return float("inf"), float("inf")
    planes = []
    for group in progress(range(groups), "judge plane", groups):
        kept = tuple(pair for n, pair in enumerate(photos.pairs) if n % groups != group)
        subset = _PairwiseViews(photos.images, photos.intrinsics, photos.world_from_camera, kept)
        planes.append(frame.plane(_refine(subset, frame, best, 0.02, 40)))
    distance = np.array([float(plane.signed_distance(frame.origin)) for plane in planes])
    mean_normal = np.mean([plane.normal for plane in planes], axis=0)
    mean = Plane(mean_normal / np.linalg.norm(mean_normal), 0.0)
    angles = np.array([angle_between(plane, mean) for plane in planes])
    factor = groups - 1.0
    return (
        float(np.sqrt(factor * np.mean((distance - distance.mean()) ** 2))),
        float(np.sqrt(factor * np.mean(angles**2))),
    )


def _choose_pairs(world_from_camera: FloatArray) -> tuple[tuple[int, int], ...]:
    """Pairs that look the same way from places that are neither too close nor too far apart."""
    centres, axes = world_from_camera[:, :3, 3], world_from_camera[:, :3, 2]
    gaps = np.linalg.norm(centres[:, None] - centres, axis=-1)
    alike = axes @ axes.T > np.cos(np.radians(30.0))
    candidates = (gaps > 1e-6) & alike
    if not candidates.any():
        return ()
    usual = float(np.median(gaps[candidates]))
    pairs = []
    for first in range(len(centres)):
        # Half the usual distance: wide enough to tell planes apart, near enough to look alike.
        order = np.argsort(np.abs(np.log(np.maximum(gaps[first], 1e-9) / (0.5 * usual))))
        partners = [int(other) for other in order if candidates[first, other]][:2]
        pairs += [(first, other) for other in partners]
    unique = sorted({(min(pair), max(pair)) for pair in pairs})
    return tuple(unique)


def _spread(pairs: tuple[tuple[int, int], ...], count: int) -> tuple[tuple[int, int], ...]:
    """At most ``count`` of the pairs, taken evenly from all of them."""
    step = max(1, -(-len(pairs) // count))
    return pairs[::step]


def _grey_views(
    views: Views,
    world_from_camera: FloatArray,
    pairs: tuple[tuple[int, int], ...],
    width: int,
) -> _PairwiseViews:
    images, intrinsics = [], []
    for view in range(len(views)):
        full = views.intrinsics[view]
        scale = min(1.0, width / full.width)
        pinhole = full.resized(
            max(8, round(full.width * scale)), max(8, round(full.height * scale))
        )
        grey = cv2.cvtColor(np.ascontiguousarray(views.level(view, 0)), cv2.COLOR_RGB2GRAY)
        size = (pinhole.width, pinhole.height)
        images.append(cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.float32))
        intrinsics.append(pinhole)
    return _PairwiseViews(tuple(images), tuple(intrinsics), world_from_camera, pairs)


def _correlation(photos: _PairwiseViews, plane: Plane) -> float:
    """Mean local correlation over all pairs; -1 for a plane that the photos cannot see."""
    total, weight = 0.0, 0.0
    for first, second in photos.pairs:
        score, pixels = _pair_correlation(photos, first, second, plane)
        total += score
        weight += pixels
    possible = len(photos.pairs) * photos.images[0].size
    # A plane that only few pixels of the pairs share could agree by chance.
    if weight < 0.1 * possible:
        return -1.0
    return total / weight


def _pair_correlation(
    photos: _PairwiseViews, first: int, second: int, plane: Plane
) -> tuple[float, float]:
    """Sum of the local correlations of a pair, and over how many pixels."""
    mapping = _homography(photos, first, second, plane)
    image = photos.images[first]
    height, width = image.shape
    corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1]])
    if mapping is None or np.any(corners @ mapping[2] <= 0.0):
        return 0.0, 0.0
    warped = cv2.warpPerspective(
        photos.images[second],
        mapping,
        (width, height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=-1e4,
    )
    valid = cv2.erode((warped >= 0.0).astype(np.uint8), np.ones((WINDOW, WINDOW), np.uint8)) > 0
    return _local_correlation(image, np.maximum(warped, 0.0), valid)


def _local_correlation(
    first: Float32Array, second: Float32Array, valid: BoolArray
) -> tuple[float, float]:
    """Sum over the valid, textured pixels of the correlation of the windows around them."""
    window = (WINDOW, WINDOW)
    mean_first, mean_second = cv2.blur(first, window), cv2.blur(second, window)
    variance_first = cv2.blur(first * first, window) - mean_first**2
    variance_second = cv2.blur(second * second, window) - mean_second**2
    covariance = cv2.blur(first * second, window) - mean_first * mean_second
    textured = valid & (variance_first > SMALLEST_CONTRAST**2)
    floor = np.float32(SMALLEST_CONTRAST**2)
    scale = np.sqrt(np.maximum(variance_first, floor) * np.maximum(variance_second, floor))
    correlation = np.clip(covariance[textured] / scale[textured], -1.0, 1.0)
    return float(correlation.sum()), float(np.count_nonzero(textured))


def _homography(photos: _PairwiseViews, first: int, second: int, plane: Plane) -> FloatArray | None:
    """Pixels of the first photo to pixels of the second over the plane; None if it is not seen."""
    first_from_world = inverse(photos.world_from_camera[first])
    second_from_first = inverse(photos.world_from_camera[second]) @ np.linalg.inv(first_from_world)
    height = float(plane.signed_distance(photos.world_from_camera[first][:3, 3]))
    other = float(plane.signed_distance(photos.world_from_camera[second][:3, 3]))
    if height <= 0.0 or other <= 0.0:
        return None
    normal = photos.world_from_camera[first][:3, :3].T @ plane.normal
    # Points of the plane obey -normal . x / height = 1 in the first camera's coordinates.
    transfer = second_from_first[:3, :3] - np.outer(second_from_first[:3, 3], normal) / height
    matrix = photos.intrinsics[second].matrix() @ transfer
    return np.asarray(matrix @ np.linalg.inv(photos.intrinsics[first].matrix()))
