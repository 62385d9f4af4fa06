"""Poses between those of a trajectory, against SciPy's and against a motion that is known."""

import numpy as np
import pytest
import scipy

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.interpolation import MAX_GAP, poses_at_times
from pipelines.geometry.pose import about_z, pose_from_rotation, world_from_base_planar
from pipelines.geometry.trajectory import Trajectory

Rotation, Slerp = scipy.spatial.transform.Rotation, scipy.spatial.transform.Slerp


def _wild(count: int, step: float, seed: int) -> Trajectory:
    rng = np.random.default_rng(seed)
    rotations = Rotation.random(count, random_state=seed).as_matrix()
    return Trajectory(
        100.0 + step * np.arange(count, dtype=np.float64),
        pose_from_rotation(rotations, rng.normal(size=(count, 3))),
    )


def _drive(times: FloatArray) -> FloatArray:
    """A circle of radius 1 m at 1 m/s."""
    states = np.stack([np.sin(times), 1.0 - np.cos(times), times], axis=-1)
    return world_from_base_planar(states)


@pytest.mark.parametrize("seed", range(5))
def test_rotation_goes_along_the_sphere_and_position_along_the_chord(seed: int) -> None:
    trajectory = _wild(30, 0.1, seed)
    times = np.random.default_rng(seed).uniform(100.0, 102.9, 200)
    found = poses_at_times(trajectory, times)
    expected = Slerp(trajectory.timestamps, Rotation.from_matrix(trajectory.poses[:, :3, :3]))
    assert found.is_known.all()
    np.testing.assert_allclose(found.poses[:, :3, :3], expected(times).as_matrix(), atol=1e-9)
    for axis in range(3):
        line = np.interp(times, trajectory.timestamps, trajectory.poses[:, axis, 3])
        np.testing.assert_allclose(found.poses[:, axis, 3], line, atol=1e-12)


def test_at_the_time_of_a_pose_it_is_that_pose_to_the_bit() -> None:
    trajectory = _wild(20, 0.5, 3)
    found = poses_at_times(trajectory, trajectory.timestamps[::-1])
    assert found.is_known.all()
    assert np.array_equal(found.poses, trajectory.poses[::-1])
    assert not found.offsets.any()


def test_the_opposite_quaternion_is_the_same_rotation() -> None:
    # From 170 to -170 degrees the short way leads through 180.
    angles = np.radians([170.0, -170.0])
    turned = about_z(angles)
    found = poses_at_times(
        Trajectory(np.array([0.0, 0.1]), pose_from_rotation(turned, np.zeros((2, 3)))),
        np.array([0.05]),
    )
    np.testing.assert_allclose(found.poses[0, :3, :3], np.diag([-1.0, -1.0, 1.0]), atol=1e-12)


def test_odometry_at_10_hz_is_within_two_millimetres_of_a_tight_circle() -> None:
    every = np.arange(0.0, 3.0, 0.1)
    times = every[:-1] + 0.05
    found = poses_at_times(Trajectory(every, _drive(every)), times)
    away = np.linalg.norm((found.poses - _drive(times))[:, :3, 3], axis=1)
    assert away.max() < 0.002
    np.testing.assert_allclose(found.poses[:, :3, :3], _drive(times)[:, :3, :3], atol=1e-9)


@pytest.mark.parametrize("phase", [0.0, 0.3, 0.5, 0.9])
def test_a_robot_that_turns_back_between_two_poses_is_followed_to_where_it_does(
    phase: float,
) -> None:
    """Straight from place to place at 1 to 2 m/s, poses at 30 Hz that miss the places."""
    rng = np.random.default_rng(1)
    corners: FloatArray = np.arange(0.0, 5.1, 0.5)
    places = rng.uniform(-0.5, 0.5, (len(corners), 3))
    turns = np.cumsum(rng.uniform(-0.1, 0.1, len(corners)))

    def along(times: FloatArray) -> FloatArray:
        states = np.stack([np.interp(times, corners, axis) for axis in places.T], axis=-1)
        states[:, 2] = np.interp(times, corners, turns)
        return world_from_base_planar(states)

    every: FloatArray = (np.arange(-3.0, 150.0) + phase) / 30.0
    trajectory = Trajectory(every, along(every))
    # At the first place it stands, and there are poses before it.
    amid: FloatArray = rng.uniform(0.5, 4.5, 500)
    for times in (corners[:-1], amid):
        found = poses_at_times(trajectory, times).poses
        away = np.linalg.norm((found - along(times))[:, :3, 3], axis=1)
        assert away.max() < 0.0011


def test_noise_and_curves_are_no_corners() -> None:
    every: FloatArray = np.arange(0.0, 5.0, 1.0 / 30.0)
    poses = _drive(every)
    poses[:, :3, 3] += np.random.default_rng(2).normal(0.0, 0.0005, (len(every), 3))
    times = every[3:-4] + 0.015
    found = poses_at_times(Trajectory(every, poses), times).poses
    for axis in range(3):
        line = np.interp(times, every, poses[:, axis, 3])
        np.testing.assert_allclose(found[:, axis, 3], line, atol=1e-9)


def test_gaps_and_what_lies_outside_of_the_span_have_no_pose() -> None:
    trajectory = Trajectory(
        np.array([0.0, 0.1, 0.2, 1.0, 1.1]), _drive(np.array([0.0, 0.1, 0.2, 1.0, 1.1]))
    )
    times = np.array([-0.5, -0.01, 0.05, 0.21, 0.6, 0.99, 1.05, 1.11, 1.5])
    found = poses_at_times(trajectory, times)
    known = [False, True, True, True, False, True, True, True, False]
    assert found.is_known.tolist() == known
    assert np.isnan(found.poses[~found.is_known]).all()
    # Beyond the ends it is the pose at the end; in a gap, what lies between.
    assert np.array_equal(found.poses[1], trajectory.poses[0])
    assert np.array_equal(found.poses[7], trajectory.poses[-1])
    share = 0.01 / 0.8
    expected = (1.0 - share) * trajectory.poses[2, :3, 3] + share * trajectory.poses[3, :3, 3]
    np.testing.assert_allclose(found.poses[3, :3, 3], expected, atol=1e-12)
    np.testing.assert_allclose(found.offsets[[0, 4, 8]], [0.5, 0.4, 0.4])
    assert poses_at_times(trajectory, times, max_gap=0.8).is_known.tolist() == [
        *known[:4],
        True,
        *known[5:],
    ]


@pytest.mark.parametrize("count", [0, 1])
def test_few_poses(count: int) -> None:
    trajectory = Trajectory(np.zeros(count), np.zeros((count, 4, 4)) + np.eye(4))
    found = poses_at_times(trajectory, np.array([0.0, 1.0]))
    assert found.is_known.tolist() == [count == 1, False]


def test_bad_arguments() -> None:
    trajectory = _wild(3, MAX_GAP, 1)
    with pytest.raises(OptionError, match="gap"):
        poses_at_times(trajectory, np.array([100.0]), max_gap=-1.0)
    with pytest.raises(OptionError, match="timestamps"):
        poses_at_times(trajectory, np.zeros((2, 2)))
