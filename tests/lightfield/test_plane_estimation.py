"""The plane from sparse points and from photos, against planes that are known.

The sample data's wall: see ``test_model_and_render_commands``.
"""

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import StageError
from pipelines.artifacts.stages import no_progress
from pipelines.geometry.plane import Plane, angle_between, plane_from_coefficients
from pipelines.lightfield.plane_estimation import (
    MIN_POINTS,
    fit_plane,
    plane_from_photos,
    plane_from_points,
)
from pipelines.lightfield.views import Views, build_views
from tests.lightfield_samples import WALL, looking, photographed, pinhole

TILTED = plane_from_coefficients([0.3, -1.0, 0.05, 0.4])


def cameras(count: int = 12) -> FloatArray:
    """``(count, 4, 4)`` in front of the wall, looking at it."""
    generator = np.random.default_rng(2)
    return np.array(
        [
            looking([x, -3.0 + generator.uniform(-0.5, 0.5), 1.0], [0.8 * x, 0.0, 1.0])
            for x in np.linspace(-1.5, 1.5, count)
        ]
    )


def points_on(plane: Plane, count: int, noise: float, generator: np.random.Generator) -> FloatArray:
    """Points within two metres of the plane's foot of the origin, moved off it by ``noise``."""
    across = np.linalg.svd(plane.normal[None])[2][1:]
    flat = generator.uniform(-2.0, 2.0, (count, 2)) @ across
    return np.asarray(
        flat + plane.normal * (generator.normal(0.0, noise, count)[:, None] - plane.offset)
    )


def errors(plane: Plane, truth: Plane, poses: FloatArray) -> tuple[float, float]:
    """Difference of the distance to the cameras (metres) and of the direction (radians)."""
    middle = poses[:, :3, 3].mean(axis=0)
    distance = float(plane.signed_distance(middle) - truth.signed_distance(middle))
    return abs(distance), angle_between(plane, truth)


@pytest.mark.parametrize("truth", [WALL, TILTED])
@pytest.mark.parametrize("outliers", [0, 100, 350])
def test_points_with_outliers(truth: Plane, outliers: int) -> None:
    generator = np.random.default_rng(outliers)
    # Outliers on both sides; the plane's own points are 300.
    stray = generator.uniform(-3.0, 3.0, (outliers, 3)) + np.array([0.0, 0.0, 1.0])
    points = generator.permutation(np.vstack([points_on(truth, 300, 0.005, generator), stray]))
    estimate = plane_from_points(points, cameras(), np.random.default_rng(0))
    distance, angle = errors(estimate.plane, truth, cameras())
    assert distance < 0.01
    assert angle < np.radians(0.5)
    # Towards the cameras, whichever way the samples turned.
    assert np.all(estimate.plane.signed_distance(cameras()[:, :3, 3]) > 1.0)
    assert np.linalg.norm(estimate.plane.normal) == pytest.approx(1.0)
    assert estimate.method == "points"
    assert estimate.quality == pytest.approx(300 / (300 + outliers), abs=0.06)


def test_uncertainty_from_points_is_the_spread_of_the_estimates() -> None:
    estimates, sigmas = [], []
    middle = np.median(cameras()[:, :3, 3], axis=0)
    for seed in range(40):
        points = points_on(TILTED, 80, 0.01, np.random.default_rng(seed))
        estimate = plane_from_points(points, cameras(), np.random.default_rng(0))
        distance = estimate.plane.signed_distance(middle) - TILTED.signed_distance(middle)
        estimates.append([float(distance), angle_between(estimate.plane, TILTED)])
        sigmas.append([estimate.offset_sigma, estimate.angle_sigma])
    spread = np.sqrt(np.mean(np.square(estimates), axis=0))
    np.testing.assert_allclose(np.mean(sigmas, axis=0), spread, rtol=0.3)


def test_a_floor_with_more_points_does_not_win() -> None:
    generator = np.random.default_rng(0)
    floor = generator.uniform([-3.0, -3.0, -0.002], [3.0, 0.0, 0.002], (900, 3))
    points = np.vstack([floor, points_on(WALL, 200, 0.003, generator)])
    estimate = plane_from_points(points, cameras(), np.random.default_rng(0))
    distance, angle = errors(estimate.plane, WALL, cameras())
    assert distance < 0.02
    assert angle < np.radians(1.0)
    # Nothing but floor: there is no wall to be found.
    with pytest.raises(StageError, match=r"front.*--plane a,b,c,d"):
        plane_from_points(floor, cameras(), np.random.default_rng(0))


def test_too_few_points() -> None:
    points = points_on(WALL, MIN_POINTS - 1, 0.0, np.random.default_rng(0))
    with pytest.raises(StageError, match=r"29 points are too few .*--plane"):
        plane_from_points(points, cameras(), np.random.default_rng(0))
    points = points_on(WALL, MIN_POINTS, 0.0, np.random.default_rng(0))
    plane = plane_from_points(points, cameras(), np.random.default_rng(0)).plane
    np.testing.assert_allclose(plane.coefficients(), WALL.coefficients(), atol=1e-9)


