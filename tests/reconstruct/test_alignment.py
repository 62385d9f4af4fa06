"""The similarity between a model and the world, against similarities that are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import StageError
from pipelines.geometry.pose import pose_from_rotation
from pipelines.reconstruct.alignment import Similarity, align_by_convention, align_to_odometry

# Up in the image of a camera that is held upright.
UPRIGHT = np.array([[0.0, -1.0]])


def world_cameras(positions: FloatArray, seed: int = 0) -> FloatArray:
    """Upright cameras at ``positions`` that look about, ``(N, 4, 4)``."""
    generator = np.random.default_rng(seed)
    forward = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    angles = generator.normal(0.0, [0.8, 0.05, 0.05], (len(positions), 3))
    turns = Rotation.from_euler("zyx", angles).as_matrix()
    return pose_from_rotation(turns @ forward, positions)


def seen_from(similarity: Similarity, world_from_camera: FloatArray) -> FloatArray:
    """The poses in a model from which ``similarity`` leads to the world."""
    rotation = similarity.rotation.T
    return Similarity(
        1.0 / similarity.scale, rotation, -rotation @ similarity.translation / similarity.scale
    ).transform_poses(world_from_camera)


def noisy(poses: FloatArray, metres: float, degrees: float, seed: int = 3) -> FloatArray:
    generator = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(np.radians(generator.normal(0.0, degrees, (len(poses), 3))))
    shifts = generator.normal(0.0, metres, (len(poses), 3))
    return pose_from_rotation(poses[:, :3, :3] @ turns.as_matrix(), poses[:, :3, 3] + shifts)


def angle_of(rotation: FloatArray) -> float:
    return float(np.degrees(Rotation.from_matrix(rotation).magnitude()))


@settings(max_examples=20, deadline=None)
@given(
    scale=st.floats(0.01, 100.0),
    vector=st.tuples(*[st.floats(-1.8, 1.8)] * 3),
    shift=st.tuples(*[st.floats(-50.0, 50.0)] * 3),
)
def test_any_similarity_is_found_exactly(
    scale: float, vector: tuple[float, ...], shift: tuple[float, ...]
) -> None:
    world = world_cameras(np.random.default_rng(1).normal(size=(12, 3)))
    truth = Similarity(scale, Rotation.from_rotvec(vector).as_matrix(), np.array(shift))
    found = align_to_odometry(seen_from(truth, world), world).world_from_model
    assert found.scale == pytest.approx(scale, rel=1e-6)
    assert angle_of(found.rotation.T @ truth.rotation) < 1e-4
    np.testing.assert_allclose(
        found.transform_poses(seen_from(truth, world))[:, :3, 3], world[:, :3, 3], atol=1e-5
    )


def test_a_drive_along_a_line_still_has_an_up_direction() -> None:
    # Positions alone leave the rotation about the line open; here they are even exactly on it.
    positions = np.column_stack([np.linspace(0.0, 5.0, 30), np.zeros(30), np.ones(30)])
    world = world_cameras(positions)
    truth = Similarity(0.37, Rotation.from_rotvec([2.0, -0.7, 0.4]).as_matrix(), np.ones(3))
    found = align_to_odometry(seen_from(truth, world), noisy(world, 0.01, 0.5)).world_from_model
    up_error = angle_of(found.rotation.T @ truth.rotation)
    assert up_error < 0.5
    assert found.scale == pytest.approx(0.37, rel=0.01)


def test_positions_sharpen_what_noisy_rotations_say() -> None:
    positions = np.random.default_rng(2).normal(size=(30, 3)) * 3.0
    world = world_cameras(positions)
    truth = Similarity(2.5, Rotation.from_rotvec([0.2, 1.0, -0.4]).as_matrix(), np.zeros(3))
    odometry = noisy(world, 0.005, 8.0)
    found = align_to_odometry(seen_from(truth, world), odometry)
    # The mean of 30 rotations of 8 degrees would be off by more than 2; positions give 0.05.
    assert angle_of(found.world_from_model.rotation.T @ truth.rotation) < 0.3
    assert np.degrees(found.rotation_rmse) == pytest.approx(8.0 * np.sqrt(3.0), rel=0.3)
    assert found.position_rmse == pytest.approx(0.005 * np.sqrt(3.0), rel=0.5)


def test_a_few_wrong_poses_do_not_pull_the_rest() -> None:
    world = world_cameras(np.random.default_rng(4).normal(size=(30, 3)) * 2.0)
    truth = Similarity(1.7, Rotation.from_rotvec([0.5, 0.1, 0.9]).as_matrix(), np.zeros(3))
    odometry = noisy(world, 0.01, 0.3)
    odometry[[3, 17], :3, 3] += [[1.5, 0.0, 0.5], [0.0, -1.5, 0.0]]
    found = align_to_odometry(seen_from(truth, world), odometry).world_from_model
    assert angle_of(found.rotation.T @ truth.rotation) < 0.3
    assert found.scale == pytest.approx(1.7, rel=0.01)


def test_odometry_that_cannot_tell_the_scale_is_an_error() -> None:
    world = world_cameras(np.random.default_rng(5).normal(size=(10, 3)))
    still = world.copy()
    still[:, :3, 3] = 1.0
    with pytest.raises(StageError, match="hardly moves"):
        align_to_odometry(world, still)
    with pytest.raises(StageError, match="only 2 images"):
        align_to_odometry(world[:2], world[:2])
    other = world.copy()
    other[:, :3, 3] = np.random.default_rng(6).normal(size=(10, 3))
    with pytest.raises(StageError, match="do not fit"):
        align_to_odometry(world, other)


def test_the_convention_without_odometry() -> None:
    world = world_cameras(np.random.default_rng(7).normal(size=(200, 3)))
    hidden = Similarity(1.0, Rotation.from_rotvec([1.0, 2.0, 0.3]).as_matrix(), np.full(3, 4.0))
    model = seen_from(hidden, world)
    found = align_by_convention(model, 3.0, UPRIGHT.repeat(len(model), axis=0))
    placed = found.transform_poses(model)
    np.testing.assert_allclose(placed[0, :3, 3], 0.0, atol=1e-12)
    assert abs(placed[0, 1, 2]) < 1e-12  # the first camera looks along x,
    assert placed[0, 0, 2] > 0.0  # forwards
    up = found.rotation @ hidden.rotation.T @ np.array([0.0, 0.0, 1.0])
    assert np.degrees(np.arccos(up[2])) < 2.0
    distances = np.linalg.norm(placed[1:, :3, 3] - placed[:-1, :3, 3], axis=1)
    expected = 3.0 * np.linalg.norm(world[1:, :3, 3] - world[:-1, :3, 3], axis=1)
    np.testing.assert_allclose(distances, expected)


def test_no_common_up_direction_is_an_error() -> None:
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, :3, :3] = np.diag([-1.0, -1.0, 1.0])
    with pytest.raises(StageError, match="no common up"):
        align_by_convention(poses, 1.0, UPRIGHT.repeat(2, axis=0))


def test_what_is_up_in_each_image_is_up() -> None:
    world = world_cameras(np.random.default_rng(7).normal(size=(40, 3)))
    ups = UPRIGHT.repeat(40, axis=0)
    expected = align_by_convention(world, 1.0, ups)
    # The same cameras with every other one turned by a quarter about its axis, this way or that.
    turned = world.copy()
    for row, quarter in ((slice(0, None, 4), 1), (slice(1, None, 4), -1)):
        turn = Rotation.from_euler("z", 90 * quarter, degrees=True).as_matrix()
        turned[row, :3, :3] = world[row, :3, :3] @ turn
        ups[row] = UPRIGHT[0] @ turn[:2, :2]
    found = align_by_convention(turned, 1.0, ups)
    np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-12)
