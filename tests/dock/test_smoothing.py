"""Estimates smoothed by odometry are more accurate than each of them alone."""

import math

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.planar_motion import moved, movement_between
from pipelines.dock.pose_estimate import PoseEstimate
from pipelines.dock.robot import STANDSTILL, Movement
from pipelines.dock.smoothing import Smoother

SIGMAS = np.array([0.03, 0.03, math.radians(1.0)])


def estimate(state: FloatArray, *, refined: bool = True, localized: bool = True) -> PoseEstimate:
    modes = np.array([[*state, 1.0]])
    return PoseEstimate(state, np.diag(SIGMAS**2), modes, refined, localized, False, refined)


def approach_errors(seed: int, scale: float) -> tuple[float, float]:
    """Mean square errors (m^2) of raw and smoothed estimates over an approach in steps of 20 cm."""
    rng = np.random.default_rng(seed)
    smoother, state = Smoother(), np.array([0.0, -3.0, math.pi / 2.0])
    measured, raw, smooth = STANDSTILL, [], []
    for _ in range(12):
        measured_state = state + SIGMAS * rng.standard_normal(3)
        better = smoother(estimate(measured_state), measured)
        raw.append(np.sum((measured_state - state)[:2] ** 2))
        smooth.append(np.sum((better.state - state)[:2] ** 2))
        command = Movement(0.2, 0.0, 0.0)
        state = moved(state, command)
        measured = Movement(
            scale * 0.2 * (1.0 + 0.02 * rng.standard_normal()),
            0.0,
            math.radians(0.5) * rng.standard_normal(),
        )
    return float(np.mean(raw[4:])), float(np.mean(smooth[4:]))


def test_smoothed_estimates_are_more_accurate_even_with_odometry_of_wrong_scale() -> None:
    for scale in (1.0, 1.15):
        errors = np.mean([approach_errors(seed, scale) for seed in range(30)], axis=0)
        assert errors[1] < 0.6 * errors[0]


def test_repeating_one_image_does_not_shrink_the_covariance() -> None:
    smoother = Smoother()
    start = np.array([1.0, -2.0, 1.5])
    first = smoother(estimate(start), STANDSTILL)
    wrong = start + np.array([0.03, 0.0, 0.0])
    for _ in range(5):
        last = smoother(estimate(wrong), STANDSTILL)
    assert last.state[0] < wrong[0] - 0.01
    assert np.trace(last.covariance) > 0.4 * np.trace(first.covariance)


def test_another_place_resets_the_filter() -> None:
    smoother = Smoother()
    smoother(estimate(np.array([0.0, -2.0, 1.5])), STANDSTILL)
    there = np.array([2.0, -2.0, 1.5])
    np.testing.assert_array_equal(smoother(estimate(there), Movement(0.1)).state, there)


def test_an_estimate_not_localized_resets_the_filter() -> None:
    smoother = Smoother()
    smoother(estimate(np.array([0.0, -2.0, 1.5])), STANDSTILL)
    unsure = estimate(np.array([0.05, -2.0, 1.5]), localized=False)
    assert smoother(unsure, STANDSTILL) is unsure
    after = estimate(np.array([0.02, -2.0, 1.5]))
    np.testing.assert_array_equal(smoother(after, STANDSTILL).state, after.state)


def test_movements_between_states_undo_moving() -> None:
    before = np.array([0.3, -1.0, 3.0])
    movement = Movement(0.2, -0.1, 0.5)
    again = movement_between(before, moved(before, movement))
    np.testing.assert_allclose(again.vector(), movement.vector(), atol=1e-12)
