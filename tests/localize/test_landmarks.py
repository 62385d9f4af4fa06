"""Features of photos get their places in the world: against analytic geometry."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.provenance import sha256_of_bytes
from pipelines.geometry.camera import Camera, Intrinsics, Undistorter
from pipelines.geometry.plane import Plane
from pipelines.geometry.pose import inverse
from pipelines.lightfield.compact import compact_scene
from pipelines.lightfield.scene import Scene, SceneDepth
from pipelines.localize.landmarks import LandmarkSource, depth_at, plane_depth_at
from pipelines.reconstruct.reconstruction import Reconstruction
from tests.lightfield_samples import looking
from tests.report_samples import wall_scene

PINHOLE = Intrinsics(64, 48, 60.0, 58.0, 30.0, 25.0)
# The slanted plane z = 2 + 0.3 x - 0.2 y in camera coordinates, as normal . x = 2.
SLOPE = np.array([-0.3, 0.2, 1.0])
FISHEYE = Camera("OPENCV_FISHEYE", 64, 48, (40.0, 41.0, 31.0, 24.0, 0.02, -0.01, 0.0, 0.0))
RADIAL = Camera("RADIAL", 64, 48, (50.0, 30.5, 24.5, -0.08, 0.01))


def slanted_depth(pinhole: Intrinsics) -> SceneDepth:
    """The exact depth map of the slanted plane, confident everywhere."""
    rows, columns = np.mgrid[0 : pinhole.height, 0 : pinhole.width]
    x, y = (columns - pinhole.cx) / pinhole.fx, (rows - pinhole.cy) / pinhole.fy
    inverse_depth = (SLOPE[0] * x + SLOPE[1] * y + SLOPE[2]) / 2.0
    return SceneDepth(inverse_depth.astype(np.float32), np.ones(rows.shape, dtype=np.bool_))


def rays_through(columns: FloatArray, rows: FloatArray) -> FloatArray:
    return np.stack(
        [
            (columns - PINHOLE.cx) / PINHOLE.fx,
            (rows - PINHOLE.cy) / PINHOLE.fy,
            np.ones(len(columns)),
        ],
        axis=1,
    )


def test_between_pixels_of_a_depth_map_a_slanted_plane_is_exact() -> None:
    # Half the photo's size: the depth map's pixels are not the photo's.
    depth = slanted_depth(PINHOLE.resized(32, 24))
    random = np.random.default_rng(0)
    rays = rays_through(random.uniform(6.0, 57.0, 200), random.uniform(6.0, 41.0, 200))
    found = depth_at(depth, PINHOLE, rays)
    points = rays / found[:, None]
    # Interpolation is in fixed point: a 32nd of a pixel.
    assert np.abs(points @ SLOPE - 2.0).max() < 2e-3


def test_no_place_at_depth_edges_unknown_pixels_and_outside() -> None:
    flat = np.full((48, 64), 0.5, dtype=np.float32)
    flat[:, 40:] = 1.0
    flat[20, 10] = 0.0
    rays = rays_through(
        np.array([20.0, 38.0, 39.4, 41.5, 44.0, 10.4, 13.0, -3.0, 0.2, 70.0]),
        np.array([10.0, 10.0, 10.0, 10.0, 10.0, 20.4, 20.0, 10.0, 10.0, 10.0]),
    )
    found = depth_at(SceneDepth(flat, flat > 0.0), PINHOLE, rays)
    expected = np.array([0.5, 0.5, 0.0, 1.0, 1.0, 0.0, 0.5, 0.0, 0.5, 0.0])
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_where_confidence_is_scattered_as_in_computed_maps_no_feature_is_lost() -> None:
    exact = slanted_depth(PINHOLE)
    random = np.random.default_rng(0)
    scattered = SceneDepth(exact.inverse_depth, random.uniform(size=(48, 64)) < 0.27)
    rays = rays_through(random.uniform(3.0, 60.0, 200), random.uniform(3.0, 44.0, 200))
    np.testing.assert_array_equal(
        depth_at(scattered, PINHOLE, rays), depth_at(exact, PINHOLE, rays)
    )


def test_a_plane_is_met_where_ray_and_plane_cross() -> None:
    pose = looking([1.0, -3.0, 1.2], [0.5, 0.0, 0.8])
    wall = Plane(np.array([0.0, -1.0, 0.0]), 0.0)
    rays = rays_through(np.linspace(0.0, 63.0, 50), np.linspace(5.0, 45.0, 50))
    points = (rays / plane_depth_at(wall, pose, rays)[:, None]) @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(points[:, 1], 0.0, atol=1e-9)
    away = looking([1.0, -3.0, 1.2], [0.5, -9.0, 0.8])
    assert not plane_depth_at(wall, away, rays).any()
    along = looking([1.0, -0.05, 1.2], [9.0, -0.05, 1.2])
    grazing = np.array([[-0.05, 0.0, 1.0]])
    assert not plane_depth_at(wall, along, grazing).any()


def scene_of(camera: Camera, depth: bool) -> tuple[Scene, FloatArray]:
    """One view of the slanted plane; its pose."""
    scene = wall_scene()
    assert scene.surface is not None
    pose = looking([1.0, -3.0, 1.2], [0.5, 0.0, 0.8])
    normal = -(pose[:3, :3] @ SLOPE) / np.linalg.norm(SLOPE)
    point = pose[:3, :3] @ np.array([0.0, 0.0, 2.0]) + pose[:3, 3]
    plane = Plane(normal, -float(normal @ point))
    maps = (slanted_depth(Undistorter(camera).intrinsics),) if depth else ()
    return replace(
        scene,
        image_names=("a.png",),
        encoded_images=scene.encoded_images[:1],
        timestamps=np.zeros(1),
        cameras=(camera,),
        camera_index=np.zeros(1, dtype=np.int64),
        world_from_camera=pose[None],
        surface=replace(scene.surface, plane=plane),
        depth=maps,
    ), pose


def recorded_pixels(camera: Camera, flat: FloatArray) -> FloatArray:
    """Where a lens shows points ``(N, 2)`` at depth one: the models' own formulas."""
    squared = np.sum(flat**2, axis=1)
    if camera.model == "RADIAL":
        focal, *centre, k1, k2 = camera.params
        bending = 1.0 + k1 * squared + k2 * squared**2
        return np.asarray(flat * bending[:, None] * focal + centre)
    fx, fy, cx, cy, k1, k2, k3, k4 = camera.params
    radius = np.sqrt(squared)
    angle = np.arctan(radius)
    bent = angle * (1 + k1 * angle**2 + k2 * angle**4 + k3 * angle**6 + k4 * angle**8)
    return np.asarray(flat * (bent / radius)[:, None] * [fx, fy] + [cx, cy])


