"""Rigid transforms and planar robot poses.

A rigid transform is a ``(4, 4)`` homogeneous matrix named ``b_from_a``: it takes homogeneous
coordinates in frame ``a`` to frame ``b``, so that ``c_from_a = c_from_b @ b_from_a``. Stacks of
transforms have shape ``(N, 4, 4)``. World and robot base follow REP-103 (x forward, y left,
z up); cameras follow OpenCV and COLMAP (x right, y down, z forward). Angles are radians; heading is
counter-clockwise about z, in (-pi, pi].
"""

import math
import warnings

import numpy as np
import scipy
from numpy.typing import ArrayLike

from pipelines.artifacts.arrays import BoolArray, FloatArray, Shape, checked_array
from pipelines.artifacts.errors import OptionError

# Columns: the axes of a forward-looking camera (right, down, forward) in base coordinates.
BASE_FROM_FORWARD_CAMERA = np.array(
    [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], dtype=np.float64
)


# What rotations read from text files may be off by.
ROTATION_TOLERANCE = 1e-4


def are_rigid(poses: FloatArray, tolerance: float = ROTATION_TOLERANCE) -> BoolArray:
    """Which matrices are rotations (no reflections) with translations, and nothing else.

    Args:
        poses: ``(..., 4, 4)``.
        tolerance: largest deviation of R R^T from the identity.

    Returns:
        ``(...)``; False where a number is not finite.
    """
    rotation = poses[..., :3, :3]
    with np.errstate(invalid="ignore", over="ignore"):
        error = np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)).max(axis=(-1, -2))
        last = np.abs(poses[..., 3, :] - [0.0, 0.0, 0.0, 1.0]).max(axis=-1)
        is_rotation = (error <= tolerance) & (np.linalg.det(rotation) > 0.0)
    is_placed = np.all(np.isfinite(poses[..., :3, 3]), axis=-1)
    return np.asarray(is_rotation & is_placed & (last <= 1e-9), dtype=np.bool_)


def checked_poses(value: ArrayLike | None, name: str, shape: Shape = (4, 4)) -> FloatArray:
    """An argument as rigid transforms.

    Args:
        value: what the caller handed over.
        name: what the message calls it.
        shape: of the array; its last two lengths are 4.

    Raises:
        OptionError: another shape, no numbers, or a matrix that is no rigid transform.
    """
    poses = checked_array(value, name, shape)
    if not np.all(are_rigid(poses)):
        raise OptionError(
            f"{name} is no rigid transform: a rotation matrix, a translation, 0 0 0 1"
        )
    return poses


def wrap_angle(angle: ArrayLike) -> FloatArray:
    """Wraps angles (radians, any shape) into (-pi, pi]."""
    values = np.asarray(angle, dtype=np.float64)
    return np.asarray(np.pi - np.mod(np.pi - values, 2.0 * np.pi), dtype=np.float64)


def pose_from_rotation(rotation: ArrayLike, translation: ArrayLike) -> FloatArray:
    """Assembles transforms from rotation matrices ``(..., 3, 3)`` and translations ``(..., 3)``.

    Returns:
        ``(..., 4, 4)`` homogeneous matrices.
    """
    rotation_array = np.asarray(rotation, dtype=np.float64)
    pose = np.zeros((*rotation_array.shape[:-2], 4, 4))
    pose[..., :3, :3] = rotation_array
    pose[..., :3, 3] = translation
    pose[..., 3, 3] = 1.0
    return pose


def pose_from_quaternion(translation: ArrayLike, quaternion_xyzw: ArrayLike) -> FloatArray:
    """Transforms from translations ``(..., 3)`` and unit quaternions ``(..., 4)``, scalar last.

    Returns:
        ``(..., 4, 4)`` homogeneous matrices.
    """
    x, y, z, w = np.moveaxis(np.asarray(quaternion_xyzw, dtype=np.float64), -1, 0)
    length = np.sqrt(x * x + y * y + z * z + w * w)
    return pose_from_rotation(
        _rotation_of_unit(x / length, y / length, z / length, w / length), translation
    )


def _rotation_of_unit(x: ArrayLike, y: ArrayLike, z: ArrayLike, w: ArrayLike) -> FloatArray:
    """Rotation matrices ``(..., 3, 3)`` of unit quaternions, whose parts have shape ``(...)``.

    Written out, as is ``_turned_about_axes``: what every start needs does not wait for SciPy, whose
    transforms take 0.2 s to load.
    """
    x, y, z, w = (np.asarray(part, dtype=np.float64) for part in (x, y, z, w))
    rows = [
        [x * x - y * y - z * z + w * w, 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), -x * x + y * y - z * z + w * w, 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), -x * x - y * y + z * z + w * w],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_of(pose: FloatArray) -> FloatArray:
    """Unit quaternions ``(..., 4)``, scalar last and not negative, of poses ``(..., 4, 4)``."""
    rotation = scipy.spatial.transform.Rotation.from_matrix(pose[..., :3, :3].reshape(-1, 3, 3))
    quaternion = rotation.as_quat(canonical=True)
    return np.asarray(quaternion.reshape(*pose.shape[:-2], 4), dtype=np.float64)


def inverse(pose: FloatArray) -> FloatArray:
    """Inverse of rigid transforms ``(..., 4, 4)``: ``a_from_b`` of ``b_from_a``."""
    rotation_transposed = np.swapaxes(pose[..., :3, :3], -1, -2)
    translation = -(rotation_transposed @ pose[..., :3, 3:])[..., 0]
    return pose_from_rotation(rotation_transposed, translation)


