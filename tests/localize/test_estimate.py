"""Estimates: the circle of the headings, modes."""

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.pose import wrap_angle
from pipelines.localize.belief import (
    Belief,
    gaussian_belief,
    normalise_log_weights,
    region_of_area,
    uniform_belief,
)
from pipelines.localize.estimate import (
    find_modes,
    max_weight_state,
    mean_state,
    modes_table,
    state_covariance,
)
from pipelines.localize.state_space import PLANAR, SPATIAL
from tests.localize_samples import weighted

LOBBY = region_of_area((-5.0, 5.0, -5.0, 0.0))


def rotated_headings(belief: Belief, angle: float) -> Belief:
    states = belief.states.copy()
    states[:, 2] = wrap_angle(states[:, 2] + angle)
    return Belief(states, belief.log_weights)


def mixture(parts: list[tuple[FloatArray, float]], count: int, seed: int = 0) -> Belief:
    """Particles of equal number around each centre, sharing the weights given."""
    rng = np.random.default_rng(seed)
    beliefs = [gaussian_belief(PLANAR, centre, 0.1, 0.05, count, rng) for centre, _ in parts]
    shares = np.repeat([share for _, share in parts], count)
    log_weights, _ = normalise_log_weights(np.log(shares))
    return Belief(np.concatenate([belief.states for belief in beliefs]), log_weights)


def test_the_heaviest_particle_is_the_papers_estimate() -> None:
    belief = weighted([[0, 0, 0], [1, 2, 3], [4, 5, -1]], [0.3, 0.4, 0.3])
    np.testing.assert_array_equal(max_weight_state(belief), [1.0, 2.0, 3.0])


def test_weighted_mean_by_hand() -> None:
    belief = weighted([[0, 0, np.pi - 0.1], [4, 8, -np.pi + 0.3]], [0.5, 0.5])
    np.testing.assert_allclose(mean_state(belief), [2.0, 4.0, -np.pi + 0.1], atol=1e-12)
    belief = weighted([[0, 0, 0.2], [4, 8, 0.2]], [0.25, 0.75])
    np.testing.assert_allclose(mean_state(belief), [3.0, 6.0, 0.2], atol=1e-12)


@given(st.floats(-10.0, 10.0), st.integers(0, 2**32), st.floats(0.01, 0.5))
def test_mean_and_covariance_turn_with_the_headings(angle: float, seed: int, spread: float) -> None:
    belief = gaussian_belief(PLANAR, (1.0, -2.0, 0.3), 0.2, spread, 60, np.random.default_rng(seed))
    turned = rotated_headings(belief, angle)
    mean, turned_mean = mean_state(belief), mean_state(turned)
    assert abs(float(wrap_angle(turned_mean[2] - mean[2] - angle))) < 1e-9
    assert -np.pi < turned_mean[2] <= np.pi
    np.testing.assert_allclose(
        state_covariance(PLANAR, turned.states, turned.weights, turned_mean),
        state_covariance(PLANAR, belief.states, belief.weights, mean),
        atol=1e-9,
    )


def test_opposite_headings_have_no_mean_and_the_heavier_stands() -> None:
    belief = weighted([[0, 0, 0.0], [0, 0, np.pi]], [0.5, 0.5])
    assert mean_state(belief)[2] == 0.0


def test_covariance_of_a_cluster_across_the_jump_is_that_of_its_spread() -> None:
    belief = gaussian_belief(PLANAR, (0.0, 0.0, np.pi), 0.2, 0.1, 20000, np.random.default_rng(1))
    (mode,) = find_modes(belief)
    assert mode.share == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(mode.covariance, np.diag([0.04, 0.04, 0.01]), atol=2e-3)
    np.testing.assert_array_equal(mode.covariance, mode.covariance.T)
    assert abs(float(wrap_angle(mode.state[2] - np.pi))) < 0.01


