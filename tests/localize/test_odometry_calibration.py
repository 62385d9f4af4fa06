"""What the filter learns: the systematic error of odometry, its noise."""

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.odometry_calibration import OdometryCalibration, uncalibrated
from pipelines.localize.state_space import PLANAR


def drive(
    calibration: OdometryCalibration,
    motions: FloatArray,
    true_motion: FloatArray,
    noise: float = 0.0,
    surprise: float = 1.0,
) -> OdometryCalibration:
    """Learns from motions whose true counterpart is ``true_motion @ motion``, measured noisily."""
    rng = np.random.default_rng(0)
    for motion in motions:
        estimated = true_motion @ motion + noise * rng.standard_normal(len(motion))
        calibration = calibration.learned(motion, estimated - motion, surprise)
    return calibration


def steps(count: int, seed: int = 1) -> FloatArray:
    """Motions of a robot that drives forward and turns by and by."""
    rng = np.random.default_rng(seed)
    return np.stack(
        [rng.uniform(0.1, 0.3, count), np.zeros(count), rng.uniform(-0.2, 0.2, count)], axis=1
    )


def test_nothing_is_corrected_before_anything_is_known() -> None:
    motion = np.array([0.2, 0.0, 0.1])
    np.testing.assert_array_equal(uncalibrated(3).corrected(motion), motion)
    assert uncalibrated(6).noise_scale == 1.0


# Wheels that are ten percent too small; a gyroscope that drifts with the way driven; both.
SHRUNK = np.diag([1.1, 1.1, 1.0])
DRIFTING = np.eye(3) + np.array([[0.0] * 3, [0.0] * 3, [0.15, 0.0, 0.0]])


@pytest.mark.parametrize("true_motion", [SHRUNK, DRIFTING, SHRUNK @ DRIFTING])
def test_a_systematic_error_is_learned_and_taken_off(true_motion: FloatArray) -> None:
    calibration = drive(uncalibrated(3), steps(40), true_motion, noise=0.01)
    for motion in steps(10, seed=2):
        true = true_motion @ motion
        left = calibration.corrected(motion) - true
        # What is left is a fraction of what odometry would err.
        assert np.linalg.norm(left) < 0.35 * np.linalg.norm(motion - true) + 0.004


def test_learning_takes_some_frames_and_does_not_overshoot() -> None:
    motion = np.array([0.2, 0.0, 0.0])
    calibration, lengths = uncalibrated(3), []
    for _ in range(30):
        lengths.append(float(calibration.corrected(motion)[0]))
        calibration = calibration.learned(motion, np.array([0.02, 0.0, 0.0]), 1.0)
    assert lengths[0] == pytest.approx(0.2)
    assert lengths == sorted(lengths)
    assert lengths[1] < 0.215
    assert 0.215 < lengths[-1] <= 0.22 + 1e-9


def test_errors_at_random_are_not_taken_for_systematic_ones() -> None:
    calibration = drive(uncalibrated(3), steps(60), np.eye(3), noise=0.01)
    motion = np.array([0.2, 0.0, 0.0])
    assert np.linalg.norm(calibration.corrected(motion) - motion) < 0.01


def test_what_was_learned_is_forgotten_when_it_no_longer_holds() -> None:
    calibration = drive(uncalibrated(3), steps(40), SHRUNK)
    calibration = drive(calibration, steps(120, seed=4), np.eye(3))
    motion = np.array([0.2, 0.0, 0.0])
    assert abs(calibration.corrected(motion)[0] - 0.2) < 0.002


def test_standing_still_teaches_nothing() -> None:
    calibration = drive(uncalibrated(3), np.zeros((50, 3)), np.eye(3), noise=0.02)
    motion = np.array([0.2, 0.0, 0.1])
    np.testing.assert_allclose(calibration.corrected(motion), motion, atol=1e-12)


def test_the_noise_goes_up_with_surprises_and_down_without() -> None:
    motion, nothing = np.array([0.2, 0.0, 0.0]), np.zeros(3)
    up = down = uncalibrated(3)
    ups, downs = [1.0], [1.0]
    for _ in range(40):
        up, down = up.learned(motion, nothing, 4.0), down.learned(motion, nothing, 0.5)
        ups.append(up.noise_scale)
        downs.append(down.noise_scale)
    assert ups == sorted(ups)
    assert downs == sorted(downs, reverse=True)
    # A surprise is a squared ratio: 4 means twice as much noise as was expected.
    assert ups[-1] == pytest.approx(2.0, abs=0.02)
    assert downs[-1] == pytest.approx(np.sqrt(0.5), abs=0.02)


@pytest.mark.parametrize("surprise", [0.0, 1e9])
def test_the_noise_stays_in_its_bounds(surprise: float) -> None:
    calibration = drive(uncalibrated(3), steps(200), np.eye(3), surprise=surprise)
    assert 0.2 < calibration.noise_scale < 5.0


def test_learning_changes_nothing_in_place() -> None:
    first = uncalibrated(PLANAR.dimension)
    first.learned(np.ones(3), np.ones(3), 2.0)
    np.testing.assert_array_equal(first.information, 0.0)
    np.testing.assert_array_equal(first.moments, 0.0)


def test_a_jump_to_another_place_teaches_nothing_about_the_wheels() -> None:
    motion = np.array([0.0, 0.0, 0.5])
    calibration = uncalibrated(3)
    for _ in range(5):
        calibration = calibration.learned(motion, np.array([0.0, 0.0, 0.05]), 1.0)
    jumped = calibration.learned(motion, np.array([2.0, 1.0, 0.3]), 900.0)
    np.testing.assert_array_equal(jumped.correction, calibration.correction)
    assert jumped.noise_scale > calibration.noise_scale
