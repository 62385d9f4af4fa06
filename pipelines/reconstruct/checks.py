"""Checks whether a structure-from-motion result can be trusted.

pycolmap does not report its failures: an unreadable image is missing, and a camera that only
rotated on the spot gives a full model with tiny reprojection errors. So the result is judged by
what a failure changes: features and matches in the database, images and points in the model, and
the triangulation angles of the points.
"""

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import StageError, reason_of
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import inverse
from pipelines.reconstruct.colmap_model import ColmapModel
from pipelines.reconstruct.parallax import rotation_only_share

MIN_IMAGES = 3
MIN_MEDIAN_FEATURES = 50
MIN_REGISTERED_SHARE = 0.5
MIN_POINTS_PER_IMAGE = 20
MIN_TRIANGULATION_ANGLE = 3.0  # degrees, median over the points of the largest angle of each
# Neighbours in a film hardly differ in place, so a part of the pairs may.
MAX_ROTATION_SHARE = 0.7
MAX_POINTS_MEASURED = 20_000
MOVE_SIDEWAYS = "the camera has to move sideways, not turn on the spot"
# COLMAP's kinds of image pairs (estimators/two_view_geometry.h).
USABLE_PAIRS = (2, 3, 4, 5, 6, 8)


@dataclass(frozen=True)
class DatabaseFindings:
    """What extraction and matching left in COLMAP's database.

    Attributes:
        features: name of an image -> number of its features, for the images that have an entry.
        verified_pairs: pairs of images that show the same features in a possible geometry.
        rotation_share: share of these pairs that a rotation alone explains (``parallax``).
    """

    features: dict[str, int]
    verified_pairs: int
    rotation_share: float


