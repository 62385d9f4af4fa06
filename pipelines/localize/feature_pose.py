"""A camera's pose from features: SIFT, matching, perspective-n-point.

Matches of features (``local_features``) are mutual nearest neighbours that pass the ratio test. The
pose comes from pycolmap: LO-RANSAC over minimal solutions, then robust refinement, with the
camera's own distortion.

Pixels have their centres at integers here and at .5 in pycolmap.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import Float32Array, FloatArray, ImageArray, IntArray
from pipelines.geometry.camera import Camera
from pipelines.lightfield.local_features import Features, find_features
from pipelines.reconstruct.colmap_model import PIXEL_CENTRE_SHIFT, colmap_params

# Largest ratio of the distances to the nearest and to the second nearest descriptor.
RATIO = 0.8
# The strongest features rank the photos, and so many photos are matched with all features.
RANKING_FEATURES, MATCHED_PHOTOS = 256, 12
# Reprojection error up to which a landmark is an inlier: a share of the image's longer side, and at
# least so many pixels.
LARGEST_ERROR_SHARE = 0.0125
SMALLEST_ERROR = 2.0
RANSAC_TRIALS = 20_000


@dataclass(frozen=True)
class FeatureSettings:
    """How poses are found.

    Attributes:
        max_size: features are detected in images reduced to this longer side, pixels.
        max_features: the most features of an image.
        min_inliers: the fewest inliers of a pose.
        seed: of RANSAC.
        threads: photos that are matched at the same time; changes no result.
    """

    max_size: int
    max_features: int
    min_inliers: int
    seed: int
    threads: int


@dataclass(frozen=True)
class FoundPose:
    """The pose of one image by its features.

    Attributes:
        matches: features that match a landmark.
        inliers: features of these that agree on the pose.
        camera_from_world: ``(3, 4)``; None: no pose.
        covariance: ``(6, 6)`` of the error of the camera's position (metres) and rotation
            (radians), in world axes; None where there is no pose.
        focal_length: of the camera, pixels, mean of both axes: known or found; None where there is
            no pose.
    """

    matches: int
    inliers: int = 0
    camera_from_world: FloatArray | None = None
    covariance: FloatArray | None = None
    focal_length: float | None = None


@dataclass(frozen=True)
class MapView:
    """A photo of the map.

    Attributes:
        descriptors: ``(F, 128)`` of all its features: those that are no landmarks compete as well.
        landmark: ``(F,)`` row of ``points`` of each feature; -1: no landmark.
        points: ``(L, 3)`` world coordinates of the landmarks.
    """

    descriptors: Float32Array
    landmark: IntArray
    points: FloatArray


def match(first: Float32Array, second: Float32Array, *, mutual: bool = True) -> IntArray:
    """Pairs ``(K, 2)`` of rows that match.

    Args:
        first: ``(F, 128)`` descriptors.
        second: ``(S, 128)`` descriptors.
        mutual: whether only mutual nearest neighbours match.
    """
    if len(first) == 0 or len(second) == 0:
        return np.empty((0, 2), dtype=np.int64)
    similarity = first @ second.T  # [F, S]
    rows = np.arange(len(first))
    best = similarity.argmax(axis=1)
    nearest = 1.0 - similarity[rows, best]
    kept = similarity.argmax(axis=0)[best] == rows if mutual else np.ones(len(first), np.bool_)
    similarity[rows, best] = -1.0
    # Squared distances of unit vectors are twice one minus their product.
    kept &= nearest < RATIO**2 * (1.0 - similarity.max(axis=1))
    return np.column_stack([rows[kept], best[kept]]).astype(np.int64)


class PoseFinder:
    """Holds the map's landmarks and finds poses by them.

    Args:
        camera: the camera that is located.
        settings: of features, matching and RANSAC.
    """

    def __init__(self, camera: Camera, settings: FeatureSettings) -> None:
        self._camera = camera
        self._settings = settings
        self._views: list[MapView] = []
        self._used: ImageArray | None = None

    def describe(self, grey: ImageArray) -> FloatArray:
        """Takes one more photo of the map; returns the pixels ``(F, 2)`` of its features."""
        features = self._features(grey)
        unknown = np.full(len(features.pixels), -1, dtype=np.int64)
        self._views.append(MapView(features.descriptors, unknown, np.empty((0, 3))))
        return features.pixels

    def place(self, rows: IntArray, points: FloatArray) -> None:
        """Sets the landmarks of the last photo.

        Args:
            rows: ``(L,)`` indices of its features.
            points: ``(L, 3)`` their world coordinates.
        """
        landmark = self._views[-1].landmark.copy()
        landmark[rows] = np.arange(len(rows))
        self._views[-1] = replace(self._views[-1], landmark=landmark, points=points)

    def use_only(self, used: ImageArray) -> None:
        """Sets the mask ``(height, width)`` of camera images: features where it is not 0."""
        self._used = used

    def locate(self, grey: ImageArray, *, find_focal_length: bool = False) -> FoundPose:
        """The camera's pose when it took an image ``(height, width)``.

        Args:
            grey: the image, as recorded.
            find_focal_length: whether the camera's is only about right, and found with the pose.
        """
        import pycolmap

        settings, own = self._settings, self._camera
        features = self._features(grey, self._used)
        rows, points = self._landmarks(features)
        matches = len(np.unique(rows))
        if matches < settings.min_inliers:
            return FoundPose(matches)
        camera = pycolmap.Camera(
            model=own.model, width=own.width, height=own.height, params=list(colmap_params(own))
        )
        options = pycolmap.AbsolutePoseEstimationOptions()
        longer = max(own.width, own.height)
        options.ransac.max_error = max(SMALLEST_ERROR, LARGEST_ERROR_SHARE * longer)
        options.ransac.max_num_trials = RANSAC_TRIALS
        options.ransac.random_seed = settings.seed
        # Several threads would draw the random numbers in any order.
        options.ransac.num_threads = 1
        pixels = features.pixels[rows] + PIXEL_CENTRE_SHIFT
        refinement = pycolmap.AbsolutePoseRefinementOptions()
        refinement.refine_focal_length = find_focal_length
        answer = pycolmap.estimate_and_refine_absolute_pose(
            pixels, points, camera, options, refinement
        )
        if answer is None:
            return FoundPose(matches)
        mask = np.asarray(answer["inlier_mask"], dtype=np.bool_)
        # A feature that is matched with several photos is one inlier.
        inliers = len(np.unique(rows[mask]))
        if inliers < settings.min_inliers:
            return FoundPose(matches, inliers)
        camera_from_world = np.asarray(answer["cam_from_world"].matrix(), dtype=np.float64)
        repeats = int(mask.sum()) / inliers
        covariance = repeats * pose_covariance(
            camera, camera_from_world, pixels[mask], points[mask]
        )
        return FoundPose(
            matches, inliers, camera_from_world, covariance, float(camera.mean_focal_length())
        )

    def _features(self, grey: ImageArray, used: ImageArray | None = None) -> Features:
        return find_features(grey, self._settings.max_size, self._settings.max_features, used)

    def _landmarks(self, features: Features) -> tuple[IntArray, FloatArray]:
        """Rows ``(K,)`` of features that match a landmark, and its coordinates ``(K, 3)``."""
        chosen = self._most_similar(features)
        rows, points = [np.empty(0, dtype=np.int64)], [np.empty((0, 3))]
        with ThreadPoolExecutor(self._settings.threads) as pool:
            for view, pairs in zip(
                chosen,
                pool.map(lambda view: match(features.descriptors, view.descriptors), chosen),
                strict=True,
            ):
                landmark = view.landmark[pairs[:, 1]]
                rows.append(pairs[landmark >= 0, 0])
                points.append(view.points[landmark[landmark >= 0]])
        return np.concatenate(rows), np.concatenate(points)

    def _most_similar(self, features: Features) -> Sequence[MapView]:
        """The photos that the strongest features match best."""
        if len(self._views) <= MATCHED_PHOTOS:
            return self._views
        strongest = features.descriptors[:RANKING_FEATURES]
        with ThreadPoolExecutor(self._settings.threads) as pool:
            counts = list(
                pool.map(
                    lambda view: len(match(strongest, view.descriptors, mutual=False)), self._views
                )
            )
        best = np.argsort(-np.array(counts), kind="stable")[:MATCHED_PHOTOS]
        return [self._views[index] for index in best]


def pose_covariance(
    camera: Any, camera_from_world: FloatArray, pixels: FloatArray, points: FloatArray
) -> FloatArray:
    """Covariance ``(6, 6)`` of a camera's position (metres) and rotation (radians), world axes.

    That of least squares: the inverse of the normal equations, times the variance of the
    reprojection errors. The rotation is about the camera's centre.

    Args:
        camera: a ``pycolmap.Camera``.
        camera_from_world: ``(3, 4)``.
        pixels: ``(N, 2)`` where the points are seen, pycolmap's convention, N at least 4.
        points: ``(N, 3)`` world coordinates.
    """
    rotation, centre = (
        camera_from_world[:, :3],
        -camera_from_world[:, :3].T @ camera_from_world[:, 3],
    )
    local = (points - centre) @ rotation.T
    step = 1e-6 * np.maximum(np.abs(local[:, 2:]), 1e-9)
    slopes = []
    for axis in np.eye(3):
        ahead = np.asarray(camera.img_from_cam(local + step * axis), dtype=np.float64)
        behind = np.asarray(camera.img_from_cam(local - step * axis), dtype=np.float64)
        slopes.append((ahead - behind) / (2.0 * step))
    by_point = np.stack(slopes, axis=-1)  # [N, 2, 3]
    levers = points - centre
    # When the camera moves or rotates, points move the other way.
    by_rotation = np.cross(levers[:, :, None], np.eye(3)[None], axis=1)  # [N, 3, rotation axis]
    by_pose = np.concatenate(
        [np.repeat(-rotation[None], len(points), 0), rotation @ by_rotation], axis=2
    )
    jacobian = (by_point @ by_pose).reshape(-1, 6)
    errors = np.asarray(camera.img_from_cam(local), dtype=np.float64) - pixels
    variance = float(np.sum(errors**2)) / max(1, 2 * len(points) - 6)
    return np.asarray(variance * np.linalg.pinv(jacobian.T @ jacobian))
