"""Planar and spatial states: the operations on them against 4x4 matrices and SciPy."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.pose import inverse, world_from_base_planar, wrap_angle
from pipelines.localize.state_space import (
    PLANAR,
    SPATIAL,
    StateSpace,
    grid_cells,
    state_space_named,
    state_space_of_dimension,
)

both = pytest.mark.parametrize("space", [PLANAR, SPATIAL], ids=lambda space: space.name)
seeds = st.integers(0, 2**32)


def random_states(space: StateSpace, count: int, seed: int) -> FloatArray:
    """Anywhere within ten metres, in any orientation."""
    corner = np.full(space.positions, 10.0)
    return space.uniform(-corner, corner, count, np.random.default_rng(seed))


def random_offsets(space: StateSpace, count: int, seed: int) -> FloatArray:
    """Differences whose angles are shorter than half a turn."""
    rng = np.random.default_rng(seed + 1)
    offsets = rng.normal(0.0, 2.0, (count, space.dimension))
    angles = rng.uniform(0.0, 3.1, (count, 1))
    directions = rng.standard_normal((count, space.angles))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    offsets[:, space.positions :] = angles * directions
    return np.asarray(offsets)


def assert_same_poses(space: StateSpace, states: FloatArray, poses: FloatArray) -> None:
    np.testing.assert_allclose(space.poses(states), poses, atol=1e-9)


@both
@given(seed=seeds)
def test_a_difference_leads_from_one_state_to_the_other(space: StateSpace, seed: int) -> None:
    states, centre = random_states(space, 8, seed), random_states(space, 8, seed + 2)
    offsets = space.difference(states, centre)
    assert_same_poses(space, space.moved(centre, offsets), space.poses(states))
    # By the shortest way round.
    angles = np.linalg.norm(offsets[:, space.positions :], axis=1)
    assert np.all(angles <= np.pi + 1e-9)
    apart = (states - centre)[:, : space.positions]
    np.testing.assert_allclose(offsets[:, : space.positions], apart)


@both
@given(seed=seeds)
def test_what_was_added_is_the_difference(space: StateSpace, seed: int) -> None:
    states, offsets = random_states(space, 8, seed), random_offsets(space, 8, seed)
    moved = space.moved(states, offsets)
    np.testing.assert_allclose(space.difference(moved, states), offsets, atol=1e-8)


@both
@given(seed=seeds)
def test_composition_is_the_product_of_the_poses(space: StateSpace, seed: int) -> None:
    states, motions = random_states(space, 8, seed), random_offsets(space, 8, seed)
    composed = space.composed(states, motions)
    assert_same_poses(space, composed, space.poses(states) @ space.poses(motions))
    # One motion for all states is broadcast.
    together = space.composed(states, motions[0])
    assert_same_poses(space, together, space.poses(states) @ space.poses(motions[:1]))


@both
@given(seed=seeds)
def test_the_increment_is_what_has_to_be_composed(space: StateSpace, seed: int) -> None:
    before, after = random_states(space, 2, seed)
    poses = space.poses(np.stack([before, after]))
    increment = space.increment(poses[0], poses[1])
    assert_same_poses(space, increment, inverse(poses[0]) @ poses[1])
    assert_same_poses(space, space.composed(before, increment), poses[1])


@both
@given(seed=seeds)
def test_poses_and_states_are_the_same_thing(space: StateSpace, seed: int) -> None:
    states = random_states(space, 6, seed)
    poses = space.poses(states.reshape(2, 3, space.dimension))
    assert poses.shape == (2, 3, 4, 4)
    np.testing.assert_allclose(space.states(poses).reshape(6, -1), states, atol=1e-7)


def test_spatial_poses_are_those_of_the_rotation_vector() -> None:
    states = random_states(SPATIAL, 5, 0)
    poses = SPATIAL.poses(states)
    for state, pose in zip(states, poses, strict=True):
        np.testing.assert_allclose(pose[:3, :3], Rotation.from_rotvec(state[3:]).as_matrix())
        np.testing.assert_array_equal(pose[:3, 3], state[:3])
    # On the floor and upright the two spaces say the same.
    planar = random_states(PLANAR, 5, 1)
    spatial = SPATIAL.states(world_from_base_planar(planar))
    np.testing.assert_allclose(spatial[:, [0, 1, 5]], planar, atol=1e-9)
    np.testing.assert_allclose(spatial[:, 2:5], 0.0, atol=1e-9)


def test_spatial_differences_are_turns_about_the_worlds_axes() -> None:
    state = random_states(SPATIAL, 1, 3)[0]
    turn = np.array([0.0, 0.0, 0.4])
    moved = SPATIAL.moved(state, np.concatenate([np.zeros(3), turn]))
    expected = Rotation.from_rotvec(turn).as_matrix() @ SPATIAL.poses(state)[:3, :3]
    np.testing.assert_allclose(SPATIAL.poses(moved)[:3, :3], expected, atol=1e-12)


# --- means and spreads -------------------------------------------------------------------------


@given(seed=seeds, centre=st.floats(-np.pi, np.pi))
def test_the_mean_heading_does_not_mind_the_jump(seed: int, centre: float) -> None:
    rng = np.random.default_rng(seed)
    around = rng.uniform(-1.0, 1.0, 9)
    weights = rng.random(9) + 0.01
    states = np.zeros((9, 3))
    states[:, 2] = wrap_angle(centre + around)
    expected = np.angle(np.sum(weights * np.exp(1j * states[:, 2])))
    mean = PLANAR.mean(states, weights)
    assert abs(float(wrap_angle(mean[2] - expected))) < 1e-9
    assert -np.pi < mean[2] <= np.pi


@given(seed=seeds)
def test_the_mean_rotation_minimises_the_chordal_distance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centre = random_states(SPATIAL, 1, seed)[0]
    states = SPATIAL.moved(centre, rng.normal(0.0, 0.3, (12, 6)))
    weights = rng.random(12) + 0.01
    mean = SPATIAL.mean(states, weights)
    np.testing.assert_allclose(mean[:3], np.average(states[:, :3], axis=0, weights=weights))
    # The rotation nearest to the weighted sum of the matrices, by singular values.
    total = np.einsum("m,mij->ij", weights, SPATIAL.poses(states)[:, :3, :3])
    left, _, right = np.linalg.svd(total)
    nearest = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    np.testing.assert_allclose(SPATIAL.poses(mean)[:3, :3], nearest, atol=1e-6)


@both
def test_the_mean_of_one_state_is_the_state(space: StateSpace) -> None:
    state = random_states(space, 1, 5)
    np.testing.assert_allclose(space.mean(state, np.array([0.3])), state[0], atol=1e-12)


@both
def test_the_spread_is_that_of_the_noise(space: StateSpace) -> None:
    centre = random_states(space, 1, 6)[0]
    sigmas = np.linspace(0.1, 0.3, space.dimension)
    noise = sigmas * np.random.default_rng(7).standard_normal((40_000, space.dimension))
    spread = space.spread(space.moved(centre, noise))
    # The standard deviation on the circle or sphere is that on the line but for sigma^2 / 4.
    np.testing.assert_allclose(spread, sigmas, rtol=0.03)


@both
def test_the_spread_of_all_orientations_is_finite(space: StateSpace) -> None:
    spread = space.spread(random_states(space, 5000, 8))
    assert np.all(np.isfinite(spread))
    assert np.all(spread[space.positions :] <= np.pi / np.sqrt(3.0) + 1e-12)


# --- uniform states ----------------------------------------------------------------------------


@both
def test_uniform_positions_fill_the_box_and_nothing_else(space: StateSpace) -> None:
    low, high = np.array([-1.0, 2.0, 0.0])[: space.positions], np.array([3.0, 2.5, 9.0])
    high = high[: space.positions]
    states = space.uniform(low, high, 20_000, np.random.default_rng(9))
    share = (states[:, : space.positions] - low) / (high - low)
    assert share.min() >= 0.0
    assert share.max() <= 1.0
    np.testing.assert_allclose(share.mean(axis=0), 0.5, atol=0.011)
    np.testing.assert_allclose(share.var(axis=0), 1.0 / 12.0, rtol=0.04)


def test_uniform_headings_have_no_direction() -> None:
    headings = random_states(PLANAR, 20_000, 10)[:, 2]
    for order in (1, 2, 3):
        assert abs(np.exp(1j * order * headings).mean()) < 5.0 / np.sqrt(2.0 * 20_000)


def test_uniform_rotations_are_those_of_haars_measure() -> None:
    count = 20_000
    vectors = random_states(SPATIAL, count, 11)[:, 3:]
    angles = np.linalg.norm(vectors, axis=1)
    # The angle's distribution function is (angle - sin angle) / pi.
    quantiles = np.sort((angles - np.sin(angles)) / np.pi)
    distance = np.abs(quantiles - (np.arange(count) + 0.5) / count).max()
    assert distance < 1.95 / np.sqrt(count)  # Kolmogorov and Smirnov, 0.1 %
    # Every direction of the body points everywhere alike.
    matrices = Rotation.from_rotvec(vectors).as_matrix()
    assert np.abs(matrices.mean(axis=0)).max() < 5.0 / np.sqrt(3.0 * count)
    np.testing.assert_allclose((matrices**2).mean(axis=0), 1.0 / 3.0, atol=0.012)


@pytest.mark.parametrize("radius", [0.05, 0.4, 1.0])
def test_the_orientations_volume_is_in_the_measure_of_differences(radius: float) -> None:
    # Near a state, uniform orientations are as dense as 1 / volume, a cubed radian.
    share = (radius - np.sin(radius)) / np.pi
    # Haar's density falls off as 2 (1 - cos a) / a^2; within the ball it has to be integrated.
    grid = np.linspace(0.0, radius, 20_001)[1:] - radius / 40_000
    ball = np.sum(4.0 * np.pi * 2.0 * (1.0 - np.cos(grid))) * radius / 20_000
    assert ball / SPATIAL.orientation_volume() == pytest.approx(share, rel=1e-6)
    assert ball == pytest.approx(4.0 / 3.0 * np.pi * radius**3, rel=0.06 * radius**2 + 1e-6)
    assert PLANAR.orientation_volume() == pytest.approx(2.0 * np.pi)


# --- angles between states ---------------------------------------------------------------------


@both
@given(seed=seeds)
def test_pair_angles_are_those_of_the_relative_rotations(space: StateSpace, seed: int) -> None:
    states, others = random_states(space, 4, seed), random_states(space, 3, seed + 3)
    found = space.pair_angles(states, others)
    first, second = space.poses(states)[:, :3, :3], space.poses(others)[:, :3, :3]
    traces = np.einsum("aij,bij->ab", first, second)
    expected = np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0))
    assume(np.all(expected > 1e-3))
    np.testing.assert_allclose(found, expected, atol=1e-6)


# --- names and cells ---------------------------------------------------------------------------


@both
def test_spaces_are_found_by_name_and_by_dimension(space: StateSpace) -> None:
    assert state_space_named(space.name) is space
    assert state_space_of_dimension(space.dimension) is space
    assert space.positions + space.angles == space.dimension


def test_other_spaces_do_not_exist() -> None:
    with pytest.raises(OptionError, match="'flat' is none of planar, spatial"):
        state_space_named("flat")
    with pytest.raises(OptionError, match="4 numbers instead of 3"):
        state_space_of_dimension(4)


def test_cells_count_places_and_directions() -> None:
    states = np.array([[0.1, 0.1, 0.1], [0.2, 0.2, 0.1 - 2.0 * np.pi], [0.3, 0.1, 0.1]])
    cells = grid_cells(PLANAR, states, 0.25, 0.5)
    np.testing.assert_array_equal(cells, [[0, 0, 0], [0, 0, 0], [1, 0, 0]])
    vectors = np.array([[0.1] * 3 + [0.0, 0.0, 0.1], [0.1] * 3 + [0.0, 0.0, 0.1 + 2.0 * np.pi]])
    first, second = grid_cells(SPATIAL, vectors, 0.25, 0.5)
    np.testing.assert_array_equal(first, second)


@both
def test_arguments_are_left_alone(space: StateSpace) -> None:
    states, offsets = random_states(space, 3, 12), random_offsets(space, 3, 12)
    before, offsets_before = states.copy(), offsets.copy()
    space.moved(states, offsets)
    space.composed(states, offsets)
    space.difference(states, states[0])
    space.mean(states, np.ones(3))
    np.testing.assert_array_equal(states, before)
    np.testing.assert_array_equal(offsets, offsets_before)