@dataclass(frozen=True)
class ModelFindings:
    """Measures of one model.

    Attributes:
        registered: images with a pose.
        points: triangulated points.
        median_points_per_image: points seen in an image, median over the images.
        mean_track_length: images that see a point, mean over the points.
        mean_reprojection_error: pixels.
        median_triangulation_angle: degrees; median over the points of the largest angle between
            two rays to each.
    """

    registered: int
    points: int
    median_points_per_image: float
    mean_track_length: float
    mean_reprojection_error: float
    median_triangulation_angle: float

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types, for the statistics of the reconstruction."""
        return {
            "points": self.points,
            "median_points_per_image": self.median_points_per_image,
            "mean_track_length": self.mean_track_length,
            "mean_reprojection_error_px": self.mean_reprojection_error,
            "median_triangulation_angle_deg": self.median_triangulation_angle,
        }


def count_rows(database: Path, table: str) -> int:
    """Rows of a table of a database that another process is writing; 0 where not readable yet."""
    try:
        with closing(_open(database)) as connection:
            # The table is one of this package's own constants.
            row = connection.execute(f"SELECT COUNT(*) FROM {table}").fetchone()
            return int(row[0])
    except sqlite3.Error:
        return 0


def read_findings(database: Path, camera: Camera | None, size: tuple[int, int]) -> DatabaseFindings:
    """Counts features and pairs, and looks for parallax.

    Args:
        database: COLMAP's, after matching.
        camera: None where unknown.
        size: width and height of the images.

    Raises:
        StageError: the database cannot be read.
    """
    try:
        with closing(_open(database)) as connection:
            features = dict(
                connection.execute(
                    "SELECT images.name, keypoints.rows FROM images "
                    "JOIN keypoints ON keypoints.image_id = images.image_id"
                ).fetchall()
            )
            kinds = dict(
                connection.execute(
                    "SELECT config, COUNT(*) FROM two_view_geometries WHERE rows > 0 "
                    "GROUP BY config"
                ).fetchall()
            )
    except sqlite3.Error as error:
        raise StageError(
            f"the database of structure from motion is unreadable: {reason_of(error)}"
        ) from error
    verified = sum(kinds.get(kind, 0) for kind in USABLE_PAIRS)
    share = rotation_only_share(database, camera, size) if verified else 0.0
    return DatabaseFindings(features, verified, share)


def _open(database: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{database.absolute().as_uri()}?mode=ro", uri=True, timeout=1.0)


def check_database(findings: DatabaseFindings, names: dict[str, str]) -> None:
    """Compares the database with the images that were handed in.

    Args:
        findings: of the database.
        names: name in the database -> name in the data set.

    Raises:
        StageError: too few features (the poorest image is named), images that show nothing in
            common, or a camera that only turned.
    """
    counts = {own: findings.features.get(name, 0) for name, own in names.items()}
    poorest = min(counts, key=lambda own: counts[own])
    median = float(np.median(list(counts.values())))
    if median < MIN_MEDIAN_FEATURES:
        raise StageError(
            f"too few features: {median:.0f} in the median image, {counts[poorest]} in {poorest}; "
            f"structure from motion needs {MIN_MEDIAN_FEATURES} (are the images blurred, dark or "
            "of bare walls?)"
        )
    if findings.verified_pairs == 0:
        raise StageError(
            f"no two of the {len(names)} images show the same features; they need about two "
            "thirds of overlap from one to the next"
        )
    if findings.rotation_share > MAX_ROTATION_SHARE:
        raise StageError(
            f"no parallax: {100 * findings.rotation_share:.0f} % of the image pairs differ by a "
            f"rotation alone; {MOVE_SIDEWAYS}"
        )


def measure(model: ColmapModel) -> ModelFindings:
    """Measures a model."""
    tracks = model.points.tracks
    per_image = [int(np.count_nonzero(image.points >= 0)) for image in model.images]
    count = len(model.points.positions)
    errors = model.points.errors
    return ModelFindings(
        registered=len(model.images),
        points=count,
        median_points_per_image=float(np.median(per_image)) if per_image else 0.0,
        mean_track_length=len(tracks) / count if count else 0.0,
        mean_reprojection_error=float(np.mean(errors)) if count else 0.0,
        median_triangulation_angle=_median_angle(model) if count else 0.0,
    )


def _median_angle(model: ColmapModel) -> float:
    """``median_triangulation_angle`` of a model, over evenly chosen points where there are many."""
    poses = inverse(np.array([image.camera_from_world for image in model.images]))
    row_of_image = {image.identifier: row for row, image in enumerate(model.images)}
    tracks, positions = model.points.tracks, model.points.positions
    order = np.argsort(tracks[:, 0], kind="stable")
    rows = np.array([row_of_image[number] for number in tracks[order, 1].tolist()], dtype=np.int64)
    bounds = np.searchsorted(tracks[order, 0], np.arange(len(positions) + 1))
    step = max(1, len(positions) // MAX_POINTS_MEASURED)
    angles = [
        _largest_angle(positions[point] - poses[rows[bounds[point] : bounds[point + 1]], :3, 3])
        for point in range(0, len(positions), step)
    ]
    return float(np.degrees(np.median(angles)))


def _largest_angle(rays: FloatArray) -> float:
    """Largest angle (radians) between two of the rays ``(K, 3)``."""
    if len(rays) < 2:
        return 0.0
    directions = rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-300)
    return float(np.arccos(np.clip((directions @ directions.T).min(), -1.0, 1.0)))


def check_model(findings: ModelFindings, total: int, pieces: Sequence[int]) -> None:
    """Judges one model.

    Args:
        findings: of the model.
        total: images that were handed in.
        pieces: images in each firmly connected piece that the attempt found.

    Raises:
        StageError: too few images with a pose, no parallax, or too few points.
    """
    registered = findings.registered
    if registered < MIN_IMAGES or registered < MIN_REGISTERED_SHARE * total:
        largest = ", ".join(str(size) for size in sorted(pieces, reverse=True)[:5])
        split = f" (the images fall into pieces of {largest})" if len(pieces) > 1 else ""
        raise StageError(
            f"only {registered} of {total} images could be posed together{split}; more overlap "
            "between the images, --matcher exhaustive or more --max-features may help"
        )
    angle = findings.median_triangulation_angle
    if angle < MIN_TRIANGULATION_ANGLE:
        raise StageError(
            f"no parallax: in the median, points are seen under {angle:.1f} degrees instead of at "
            f"least {MIN_TRIANGULATION_ANGLE:.0f}; {MOVE_SIDEWAYS}"
        )
    if findings.median_points_per_image < MIN_POINTS_PER_IMAGE:
        raise StageError(
            f"only {findings.median_points_per_image:.0f} points in the median image could be "
            f"triangulated; {MIN_POINTS_PER_IMAGE} are needed"
        )
