"""Poses of a robot on a floor, adjusted in the plane, against poses that are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError, StageError
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import (
    base_from_camera_mount,
    inverse,
    planar_state_of,
    world_from_base_planar,
)
from pipelines.reconstruct.planar_adjustment import adjust_in_plane
from pipelines.reconstruct.reconstruction import Reconstruction
from pipelines.reconstruct.settings import ReconstructSettings
from tests.reconstruct_samples import small_reconstruction

CAMERA = Camera("OPENCV", 640, 480, (577.0, 577.0, 319.5, 239.5, 0.02, -0.03, 0.001, -0.001))
MOUNT = base_from_camera_mount((0.1, 0.02, 1.0), (0.0, -4.0, 3.0))
PIXEL_NOISE = 0.3


def true_states() -> FloatArray:
    """A drive along a wall, to and fro, ``(12, 3)``."""
    x = np.linspace(-2.5, 2.5, 12)
    return np.stack([x, -4.0 + 0.5 * np.cos(2.0 * x), np.pi / 2.0 - 0.1 * x], axis=1)


def seen_wall(root: Path, world_from_camera: FloatArray) -> Reconstruction:
    """What cameras at these poses see of points on a wall y = 0 and a little before it."""
    rng = np.random.default_rng(3)
    points = rng.uniform([-4.0, -0.6, 0.2], [4.0, 0.0, 2.2], (150, 3))
    rows, pixels = [], []
    for point, place in enumerate(points):
        for image, pose in enumerate(world_from_camera):
            x, y, z = (inverse(pose) @ [*place, 1.0])[:3]
            # The inverse of the lens, by iteration: rays() of the pixel is the ray.
            pixel = np.array([[577.0 * x / z + 319.5, 577.0 * y / z + 239.5]])
            for _ in range(20):
                ray = CAMERA.rays(pixel)[0]
                pixel += 577.0 * (np.array([[x / z, y / z]]) - ray[None, :2])
            if 0.0 < pixel[0, 0] < 639.0 and 0.0 < pixel[0, 1] < 479.0:
                rows.append((point, image))
                pixels.append(pixel[0] + PIXEL_NOISE * rng.standard_normal(2))
    small = small_reconstruction(root)
    return replace(
        small,
        image_names=tuple(f"{index}.png" for index in range(len(world_from_camera))),
        image_hashes=tuple("0" * 64 for _ in world_from_camera),
        timestamps=np.arange(len(world_from_camera), dtype=np.float64),
        cameras=(CAMERA,),
        camera_index=np.zeros(len(world_from_camera), dtype=np.int64),
        world_from_camera=world_from_camera,
        points=points,
        observations=np.array(rows, dtype=np.int64),
        base_from_camera=MOUNT,
        observed_pixels=np.array(pixels),
        point_colors=np.zeros((len(points), 3), dtype=np.uint8),
        point_errors=np.zeros(len(points)),
    )


def test_poses_bent_out_of_the_plane_come_back(tmp_path: Path) -> None:
    states, rng = true_states(), np.random.default_rng(5)
    exact = seen_wall(tmp_path, world_from_base_planar(states) @ MOUNT)
    nods = Rotation.from_rotvec(rng.normal(0.0, 0.01, (len(states), 3))).as_matrix()
    bent = exact.world_from_camera.copy()
    bent[:, :3, :3] = bent[:, :3, :3] @ nods
    bent[:, :3, 3] += rng.normal(0.0, 0.03, (len(states), 3))
    points = exact.points + rng.normal(0.0, 0.03, exact.points.shape)
    odometry = states + rng.normal(0.0, [0.004, 0.004, 0.002], states.shape)
    found = adjust_in_plane(replace(exact, world_from_camera=bent, points=points), odometry)
    adjusted = found.reconstruction.world_from_camera @ inverse(MOUNT)
    np.testing.assert_allclose(adjusted[:, 2, 3], 0.0, atol=1e-9)
    left = planar_state_of(adjusted) - states
    # As a whole it stays where the bent poses were in the mean: that much is not told apart.
    apart = np.std(left, axis=0)
    assert np.all(apart < [0.006, 0.006, 0.0015])
    assert found.rms == pytest.approx(PIXEL_NOISE * np.sqrt(2.0), rel=0.2)


def test_odometry_gives_the_scale(tmp_path: Path) -> None:
    states = true_states()
    exact = seen_wall(tmp_path, world_from_base_planar(states) @ MOUNT)
    large = exact.world_from_camera.copy()
    large[:, :2, 3] *= 1.03
    found = adjust_in_plane(replace(exact, world_from_camera=large), states)
    positions = found.reconstruction.world_from_camera[:, :3, 3]
    extent = np.ptp(exact.world_from_camera[:, 0, 3])
    assert np.ptp(positions[:, 0]) == pytest.approx(extent, rel=0.003)


def test_a_camera_that_leaves_the_plane_is_refused(tmp_path: Path) -> None:
    states = true_states()
    poses = world_from_base_planar(states) @ MOUNT
    poses[:, 2, 3] += np.linspace(-0.3, 0.3, len(poses)) ** 2 * 5.0
    with pytest.raises(StageError, match="do not fit a camera that moves in a plane"):
        adjust_in_plane(seen_wall(tmp_path, poses), states)


def test_it_needs_the_mount(tmp_path: Path) -> None:
    states = true_states()
    wall = seen_wall(tmp_path, world_from_base_planar(states) @ MOUNT)
    with pytest.raises(StageError, match=r"\[mount\]"):
        adjust_in_plane(replace(wall, base_from_camera=None), states)


def test_it_goes_with_structure_from_motion_alone() -> None:
    with pytest.raises(OptionError, match="--planar goes with --method sfm"):
        ReconstructSettings("odometry", planar=True)
