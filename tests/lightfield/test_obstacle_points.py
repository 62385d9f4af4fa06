"""Obstacle points of rooms whose walls are known, with depth maps that are wrong far away."""

from dataclasses import replace

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.plane import Plane
from pipelines.lightfield.obstacle_points import distinct_rows, obstacle_points
from pipelines.lightfield.scene import PlaneEstimate, Scene, SceneDepth
from tests.room_samples import DOOR_HIGH, DOOR_LOW, PARTITION_X
from tests.two_room_samples import distance_from_walls, two_rooms

TOP = 1.2
# From farther away than this, metres, some depth maps show a wall where the door stands open.
FAR = 2.0


def in_doorway(points: FloatArray) -> FloatArray:
    """Those of points ``(M, 2)`` that stand in the middle half of the doorway."""
    inside = np.abs(points[:, 0] - PARTITION_X) < 0.2
    middle, half = 0.5 * (DOOR_LOW + DOOR_HIGH), 0.25 * (DOOR_HIGH - DOOR_LOW)
    return np.asarray(points[inside & (np.abs(points[:, 1] - middle) < half)])


@pytest.fixture(scope="module")
def closed_from_afar() -> Scene:
    """The rooms, where every fourth photo taken far from the doorway shows it closed."""
    scene = two_rooms()
    depth = list(scene.depth)
    camera = scene.cameras[0].intrinsics
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    for index, pose in enumerate(scene.world_from_camera):
        away = PARTITION_X - pose[0, 3]
        if index % 4 != 0 or away < FAR:
            continue
        rays = camera.rays(columns, rows) @ pose[:3, :3].T
        with np.errstate(divide="ignore"):
            to_partition = away / rays[..., 0]
        nearer = (to_partition > 0.0) & (1.0 / depth[index].inverse_depth > to_partition)
        inverse = np.where(nearer, 1.0 / to_partition, depth[index].inverse_depth)
        depth[index] = SceneDepth(inverse.astype(np.float32), depth[index].confident)
    return replace(scene, depth=tuple(depth))


def test_obstacles_stand_at_the_walls_and_nowhere_else() -> None:
    points = obstacle_points(two_rooms(), TOP)
    assert points is not None
    assert max(map(distance_from_walls, points)) < 0.05
    # And everywhere along them: those of the west.
    for y in np.arange(0.1, 2.9, 0.1):
        assert np.linalg.norm(points - [0.0, y], axis=1).min() < 0.1


def test_what_views_nearby_see_through_is_no_obstacle(closed_from_afar: Scene) -> None:
    points = obstacle_points(closed_from_afar, TOP)
    assert points is not None
    assert len(in_doorway(points)) == 0
    everywhere = obstacle_points(two_rooms(), TOP)
    assert everywhere is not None
    # The walls stay.
    apart = np.linalg.norm(everywhere[:, None] - points, axis=2).min(axis=1)
    assert np.mean(apart < 0.06) > 0.98


def test_in_a_scene_with_a_plane_every_depth_map_counts(closed_from_afar: Scene) -> None:
    plane = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    surface = PlaneEstimate(plane, 0.01, 0.01, "given", 1.0)
    points = obstacle_points(replace(closed_from_afar, surface=surface), TOP)
    assert points is not None
    assert len(in_doorway(points)) > 0


def test_a_scene_without_depth_maps_shows_no_obstacles() -> None:
    assert obstacle_points(replace(two_rooms(), depth=()), TOP) is None


@pytest.mark.parametrize("count", [0, 1, 500])
def test_distinct_rows_are_those_that_numpy_finds(count: int) -> None:
    rows = np.random.default_rng(count).integers(-3, 4, (count, 2))
    rows[:, 1] *= 2**40
    distinct, owner, counts = distinct_rows(rows)
    values, inverse, times = np.unique(rows, axis=0, return_inverse=True, return_counts=True)
    np.testing.assert_array_equal(distinct, values)
    np.testing.assert_array_equal(owner, inverse.reshape(-1))
    np.testing.assert_array_equal(counts, times)
