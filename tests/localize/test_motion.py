"""The motion model: composition, increments, moments of the noise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipelines.artifacts.errors import OptionError
from pipelines.geometry.pose import inverse, planar_state_of, world_from_base_planar, wrap_angle
from pipelines.localize.motion import checked_increment, predict
from pipelines.localize.settings import MotionModel
from pipelines.localize.state_space import PLANAR, SPATIAL

EXACT = MotionModel(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
places = st.floats(-50.0, 50.0)
angles = st.floats(-np.pi, np.pi)
planar = st.tuples(places, places, angles)


@given(planar, planar)
def test_the_increment_is_the_relative_pose(
    a: tuple[float, float, float], b: tuple[float, float, float]
) -> None:
    pose_a, pose_b = world_from_base_planar(a), world_from_base_planar(b)
    increment = PLANAR.increment(pose_a, pose_b)
    # Matrices are the independent truth: the pose of b seen from a.
    relative = planar_state_of(inverse(pose_a) @ pose_b)
    np.testing.assert_allclose(increment[:2], relative[:2], atol=1e-9)
    assert abs(float(wrap_angle(increment[2] - relative[2]))) < 1e-9
    assert -np.pi < increment[2] <= np.pi


@given(planar, planar, planar)
def test_without_noise_prediction_is_exact_composition(
    state: tuple[float, float, float],
    a: tuple[float, float, float],
    b: tuple[float, float, float],
) -> None:
    pose_a, pose_b = world_from_base_planar(a), world_from_base_planar(b)
    states = np.array([state, (1.0, 2.0, 3.0)])
    moved = predict(
        PLANAR, states, PLANAR.increment(pose_a, pose_b), EXACT, np.random.default_rng(0)
    )
    expected = planar_state_of(world_from_base_planar(states) @ inverse(pose_a) @ pose_b)
    np.testing.assert_allclose(moved[:, :2], expected[:, :2], atol=1e-9)
    np.testing.assert_allclose(wrap_angle(moved[:, 2] - expected[:, 2]), 0.0, atol=1e-9)
    assert np.all((moved[:, 2] > -np.pi) & (moved[:, 2] <= np.pi))


def test_a_tilted_odometry_pose_counts_by_its_ground_track() -> None:
    angle = 0.2
    tilt = np.eye(4)
    tilt[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    before = world_from_base_planar((1.0, 1.0, np.pi / 2.0)) @ tilt
    after = world_from_base_planar((1.0, 3.0, np.pi / 2.0)) @ tilt
    np.testing.assert_allclose(PLANAR.increment(before, after), [2.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    "increment", [(0.8, 0.0, 0.0), (0.3, -0.6, 0.4), (0.0, 0.0, -1.2), (0.0, 0.0, 0.0)]
)
@pytest.mark.parametrize("scale", [1.0, 2.5])
def test_noise_has_the_moments_of_the_model(
    increment: tuple[float, float, float], scale: float
) -> None:
    model = MotionModel(0.03, 0.02, 0.05, 0.01, 0.02, 0.01)
    count = 200_000
    heading = 2.0
    states = np.tile([3.0, -1.0, heading], (count, 1))
    moved = predict(PLANAR, states, np.array(increment), model, np.random.default_rng(5), scale)
    dx, dy, turn = increment
    driven = dx * dx + dy * dy
    position_variance = scale**2 * (0.05 * driven + 0.01 * turn**2 + 0.02**2)
    heading_variance = scale**2 * (0.03 * turn**2 + 0.02 * driven + 0.01**2)
    cosine, sine = np.cos(heading), np.sin(heading)
    expected = [3.0 + cosine * dx - sine * dy, -1.0 + sine * dx + cosine * dy, heading + turn]
    deviation = moved - expected
    deviation[:, 2] = wrap_angle(deviation[:, 2])
    covariance = np.cov(deviation.T)
    variances = np.array([position_variance, position_variance, heading_variance])
    # Five standard errors of a mean and of a variance.
    assert np.all(np.abs(deviation.mean(axis=0)) < 5.0 * np.sqrt(variances / count))
    np.testing.assert_allclose(np.diag(covariance), variances, rtol=5.0 * np.sqrt(2.0 / count))
    limits = 5.0 * np.sqrt(np.outer(variances, variances) / count)
    off_diagonal = ~np.eye(3, dtype=bool)
    assert np.all(np.abs(covariance)[off_diagonal] < limits[off_diagonal])


def test_particles_are_not_changed_in_place_and_draws_are_seeded() -> None:
    states = np.zeros((4, 3))
    first = predict(
        PLANAR, states, np.array([0.1, 0.0, 0.1]), MotionModel(), np.random.default_rng(1)
    )
    second = predict(
        PLANAR, states, np.array([0.1, 0.0, 0.1]), MotionModel(), np.random.default_rng(1)
    )
    assert first.tobytes() == second.tobytes()
    assert not np.any(states)
    assert len(np.unique(first[:, 0])) == 4


def test_noise_only_where_there_is_a_cause() -> None:
    only_driving = MotionModel(0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
    assert only_driving.standard_deviations(PLANAR, np.array([0.0, 0.0, 1.0])) == (0.0, 0.0)
    position, heading = only_driving.standard_deviations(PLANAR, np.array([3.0, 4.0, 0.0]))
    assert position == pytest.approx(5.0 * np.sqrt(0.1))
    assert heading == 0.0


@pytest.mark.parametrize("name", ["alpha1", "alpha2", "alpha3", "alpha4", "position_floor"])
@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf])
def test_impossible_noise_is_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(OptionError, match=name):
        MotionModel(**{name: value})


def test_impossible_increments_and_scales_are_refused() -> None:
    states, rng = np.zeros((1, 3)), np.random.default_rng(0)
    for increment in ([np.nan, 0.0, 0.0], [0.0, np.inf, 0.0], [0.0, 0.0]):
        with pytest.raises(OptionError, match="increment"):
            predict(PLANAR, states, np.array(increment), MotionModel(), rng)
    for scale in (-1.0, np.nan, np.inf):
        with pytest.raises(OptionError, match="scale"):
            predict(PLANAR, states, np.zeros(3), MotionModel(), rng, scale)
    with pytest.raises(OptionError, match="odometry increment"):
        checked_increment(PLANAR, PLANAR.increment(np.eye(4), np.full((4, 4), np.nan)))


def test_a_motion_that_nobody_measured_is_a_random_walk() -> None:
    model = MotionModel(walk_position=0.3, walk_heading=0.2)
    count = 100_000
    for space in (PLANAR, SPATIAL):
        states = np.zeros((count, space.dimension))
        moved = predict(space, states, None, model, np.random.default_rng(6))
        sigmas = np.array([0.3] * space.positions + [0.2] * space.angles)
        assert np.all(np.abs(moved.mean(axis=0)) < 5.0 * sigmas / np.sqrt(count))
        np.testing.assert_allclose(moved.std(axis=0), sigmas, rtol=5.0 / np.sqrt(2.0 * count))


def test_six_degrees_of_freedom_have_the_same_noise_along_and_about_all_axes() -> None:
    model, count = MotionModel(0.03, 0.02, 0.05, 0.01, 0.02, 0.01), 100_000
    increment = np.array([0.3, -0.4, 0.0, 0.0, 0.2, 0.0])
    before = np.array([1.0, 2.0, 3.0, 0.3, -0.4, 1.0])
    states = np.tile(before, (count, 1))
    moved = predict(SPATIAL, states, increment, model, np.random.default_rng(7))
    # In the body's frame before the motion, where noise and motion are defined.
    own = SPATIAL.states(inverse(SPATIAL.poses(before)) @ SPATIAL.poses(moved))
    deviation = own - increment
    position = np.sqrt(0.05 * 0.25 + 0.01 * 0.04 + 0.02**2)
    angle = np.sqrt(0.03 * 0.04 + 0.02 * 0.25 + 0.01**2)
    sigmas = np.array([position] * 3 + [angle] * 3)
    assert np.all(np.abs(deviation.mean(axis=0)) < 5.0 * sigmas / np.sqrt(count))
    np.testing.assert_allclose(deviation.std(axis=0), sigmas, rtol=5.0 / np.sqrt(2.0 * count))


def test_composition_broadcasts_and_wraps() -> None:
    states = PLANAR.composed(
        np.array([0.0, 0.0, np.pi]), np.array([[1.0, 0.0, 0.1], [0.0, 1.0, -0.1]])
    )
    np.testing.assert_allclose(states[:, :2], [[-1.0, 0.0], [0.0, -1.0]], atol=1e-12)
    np.testing.assert_allclose(states[:, 2], [-np.pi + 0.1, np.pi - 0.1])
