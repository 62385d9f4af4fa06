"""The compiled net: its triangulation against Qhull, its weights against the readable net."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, Delaunay

from pipelines.artifacts.array_types import FloatArray, IntArray
from pipelines.geometry.camera import Intrinsics
from pipelines.lightfield.compiled import compiled, source_stamp
from pipelines.lightfield.net import pixel_weights
from pipelines.lightfield.net_cell_kernels import net_room_for
from pipelines.lightfield.net_kernels import _set_axes, build_net
from pipelines.lightfield.triangulation import GHOST, delaunay, triangulation_for
from tests.lightfield_samples import looking, pinhole, pixels_of

# They are parts of a kernel; called from here they would not be compiled.
compiled_delaunay, compiled_net = compiled(delaunay), compiled(build_net)
compiled_axes = compiled(_set_axes)


def triangulate(points: FloatArray) -> tuple[IntArray, IntArray]:
    """Triangles (t, 3) and hull edges (h, 2) of ``delaunay``."""
    room = triangulation_for(len(points))
    triangles = room.triangles
    triangles[:] = -7
    total = compiled_delaunay(np.ascontiguousarray(points, dtype=np.float64), len(points), room)
    assert 0 <= total <= len(triangles)
    used = triangles[:total]
    assert np.all(triangles[total:] == -7) or total > 0
    is_ghost = used[:, 2] == GHOST
    return used[~is_ghost], used[is_ghost][:, :2]


def as_set(rows: NDArray[np.integer[Any]]) -> set[tuple[int, ...]]:
    return {tuple(sorted(row)) for row in rows.tolist()}


def areas(points: FloatArray, triangles: IntArray) -> FloatArray:
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


@settings(deadline=None, max_examples=30)
@given(count=st.integers(4, 25), seed=st.integers(0, 100_000))
def test_no_point_lies_in_a_circumcircle(count: int, seed: int) -> None:
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


@settings(deadline=None, max_examples=100)
@given(
    columns=st.integers(2, 8),
    rows=st.integers(2, 8),
    seed=st.integers(0, 100_000),
    noise=st.sampled_from([0.0, 1e-15, 1e-13, 1e-11, 1e-7]),
)
def test_regular_grids_are_triangulated_whatever_rounding_says(
    columns: int, rows: int, seed: int, noise: float
) -> None:
    """Every four neighbours lie on a circle, every row on a line; a camera gantry is like that."""
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
    room = triangulation_for(count)
    for direction in ([1.0, 0.0], [0.0, 1.0], [3.0, -2.0], [1.0, np.pi]):
        points = 1e3 + steps[:, None] * np.array(direction)
        assert compiled_delaunay(points, count, room) == 0


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


@settings(deadline=None, max_examples=60)
@given(count=st.integers(1, 6), seed=st.integers(0, 100_000))
def test_axes_of_centres_are_those_that_lapack_finds(count: int, seed: int) -> None:
    generator = np.random.default_rng(seed)
    offsets = generator.normal(size=(count, 3)) * 10.0 ** generator.uniform(-6.0, 6.0, 3)
    scatter = offsets.T @ offsets
    room = net_room_for(count)
    room.scatter[:] = scatter
    least = compiled_axes(room)
    largest = np.abs(scatter).max()
    spread = np.diag(room.spread)
    assert least == spread.argmin()
    np.testing.assert_allclose(np.sort(spread), np.linalg.eigvalsh(scatter), atol=1e-14 * largest)
    back = room.axes @ np.diag(spread) @ room.axes.T
    np.testing.assert_allclose(back, scatter, atol=1e-14 * largest)
    np.testing.assert_allclose(room.axes.T @ room.axes, np.eye(3), atol=1e-14)


def kernel_weights(
    centres: FloatArray, pose: FloatArray, camera: Intrinsics, visible: list[bool] | None = None
) -> FloatArray:
    """``(N, H, W)`` weights of all views by the compiled net."""
    count = len(centres)
    views = np.zeros((4 * count + 8, 3), dtype=np.int64)
    coefficients = np.zeros((4 * count + 8, 3, 3))
    label = np.full((camera.height, camera.width), -9, dtype=np.int64)
    cells = compiled_net(
        centres,
        pose,
        camera.vector(),
        np.ones(count, dtype=np.bool_) if visible is None else np.array(visible),
        net_room_for(count),
        views,
        coefficients,
        label,
    )
    weights = np.zeros((count, *label.shape))
    if cells == 0:
        return weights
    assert label.min() >= 0
    assert label.max() < cells
    pixels = np.concatenate([pixels_of(camera), np.ones((*label.shape, 1))], axis=-1)
    rows, columns = np.indices(label.shape)
    for corner in range(3):
        weight = np.einsum("yxi,yxi->yx", coefficients[label, corner], pixels)
        np.add.at(weights, (views[label, corner], rows, columns), weight)
    return weights


def reference_weights(centres: FloatArray, pose: FloatArray, camera: Intrinsics) -> FloatArray:
    net = pixel_weights(centres, pose, camera)
    weights = np.zeros((len(centres), camera.height, camera.width))
    rows, columns = np.indices((camera.height, camera.width))
    for corner in range(3):
        np.add.at(weights, (net.views[..., corner], rows, columns), net.weights[..., corner])
    return weights


@settings(deadline=None, max_examples=50)
@given(
    count=st.integers(1, 14),
    seed=st.integers(0, 100_000),
    arrangement=st.sampled_from(["general", "line", "plane", "copies", "behind", "at a centre"]),
)
def test_weights_are_those_of_the_readable_net(count: int, seed: int, arrangement: str) -> None:
    generator = np.random.default_rng(seed)
    centres = generator.normal(size=(count, 3)) * [1.0, 0.7, 0.6] - [0.0, 3.0, 0.0]
    place = generator.normal(size=3) * [1.0, 0.3, 0.5] - [0.0, 5.0, 0.0]
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
    target = generator.normal(size=3) * [1.0, 0.0, 1.0]
    pose = looking(place, target, float(generator.uniform(-1.0, 1.0)))
    camera = pinhole(23, 17, float(generator.uniform(8.0, 60.0)))
    found = kernel_weights(centres, pose, camera)
    np.testing.assert_allclose(found, reference_weights(centres, pose, camera), atol=2e-6)


def test_only_visible_views_take_part() -> None:
    generator = np.random.default_rng(5)
    centres = generator.normal(size=(6, 3)) - [0.0, 3.0, 0.0]
    pose, camera = looking([0.2, -6.0, 0.1], [0.0, 0.0, 0.0]), pinhole(23, 17, 20.0)
    visible = [True, False, True, True, False, True]
    weights = kernel_weights(centres, pose, camera, visible)
    assert not weights[[1, 4]].any()
    expected = reference_weights(centres[visible], pose, camera)
    np.testing.assert_allclose(weights[visible], expected, atol=2e-6)
    assert not kernel_weights(centres, pose, camera, [False] * 6).any()


def test_a_camera_grid_seen_straight_on_has_sound_weights() -> None:
    """The diagonals of its squares are nobody's business, everything else is."""
    x, z = np.meshgrid(np.arange(7) * 0.3, np.arange(5) * 0.2)
    centres = np.column_stack([x.ravel(), np.full(35, -4.0), z.ravel()])
    camera = pinhole(60, 45, 50.0)
    for offset in np.random.default_rng(0).uniform(-0.3, 0.3, (20, 3)):
        place = np.array([0.9, -6.0, 0.4]) + offset
        weights = kernel_weights(centres, looking(place, place + np.array([0.0, 1.0, 0.0])), camera)
        np.testing.assert_allclose(weights.sum(axis=0), 1.0, atol=1e-9)
        assert weights.min() > -1e-9
        assert weights.max() < 1.0 + 1e-9
        # In the row of a border only neighbours blend: no view of a row is passed over.
        top = weights.reshape(5, 7, 45, 60)[-1]
        for left, right in pairwise(range(7)):
            between = (top[left] > 0.05) & (top[right] > 0.05)
            others = np.delete(top, [left, right], axis=0)
            assert not others[:, between].any()