def test_two_equal_doors_are_two_modes_and_not_their_mean() -> None:
    doors: list[FloatArray] = [np.array([-2.0, -3.0, 1.5]), np.array([2.0, -3.0, 1.5])]
    belief = mixture([(doors[0], 1.0), (doors[1], 1.0)], 300)
    modes = find_modes(belief)
    assert len(modes) == 2
    for mode in modes:
        assert mode.share == pytest.approx(0.5)
        distance = min(float(np.linalg.norm(mode.state - door)) for door in doors)
        assert distance < 0.03
    # The mean of the two is a place where no particle is.
    gap = np.linalg.norm(belief.states - mean_state(belief), axis=1)
    assert gap.min() > 1.0


def test_modes_come_heaviest_first_with_their_shares() -> None:
    centres: list[FloatArray] = [np.array([x, 0.0, -np.pi]) for x in (0.0, 3.0, 6.0)]
    belief = mixture(list(zip(centres, (0.2, 0.5, 0.3), strict=True)), 200)
    modes = find_modes(belief)
    table = modes_table(modes)
    np.testing.assert_allclose(table[:, 3], [0.5, 0.3, 0.2], atol=1e-9)
    np.testing.assert_allclose(table[:, 0], [3.0, 6.0, 0.0], atol=0.05)
    members = np.concatenate([mode.members for mode in modes])
    assert sorted(members.tolist()) == list(range(600))


def test_same_place_opposite_headings_are_two_modes() -> None:
    pair: list[tuple[FloatArray, float]] = [
        (np.array([0.0, 0.0, 0.0]), 1.0),
        (np.array([0.0, 0.0, np.pi]), 1.0),
    ]
    assert len(find_modes(mixture(pair, 200))) == 2


