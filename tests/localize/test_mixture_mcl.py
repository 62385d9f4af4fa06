"""The mixture strategy in front of the wall: found, followed, carried away and found again."""

import math

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.localizer import Localizer
from pipelines.localize.run import FrameRecord
from tests.report_samples import facing_wall, photo, smooth, wall_scene
from tests.sequence_samples import (
    BLACK,
    START,
    TRUTH,
    content,
    heading_error,
    increments,
    localize_sequence,
    localizer,
    mixture_settings,
    position_error,
)


@pytest.fixture(scope="module")
def sequences() -> list[list[FrameRecord]]:
    """A sequence without a start pose, for each of a few seeds."""
    return [localize_sequence(localizer(mixture_settings(), seed)) for seed in range(5)]


@pytest.mark.parametrize("seed", range(5))
def test_the_robot_is_found_anywhere_and_tracked(
    seed: int, sequences: list[list[FrameRecord]]
) -> None:
    records = sequences[seed]
    words = [record.status for record in records]
    found = words.index("tracking")
    assert words == ["global"] * found + ["tracking"] * (len(words) - found)
    assert found <= 2
    for record, truth in zip(records[-3:], TRUTH[-3:], strict=True):
        for estimate in ("mode", "mean"):
            assert position_error(record, truth, estimate) < 0.1
            assert heading_error(record, truth, estimate) < math.radians(4.0)
    assert records[-1].confidence > 0.5
    # More hypotheses while nobody knows, the number that was asked for in the end.
    counts = [len(record.particles) for record in records]
    assert counts[0] > counts[-1]
    assert counts[-1] <= 2 * 60


def test_the_refined_estimate_is_the_finest(sequences: list[list[FrameRecord]]) -> None:
    modes, refined = [], []
    for records in sequences:
        for record, truth in zip(records[2:], TRUTH[2:], strict=True):
            modes.append(position_error(record, truth, "mode"))
            refined.append(position_error(record, truth, "refined"))
            assert record.refined_covariance is not None
            assert np.all(np.linalg.eigvalsh(record.refined_covariance) > 0.0)
    assert max(refined) < 0.02
    assert np.median(refined) < 0.5 * np.median(modes)


def test_without_a_refine_width_there_is_no_refined_estimate() -> None:
    chosen = mixture_settings(refine_width=0, estimate="mode")
    last = localize_sequence(localizer(chosen), TRUTH[:3])[-1]
    assert set(last.estimates) == {"max_weight", "mean", "mode"}
    assert last.refined_covariance is None


def test_the_refined_covariance_covers_the_error(sequences: list[list[FrameRecord]]) -> None:
    squares = []
    for records in sequences:
        for record, truth in zip(records[2:], TRUTH[2:], strict=True):
            error = record.estimates["refined"] - truth
            assert record.refined_covariance is not None
            squares.append(error @ np.linalg.solve(record.refined_covariance, error))
    # Chi-squared with three degrees of freedom: 16 is exceeded once in a thousand times.
    assert max(squares) < 16.0


@pytest.mark.parametrize("seed", range(3))
def test_a_start_pose_that_is_given_is_followed_with_the_fewest_particles(seed: int) -> None:
    records = localize_sequence(
        localizer(mixture_settings(start=START, start_position_sigma=0.2), seed)
    )
    assert {record.status for record in records} == {"tracking"}
    # It looks round at first, as far as the start pose is uncertain.
    assert max(len(record.particles) for record in records[1:]) <= 2 * 60
    assert len(records[-1].particles) == 60
    assert position_error(records[-1], TRUTH[-1], "refined") < 0.02


def test_a_robot_is_found_and_followed_before_a_wall_without_edges() -> None:
    # A step aside looks like a turn back there, and in so small images shades are faint: what is
    # not known the covariance says.
    scene = wall_scene(smooth)
    images = [photo(state, paint=smooth) for state in TRUTH]
    for seed in range(3):
        records = localize_sequence(localizer(mixture_settings(), seed, scene), images=images)
        for record, truth in zip(records[2:], TRUTH[2:], strict=True):
            assert record.status == "tracking"
            assert position_error(record, truth, "refined") < 0.05
            assert heading_error(record, truth, "refined") < math.radians(1.5)
            error = record.estimates["refined"] - truth
            assert record.refined_covariance is not None
            assert error @ np.linalg.solve(record.refined_covariance, error) < 25.0


# --- carried away ------------------------------------------------------------------------------

# After four images somebody carries the robot to where the wall looks different.
ELSEWHERE = [facing_wall(1.9 + 0.05 * i, 1.0, 0.5) for i in range(5)]
KIDNAPPED = np.array([*TRUTH[:4], *ELSEWHERE])


def kidnapped(seed: int, images_between: int = 0) -> list[FrameRecord]:
    """Odometry does not notice that the robot is carried away."""
    robot = localizer(mixture_settings(start=START, start_position_sigma=0.15), seed)
    motions = [*increments(TRUTH[:4]), np.zeros(3), *increments(np.array(ELSEWHERE))[1:]]
    records = []
    for number, (state, motion) in enumerate(zip(KIDNAPPED, motions, strict=True)):
        if number == 4:
            records += [robot.step(BLACK, np.zeros(3)) for _ in range(images_between)]
        records.append(robot.step(photo(state), motion, float(number)))
    return records


