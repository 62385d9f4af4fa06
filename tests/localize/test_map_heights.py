"""Maps whose views lie where no robot on z = 0 took them are noted; others are not."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.plane import Plane
from pipelines.geometry.pose import world_from_base_planar
from pipelines.geometry.trajectory import read_tum
from pipelines.lightfield.scene import PlaneEstimate, Scene, SceneDepth
from pipelines.localize.map_heights import notes_on_heights, viewing_distance
from tests.reconstruct_samples import SAMPLES
from tests.report_samples import MOUNT, wall_scene


def map_of(poses: FloatArray, distance: float = 3.0, by_robot: bool = False) -> Scene:
    """A map with views at ``world_from_camera``; the wall is ``distance`` ahead, at y = 0."""
    base = wall_scene()
    wall = Plane(np.array([0.0, -1.0, 0.0]), float(np.median(poses[:, 1, 3])) + distance)
    return replace(
        base,
        world_from_camera=poses,
        camera_index=np.zeros(len(poses), dtype=np.int64),
        base_from_camera=MOUNT if by_robot else None,
        surface=PlaneEstimate(wall, 0.01, 0.002, "given", 1.0),
    )


def views_at(places: FloatArray) -> FloatArray:
    """``(N, 4, 4)`` of cameras at ``(N, 3)`` that look along y."""
    states = np.column_stack([places[:, :2], np.full(len(places), math.pi / 2.0)])
    poses = world_from_base_planar(states) @ MOUNT
    poses[:, 2, 3] = places[:, 2]
    return np.asarray(poses)


def street(fall: float, noise: float = 0.0) -> FloatArray:
    """91 m along x; the camera sits 1 m above the ground."""
    along = np.arange(92.0)
    random = np.random.default_rng(0).normal(0.0, noise, 92)
    return np.column_stack([along, np.zeros(92), 1.0 - fall * along / 91.0 + random])


@given(st.integers(0, 2**32 - 1), st.integers(3, 200))
def test_a_level_drive_is_not_mentioned(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    places = np.column_stack([rng.uniform(-9.0, 9.0, (count, 2)), rng.normal(1.0, 0.02, count)])
    for by_robot in (False, True):
        assert notes_on_heights(map_of(views_at(places), by_robot=by_robot), 1.0) == ()


@given(st.integers(0, 2**32 - 1))
def test_the_ups_and_downs_of_a_hand_are_not_mentioned(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = np.column_stack([rng.uniform(-3.0, 3.0, (40, 2)), rng.uniform(1.08, 1.54, 40)])
    assert notes_on_heights(map_of(views_at(places)), 1.0) == ()


def test_the_workshop_is_not_mentioned() -> None:
    poses = read_tum(SAMPLES / "workshop/map" / "groundtruth.txt").poses
    assert notes_on_heights(map_of(poses, 2.0), 1.0) == ()


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_street_that_falls_is_mentioned(noise: float) -> None:
    (note,) = notes_on_heights(map_of(views_at(street(1.1, noise)), 10.0), 1.0)
    assert "views rise by 1.1" in note.replace("1.0", "1.1").replace("1.2", "1.1")
    assert "over 91 m" in note
    assert "--degrees-of-freedom 6" in note


def test_a_street_that_a_robot_recorded_is_mentioned() -> None:
    (note,) = notes_on_heights(map_of(views_at(street(1.1)), 10.0, by_robot=True), 1.0)
    assert "stood at heights from -1.05 to -0.05 m" in note


def test_a_crest_that_a_robot_recorded_is_mentioned_though_it_is_no_plane() -> None:
    places = street(0.0)
    places[:, 2] -= 1.1 * np.sin(np.linspace(0.0, np.pi, 92))
    (note,) = notes_on_heights(map_of(views_at(places), 10.0, by_robot=True), 1.0)
    assert "ground is not level" in note


def test_a_map_whose_origin_is_the_first_camera_is_mentioned() -> None:
    places = np.column_stack([np.linspace(-2.0, 2.0, 30), np.zeros(30), np.zeros(30)])
    (note,) = notes_on_heights(map_of(views_at(places)), 1.0)
    assert "camera is 1.00 m above z = 0 and the map's views at 0.00 m" in note
    assert "z of [mount]" in note


def test_a_robot_far_below_the_hand_is_mentioned() -> None:
    rng = np.random.default_rng(1)
    places = np.column_stack([rng.uniform(-3.0, 3.0, (40, 2)), rng.uniform(1.0, 1.6, 40)])
    (note,) = notes_on_heights(map_of(views_at(places)), 0.2)
    assert "0.20 m above z = 0" in note
    # From far away the same difference is none.
    assert notes_on_heights(map_of(views_at(places), 20.0), 0.2) == ()


def test_two_storeys_are_mentioned() -> None:
    places = np.column_stack([np.tile(np.arange(20.0), 2), np.zeros(40), np.repeat([1.0, 4.0], 20)])
    (note,) = notes_on_heights(map_of(views_at(places)), 1.0)
    assert "from 1.00 to 4.00 m" in note


def test_the_viewing_distance_is_that_of_plane_or_depth() -> None:
    scene = map_of(views_at(np.column_stack([np.arange(5.0), np.zeros(5), np.ones(5)])), 4.0)
    assert viewing_distance(scene) == pytest.approx(4.0)
    values = np.array([[0.0, 0.5], [0.5, 0.5]], dtype=np.float32)
    depth = SceneDepth(values, values > 0.0)
    assert viewing_distance(replace(scene, depth=(depth,) * 5)) == pytest.approx(2.0)