def test_machine_code_on_disk_is_bound_to_all_modules_that_went_into_it(tmp_path: Path) -> None:
    """A kernel holds the code of functions from other modules; numba looks at its own alone."""
    functions: tuple[Any, ...] = (compiled_delaunay, compiled_net)
    for function in functions:
        module = Path(function.__code__.co_filename)
        assert function._cache._cache_file._source_stamp == source_stamp(module)
    folder = tmp_path / "lightfield"
    folder.mkdir()
    for name, text in {
        "a": "from pipelines.lightfield.b import f\n",
        "b": "from pipelines.lightfield.c import (\n    g,\n)\n",
        "c": "from pipelines.lightfield.a import h\n",
        "d": "",
    }.items():
        (folder / f"{name}.py").write_text(text)

    other = tmp_path / "localize" / "e.py"
    other.parent.mkdir()
    other.write_text("from pipelines.lightfield.c import g\n")

    def stamps() -> tuple[str, str]:
        source_stamp.cache_clear()
        return source_stamp(folder / "a.py", tmp_path), source_stamp(other, tmp_path)

    before = stamps()
    (folder / "d.py").write_text("unrelated")
    assert stamps() == before
    with (folder / "c.py").open("a") as file:
        file.write("x = 1\n")
    for new, old in zip(stamps(), before, strict=True):
        assert new != old
