"""The Delaunay mesh in C++: its triangulation against Qhull, its weights against SciPy's mesh."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, Delaunay

from pipelines import native
from pipelines.artifacts.arrays import BoolArray, FloatArray, Int32Array
from pipelines.geometry.camera import Intrinsics
from pipelines.render.delaunay_mesh import MESH_LIMITS, SMALLEST_AREA, pixel_weights
from tests.lightfield_samples import looking, pinhole, pixels_of

GHOST = -1


def triangulate(points: FloatArray) -> tuple[Int32Array, Int32Array]:
    """Triangles (t, 3) and hull edges (h, 2)."""
    corners = native.delaunay_triangles(np.ascontiguousarray(points), SMALLEST_AREA)
    is_ghost = corners[:, 2] == GHOST
    return corners[~is_ghost], corners[is_ghost][:, :2]


def as_set(rows: NDArray[np.integer[Any]]) -> set[tuple[int, ...]]:
    return {tuple(sorted(row)) for row in rows.tolist()}


def areas(points: FloatArray, triangles: Int32Array) -> FloatArray:
    a, b, c = (points[triangles[:, i]] for i in range(3))
    u, v = b - a, c - a
    return np.asarray((u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2.0)


def assert_is_triangulation(points: FloatArray) -> None:
    """The triangles fill the hull without overlap, use every point and border each other."""
    triangles, hull = triangulate(points)
    size = float(ConvexHull(points).volume)
    own = areas(points, triangles)
    assert own.min() > 0.0
    assert own.sum() == pytest.approx(size, rel=1e-9)
    assert set(np.unique(triangles)) == set(range(len(points)))
    # Euler: each point adds two triangles, ghosts included.
    assert len(triangles) + len(hull) == 2 * len(points) - 2
    edges = [(t[i], t[(i + 1) % 3]) for t in triangles.tolist() for i in range(3)]
    assert len(set(edges)) == len(edges)
    lonely = {(b, a) for a, b in edges} - set(edges)
    assert lonely == {(a, b) for a, b in hull.tolist()}


@settings(deadline=None, max_examples=60)
@given(count=st.integers(3, 40), seed=st.integers(0, 100_000), scale=st.floats(1e-3, 1e6))
def test_random_points_give_the_triangles_of_qhull(count: int, seed: int, scale: float) -> None:
    generator = np.random.default_rng(seed)
    points = scale * (generator.normal(size=(count, 2)) + generator.normal(size=2))
    triangles, hull = triangulate(points)
    reference = Delaunay(points)
    assert as_set(triangles) == as_set(reference.simplices)
    assert as_set(hull) == as_set(reference.convex_hull)
    assert areas(points, triangles).min() > 0.0


def test_a_thousand_points_give_the_triangles_of_qhull() -> None:
    points = np.random.default_rng(4).normal(size=(1000, 2))
    triangles, hull = triangulate(points)
    reference = Delaunay(points)
    assert as_set(triangles) == as_set(reference.simplices)
    assert as_set(hull) == as_set(reference.convex_hull)


@settings(deadline=None, max_examples=30)
@given(count=st.integers(4, 25), seed=st.integers(0, 100_000))
def test_no_point_is_in_a_circumcircle(count: int, seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(count, 2))
    triangles, hull = triangulate(points)
    for triangle in triangles:
        a, b, c = points[triangle]
        # The point that is as far from a as from b and from c.
        middle = np.linalg.solve(2.0 * np.array([b - a, c - a]), [b @ b - a @ a, c @ c - a @ a])
        radius = np.linalg.norm(a - middle)
        others = np.delete(points, triangle, axis=0)
        assert np.all(np.linalg.norm(others - middle, axis=1) > radius * (1.0 - 1e-9))
    for start, end in hull:
        # The hull is to the right of its edges.
        along = points[end] - points[start]
        offsets = points - points[start]
        assert np.all(along[0] * offsets[:, 1] - along[1] * offsets[:, 0] <= 1e-12)


# The same grids every time: in one of 10,000, noise of just the size below which three points count
# as a line leaves a notch in the hull.
@settings(deadline=None, max_examples=200, derandomize=True)
@example(columns=5, rows=2, seed=1447, noise=1e-11)
@given(
    columns=st.integers(2, 8),
    rows=st.integers(2, 8),
    seed=st.integers(0, 100_000),
    noise=st.sampled_from([0.0, 1e-15, 1e-13, 1e-11, 1e-7]),
)
def test_regular_grids_are_triangulated_whatever_rounding_says(
    columns: int, rows: int, seed: int, noise: float
) -> None:
    """Every four neighbours are on a circle, every row on a line; a camera gantry is like that."""
    generator = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    grid = np.stack([x, y], axis=-1).reshape(-1, 2) * generator.uniform(0.1, 60.0)
    angle = generator.uniform(0.0, 6.3)
    cosine, sine = np.cos(angle), np.sin(angle)
    points = grid @ np.array([[cosine, sine], [-sine, cosine]]) + generator.uniform(-99, 99, 2)
    points += noise * generator.normal(size=points.shape)
    # Rounding noise on a straight border may or may not make triangles without area there.
    if noise == 0.0:
        assert_is_triangulation(generator.permutation(points))
    triangles, _ = triangulate(generator.permutation(points))
    assert len(triangles) >= 2 * (columns - 1) * (rows - 1)
    assert len(np.unique(triangles)) == len(points)


@settings(deadline=None, max_examples=40)
@given(count=st.integers(4, 30), seed=st.integers(0, 100_000))
def test_points_on_a_circle_are_triangulated(count: int, seed: int) -> None:
    generator = np.random.default_rng(seed)
    angle = 2.0 * np.pi * (np.arange(count) + generator.uniform(-0.2, 0.2, count)) / count
    points = generator.uniform(1.0, 900.0) * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    assert_is_triangulation(generator.permutation(points) + generator.uniform(-99.0, 99.0, 2))


def test_corners_up_to_infinity_are_triangulated() -> None:
    """Centres beside the virtual camera project millions of pixels away."""
    generator = np.random.default_rng(0)
    for _ in range(100):
        points = generator.normal(0.0, 100.0, (10, 2))
        points[:4] *= 10.0 ** generator.uniform(0.0, 8.0, (4, 1))
        assert_is_triangulation(points)


@pytest.mark.parametrize("count", [3, 4, 9])
def test_points_on_a_line_have_no_triangles(count: int) -> None:
    steps = np.random.default_rng(count).permutation(count).astype(np.float64)
    for direction in ([1.0, 0.0], [0.0, 1.0], [3.0, -2.0], [1.0, np.pi]):
        points = 1e3 + steps[:, None] * np.array(direction)
        assert native.delaunay_triangles(points, SMALLEST_AREA).shape == (0, 3)


def test_a_few_triangulations_by_hand() -> None:
    triangles, hull = triangulate(np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 3.0], [5.0, 4.0]]))
    assert as_set(triangles) == {(0, 1, 2), (1, 2, 3)}
    assert as_set(hull) == {(0, 1), (0, 2), (1, 3), (2, 3)}
    # A point in the middle, and one on the middle of a border.
    square = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]
    triangles, _ = triangulate(np.array([*square, [1.5, 2.0]]))
    assert as_set(triangles) == {(0, 1, 4), (1, 2, 4), (2, 3, 4), (0, 3, 4)}
    triangles, hull = triangulate(np.array([*square, [2.0, 0.0]]))
    assert as_set(triangles) == {(0, 3, 4), (2, 3, 4), (1, 2, 4)}
    assert as_set(hull) == {(0, 4), (1, 4), (1, 2), (2, 3), (0, 3)}


@settings(deadline=None, max_examples=100)
@given(seed=st.integers(0, 100_000))
def test_whatever_numbers_there_are_corners_are_among_the_points(seed: int) -> None:
    """Equal points, infinity, no numbers, rounding at all scales: no crash, nothing made up."""
    generator = np.random.default_rng(seed)
    points = generator.normal(size=(int(generator.integers(0, 30)), 2))
    points = np.round(points, 1) * 10.0 ** generator.integers(-320, 308, points.shape).astype(float)
    points[generator.random(points.shape) < 0.2] = np.nan
    points[generator.random(points.shape) < 0.2] = 0.0
    points = np.concatenate([points, points[: len(points) // 2]])
    corners = native.delaunay_triangles(points, SMALLEST_AREA)
    assert corners.size == 0 or (corners.min() >= GHOST and corners.max() < len(points))


# --- weights -----------------------------------------------------------------------------------


def meshes(
    centres: FloatArray, poses: FloatArray, camera: Intrinsics, takes_part: BoolArray | None = None
) -> tuple[Int32Array, FloatArray, Int32Array, int]:
    if takes_part is None:
        takes_part = np.ones((len(poses), len(centres)), dtype=np.bool_)
    photos, weights, regions, most = native.delaunay_meshes(
        poses=poses,
        intrinsics=camera.vector(),
        width=camera.width,
        height=camera.height,
        centres=centres,
        takes_part=takes_part,
        limits=MESH_LIMITS,
    )
    return photos, weights.astype(np.float64), regions, most


def mesh_weights(
    centres: FloatArray, pose: FloatArray, camera: Intrinsics, takes_part: list[bool] | None = None
) -> FloatArray:
    """``(N, H, W)`` weights of all photos."""
    chosen = None if takes_part is None else np.array([takes_part])
    photos, coefficients, regions, most = meshes(centres, pose[None], camera, chosen)
    weights = np.zeros((len(centres), camera.height, camera.width))
    region = regions[0]
    if most == 0:
        assert np.all(region == -1)
        return weights
    assert region.min() >= 0
    assert region.max() < most
    middle = 0.5 * (np.array([camera.width, camera.height]) - 1.0)
    offsets = pixels_of(camera) - middle
    terms = np.concatenate(
        [offsets, np.ones((*region.shape, 1)), np.zeros((*region.shape, 1))], axis=-1
    )
    rows, columns = np.indices(region.shape)
    for corner in range(3):
        weight = np.einsum("yxi,yxi->yx", coefficients[0, region, corner], terms)
        photo = photos[0, region, corner]
        used = photo >= 0
        np.add.at(weights, (photo[used], rows[used], columns[used]), weight[used])
    return weights


def reference_weights(centres: FloatArray, pose: FloatArray, camera: Intrinsics) -> FloatArray:
    mesh = pixel_weights(centres, pose, camera)
    weights = np.zeros((len(centres), camera.height, camera.width))
    rows, columns = np.indices((camera.height, camera.width))
    for corner in range(3):
        np.add.at(weights, (mesh.views[..., corner], rows, columns), mesh.weights[..., corner])
    return weights


ARRANGEMENTS = ("general", "line", "plane", "copies", "behind", "at a centre", "amid", "beside")


@settings(deadline=None, max_examples=200)
@given(
    count=st.integers(1, 30),
    seed=st.integers(0, 100_000),
    arrangement=st.sampled_from(ARRANGEMENTS),
)
def test_weights_are_those_of_the_readable_mesh(count: int, seed: int, arrangement: str) -> None:
    generator = np.random.default_rng(seed)
    centres = generator.normal(size=(count, 3)) * [1.0, 0.7, 0.6] - [0.0, 3.0, 0.0]
    place = generator.normal(size=3) * [1.0, 0.3, 0.5] - [0.0, 5.0, 0.0]
    target = generator.normal(size=3) * [1.0, 0.0, 1.0]
    if arrangement == "line":
        centres = centres[0] + np.outer(np.arange(count), [0.4, 0.1, 0.05])
    elif arrangement == "plane":
        centres[:, 2] = place[2]
    elif arrangement == "copies":
        centres = np.repeat(centres[: count // 3 + 1], 12, axis=0)
    elif arrangement == "behind":
        place[1] = generator.uniform(-1.0, 0.0)
    elif arrangement == "at a centre":
        place = centres[0].copy()
    elif arrangement == "amid":
        place[1] = generator.uniform(-3.5, -2.5)
    elif arrangement == "beside":
        centres[:, 1:] = [place[1], place[2]]
        target = place + np.array([0.0, 1.0, 0.0])
    pose = looking(place, target, float(generator.uniform(-1.0, 1.0)))
    camera = pinhole(23, 17, float(generator.uniform(8.0, 60.0)))
    found = mesh_weights(centres, pose, camera)
    # Between centres that are close together in the image weights are steep, and the tables hold
    # them in single precision.
    _, coefficients, regions, _ = meshes(centres, pose[None], camera)
    reach = np.array([0.5 * camera.width, 0.5 * camera.height, 1.0, 0.0])
    largest = (np.abs(coefficients[0]) @ reach).max(axis=-1)[regions[0]]
    error = np.abs(found - reference_weights(centres, pose, camera)).max(axis=0)
    assert np.all(error <= 2e-6 + 2.0 * np.finfo(np.float32).eps * largest)


def test_only_photos_that_take_part_have_weights() -> None:
    generator = np.random.default_rng(5)
    centres = generator.normal(size=(6, 3)) - [0.0, 3.0, 0.0]
    pose, camera = looking([0.2, -6.0, 0.1], [0.0, 0.0, 0.0]), pinhole(23, 17, 20.0)
    takes_part = [True, False, True, True, False, True]
    weights = mesh_weights(centres, pose, camera, takes_part)
    assert not weights[[1, 4]].any()
    expected = reference_weights(centres[takes_part], pose, camera)
    np.testing.assert_allclose(weights[takes_part], expected, atol=1e-5)
    assert not mesh_weights(centres, pose, camera, [False] * 6).any()


def test_a_camera_grid_seen_straight_on_has_sound_weights() -> None:
    """The diagonals of its squares are nobody's business, everything else is."""
    x, z = np.meshgrid(np.arange(7) * 0.3, np.arange(5) * 0.2)
    centres = np.column_stack([x.ravel(), np.full(35, -4.0), z.ravel()])
    camera = pinhole(60, 45, 50.0)
    for offset in np.random.default_rng(0).uniform(-0.3, 0.3, (20, 3)):
        place = np.array([0.9, -6.0, 0.4]) + offset
        weights = mesh_weights(centres, looking(place, place + np.array([0.0, 1.0, 0.0])), camera)
        np.testing.assert_allclose(weights.sum(axis=0), 1.0, atol=1e-5)
        assert weights.min() > -1e-5
        assert weights.max() < 1.0 + 1e-5
        # In the row of a border only neighbours blend: no view of a row is passed over.
        top = weights.reshape(5, 7, 45, 60)[-1]
        for left, right in pairwise(range(7)):
            between = (top[left] > 0.05) & (top[right] > 0.05)
            others = np.delete(top, [left, right], axis=0)
            assert np.all(others[:, between] < 1e-5)


