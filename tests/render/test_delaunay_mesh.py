"""The mesh of recording centres against geometry worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.camera import Intrinsics
from pipelines.render.delaunay_mesh import (
    PixelWeights,
    distinct_vertices,
    is_one_dimensional,
    pixel_weights,
    project_centres,
)
from tests.lightfield_samples import looking, pinhole, pixels_of

# Looks along +y from the origin: x right, z up, 40 pixels a unit at depth 1; middle (30, 20).
CAMERA = pinhole(61, 41, 40.0)
POSE = looking([0.0, 0.0, 0.0], [0.0, 1.0, 0.0])


def centre_at(x: float, y: float, depth: float = 2.0) -> list[float]:
    """The recording centre that projects to a pixel at a depth, negative behind the camera."""
    return [(x - 30.0) / 40.0 * depth, depth, -(y - 20.0) / 40.0 * depth]


def weight_of(mesh: PixelWeights, view: int) -> FloatArray:
    """``(H, W)`` the weight that a view has."""
    return np.asarray(np.where(mesh.views == view, mesh.weights, 0.0).sum(axis=-1))


def dense(mesh: PixelWeights, count: int) -> FloatArray:
    """``(N, H, W)`` weights of all views."""
    return np.stack([weight_of(mesh, view) for view in range(count)])


def projected_homogeneously(
    centres: FloatArray, pose: FloatArray, intrinsics: Intrinsics
) -> FloatArray:
    """What the paper says: multiply by the projection matrix, divide by the third component."""
    projection = intrinsics.matrix() @ np.linalg.inv(pose)[:3]
    homogeneous = np.column_stack([centres, np.ones(len(centres))]) @ projection.T
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_centres_project_by_homogeneous_multiplication_on_either_side(side: float) -> None:
    generator = np.random.default_rng(3)
    pose = looking([1.0, -4.0, 1.3], [0.4, 0.0, 1.0], roll=0.3)
    camera = Intrinsics(64, 48, 50.0, 55.0, 30.0, 25.0)
    ahead = pose[:3, 2]
    offsets = generator.normal(size=(20, 3))
    offsets += (side * (1.0 + generator.random(20)) - offsets @ ahead)[:, None] * ahead
    centres = pose[:3, 3] + offsets
    expected = projected_homogeneously(centres, pose, camera)
    np.testing.assert_allclose(project_centres(centres, pose, camera), expected, atol=1e-9)
    # One by hand: behind the camera and to its right appears to the left.
    assert project_centres(np.array([[1.0, -2.0, 0.0]]), POSE, CAMERA)[0] == pytest.approx(
        [30.0 - 20.0, 20.0]
    )


def test_a_triangle_is_one_at_the_own_corner_and_falls_to_zero_at_the_opposite_side() -> None:
    corners = np.array([[10.0, 5.0], [50.0, 9.0], [22.0, 35.0]])
    centres = np.array([centre_at(*corner) for corner in corners.tolist()])
    mesh = pixel_weights(centres, POSE, CAMERA)
    weights = dense(mesh, 3)
    np.testing.assert_allclose(weights.sum(axis=0), 1.0, atol=1e-12)
    for view, (x, y) in enumerate(corners.astype(int).tolist()):
        expected = np.zeros(3)
        expected[view] = 1.0
        np.testing.assert_allclose(weights[:, y, x], expected, atol=1e-9)
    # Halfway between the first two corners, which lie on pixels, the third has no say.
    np.testing.assert_allclose(weights[:, 7, 30], [0.5, 0.5, 0.0], atol=1e-9)
    # Linear in between: barycentric coordinates by solving for them.
    for x, y in [(25, 12), (20, 20), (30, 18), (40, 10)]:
        expected = np.linalg.solve(np.vstack([corners.T, np.ones(3)]), [x, y, 1.0])
        assert expected.min() > 0.0
        np.testing.assert_allclose(weights[:, y, x], expected, atol=1e-9)


def test_beyond_an_outer_edge_its_views_blend_and_beyond_a_corner_its_view_stands_alone() -> None:
    corners = [(20.0, 10.0), (40.0, 10.0), (30.0, 30.0)]
    mesh = pixel_weights(np.array([centre_at(*c) for c in corners]), POSE, CAMERA)
    weights = dense(mesh, 3)
    # Above the upper edge the ramp along it goes on.
    np.testing.assert_allclose(weights[:, 0, 25], [0.75, 0.25, 0.0], atol=1e-9)
    np.testing.assert_allclose(weights[:, 3, 35], [0.25, 0.75, 0.0], atol=1e-9)
    # Up and to the left of the first corner, right of the second, below the third.
    np.testing.assert_allclose(weights[:, 2, 5], [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(weights[:, 2, 58], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(weights[:, 40, 30], [0.0, 0.0, 1.0], atol=1e-12)


def test_corners_along_a_straight_border_all_count() -> None:
    corners = [(x, y) for y in (10.0, 30.0) for x in (10.0, 30.0, 50.0)]
    mesh = pixel_weights(np.array([centre_at(*c) for c in corners]), POSE, CAMERA)
    weights = dense(mesh, 6)
    np.testing.assert_allclose(weights[:, 2, 20], [0.5, 0.5, 0.0, 0.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(weights[:, 38, 45], [0.0, 0.0, 0.0, 0.0, 0.25, 0.75], atol=1e-9)


@pytest.mark.parametrize("depth", [2.0, -2.0])
def test_in_front_of_the_recording_positions_the_net_is_mirrored(depth: float) -> None:
    """Centres a, b, c from left to right in space: behind the camera they come out c, b, a."""
    centres = np.array([[-1.0, depth, 0.5], [1.0, depth, 0.5], [0.0, depth, -0.5]])
    weights = dense(pixel_weights(centres, POSE, CAMERA), 3)
    left, right = (0, 1) if depth > 0.0 else (1, 0)
    row = 10 if depth > 0.0 else 30
    assert weights[left, row, 10] == pytest.approx(1.0)
    assert weights[right, row, 50] == pytest.approx(1.0)
    assert weights[2, 40 - row, 30] == pytest.approx(1.0)
    # The ray through this pixel, extended to the centres' plane, divides it 3 : 1.
    np.testing.assert_allclose(weights[[left, right], row, 20], [0.75, 0.25], atol=1e-9)


def test_on_a_robot_all_centres_lie_on_the_horizon_and_weights_ramp_along_it() -> None:
    xs = [10.0, 25.0, 40.0]
    # At different depths, before and behind the camera, and not in order.
    centres = np.array([centre_at(xs[1], 20.0, 3.0), centre_at(xs[2], 20.0, -1.0)])
    centres = np.vstack([centres, centre_at(xs[0], 20.0, 1.5)])
    assert is_one_dimensional(centres, POSE[:3, 3])
    weights = dense(pixel_weights(centres, POSE, CAMERA), 3)[[2, 0, 1]]
    np.testing.assert_allclose(weights.sum(axis=0), 1.0, atol=1e-12)
    for row in (0, 20, 40):
        for number, x in enumerate((10, 25, 40)):
            assert weights[number, row, x] == pytest.approx(1.0)
        np.testing.assert_allclose(weights[:, row, 13], [0.8, 0.2, 0.0], atol=1e-9)
        np.testing.assert_allclose(weights[:, row, 37], [0.0, 0.2, 0.8], atol=1e-9)
        np.testing.assert_allclose(weights[0, row, :11], 1.0, atol=1e-9)
        np.testing.assert_allclose(weights[2, row, 40:], 1.0, atol=1e-9)


def test_a_slanted_line_of_centres_gives_slanted_ramps() -> None:
    """Centres on a line through (10, 5) and (50, 35): ramps run along it, constant across it."""
    corners = np.array([[10.0, 5.0], [30.0, 20.0], [50.0, 35.0]])
    depths = (2.0, 3.0, -2.0)
    centres = np.array(
        [centre_at(x, y, d) for (x, y), d in zip(corners.tolist(), depths, strict=True)]
    )
    weights = dense(pixel_weights(centres, POSE, CAMERA), 3)
    along = (pixels_of(CAMERA) - corners[0]) @ [0.8, 0.6] / 25.0
    expected = np.stack(
        [
            np.clip(1.0 - along, 0.0, 1.0),
            np.clip(1.0 - np.abs(along - 1.0), 0.0, 1.0),
            np.clip(along - 1.0, 0.0, 1.0),
        ]
    )
    np.testing.assert_allclose(weights, expected, atol=1e-9)


def test_nearly_coplanar_centres_make_no_sliver_triangles() -> None:
    generator = np.random.default_rng(2)
    centres = np.column_stack(
        [np.linspace(-2.0, 2.0, 7), np.full(7, 3.0), generator.normal(0.0, 1e-3, 7)]
    )
    assert is_one_dimensional(centres, POSE[:3, 3])
    assert not is_one_dimensional(centres * [1.0, 1.0, 200.0], POSE[:3, 3])
    weights = dense(pixel_weights(centres, POSE, CAMERA), 7)
    # Weights depend on the column, hardly on the row.
    assert np.abs(weights - weights[:, :1]).max() < 0.02
    assert np.all(np.diff(weights.argmax(axis=0)[20]) >= 0)


def test_one_view_has_all_the_weight() -> None:
    mesh = pixel_weights(np.array([[0.3, 2.0, 0.1]]), POSE, CAMERA)
    assert np.all(mesh.views == 0)
    np.testing.assert_array_equal(weight_of(mesh, 0), np.ones((41, 61)))


@pytest.mark.parametrize("depths", [(2.0, 3.0), (2.0, -5.0)])
def test_two_views_ramp_along_the_line_between_them(depths: tuple[float, float]) -> None:
    first, second = np.array([14.0, 8.0]), np.array([46.0, 32.0])
    centres = np.array([centre_at(14.0, 8.0, depths[0]), centre_at(46.0, 32.0, depths[1])])
    weights = dense(pixel_weights(centres, POSE, CAMERA), 2)
    along = (pixels_of(CAMERA) - first) @ (second - first) / np.sum((second - first) ** 2)
    np.testing.assert_allclose(weights[1], np.clip(along, 0.0, 1.0), atol=1e-9)
    np.testing.assert_allclose(weights.sum(axis=0), 1.0, atol=1e-12)


def test_of_centres_on_one_ray_the_nearest_stays() -> None:
    shared = [centre_at(15.0, 20.0, 4.0), centre_at(15.0, 20.0, 2.0), centre_at(15.0, 20.0, -3.0)]
    centres = np.array([*shared, centre_at(45.0, 20.0, 3.0), centre_at(30.0, 5.0, 3.0)])
    mesh = pixel_weights(centres, POSE, CAMERA)
    assert weight_of(mesh, 1)[20, 15] == pytest.approx(1.0)
    assert not np.any(weight_of(mesh, 0))
    assert not np.any(weight_of(mesh, 2))


def test_views_from_one_place_the_first_stays() -> None:
    centres = np.repeat([centre_at(15.0, 20.0), centre_at(45.0, 25.0)], 20, axis=0)
    mesh = pixel_weights(centres, POSE, CAMERA)
    assert set(np.unique(mesh.views)) == {0, 20}


def test_far_outside_the_image_corners_coincide_by_their_share() -> None:
    """Neighbouring numbers lie 2e-6 apart at 1e10: rounding must not tell places apart there."""
    corners = np.array([[1e10, 3.0], [np.nextafter(1e10, 2e10), 3.0], [9e9, 3.0], [5.0, 3.0]])
    corners = np.vstack([corners, [5.0 + 1e-7, 3.0], [5.001, 3.0]])
    kept = distinct_vertices(corners, np.array([2.0, 1.0, 3.0, 4.0, 5.0, 6.0]))
    assert kept.tolist() == [1, 2, 3, 5]


def test_from_a_recorded_position_itself_weights_are_sound() -> None:
    centres = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 0.3], [-1.0, 2.0, -0.4], [0.2, 3.0, 1.0]])
    for pose in (POSE, looking([0.0, 0.0, 0.0], [0.3, 0.9, 0.2], roll=0.4)):
        corners = project_centres(centres, pose, CAMERA)
        # A centre without direction is put in the middle of the image, not at rounding noise.
        np.testing.assert_array_equal(corners[0], [30.0, 20.0])
        weights = dense(pixel_weights(centres, pose, CAMERA), 4)
        np.testing.assert_allclose(weights.sum(axis=0), 1.0, atol=1e-12)
        assert weights[0, 20, 30] == pytest.approx(1.0)


def test_on_the_recording_line_the_neighbours_to_both_sides_blend() -> None:
    """The virtual camera looks across a line of centres on which it stands: all are beside it."""
    xs = np.array([-3.0, -1.0, 0.5, 2.0])
    centres = np.column_stack([xs, np.zeros(4), np.zeros(4)])
    corners = project_centres(centres, POSE, CAMERA)
    assert np.all(np.isfinite(corners))
    assert np.abs(corners[:, 0]).min() > 1e6
    weights = dense(pixel_weights(centres, POSE, CAMERA), 4)
    # The image is a speck between infinity to the left and to the right.
    np.testing.assert_allclose(weights[1], 0.5, atol=1e-6)
    np.testing.assert_allclose(weights[2], 0.5, atol=1e-6)
    # From a step behind the line the same neighbours blend, now by position.
    behind = looking([0.0, -0.01, 0.0], [0.0, 1.0, 0.0])
    weights = dense(pixel_weights(centres, behind, CAMERA), 4)
    np.testing.assert_allclose(weights[[1, 2], 20, 30], [1.0 / 3.0, 2.0 / 3.0], atol=1e-9)


@given(
    count=st.integers(1, 9),
    seed=st.integers(0, 10_000),
    spread=st.tuples(*[st.sampled_from([0.0, 1e-9, 1e-3, 1.0])] * 3),
    at_centre=st.booleans(),
)
def test_weights_are_a_partition_of_one_whatever_the_arrangement(
    count: int, seed: int, spread: tuple[float, float, float], at_centre: bool
) -> None:
    generator = np.random.default_rng(seed)
    centres = generator.normal(size=(count, 3)) * spread + generator.normal(size=3)
    place = centres[0] if at_centre else generator.normal(size=3)
    pose = looking(place, place + generator.normal(size=3), float(generator.uniform(-3.0, 3.0)))
    mesh = pixel_weights(centres, pose, pinhole(9, 7, 6.0))
    assert np.all(mesh.weights >= 0.0)
    np.testing.assert_allclose(mesh.weights.sum(axis=-1), 1.0, atol=1e-9)
    assert mesh.views.min() >= 0
    assert mesh.views.max() < count
