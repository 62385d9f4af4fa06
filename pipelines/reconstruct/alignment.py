"""From the coordinates of a structure-from-motion model to a metric world with z up.

Structure from motion leaves a similarity open: scale, orientation and origin. Odometry closes it:
the similarity is fitted to its positions and to its orientations at once. Positions alone leave the
up direction open where a robot drives along a line, and orientations alone say nothing of scale.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import StageError
from pipelines.geometry.pose import pose_from_rotation

MIN_PAIRS = 3
# Metres and radians: no odometry is better than this, however well it seems to fit.
POSITION_FLOOR, ROTATION_FLOOR = 1e-3, 2e-4
REWEIGHTINGS = 10
# Normal distribution: standard deviation / median absolute deviation.
DEVIATION_PER_MEDIAN = 1.4826
# Share of the spread of the positions by which model and odometry may differ.
LARGEST_DISAGREEMENT = 0.25
# Pairs of cameras nearer than this share of the largest distance say little about scale.
MIN_SHARE_OF_EXTENT = 0.2
MAX_CAMERAS_FOR_SCALE = 300


@dataclass(frozen=True)
class Similarity:
    """``x_b = scale * rotation @ x_a + translation``.

    Attributes:
        scale: lengths in b / lengths in a.
        rotation: ``(3, 3)``.
        translation: ``(3,)``.
    """

    scale: float
    rotation: FloatArray
    translation: FloatArray

    def transform_points(self, points: FloatArray) -> FloatArray:
        """Points ``(N, 3)`` of a in b."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)

    def transform_poses(self, a_from_camera: FloatArray) -> FloatArray:
        """Camera poses ``(N, 4, 4)`` in b; cameras keep their own unit scale."""
        centres = self.transform_points(a_from_camera[:, :3, 3])
        return pose_from_rotation(self.rotation @ a_from_camera[:, :3, :3], centres)


@dataclass(frozen=True)
class Alignment:
    """A similarity and how well it fits.

    Attributes:
        world_from_model: the similarity.
        position_rmse: metres.
        rotation_rmse: radians.
    """

    world_from_model: Similarity
    position_rmse: float
    rotation_rmse: float


def align_to_odometry(model_from_camera: FloatArray, world_from_camera: FloatArray) -> Alignment:
    """The similarity that brings camera poses of a model onto those of odometry.

    Joint least squares over positions and rotations with a robust loss. The weight of each kind
    is estimated from its own residuals, so that neither metres nor radians need a guess.

    Args:
        model_from_camera: ``(N, 4, 4)``.
        world_from_camera: ``(N, 4, 4)`` of the same images, from odometry and the mount.

    Raises:
        StageError: fewer than three images, odometry that hardly moves, or positions that do not
            fit each other, so that the scale would be made up.
    """
    check_enough(model_from_camera)
    spread = spread_of(world_from_camera[:, :3, 3])
    if spread < POSITION_FLOOR:
        raise StageError("the odometry hardly moves, so it does not tell the scale")
    similarity = _start(model_from_camera, world_from_camera)
    position_sigma, rotation_sigma = spread, 1.0
    for _ in range(REWEIGHTINGS):
        position_errors, rotation_errors = _errors(similarity, model_from_camera, world_from_camera)
        position_sigma = _deviation(position_errors, POSITION_FLOOR)
        rotation_sigma = _deviation(rotation_errors, ROTATION_FLOOR)
        similarity = _refined(
            similarity, model_from_camera, world_from_camera, (position_sigma, rotation_sigma)
        )
    position_errors, rotation_errors = _errors(similarity, model_from_camera, world_from_camera)
    position_rmse, rotation_rmse = map(root_mean_square, (position_errors, rotation_errors))
    check_fit(position_rmse, spread)
    return Alignment(similarity, position_rmse, rotation_rmse)


def mean_up(world_from_camera: FloatArray, image_ups: FloatArray) -> FloatArray:
    """Mean ``(3,)`` over cameras ``(N, 4, 4)`` of what is up in their images ``(N, 2)``."""
    axes = world_from_camera[:, :3, :2]
    return np.asarray((axes @ image_ups[:, :, None])[..., 0].mean(axis=0))


def check_enough(model_from_camera: FloatArray) -> None:
    """Makes sure that so many poses ``(N, 4, 4)`` tell a similarity.

    Raises:
        StageError: fewer than ``MIN_PAIRS``.
    """
    if len(model_from_camera) < MIN_PAIRS:
        raise StageError(
            f"only {len(model_from_camera)} images have both a pose by structure from motion and "
            f"odometry; the alignment needs {MIN_PAIRS}"
        )


def check_fit(error: float, spread: float) -> None:
    """Makes sure that model and odometry agree, as else the scale would be made up.

    Args:
        error: metres by which they differ (root mean square).
        spread: metres over which the cameras spread.

    Raises:
        StageError: they do not.
    """
    if error > LARGEST_DISAGREEMENT * spread:
        raise StageError(
            f"structure from motion and odometry do not fit: they differ by {error:.3f} m "
            f"where the cameras spread over {spread:.3f} m"
        )


def spread_of(positions: FloatArray) -> float:
    """Root mean square distance of positions ``(N, 3)`` from their mean."""
    return root_mean_square(positions - positions.mean(axis=0))