@pytest.mark.parametrize("seed", range(4))
def test_a_kidnapped_robot_is_found_again_within_a_few_frames(seed: int) -> None:
    records = kidnapped(seed)
    assert records[3].status == "tracking"
    assert position_error(records[3], TRUTH[3]) < 0.2
    for record, truth in zip(records[-2:], ELSEWHERE[-2:], strict=True):
        assert record.status == "tracking"
        assert position_error(record, truth, "refined") < 0.05
        assert heading_error(record, truth, "refined") < math.radians(1.0)


def test_a_robot_that_is_carried_away_behind_a_covered_lens_is_found_again() -> None:
    for seed in range(2):
        records = kidnapped(seed, images_between=2)
        assert [record.status for record in records[4:6]] == ["blind"] * 2
        assert position_error(records[-1], ELSEWHERE[-1], "refined") < 0.05


def test_steady_images_do_not_make_it_look_everywhere() -> None:
    records = localize_sequence(localizer(mixture_settings(start=START), 0))
    assert max(len(record.particles) for record in records[1:]) <= 2 * 60


# --- odometry that errs in the same way all the time -------------------------------------------


def errors_of_prediction(record: FrameRecord, before: FrameRecord, motion: FloatArray) -> float:
    """Metres between the refined estimate and what this motion from the last one predicts."""
    state = before.estimates["refined"]
    cosine, sine = np.cos(state[2]), np.sin(state[2])
    moved = state[:2] + np.array([[cosine, -sine], [sine, cosine]]) @ motion[:2]
    return float(np.hypot(*(record.estimates["refined"][:2] - moved)))


def test_particles_follow_a_robot_whose_wheels_are_worn() -> None:
    # The robot drives along the wall; odometry says a third too much.
    truth = np.array([facing_wall(-1.4 + 0.15 * i, 1.6) for i in range(18)])
    motions = [motion * [1.33, 1.33, 1.0] for motion in increments(truth)]
    chosen = mixture_settings(start=tuple(map(float, truth[0])), start_position_sigma=0.05)
    too_far = []
    for seed in range(5):
        robot = localizer(chosen, seed)
        records = [
            robot.step(photo(state), motion) for state, motion in zip(truth, motions, strict=True)
        ]
        assert {record.status for record in records} == {"tracking"}
        # A black image shows where odometry alone would take the robot.
        blind = robot.step(BLACK, motions[-1])
        assert blind.status == "blind"
        moved = blind.estimates["mean"] - records[-1].estimates["mean"]
        too_far.append(float(moved[0]) - 0.15)
        raw = errors_of_prediction(records[-1], records[-2], motions[-1])
        assert raw == pytest.approx(0.05, abs=0.01)
    # By odometry alone it would be 5 cm too far.
    assert abs(np.median(too_far)) < 0.02


# --- without odometry --------------------------------------------------------------------------


def walked(robot: Localizer, truth: FloatArray, largest_error: float) -> FrameRecord:
    """The record of the last image of a robot that is followed by its images alone."""
    for state in truth:
        record = robot.step(photo(state))
        assert record.status == "tracking"
        assert position_error(record, state, "refined") < largest_error
    return record


def test_without_odometry_a_steady_motion_faster_than_the_random_walk_is_followed() -> None:
    # 0.3 m from image to image: two standard deviations of the walk, each time in the same way.
    truth = np.array([facing_wall(-1.5 + 0.3 * i, 1.7) for i in range(10)])
    chosen = mixture_settings(start=tuple(map(float, truth[0])), start_position_sigma=0.05)
    for seed in range(3):
        robot = localizer(chosen, seed)
        record = walked(robot, truth, 0.02)
        # Behind a covered lens it goes on as it did.
        blind = robot.step(BLACK)
        moved = blind.estimates["mode"] - record.estimates["refined"]
        np.testing.assert_allclose(moved[:2], [0.3, 0.0], atol=0.12)


def test_a_prediction_that_is_off_does_not_make_an_image_count_less() -> None:
    """Back and forth: the speed so far is wrong every time, and the image alone is right."""
    truth = np.array([facing_wall(-0.5 + 0.12 * (i % 2), 1.7) for i in range(8)])
    chosen = mixture_settings(start=tuple(map(float, truth[0])), start_position_sigma=0.05)
    for seed in range(2):
        walked(localizer(chosen, seed), truth, 0.015)


# --- repeatable --------------------------------------------------------------------------------


def test_a_kidnapped_robot_gives_the_same_bytes_with_any_number_of_threads() -> None:
    runs = []
    for threads in (1, 2, 3):
        robot = localizer(mixture_settings(start=START, threads=threads), 3)
        images = [photo(state) for state in KIDNAPPED[:6]]
        runs.append([content(robot.step(image, np.zeros(3))) for image in images])
    assert runs[0] == runs[1] == runs[2]
