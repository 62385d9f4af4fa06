"""Which photos are compared: against geometry that is tried point by point."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import inverse, pose_from_rotation
from pipelines.reconstruct.photo_pairs import (
    COLUMNS,
    DEPTHS,
    FOLLOWING,
    MIN_OVERLAP,
    PARTNERS,
    REACH,
    ROWS,
    depth_unit,
    image_pairs,
    spatial_pairs,
    view_geometry,
    view_overlap,
)

CAMERA = Camera("PINHOLE", 320, 240, (260.0, 270.0, 150.0, 125.0))
UPRIGHT = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def walk(count: int, seed: int) -> FloatArray:
    """Cameras that stroll about a room and look around."""
    generator = np.random.default_rng(seed)
    positions = np.cumsum(generator.normal(0.0, 0.4, (count, 3)) * [1.0, 1.0, 0.1], axis=0)
    headings = np.cumsum(generator.normal(0.0, 30.0, count))
    turns = Rotation.from_euler("z", headings[:, None], degrees=True).as_matrix()
    return pose_from_rotation(turns @ UPRIGHT, positions)


def overlap_point_by_point(poses: FloatArray, first: int, second: int) -> float:
    """Points of each camera at given depths, projected into the other one, one at a time."""
    matrix = np.array([[260.0, 0.0, 150.0], [0.0, 270.0, 125.0], [0.0, 0.0, 1.0]])
    shares = []
    for own, other in ((first, second), (second, first)):
        seen = 0
        for depth, column, row in itertools.product(DEPTHS, range(COLUMNS), range(ROWS)):
            pixel = [(column + 0.5) / COLUMNS * 320 - 0.5, (row + 0.5) / ROWS * 240 - 0.5, 1.0]
            local = depth * depth_unit(poses) * np.linalg.solve(matrix, pixel)
            x, y, z = (inverse(poses[other]) @ poses[own] @ [*local, 1.0])[:3]
            if z > 0.0:
                u, v, _ = matrix @ [x / z, y / z, 1.0]
                seen += -0.5 <= u <= 319.5 and -0.5 <= v <= 239.5
        shares.append(seen / (len(DEPTHS) * COLUMNS * ROWS))
    return min(shares)


def test_the_overlap_of_two_views_is_that_of_their_points() -> None:
    poses = walk(12, seed=1)
    pairs = np.array(list(itertools.combinations(range(12), 2)))
    found = view_overlap(view_geometry(CAMERA, poses), poses, pairs)
    expected = [overlap_point_by_point(poses, i, j) for i, j in pairs.tolist()]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert 0.05 < np.mean(found > MIN_OVERLAP) < 0.9


@pytest.mark.parametrize("seed", range(3))
def test_the_pairs_are_those_of_all_that_see_the_same(seed: int) -> None:
    count = 60
    poses = walk(count, seed)
    unit = depth_unit(poses)
    candidates: dict[int, list[tuple[float, int]]] = {row: [] for row in range(count)}
    for i, j in itertools.combinations(range(count), 2):
        near = np.linalg.norm(poses[i, :3, 3] - poses[j, :3, 3]) <= REACH * unit
        turned = np.degrees(np.arccos(np.clip(poses[i, :3, 2] @ poses[j, :3, 2], -1.0, 1.0)))
        overlap = overlap_point_by_point(poses, i, j) if near and turned <= 60.0 else 0.0
        if overlap >= MIN_OVERLAP - 1e-12:
            candidates[i].append((-overlap, j))
            candidates[j].append((-overlap, i))
    expected = {(i, j) for i, j in itertools.combinations(range(count), 2) if j - i <= FOLLOWING}
    for own, found in candidates.items():
        for _, other in sorted(found)[:PARTNERS]:
            expected.add((min(own, other), max(own, other)))
    assert spatial_pairs(CAMERA, poses) == sorted(expected)


def test_views_back_to_back_and_from_behind_are_not_compared() -> None:
    back = np.diag([-1.0, -1.0, 1.0])
    places = np.array([[0.0, 0.0, 1.0]] * 6 + [[-9.0, 0.0, 1.0]])
    turns = np.array([UPRIGHT, *[back @ UPRIGHT] * 4, UPRIGHT, UPRIGHT])
    pairs = spatial_pairs(CAMERA, pose_from_rotation(turns, places))
    assert (0, 5) in pairs
    assert (0, 4) not in pairs
    assert (0, 6) not in pairs


def test_small_sets_are_compared_exhaustively_and_long_ones_along_time() -> None:
    assert image_pairs(40, "auto") == list(itertools.combinations(range(40), 2))
    pairs = image_pairs(300, "auto")
    assert len(pairs) == len(set(pairs)) < 300 * 299 / 2 / 8
    assert all(0 <= i < j < 300 for i, j in pairs)
    assert {(7, 8), (7, 17), (7, 23), (7, 263), (0, 290)} <= set(pairs)
    assert (7, 18) not in pairs
    assert image_pairs(3, "sequential") == [(0, 1), (0, 2), (1, 2)]
    assert len(image_pairs(100, "exhaustive")) == 4950