def test_each_mesh_is_that_of_its_own_camera() -> None:
    generator = np.random.default_rng(6)
    centres = generator.normal(size=(9, 3)) - [0.0, 3.0, 0.0]
    camera = pinhole(23, 17, 20.0)
    places = generator.normal(size=(12, 3)) * [1.0, 0.3, 0.5] - [0.0, 5.0, 0.0]
    poses = np.array([looking(place, [0.0, 0.0, 0.0]) for place in places])
    takes_part = generator.random((12, 9)) < 0.6
    takes_part[3] = False
    together = meshes(centres, poses, camera, takes_part)
    assert together[3] == max(region.max() + 1 for region in together[2])
    for number, pose in enumerate(poses):
        alone = meshes(centres, pose[None], camera, takes_part[number : number + 1])
        for table in range(3):
            one, all_of_them = np.asarray(alone[table]), np.asarray(together[table])
            np.testing.assert_array_equal(one[0], all_of_them[number])


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e300, 1e300, 1e-320, 0.0])
def test_whatever_numbers_there_are_regions_are_whole(value: float) -> None:
    """Poses, centres and cameras that are none: each pixel has a region that is there."""
    generator = np.random.default_rng(7)
    camera = pinhole(7, 5, 6.0)
    for _ in range(60):
        centres = generator.normal(size=(8, 3)) - [0.0, 3.0, 0.0]
        poses = np.array([looking([0.2, -6.0, 0.1], [0.0, 0.0, 0.0])])
        intrinsics = camera.vector()
        for array in (centres, poses, intrinsics):
            array[generator.random(array.shape) < 0.2] = value
        photos, _, regions, most = native.delaunay_meshes(
            poses=poses,
            intrinsics=intrinsics,
            width=7,
            height=5,
            centres=centres,
            takes_part=np.ones((1, 8), np.bool_),
            limits=MESH_LIMITS,
        )
        assert regions.min() >= 0
        assert regions.max() < most
        assert photos.min() >= -1
        assert photos.max() < len(centres)


