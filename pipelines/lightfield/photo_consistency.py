"""Photo-consistency over a plane: pairs of views, warped by its homography, and their ZNCC."""

from dataclasses import dataclass

import cv2
import numpy as np

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane
from pipelines.geometry.pose import inverse
from pipelines.lightfield.views import Views

WINDOW = 7
# Windows with less contrast (grey levels, standard deviation) say nothing about the plane.
SMALLEST_CONTRAST = 3.0


@dataclass(frozen=True)
class PairwiseViews:
    """Grey photos at one resolution and the pairs of them that are compared."""

    images: tuple[Float32Array, ...]
    intrinsics: tuple[Intrinsics, ...]
    world_from_camera: FloatArray
    pairs: tuple[tuple[int, int], ...]


def choose_pairs(world_from_camera: FloatArray) -> tuple[tuple[int, int], ...]:
    """Pairs of views with similar axes and a baseline that is neither too short nor too long."""
    centres, axes = world_from_camera[:, :3, 3], world_from_camera[:, :3, 2]
    gaps = np.linalg.norm(centres[:, None] - centres, axis=-1)
    alike = axes @ axes.T > np.cos(np.radians(30.0))
    candidates = (gaps > 1e-6) & alike
    if not candidates.any():
        return ()
    typical = float(np.median(gaps[candidates]))
    pairs = []
    for first in range(len(centres)):
        # Half the typical distance: wide enough to tell planes apart, near enough to look alike.
        order = np.argsort(np.abs(np.log(np.maximum(gaps[first], 1e-9) / (0.5 * typical))))
        partners = [int(other) for other in order if candidates[first, other]][:2]
        pairs += [(first, other) for other in partners]
    unique = sorted({(min(pair), max(pair)) for pair in pairs})
    return tuple(unique)


def spread_evenly(pairs: tuple[tuple[int, int], ...], count: int) -> tuple[tuple[int, int], ...]:
    """At most ``count`` of the pairs, taken evenly from all of them."""
    step = max(1, -(-len(pairs) // count))
    return pairs[::step]


def grey_views(
    views: Views,
    world_from_camera: FloatArray,
    pairs: tuple[tuple[int, int], ...],
    width: int,
) -> PairwiseViews:
    """Photos in grey, area-averaged to ``width`` pixels at most, with the pairs to compare."""
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
    return PairwiseViews(tuple(images), tuple(intrinsics), world_from_camera, pairs)


def plane_correlation(photos: PairwiseViews, plane: Plane) -> float:
    """Mean local ZNCC score over all pairs; -1 for a plane that the photos cannot see."""
    total, weight = 0.0, 0.0
    for first, second in photos.pairs:
        score, pixels = pair_correlation(photos, first, second, plane)
        total += score
        weight += pixels
    possible = len(photos.pairs) * photos.images[0].size
    # A plane that only few pixels of the pairs share could agree by chance.
    if weight < 0.1 * possible:
        return -1.0
    return total / weight


def pair_correlation(
    photos: PairwiseViews, first: int, second: int, plane: Plane
) -> tuple[float, float]:
    """Sum of the local ZNCC scores of a pair, and the number of pixels in the sum."""
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
    """Sum over the valid, textured pixels of the ZNCC score of the windows around them."""
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


def _homography(photos: PairwiseViews, first: int, second: int, plane: Plane) -> FloatArray | None:
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
