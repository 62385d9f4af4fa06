"""What a run came to, against figures computed by hand."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from pipelines.experiments.sweep_result import RunResult, judged
from pipelines.localize.run import FrameRecord, Run
from tests.report_samples import TRUTH, wall_run


def long_run(offsets: Sequence[float | None]) -> Run:
    """Frames whose one estimate is so many metres beside the truth; None: lost."""
    usual, lost = wall_run(statuses="tlllll").frames[:2]
    truth = np.resize(TRUTH, (len(offsets), 3))

    def frame(number: int, offset: float | None) -> FrameRecord:
        if offset is None:
            return replace(lost, timestamp=float(number))
        estimate = truth[number] + np.array([offset, 0.0, 0.0])
        return replace(usual, timestamp=float(number), estimates={"mode": estimate})

    frames = tuple(frame(number, offset) for number, offset in enumerate(offsets))
    images = (wall_run().encoded_images[0],) * len(frames)
    return replace(wall_run(odometry=None), frames=frames, groundtruth=truth, encoded_images=images)


def result(offsets: Sequence[float | None]) -> RunResult:
    return judged(long_run(offsets), 3.0)


def test_a_drive_has_settled_from_the_fifth_frame_on() -> None:
    found = result([3.0, 3.0, 3.0, 3.0, 0.01, 0.02, 0.03])
    assert found.settled_position_error_m == pytest.approx(0.02)
    assert found.median_position_error_m == pytest.approx(3.0)
    assert found.settled_heading_error_deg == pytest.approx(0.0)
    assert result([0.1] * 4).settled_position_error_m is None


def test_frames_without_an_estimate_are_infinitely_wrong() -> None:
    assert result([0.0] * 4 + [0.01, None, None]).settled_position_error_m is None
    assert result([0.0] * 4 + [0.01, 0.02, None]).settled_position_error_m == pytest.approx(0.02)


def test_a_robot_that_was_lost_is_found_again_or_not() -> None:
    found = result([2.0, 0.0, 0.0, 2.0, 0.0, 2.0, None, 2.0, 0.0])
    assert (found.frames_until_converged, found.frames_to_recover) == (8, 3)
    never_lost = result([2.0, 2.0, 0.0, 0.0])
    assert (never_lost.frames_until_converged, never_lost.frames_to_recover) == (2, 0)
    gone = result([0.0, 2.0, 0.0, 2.0])
    assert (gone.frames_until_converged, gone.frames_to_recover) == (None, None)
    nowhere = result([None] * 6)
    assert (nowhere.success, nowhere.frames_to_recover, nowhere.frames) == (False, None, 6)
    assert nowhere.close_share is None


def test_close_counts_from_the_eleventh_frame_on() -> None:
    found = result([5.0] * 10 + [0.09, 0.11, None, 0.0])
    assert found.close_share == pytest.approx(0.5)
    assert result([0.0] * 10).close_share is None


def test_confidence_where_images_show_nothing_stands_apart() -> None:
    run = wall_run(statuses="gtbbtt")
    confidences = (0.2, 0.7, 0.01, 0.03, 0.8, 0.9)
    frames = tuple(
        replace(frame, confidence=confidence)
        for frame, confidence in zip(run.frames, confidences, strict=True)
    )
    found = judged(replace(run, frames=frames), 3.0)
    assert (found.frames_blind, found.confidence_blind) == (2, 0.03)
    assert found.confidence == pytest.approx(0.75)
    seeing = judged(wall_run(), 3.0)
    assert (seeing.frames_blind, seeing.confidence_blind) == (0, None)


def test_frames_are_right_silent_or_wrong() -> None:
    found = result([5.0, 0.2, 0.05, None, 0.05, 0.05])
    assert (found.frames_right, found.frames_silent, found.frames_wrong) == (4, 1, 1)
    assert found.wrong_at_the_end
    assert not result([5.0] + [0.05] * 10).wrong_at_the_end
    counts, totals, hits = np.array(found.confidence_sums).T
    # Lost frames say 0.1, the others 0.9; three are within 10 cm.
    assert counts.tolist() == [0, 1, 0, 0, 0, 0, 0, 0, 0, 5]
    assert totals[[1, 9]] == pytest.approx([0.1, 4.5])
    assert hits.tolist() == [0] * 9 + [3]


def test_the_first_frame_is_a_search_unless_the_start_was_known() -> None:
    run = wall_run(statuses="ttgttl")
    frames = tuple(
        replace(frame, seconds={"filter": seconds})
        for frame, seconds in zip(run.frames, (8.0, 1.0, 4.0, 2.0, 3.0, 9.0), strict=True)
    )
    found = judged(replace(run, frames=frames), 3.0)
    assert (found.seconds_while_searching, found.seconds_while_tracking) == (6.0, 2.0)
    assert (found.seconds_per_frame, found.cpu_seconds_per_frame) == (4.5, 0.5)
    given = {**run.settings, "start": [0.0, 0.0, 0.0]}
    found = judged(replace(run, frames=frames, settings=given), 3.0)
    assert (found.seconds_while_searching, found.seconds_while_tracking) == (4.0, 3.5)
