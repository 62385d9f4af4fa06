"""Rotations that are written out, beside those of SciPy."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.pose import (
    BASE_FROM_FORWARD_CAMERA,
    base_from_camera_mount,
    pose_from_quaternion,
)

quaternions = arrays(np.float64, (2, 3, 4), elements=st.floats(-1.0, 1.0)).filter(
    lambda found: bool(np.all(np.linalg.norm(found, axis=-1) > 0.1))
)
angles = arrays(np.float64, 3, elements=st.floats(-360.0, 360.0))


@given(quaternions)
def test_quaternions_become_the_rotations_of_scipy(found: FloatArray) -> None:
    poses = pose_from_quaternion(np.ones((2, 3, 3)), found)
    expected = Rotation.from_quat(found.reshape(-1, 4)).as_matrix()
    np.testing.assert_allclose(poses[..., :3, :3].reshape(-1, 3, 3), expected, atol=1e-14)
    np.testing.assert_array_equal(poses[..., :3, 3], 1.0)
    assert pose_from_quaternion(np.zeros(3), found[0, 0]).shape == (4, 4)


@given(angles)
def test_roll_pitch_and_yaw_turn_a_camera_as_in_scipy(found: FloatArray) -> None:
    mount = base_from_camera_mount([1.0, 2.0, 3.0], found)
    expected = Rotation.from_euler("xyz", found, degrees=True).as_matrix()
    np.testing.assert_allclose(mount[:3, :3], expected @ BASE_FROM_FORWARD_CAMERA, atol=1e-14)
    np.testing.assert_array_equal(mount[:3, 3], [1.0, 2.0, 3.0])