@given(st.floats(-4.0, 4.0), st.floats(-20.0, 20.0), st.integers(0, 1000))
def test_a_cluster_is_one_mode_wherever_it_lies(angle: float, shift: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    belief = gaussian_belief(PLANAR, (shift, -shift, angle), 0.08, 0.04, 195, rng)
    modes = find_modes(belief)
    assert len(modes) == 1
    np.testing.assert_allclose(modes[0].state, mean_state(belief), atol=1e-9)


def test_chance_dips_in_a_broad_cluster_do_not_split_it() -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        modes = find_modes(gaussian_belief(PLANAR, (0.0, 0.0, 0.0), 1.0, 0.5, 1000, rng))
        assert modes[0].share > 0.95


def test_a_light_background_does_not_blur_the_peaks() -> None:
    belief = uniform_belief(PLANAR, LOBBY, 20000, np.random.default_rng(2))
    doors = np.array([[-2.5, -3.0], [0.0, -3.0], [2.5, -3.0]])
    offsets = belief.states[:, None, :2] - doors
    squared = np.sum(offsets**2, axis=2) / 0.2**2
    misfit = 0.5 * np.min(squared, axis=1) + 0.5 * (belief.states[:, 2] - 1.5) ** 2 / 0.15**2
    log_weights, _ = normalise_log_weights(-np.minimum(misfit, 10.0))
    modes = find_modes(Belief(belief.states, log_weights), minimum_share=0.1)
    found = sorted(float(mode.state[0]) for mode in modes)
    assert found == pytest.approx([-2.5, 0.0, 2.5], abs=0.2)


def test_one_particle_takes_all_is_one_mode_without_spread() -> None:
    states = np.random.default_rng(3).random((50, 3))
    with np.errstate(divide="ignore"):
        log_weights = np.log(np.eye(50)[7])
    (mode,) = find_modes(Belief(states, log_weights))
    assert mode.share == 1.0
    np.testing.assert_allclose(mode.state, states[7], atol=1e-12)
    np.testing.assert_array_equal(mode.covariance, 0.0)
    np.testing.assert_array_equal(mode.members, [7])


def test_the_heaviest_mode_is_kept_even_if_it_is_light() -> None:
    belief = uniform_belief(
        PLANAR, region_of_area((-100, 100, -100, 100)), 3000, np.random.default_rng(4)
    )
    modes = find_modes(belief, minimum_share=0.5)
    assert len(modes) == 1
    assert modes[0].share < 0.1


def test_twenty_thousand_particles_take_little_time_and_the_order_does_not_matter() -> None:
    belief = uniform_belief(PLANAR, LOBBY, 20000, np.random.default_rng(5))
    start = time.process_time()
    modes = find_modes(belief)
    assert time.process_time() - start < 1.0
    order = np.random.default_rng(6).permutation(20000)
    shuffled = find_modes(Belief(belief.states[order], belief.log_weights[order]))
    np.testing.assert_allclose(modes_table(shuffled), modes_table(modes), atol=1e-9)


@pytest.mark.parametrize("bandwidth", [0.0, -1.0, np.nan, np.inf])
def test_impossible_bandwidths_are_refused(bandwidth: float) -> None:
    belief = weighted([[0, 0, 0]], [1.0])
    with pytest.raises(OptionError, match="position bandwidth"):
        find_modes(belief, position_bandwidth=bandwidth)
    with pytest.raises(OptionError, match="heading bandwidth"):
        find_modes(belief, heading_bandwidth=bandwidth)


def test_particles_too_far_apart_for_the_bandwidth_are_refused() -> None:
    with pytest.raises(OptionError, match="spread"):
        find_modes(weighted([[0, 0, 0], [1e12, 0, 0]], [1.0, 1.0]))


# --- six degrees of freedom --------------------------------------------------------------------


def clumps(centres: list[FloatArray], counts: list[int]) -> Belief:
    """Equally weighted particles close around poses."""
    rng = np.random.default_rng(9)
    states = [
        SPATIAL.moved(centre, 0.05 * rng.standard_normal((count, 6)))
        for centre, count in zip(centres, counts, strict=True)
    ]
    total = sum(counts)
    return Belief(np.concatenate(states), np.full(total, -np.log(total)))


POSE: FloatArray = np.array([1.0, -2.0, 0.5, 0.3, -0.8, 1.9])


@pytest.mark.parametrize(
    "offset",
    [[1.5, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 1.5]],
    ids=["another place", "another direction"],
)
def test_two_clumps_of_poses_are_two_modes(offset: list[float]) -> None:
    other = SPATIAL.moved(POSE, np.array(offset))
    modes = find_modes(clumps([POSE, other], [300, 100]))
    assert [mode.share for mode in modes] == pytest.approx([0.75, 0.25])
    for mode, centre in zip(modes, (POSE, other), strict=True):
        assert np.linalg.norm(SPATIAL.difference(mode.state, centre)) < 0.03
        np.testing.assert_allclose(np.diag(mode.covariance), 0.05**2, rtol=0.5)
    assert sorted(np.concatenate([mode.members for mode in modes])) == list(range(400))
    assert modes_table(modes).shape == (2, 7)


def test_a_clump_of_poses_is_one_mode_across_the_jump_of_the_rotation_vector() -> None:
    # Half a turn: the vector of one particle points up, that of its neighbour down.
    centre = np.array([0.0, 0.0, 1.0, 0.0, 0.0, np.pi])
    belief = clumps([centre], [300])
    assert belief.states[:, 5].min() < -3.0 < 3.0 < belief.states[:, 5].max()
    (mode,) = find_modes(belief)
    assert mode.share == pytest.approx(1.0)
    assert np.linalg.norm(SPATIAL.difference(mode.state, centre)) < 0.03


def test_poses_without_weight_take_part_in_no_mode() -> None:
    belief = clumps([POSE, POSE + 0.9], [50, 50])
    weights = np.where(np.arange(100) < 50, 1.0, 0.0)
    modes = find_modes(weighted(belief.states.tolist(), weights.tolist()))
    assert len(modes) == 1
    np.testing.assert_array_equal(np.sort(modes[0].members), np.arange(50))
