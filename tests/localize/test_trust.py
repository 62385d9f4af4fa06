"""What runs state, held against the truth: on runs whose errors and confidences are known."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from lfnav_cli.evaluate import command
from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.localize.run import FrameRecord, Run, save_run
from pipelines.localize.trust import pooled, pooled_calibration_error, trust_elsewhere, trust_of
from tests.localize_samples import curved_path, run_along, spatial_path, spatial_run


def run_with(
    offsets: Sequence[float | None], confidences: Sequence[float], statuses: Sequence[str]
) -> tuple[Run, FloatArray]:
    """Estimates so many metres beside the truth (None: there is none), and the truth."""
    truth = curved_path(len(offsets))
    states = truth.copy()
    for number, offset in enumerate(offsets):
        states[number, 0] += math.nan if offset is None else offset
    run = run_along(states, groundtruth=truth)
    frames: list[FrameRecord] = [
        replace(frame, confidence=confidence, status=status)
        for frame, confidence, status in zip(run.frames, confidences, statuses, strict=True)
    ]
    return replace(run, frames=tuple(frames)), truth


def test_frames_are_right_wrong_or_silent() -> None:
    offsets = [0.0, 0.29, 0.31, 2.0, 0.0, None]
    statuses = ["tracking"] * 4 + ["global", "lost"]
    run, truth = run_with(offsets, [0.9, 0.95, 0.5, 1.0, 0.2, 0.0], statuses)
    found = trust_of(run, truth)
    assert found.right.tolist() == [True, True] + [False] * 4
    assert found.wrong.tolist() == [False, False, True, True, False, False]
    assert found.silent.tolist() == [False] * 4 + [True, True]
    assert found.close.tolist() == [True, False, False, False, True, False]
    assert found.has_estimate.tolist() == [True] * 5 + [False]
    assert found.median_errors_of_right == pytest.approx((0.145, 0.0))
    # Three are sure; one of them is close, and one is in another place.
    assert found.sure_not_close == pytest.approx(2.0 / 3.0)
    assert found.sure_wrong == pytest.approx(1.0 / 3.0)
    assert found.calibration_error == pytest.approx((2.85 - 1 + 0.5 + 0.8) / 6)
    assert found.calibration_error_of_estimates == pytest.approx((2.85 - 1 + 0.5 + 0.8) / 5)
    squares = [0.1**2, 0.95**2, 0.5**2, 1.0, 0.8**2, 0.0]
    assert found.brier_score == pytest.approx(np.mean(squares))
    # With a standard deviation of 10 cm, 29 cm are outside: 8.41 is more than chi-square's 7.81.
    assert found.in_region == pytest.approx(0.25)


def test_the_heading_decides_as_well() -> None:
    truth = curved_path(3)
    states = truth.copy()
    states[:, 2] += np.radians([2.9, 9.0, 11.0])
    found = trust_of(run_along(states), truth)
    assert found.close.tolist() == [True, False, False]
    assert found.right.tolist() == [True, True, False]
    assert found.wrong.tolist() == [False, False, True]


def test_frames_without_truth_do_not_count() -> None:
    run, truth = run_with([2.0, 0.0, 0.0], [1.0, 1.0, 1.0], ["tracking"] * 3)
    truth[0] = math.nan
    found = trust_of(run, truth)
    assert len(found) == 2
    assert found.calibration_error == 0.0
    with pytest.raises(OptionError, match="ground truth"):
        trust_of(run, truth[:2])


def test_in_another_place_whatever_is_tracked_is_wrong() -> None:
    run, _ = run_with([0.0, 0.0, None], [0.8, 0.1, 0.0], ["tracking", "global", "lost"])
    found = trust_elsewhere(run)
    assert found.wrong.tolist() == [True, False, False]
    assert not found.right.any()
    assert not found.close.any()
    assert found.calibration_error == pytest.approx(0.3)
    assert math.isnan(found.in_region)
    assert math.isnan(found.median_errors_of_right[0])
    assert math.isnan(found.sure_wrong)


def test_wrong_at_the_end_means_the_last_ten() -> None:
    for place, expected in ((0, 0), (1, 0), (2, 1), (11, 1)):
        offsets: list[float | None] = [0.0] * 12
        offsets[place] = 1.0
        run, truth = run_with(offsets, [0.5] * 12, ["tracking"] * 12)
        assert trust_of(run, truth).runs_wrong_at_the_end == expected
        # The same frames of the run are the last ten, whatever truth there is.
        truth[6:10] = math.nan
        assert trust_of(run, truth).runs_wrong_at_the_end == expected


def test_runs_without_any_estimate_are_silent() -> None:
    run, truth = run_with([None] * 4, [0.0] * 4, ["lost"] * 4)
    found = trust_of(run, truth)
    assert found.silent.all()
    assert math.isnan(found.in_region)
    assert math.isnan(found.calibration_error_of_estimates)
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["in_95_region"] is None


def calibrated(scale: float) -> tuple[Run, FloatArray]:
    """A long run whose estimates are close so much less often than their confidence says."""
    rng = np.random.default_rng(3)
    confidences = rng.random(3000)
    is_close = rng.random(3000) < scale * confidences
    offsets = np.where(is_close, 0.05, 0.2)
    return run_with(offsets.tolist(), confidences.tolist(), ["tracking"] * 3000)


def test_a_confidence_that_is_a_probability_has_no_error_and_another_has_the_gap() -> None:
    assert trust_of(*calibrated(1.0)).calibration_error < 0.04
    found = trust_of(*calibrated(0.5))
    assert found.calibration_error == pytest.approx(0.25, abs=0.03)
    # The sure ones are close in half of 95 %.
    assert found.sure_not_close == pytest.approx(0.525, abs=0.06)


def test_pooled_runs_are_one_set_of_frames() -> None:
    first = run_with([0.0, 1.0], [0.9, 0.8], ["tracking"] * 2)
    second = run_with([0.0, None, 0.0], [0.3, 0.0, 0.4], ["tracking", "lost", "blind"])
    parts = [trust_of(*first), trust_of(*second)]
    both = pooled(parts)
    assert len(both) == 5
    assert (both.runs, both.runs_wrong_at_the_end) == (2, 1)
    assert both.wrong.tolist() == [False, True, False, False, False]
    error = (0.1 + 0.8 + 0.7 + 0.0 + 0.6) / 5
    assert both.calibration_error == pytest.approx(error)
    sums = [part.confidence_sums() for part in parts]
    assert pooled_calibration_error(sums) == pytest.approx(error)
    assert math.isnan(pooled_calibration_error([]))
    with pytest.raises(OptionError, match="pooled"):
        pooled([parts[0], trust_of(spatial_run(2), spatial_path(2))])


def test_what_stands_in_is_held_against_its_own_covariance() -> None:
    run, truth = spatial_run(4), spatial_path(4)
    truth[:, 0] += 0.05
    # 5 cm are outside of the region of the alignment (1 cm), inside of the mode's (10 cm).
    assert trust_of(run, truth).in_region == 0.0
    coarse = {"mode": run.frames[0].estimates["mode"]}
    without = replace(run.frames[0], estimates=coarse, refined_covariance=None)
    mixed = replace(run, frames=(without, *run.frames[1:]))
    assert trust_of(mixed, truth).in_region == 0.25


def test_evaluate_says_it(tmp_path: Path) -> None:
    offsets = [0.0, 0.2, 2.0, 0.0]
    run, _ = run_with(offsets, [0.95, 0.9, 1.0, 0.1], ["tracking"] * 3 + ["global"])
    save_run(tmp_path / "run.h5", run, overwrite=False)
    arguments = [str(tmp_path / "run.h5")]
    text = CliRunner().invoke(command, arguments, catch_exceptions=False).stdout
    lines = {" ".join(line.split()) for line in text.splitlines()}
    assert "frames right, silent, wrong 2, 1, 1" in lines
    assert "wrong frames among the last 10 yes" in lines
    assert "confidence 0.9 or more 3 frames, 2 not within 0.1 m and 3 deg, 1 wrong" in lines
    result = CliRunner().invoke(command, [*arguments, "--json"], catch_exceptions=False)
    found = json.loads(result.stdout)["trust"]
    assert (found["frames_right"], found["frames_silent"], found["frames_wrong"]) == (2, 1, 1)
    assert found["calibration_error"] == pytest.approx((2.85 - 1 + 0.9) / 4)
    assert sum(item["forecasts"] for item in found["reliability"]) == 4
