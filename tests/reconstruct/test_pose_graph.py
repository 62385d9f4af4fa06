"""Odometry's drift, taken out by links between photos; and where a drifting walk began."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import StageError
from pipelines.geometry.pose import about_z, angle_about_z, inverse, pose_from_rotation
from pipelines.reconstruct.alignment import Similarity, align_to_odometry
from pipelines.reconstruct.drifting_odometry import align_to_drifting_odometry, random_walk
from pipelines.reconstruct.pose_graph import ODOMETRY_DRIFT, Links, correct_drift

FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
ROUNDS, PER_ROUND = 6, 60
REACH = 2.5


def circling() -> FloatArray:
    """True poses of a camera that goes around a hall several times, tilted a little."""
    angles = np.linspace(0.0, 2.0 * np.pi * ROUNDS, ROUNDS * PER_ROUND, endpoint=False)
    places = np.stack([6.0 * np.cos(angles), 4.0 * np.sin(angles), 1.0 + 0.1 * np.sin(7 * angles)])
    tilts = Rotation.from_euler("yx", np.stack([0.05 * np.sin(angles), 0.03 * np.cos(angles)], 1))
    return pose_from_rotation(about_z(angles) @ tilts.as_matrix() @ FORWARD, places.T)


def drifting(truth: FloatArray, seed: int) -> FloatArray:
    """Odometry: steps are 1 % wrong, the heading walks by 0.3 degrees a root metre."""
    generator = np.random.default_rng(seed)
    steps = np.diff(truth[:, :3, 3], axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    walk = np.cumsum(np.radians(0.3) * np.sqrt(lengths) * generator.normal(size=len(lengths)))
    heading = np.concatenate([[0.0], walk])
    steps[:, :2] += 0.01 * lengths[:, None] * generator.normal(size=(len(steps), 2))
    moved = np.einsum("nij,nj->ni", about_z(heading[:-1]), steps)
    places = truth[0, :3, 3] + np.concatenate([np.zeros((1, 3)), np.cumsum(moved, axis=0)])
    return pose_from_rotation(about_z(heading) @ truth[:, :3, :3], places)


def links_between(truth: FloatArray, pairs: IntArray, wrong: int, seed: int) -> Links:
    """What the photos say; the first ``wrong`` ones say anything."""
    generator = np.random.default_rng(seed)
    relative = inverse(truth[pairs[:, 0]]) @ truth[pairs[:, 1]]
    noise = Rotation.from_rotvec(generator.normal(0.0, np.radians(0.1), (len(pairs), 3)))
    places = relative[:, :3, 3] + generator.normal(0.0, 0.005, (len(pairs), 3))
    places[:wrong] = generator.normal(size=(wrong, 3))
    directions = places / np.linalg.norm(places, axis=1, keepdims=True)
    return Links(pairs, relative[:, :3, :3] @ noise.as_matrix(), directions)


def neighbours(truth: FloatArray) -> IntArray:
    """Pairs of photos near each other, of all rounds."""
    first, second = np.triu_indices(len(truth), k=1)
    apart = np.linalg.norm(truth[first, :3, 3] - truth[second, :3, 3], axis=1)
    pairs = np.stack([first, second], axis=1)
    return np.asarray(pairs[(apart > 0.05) & (apart < 1.5)][::4])


def errors(found: FloatArray, truth: FloatArray) -> FloatArray:
    """Metres, after the best fit of place and heading."""
    similarity = align_to_odometry(found, truth).world_from_model
    rigid = Similarity(1.0, similarity.rotation, np.zeros(3)).transform_points(found[:, :3, 3])
    apart = rigid - truth[:, :3, 3]
    return np.asarray(np.linalg.norm(apart - apart.mean(axis=0), axis=1))


@pytest.mark.parametrize("seed", range(3))
def test_links_take_the_drift_out_though_some_are_wrong(seed: int) -> None:
    truth = circling()
    odometry = drifting(truth, seed)
    pairs = np.random.default_rng(seed).permutation(neighbours(truth))
    wrong = len(pairs) // 5
    links = links_between(truth, pairs, wrong, seed)
    found = correct_drift(odometry, odometry, links, ODOMETRY_DRIFT, REACH)
    assert errors(odometry, truth).max() > 0.3
    assert errors(found.world_from_camera, truth).max() < 0.06
    np.testing.assert_allclose(found.world_from_camera[0], odometry[0], atol=0.01)
    assert np.mean(found.fitting[wrong:]) > 0.95
    assert np.mean(found.fitting[:wrong]) < 0.05


def test_twins_far_apart_are_not_taken_for_one_place() -> None:
    # Two rooms that look alike, one after the other: the photos of one match those of the other.
    places = np.zeros((40, 3))
    places[:, 0] = np.concatenate([np.linspace(0.0, 2.0, 20), np.linspace(8.0, 10.0, 20)])
    truth = pose_from_rotation(np.tile(FORWARD, (40, 1, 1)), places)
    odometry = drifting(truth, seed=0)
    within = np.array([[i, i + 1] for i in range(39) if i != 19])
    across = np.array([[i, j + 20] for i in range(20) for j in range(20) if abs(i - j) == 2])
    alike = truth.copy()
    alike[20:, 0, 3] -= 8.0
    links = links_between(alike, np.concatenate([across, within]), 0, seed=1)
    found = correct_drift(odometry, odometry, links, ODOMETRY_DRIFT, REACH)
    assert not found.fitting[: len(across)].any()
    assert np.linalg.norm(found.world_from_camera[:, :3, 3] - places, axis=1).max() < 0.3


@pytest.mark.parametrize("seed", range(4))
def test_a_model_is_put_where_the_walk_began(seed: int) -> None:
    truth = circling()
    odometry = drifting(truth, seed)
    generator = np.random.default_rng(seed)
    noisy = truth.copy()
    noisy[:, :3, 3] += generator.normal(0.0, 0.005, (len(truth), 3))
    turn = Rotation.random(random_state=seed).as_matrix()
    inside = Similarity(0.3, turn, generator.normal(size=3)).transform_poses(noisy)
    found = align_to_drifting_odometry(inside, odometry)
    placed = found.world_from_model.transform_poses(inside)
    assert np.linalg.norm(placed[:, :3, 3] - truth[:, :3, 3], axis=1).max() < 0.06
    assert found.world_from_model.scale * 0.3 == pytest.approx(1.0, rel=0.003)
    drift = np.linalg.norm(odometry[:, :3, 3] - truth[:, :3, 3], axis=1).max()
    assert found.place_drift == pytest.approx(drift, abs=0.06)
    headings = angle_about_z(odometry[:, :3, :3] @ truth[:, :3, :3].swapaxes(1, 2))
    assert found.heading_drift == pytest.approx(np.abs(headings).max(), abs=np.radians(0.2))


def test_what_only_trembles_is_averaged_and_what_walks_is_followed() -> None:
    generator = np.random.default_rng(0)
    path = np.arange(400.0)
    trembling = generator.normal(0.0, 0.1, 400)
    assert np.abs(random_walk(trembling, path, 1e-3)).max() < 0.3 * np.abs(trembling).max()
    walk = np.cumsum(generator.normal(0.0, 0.1, 400))
    assert np.abs(random_walk(walk + 0.01 * trembling, path, 1e-3) - walk).max() < 0.06


def test_a_model_that_does_not_fit_odometry_is_refused() -> None:
    truth = circling()
    other = pose_from_rotation(truth[:, :3, :3], np.random.default_rng(0).normal(size=(360, 3)))
    with pytest.raises(StageError, match="do not fit"):
        align_to_drifting_odometry(other, truth)
    with pytest.raises(StageError, match="stand still"):
        align_to_drifting_odometry(np.tile(truth[0], (9, 1, 1)), np.tile(truth[0], (9, 1, 1)))