def rotation_angle(pose: FloatArray) -> FloatArray:
    """Angle (radians, in [0, pi]) by which transforms ``(..., 4, 4)`` rotate; shape ``(...)``."""
    rotation = scipy.spatial.transform.Rotation.from_matrix(pose[..., :3, :3].reshape(-1, 3, 3))
    return np.asarray(rotation.magnitude().reshape(pose.shape[:-2]), dtype=np.float64)


def about_z(angles: FloatArray) -> FloatArray:
    """Rotations ``(N, 3, 3)`` by angles ``(N,)`` about the z axis."""
    cosine, sine = np.cos(angles), np.sin(angles)
    rotations = np.tile(np.eye(3), (len(angles), 1, 1))
    rotations[:, 0, 0] = rotations[:, 1, 1] = cosine
    rotations[:, 0, 1], rotations[:, 1, 0] = -sine, sine
    return rotations


def angle_about_z(rotations: FloatArray) -> FloatArray:
    """Angles ``(N,)`` of the rotations about z that are nearest to rotations ``(N, 3, 3)``."""
    sine = rotations[:, 1, 0] - rotations[:, 0, 1]
    return np.asarray(np.arctan2(sine, rotations[:, 0, 0] + rotations[:, 1, 1]))


def world_from_base_planar(states: ArrayLike) -> FloatArray:
    """Robot poses on the ground plane z = 0 (axes: REP-103).

    Args:
        states: ``(..., 3)``: x and y in metres, heading in radians, in the world.

    Returns:
        ``world_from_base``, ``(..., 4, 4)``.

    Raises:
        OptionError: no array of this shape.
    """
    # Finite or not: a state that nobody knows becomes a pose that nobody knows.
    state = checked_array(states, "states", (..., 3), finite=False)
    with np.errstate(invalid="ignore"):
        cosine, sine = np.cos(state[..., 2]), np.sin(state[..., 2])
    pose = np.zeros((*state.shape[:-1], 4, 4))
    pose[..., 0, 0] = cosine
    pose[..., 0, 1] = -sine
    pose[..., 1, 0] = sine
    pose[..., 1, 1] = cosine
    pose[..., 2, 2] = 1.0
    pose[..., 3, 3] = 1.0
    pose[..., 0, 3] = state[..., 0]
    pose[..., 1, 3] = state[..., 1]
    return pose


def planar_state_of(world_from_base: FloatArray) -> FloatArray:
    """Where on the ground plane robots stand (axes: REP-103).

    Args:
        world_from_base: ``(..., 4, 4)``.

    Returns:
        ``(..., 3)``: x and y in metres, heading in radians, in (-pi, pi]: the direction of the
        base's x axis seen from above.

    Raises:
        OptionError: no array of this shape.
    """
    world_from_base = checked_array(world_from_base, "world_from_base", (..., 4, 4), finite=False)
    state = np.empty((*world_from_base.shape[:-2], 3))
    state[..., :2] = world_from_base[..., :2, 3]
    heading = np.arctan2(world_from_base[..., 1, 0], world_from_base[..., 0, 0])
    state[..., 2] = wrap_angle(heading)
    return state


def camera_heading_of(world_from_camera: FloatArray) -> FloatArray:
    """Heading (radians, shape ``(...)``) of the optical axis of cameras ``(..., 4, 4)``."""
    heading = np.arctan2(world_from_camera[..., 1, 2], world_from_camera[..., 0, 2])
    return wrap_angle(heading)


def base_from_camera_mount(position: ArrayLike, roll_pitch_yaw_deg: ArrayLike) -> FloatArray:
    """The camera on the robot base.

    Args:
        position: ``(3,)`` metres, base coordinates.
        roll_pitch_yaw_deg: ``(3,)`` degrees: rotations about the base's fixed x, y and z axes, in
            this order, of a camera that looks along the base's x axis. Positive pitch looks down.

    Returns:
        ``base_from_camera``, ``(4, 4)``; the base's axes are those of REP-103 (x forward, y left, z
        up), the camera's those of OpenCV (x right, y down, z forward).

    Raises:
        OptionError: not three finite numbers each.
    """
    angles = np.radians(checked_array(roll_pitch_yaw_deg, "roll, pitch, yaw", (3,))).tolist()
    place = checked_array(position, "the camera's position", (3,))
    return pose_from_rotation(_turned_about_axes(*angles) @ BASE_FROM_FORWARD_CAMERA, place)


def _turned_about_axes(roll: float, pitch: float, yaw: float) -> FloatArray:
    """The rotation ``(3, 3)`` about the fixed x, y and z axes, in this order; radians."""
    (sx, cx), (sy, cy), (sz, cz) = (
        (math.sin(0.5 * angle), math.cos(0.5 * angle)) for angle in (roll, pitch, yaw)
    )
    # The product of three quaternions, the first two of which make these.
    x, y, z, w = cy * sx, sy * cx, -sy * sx, cy * cx
    return _rotation_of_unit(cz * x - sz * y, cz * y + sz * x, cz * z + sz * w, cz * w - sz * z)


def mount_of(base_from_camera: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Position ``(3,)`` and roll, pitch, yaw in degrees ``(3,)``, of ``base_from_camera_mount``.

    A camera that looks straight up or down has no unique roll and yaw; then yaw is 0.
    """
    rotation = scipy.spatial.transform.Rotation.from_matrix(
        base_from_camera[:3, :3] @ BASE_FROM_FORWARD_CAMERA.T
    )
    with warnings.catch_warnings():
        # SciPy warns that they are not unique; its own switch for that came with 1.17.
        warnings.simplefilter("ignore", UserWarning)
        roll, pitch, yaw = rotation.as_euler("xyz", degrees=True).tolist()
    # Adding zero turns -0.0 into 0.0.
    return base_from_camera[:3, 3].copy(), np.array([roll, pitch, yaw]) + 0.0