def test_points_on_a_line_are_no_plane() -> None:
    points = np.linspace([-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], 50)
    with pytest.raises(StageError, match="--plane"):
        plane_from_points(points, cameras(), np.random.default_rng(0))


def test_the_same_seed_gives_the_same_plane() -> None:
    points = points_on(TILTED, 100, 0.05, np.random.default_rng(0))
    first, second = (
        plane_from_points(points, cameras(), np.random.default_rng(4)).plane.coefficients()
        for _ in range(2)
    )
    np.testing.assert_array_equal(first, second)


def test_least_squares_through_three_and_more_points() -> None:
    corners = np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 2.0], [0.0, 1.0, 2.0]])
    plane = fit_plane(corners)
    assert abs(plane.normal[2]) == pytest.approx(1.0)
    np.testing.assert_allclose(plane.signed_distance(corners), 0.0, atol=1e-12)
    heights = np.array([0.1, -0.1, 0.1, -0.1])
    square = np.array([[1.0, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0]])
    plane = fit_plane(square + heights[:, None] * [0.0, 0.0, 1.0])
    assert plane.offset == pytest.approx(0.0, abs=1e-12)
    assert abs(plane.normal[2]) == pytest.approx(1.0)


def plaster(points: FloatArray) -> FloatArray:
    """Fine enough for windows of seven pixels, smooth enough for bilinear samples."""
    generator = np.random.default_rng(9)
    total = np.zeros(points.shape[:-1])
    for _ in range(24):
        direction = generator.normal(size=3)
        frequency = generator.uniform(6.0, 26.0)
        phase = generator.uniform(0.0, 6.3)
        total += np.sin(frequency * (points @ (direction / np.linalg.norm(direction))) + phase)
    return np.repeat((128.0 + 20.0 * np.clip(total, -6.0, 6.0))[..., None], 3, axis=-1)


def wall_photos(plane: Plane, poses: FloatArray) -> Views:
    return photographed(list(poses), pinhole(120, 90, 105.0), plane, plaster)


@pytest.mark.parametrize("truth", [WALL, TILTED], ids=["wall", "tilted"])
def test_photos_of_a_textured_plane(truth: Plane) -> None:
    poses = cameras(6)
    estimate = plane_from_photos(wall_photos(truth, poses), poses, no_progress)
    distance, angle = errors(estimate.plane, truth, poses)
    assert distance < 0.02
    assert angle < np.radians(0.5)
    assert distance < 4.0 * estimate.offset_sigma + 1e-3
    assert angle < 4.0 * estimate.angle_sigma + 1e-3
    # And it is not called certain beyond reason, nor unsure of what is plain to see.
    assert estimate.offset_sigma < 0.05
    assert estimate.angle_sigma < np.radians(2.0)
    assert np.all(estimate.plane.signed_distance(poses[:, :3, 3]) > 1.0)
    assert estimate.method == "photos"
    assert estimate.quality > 0.9


def test_photos_that_fit_worse_are_called_less_certain() -> None:
    """Poses with errors of 2 cm, as odometry has them: the stated uncertainty covers the error."""
    poses = cameras(8)
    views = wall_photos(TILTED, poses)
    moved = poses.copy()
    moved[:, :3, 3] += np.random.default_rng(1).normal(0.0, 0.02, (8, 3))
    estimate = plane_from_photos(views, moved, no_progress)
    distance, angle = errors(estimate.plane, TILTED, poses)
    assert distance < 4.0 * estimate.offset_sigma
    assert angle < 4.0 * estimate.angle_sigma
    assert estimate.angle_sigma > np.radians(0.1)


def test_photos_without_parallax_are_refused_with_advice() -> None:
    place = [0.0, -3.0, 1.0]
    poses = np.array([looking(place, [x, 0.0, 1.0]) for x in (-0.4, 0.0, 0.4)])
    with pytest.raises(StageError, match=r"too close together.*--plane a,b,c,d"):
        plane_from_photos(wall_photos(WALL, poses), poses, no_progress)
    with pytest.raises(StageError, match="--plane a,b,c,d"):
        plane_from_photos(wall_photos(WALL, poses[:1]), poses[:1], no_progress)


def test_photos_in_all_directions_are_refused_with_advice() -> None:
    angles = 2.0 * np.pi * np.arange(16) / 16
    places = np.column_stack([np.cos(angles), np.sin(angles), np.ones(16)])
    poses = np.array([looking(place, place * [3.0, 3.0, 1.0]) for place in places])
    with pytest.raises(StageError, match=r"all directions.*--plane a,b,c,d"):
        plane_from_photos(wall_photos(WALL, poses), poses, no_progress)


def test_photos_that_agree_on_nothing_are_refused_with_advice() -> None:
    generator = np.random.default_rng(0)
    poses = cameras(5)
    noise = [generator.integers(0, 256, (45, 60, 3)).astype(np.uint8) for _ in poses]
    views = build_views(noise, [pinhole(60, 45, 52.0)] * 5, poses)
    with pytest.raises(StageError, match=r"do not agree.*--plane a,b,c,d"):
        plane_from_photos(views, poses, no_progress)