# --- arguments ---------------------------------------------------------------------------------


def mesh_arguments() -> dict[str, Any]:
    return {
        "poses": np.array([looking([0.2, -6.0, 0.1], [0.0, 0.0, 0.0])] * 3),
        "intrinsics": pinhole(7, 5, 6.0).vector(),
        "width": 7,
        "height": 5,
        "centres": np.random.default_rng(8).normal(size=(4, 3)),
        "takes_part": np.ones((3, 4), dtype=np.bool_),
        "limits": MESH_LIMITS,
    }


MESHES: list[tuple[str, Callable[[Any], object]]] = [
    ("poses", lambda a: a[0]),
    ("intrinsics", lambda a: a[:3]),
    ("width", lambda a: 0),
    ("height", lambda a: 2**16),
    ("centres", lambda a: a[:, :2].copy()),
    ("takes_part", lambda a: a[:, :3].copy()),
    ("takes_part", lambda a: a[:2]),
    ("takes_part", lambda a: a.astype(np.uint8)),
    ("limits", lambda a: a[:3]),
]


@pytest.mark.parametrize(("name", "spoil"), MESHES)
def test_a_wrong_argument_of_a_mesh_is_named(name: str, spoil: Callable[[Any], object]) -> None:
    given_arguments = mesh_arguments()
    assert native.delaunay_meshes(**given_arguments)[2].shape == (3, 5, 7)
    with pytest.raises((TypeError, ValueError), match=rf"^{name}: [^\n]+$"):
        native.delaunay_meshes(**given_arguments | {name: spoil(given_arguments[name])})
    with pytest.raises(ValueError, match=r"^points: [^\n]+$"):
        native.delaunay_triangles(np.zeros((3, 3)), SMALLEST_AREA)
    with pytest.raises(ValueError, match=r"^smallest_area: [^\n]+$"):
        native.delaunay_triangles(np.zeros((3, 2)), -1.0)