@pytest.mark.parametrize("camera", [RADIAL, FISHEYE])
@pytest.mark.parametrize("depth", [True, False])
def test_features_of_a_bent_image_are_lifted_to_the_surface(camera: Camera, depth: bool) -> None:
    scene, pose = scene_of(camera, depth)
    flat = np.random.default_rng(1).uniform([-0.35, -0.25], [0.35, 0.25], (60, 2))
    local = np.column_stack([flat, np.ones(60)])
    local *= (2.0 / (local @ SLOPE))[:, None]
    found = LandmarkSource(scene, None).landmarks(0, recorded_pixels(camera, flat))
    np.testing.assert_array_equal(found.rows, np.arange(60))
    truth = local @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(found.points, truth, atol=3e-3)


def reconstruction_of(scene: Scene, points: FloatArray, pixels: FloatArray) -> Reconstruction:
    """Structure from motion of the first photo alone that saw ``points`` at ``pixels``."""
    rows = np.arange(len(points))
    return Reconstruction(
        method="sfm",
        image_root=Path("/nowhere"),
        image_names=("elsewhere.png",),
        image_hashes=(sha256_of_bytes(scene.encoded_images[0]),),
        timestamps=np.zeros(1),
        cameras=scene.cameras,
        camera_index=np.zeros(1, dtype=np.int64),
        world_from_camera=scene.world_from_camera[:1],
        points=points,
        observations=np.column_stack([rows, np.zeros_like(rows)]),
        base_from_camera=None,
        scale_source="odometry",
        dropped={},
        statistics={},
        observed_pixels=pixels,
    )


POINTS = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
PIXELS = np.array([[10.0, 12.0], [30.0, 20.0]])


def test_features_at_observed_points_are_those_points() -> None:
    scene = wall_scene()
    source = LandmarkSource(scene, reconstruction_of(scene, POINTS, PIXELS), "map")
    found = source.landmarks(0, np.array([[29.0, 21.0], [20.0, 20.0], [10.0, 12.5], [10.0, 15.0]]))
    np.testing.assert_array_equal(found.rows, [0, 2])
    np.testing.assert_array_equal(found.points, POINTS[[1, 0]])
    assert len(source.landmarks(1, PIXELS).rows) == 0


def test_points_of_recorded_photos_do_not_fit_compact_ones() -> None:
    scene = compact_scene(wall_scene())
    with pytest.raises(InputError, match=r"map: has its points in the recorded photos, .*full"):
        LandmarkSource(scene, reconstruction_of(wall_scene(), POINTS, PIXELS), "map")
    # The scene's own surface serves as before.
    assert len(LandmarkSource(scene, None).landmarks(0, PIXELS).rows) == 2


def test_a_reconstruction_of_something_else_is_refused() -> None:
    scene = wall_scene()
    right = reconstruction_of(scene, POINTS, PIXELS)
    empty = replace(right, points=POINTS[:0], observations=right.observations[:0],
                    observed_pixels=PIXELS[:0])  # fmt: skip
    moved = right.world_from_camera.copy()
    moved[0, 0, 3] += 0.1
    for wrong, text in (
        (empty, "map: holds no points"),
        (replace(right, image_hashes=("0" * 64,)), "map: shares no photo with the scene"),
        (replace(right, world_from_camera=moved), "map: has other poses of its photos"),
        (replace(right, world_from_camera=inverse(right.world_from_camera)), "has other poses"),
    ):
        with pytest.raises(InputError, match=text):
            LandmarkSource(scene, wrong, "map")
