"""Where the model of a long walk lies in the world of odometry that has drifted meanwhile.

Odometry's world is where the robot began. Over hundreds of metres its heading walks away by degrees
and its places by a metre, while structure from motion bends by centimetres. A fit to all poses
alike (``alignment``) would share that drift out and turn the world. Here the first photos tell
heading and place, each step tells the scale, and every photo tells which way is up, as tilts do not
drift. How fast odometry drifts, and how uncertain a single photo is, is estimated from how their
differences grow along the walk.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import StageError
from pipelines.geometry.pose import about_z, angle_about_z
from pipelines.reconstruct.alignment import (
    DEVIATION_PER_MEDIAN,
    POSITION_FLOOR,
    ROTATION_FLOOR,
    Similarity,
    check_enough,
    check_fit,
    root_mean_square,
    spread_of,
)
from pipelines.reconstruct.pose_graph import walked

# Photos over which drift is compared with what a single photo leaves open.
LAGS = (1, 16)
REWEIGHTINGS = 10


@dataclass(frozen=True)
class DriftAlignment:
    """A similarity, and by how much odometry departs from it in the course of the walk.

    Attributes:
        world_from_model: the similarity.
        place_drift: metres, the largest.
        heading_drift: radians, the largest.
    """

    world_from_model: Similarity
    place_drift: float
    heading_drift: float


def align_to_drifting_odometry(
    model_from_camera: FloatArray, world_from_camera: FloatArray
) -> DriftAlignment:
    """The similarity that puts a model where odometry began.

    Args:
        model_from_camera: ``(N, 4, 4)`` in time order.
        world_from_camera: ``(N, 4, 4)`` of the same photos, from odometry and the mount; z up.

    Raises:
        StageError: fewer than three photos, odometry or a model that stands still, or both do not
            fit each other at all.
    """
    check_enough(model_from_camera)
    upright = _upright(model_from_camera, world_from_camera)
    odometry = world_from_camera[:, :3, 3]
    model = model_from_camera[:, :3, 3] @ upright.T
    scale = _scale(model, odometry)
    path = walked(world_from_camera)

    turned = upright @ model_from_camera[:, :3, :3]
    turns = np.unwrap(angle_about_z(world_from_camera[:, :3, :3] @ turned.swapaxes(1, 2)))
    heading = random_walk(turns, path, ROTATION_FLOOR)
    rotation = about_z(heading[:1])[0] @ upright
    heading_drift = heading - heading[0]

    # Odometry's steps as they were, without the heading that it lost.
    steps = np.einsum("nij,nj->ni", about_z(-heading_drift[:-1]), np.diff(odometry, axis=0))
    straight = odometry[0] + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    left = straight - scale * model_from_camera[:, :3, 3] @ rotation.T
    translation = np.array([random_walk(axis, path, POSITION_FLOOR)[0] for axis in left.T])

    similarity = Similarity(scale, rotation, translation)
    apart = similarity.transform_points(model_from_camera[:, :3, 3]) - odometry
    check_fit(root_mean_square(apart), spread_of(odometry))
    distances = np.linalg.norm(apart, axis=1)
    return DriftAlignment(similarity, float(distances.max()), float(np.abs(heading_drift).max()))


def random_walk(values: FloatArray, path: FloatArray, floor: float) -> FloatArray:
    """The random walk ``(N,)`` that noisy values follow, by least squares.

    Args:
        values: ``(N,)`` its values with noise.
        path: ``(N,)`` metres walked, by which it walks.
        floor: smallest standard deviation of the noise.
    """
    noise, rate = _variances(values, path, floor)
    stiffness = noise / np.maximum(rate * np.diff(path), 1e-6 * noise)
    diagonal = np.ones(len(values))
    diagonal[:-1] += stiffness
    diagonal[1:] += stiffness
    banded = np.stack([np.concatenate([[0.0], -stiffness]), diagonal])
    return np.asarray(scipy.linalg.solveh_banded(banded, values))


def _variances(values: FloatArray, path: FloatArray, floor: float) -> tuple[float, float]:
    """Variance of the noise, and variance a metre of the walk under it."""
    spreads, lengths = [], []
    for lag in LAGS:
        shift = min(lag, len(values) - 1)
        changes = values[shift:] - values[:-shift]
        spreads.append((DEVIATION_PER_MEDIAN * float(np.median(np.abs(changes)))) ** 2)
        lengths.append(float(np.median(path[shift:] - path[:-shift])))
    length = max(lengths[1] - lengths[0], 1e-6)
    rate = max((spreads[1] - spreads[0]) / length, 0.0)
    return max((spreads[0] - rate * lengths[0]) / 2.0, floor**2), rate


def _upright(model_from_camera: FloatArray, world_from_camera: FloatArray) -> FloatArray:
    """A rotation ``(3, 3)`` of the model after which its z points up."""
    ups = model_from_camera[:, :3, :3] @ world_from_camera[:, 2, :3, None]
    up = np.median(ups[..., 0], axis=0)
    for _ in range(REWEIGHTINGS):
        up = up / np.linalg.norm(up)
        distances = np.linalg.norm(ups[..., 0] - up, axis=1)
        up = np.average(ups[..., 0], axis=0, weights=1.0 / np.maximum(distances, ROTATION_FLOOR))
    up = up / np.linalg.norm(up)
    side = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    side = side / np.linalg.norm(side)
    return np.stack([side, np.cross(up, side), up])


def _scale(model: FloatArray, odometry: FloatArray) -> float:
    """Metres a unit of the model, by the steps from photo to photo."""
    in_model = np.linalg.norm(np.diff(model, axis=0), axis=1)
    in_world = np.linalg.norm(np.diff(odometry, axis=0), axis=1)
    ratio = float(in_world.sum()) / max(float(in_model.sum()), 1e-12)
    if in_world.sum() < POSITION_FLOOR or in_model.sum() <= 0.0:
        raise StageError("the scale cannot be told: model or odometry stand still")
    for _ in range(REWEIGHTINGS):
        errors = np.abs(in_world - ratio * in_model)
        usual = max(DEVIATION_PER_MEDIAN * float(np.median(errors)), POSITION_FLOOR)
        weights = 1.0 / (1.0 + (errors / (3.0 * usual)) ** 2)
        ratio = float(np.sum(weights * in_world * in_model) / np.sum(weights * in_model**2))
    return ratio