def align_by_convention(
    model_from_camera: FloatArray, scale: float, image_ups: FloatArray
) -> Similarity:
    """The world where there is no odometry.

    The origin is the first camera; z is the mean direction that is up in the images (cameras are
    held upright more often than not); x is the heading of the first camera's optical axis.

    Args:
        model_from_camera: ``(N, 4, 4)``.
        scale: length of a unit of the model in units of the world.
        image_ups: ``(N, 2)`` directions in each image that are up: ``ImageHeader.up``.

    Raises:
        StageError: the cameras have no common up direction, or the first looks along it.
    """
    up = mean_up(model_from_camera, image_ups)
    length = float(np.linalg.norm(up))
    if length < 0.1:
        raise StageError("the cameras have no common up direction: their roll is all around")
    up = up / length
    axis = model_from_camera[0, :3, 2]
    forward = axis - (axis @ up) * up
    length = float(np.linalg.norm(forward))
    if length < 0.01:
        raise StageError("the first camera looks straight up or down, so it has no heading")
    forward = forward / length
    rotation = np.stack([forward, np.cross(up, forward), up])
    return Similarity(scale, rotation, -scale * rotation @ model_from_camera[0, :3, 3])


def root_mean_square(errors: FloatArray) -> float:
    """Root mean square of the lengths of vectors ``(N, 3)``."""
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def _deviation(errors: FloatArray, floor: float) -> float:
    """Robust standard deviation of one coordinate of errors ``(N, 3)``."""
    return max(floor, DEVIATION_PER_MEDIAN * float(np.median(np.abs(errors))))


def _errors(
    similarity: Similarity, model_from_camera: FloatArray, world_from_camera: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Errors of position (metres) and rotation (radians, rotation vectors), each ``(N, 3)``."""
    aligned = similarity.transform_poses(model_from_camera)
    rotations = np.swapaxes(world_from_camera[:, :3, :3], 1, 2) @ aligned[:, :3, :3]
    rotation_errors = scipy.spatial.transform.Rotation.from_matrix(rotations).as_rotvec()
    return aligned[:, :3, 3] - world_from_camera[:, :3, 3], np.asarray(rotation_errors)


def _start(model_from_camera: FloatArray, world_from_camera: FloatArray) -> Similarity:
    """A robust start in closed form.

    Umeyama's method would take the rotation from the positions, which fails where they lie on a
    line; here it is the median of the cameras' own rotations (Weiszfeld's iteration), the scale
    the median ratio of distances, the translation the median shift.
    """
    relative = world_from_camera[:, :3, :3] @ np.swapaxes(model_from_camera[:, :3, :3], 1, 2)
    rotations = scipy.spatial.transform.Rotation.from_matrix(relative)
    mean = rotations.mean()
    for _ in range(REWEIGHTINGS):
        angles = (mean.inv() * rotations).magnitude()
        mean = rotations.mean(weights=1.0 / np.maximum(angles, ROTATION_FLOOR))
    rotation = mean.as_matrix()
    model, world = model_from_camera[:, :3, 3], world_from_camera[:, :3, 3]
    scale = _median_ratio(model, world)
    return Similarity(scale, rotation, np.median(world - scale * model @ rotation.T, axis=0))


def _median_ratio(model: FloatArray, world: FloatArray) -> float:
    """Median of distances in the world / distances in the model, over pairs of cameras."""
    chosen = np.unique(np.linspace(0, len(model) - 1, MAX_CAMERAS_FOR_SCALE).astype(np.int64))
    first, second = np.triu_indices(len(chosen), k=1)
    in_model = np.linalg.norm(model[chosen[first]] - model[chosen[second]], axis=1)
    in_world = np.linalg.norm(world[chosen[first]] - world[chosen[second]], axis=1)
    far = in_model > MIN_SHARE_OF_EXTENT * float(in_model.max())
    ratio = float(np.median(in_world[far] / in_model[far])) if np.any(far) else 0.0
    if ratio <= 0.0:
        raise StageError("the scale cannot be told: model or odometry stand still")
    return ratio


def _refined(
    start: Similarity,
    model_from_camera: FloatArray,
    world_from_camera: FloatArray,
    sigmas: tuple[float, float],
) -> Similarity:
    """Least squares over log scale, rotation vector and translation, from ``start``."""
    # A rotation about the centre of the cameras is least correlated with the translation.
    pivot = start.transform_points(model_from_camera[:, :3, 3]).mean(axis=0)

    def moved(step: FloatArray) -> Similarity:
        rotation = scipy.spatial.transform.Rotation.from_rotvec(step[1:4]).as_matrix()
        factor = float(np.exp(step[0]))
        translation = factor * rotation @ (start.translation - pivot) + pivot + step[4:7]
        return Similarity(factor * start.scale, rotation @ start.rotation, translation)

    def residuals(step: FloatArray) -> FloatArray:
        positions, rotations = _errors(moved(step), model_from_camera, world_from_camera)
        weighted = [positions.ravel() / sigmas[0], rotations.ravel() / sigmas[1]]
        return np.concatenate(weighted)

    solution = scipy.optimize.least_squares(residuals, np.zeros(7), loss="soft_l1", f_scale=2.0)
    return moved(np.asarray(solution.x, dtype=np.float64))
