"""The pose by features beside the filter: shown for itself, a place to look, never the answer."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.localize.evaluation import evaluate_run
from pipelines.localize.localizer import region_of
from pipelines.localize.pnp import PnpAnswer
from pipelines.localize.pnp_frames import beside, pnp_record
from pipelines.localize.run import FrameRecord, Run, load_run, save_run
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import PLANAR
from pipelines.report.stage import ReportSettings, report
from pipelines.report.time_plots import time_figure
from pipelines.report.tracks import tracks_of
from tests.report_samples import TRUTH as RUN_TRUTH
from tests.report_samples import photo, wall_run, written
from tests.sequence_samples import (
    SCENE,
    TRUTH,
    content,
    localizer,
    mixture_settings,
)

ASIDE = np.array([0.0, 0.02, 0.0])


def answer(state: FloatArray | None) -> PnpAnswer:
    covariance = None if state is None else np.diag([1e-6, 1e-6, 1e-8])
    return PnpAnswer(state, covariance, 90 if state is not None else 12, 120, 0.25)


def run_with_pnp(known: tuple[int, ...], statuses: str = "gttttt") -> Run:
    """The wall's run, with poses by features 2 cm beside the truth in some frames."""
    run = wall_run(statuses=statuses)
    frames = tuple(
        beside(frame, answer(RUN_TRUTH[index] + ASIDE if index in known else None), noted=True)
        for index, frame in enumerate(run.frames)
    )
    settings = {**run.settings, "method": "filter", "with_pnp": True, "proposal": "retrieval"}
    return replace(run, frames=frames, settings=settings)


def test_evaluation_shows_it_in_rows_and_keys_of_its_own() -> None:
    evaluation = evaluate_run(run_with_pnp((0, 1, 3)))
    assert evaluation.estimate == "mode"
    assert evaluation.errors.position_error_m.median == pytest.approx(0.05)
    figures = evaluation.to_dict()["pnp"]
    assert figures["share_with_pose"] == 0.5
    assert figures["seconds_per_frame"] == 0.25
    assert figures["errors"]["position_error_m"]["max"] == pytest.approx(0.02)
    # Its time is no part of the filter's.
    assert evaluation.seconds_per_frame == pytest.approx(0.021)
    rows = {row[0]: row[1:] for row in evaluation.table()}
    assert rows["pnp: position (m)"][0] == "0.020"
    assert rows["frames with a pose, pnp"] == ("3 of 6 (50 %)",)
    # The last frames have none.
    assert rows["success, pnp"] == ("no",)


def test_without_any_pose_evaluation_says_just_that() -> None:
    evaluation = evaluate_run(run_with_pnp(()))
    assert evaluation.to_dict()["pnp"]["errors"] is None
    rows = {row[0]: row[1:] for row in evaluation.table()}
    assert rows["frames with a pose, pnp"] == ("0 of 6 (0 %)",)
    assert "pnp: position (m)" not in rows
    assert evaluate_run(wall_run()).to_dict()["pnp"] is None


def test_it_never_stands_for_a_filter_that_is_lost(tmp_path: Path) -> None:
    run = run_with_pnp((2, 3), "llllll")
    with pytest.raises(OptionError, match="lost throughout"):
        _ = run.default_estimate
    assert tracks_of(run, None).estimate_name == "none"
    assert np.array_equal(run.estimated_states("pnp")[3], RUN_TRUTH[3] + ASIDE)
    assert evaluate_run(run, estimate="pnp").consistency is None


def test_the_report_shows_it(tmp_path: Path) -> None:
    run = run_with_pnp((0, 1, 3))
    files = written(tmp_path, run)
    report(files.run, tmp_path / "report", ReportSettings(frames=(3,)))
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert "pnp, position" in page
    assert "in 3 of 6 frames" in page
    curve = next(
        line
        for line in time_figure(run, tracks_of(run, None), (3,)).axes[0].get_lines()
        if line.get_label() == "pnp"
    )
    heights = np.asarray(curve.get_ydata(), dtype=np.float64)
    np.testing.assert_allclose(heights, [2.0, 2.0, np.nan, 2.0, np.nan, np.nan])


def test_the_frame_of_a_pose_and_of_none_survive_the_file(tmp_path: Path) -> None:
    settings = LocalizerSettings(method="pnp", particles=50)
    rng, region = np.random.default_rng(0), region_of(SCENE, settings)
    frames = tuple(
        pnp_record(answer(state), region, settings, rng, float(time), "a.png")
        for time, state in enumerate((TRUTH[0], None))
    )
    assert frames[0].confidence == 0.75
    # Landmarks err too: the map's own accuracy is part of the covariance.
    sigmas = np.sqrt(np.diag(frames[0].covariance))
    assert np.all(sigmas > [0.01, 0.01, math.radians(0.25)])
    run = replace(
        wall_run(),
        frames=frames,
        encoded_images=(b"1", b"2"),
        odometry=None,
        groundtruth=None,
        settings=settings.to_dict(),
    )
    save_run(tmp_path / "run.h5", run, overwrite=False)
    back = load_run(tmp_path / "run.h5")
    assert back.default_estimate == "pnp"
    assert [content(frame) for frame in back.frames] == [content(frame) for frame in frames]
    assert back.frames[1].status == "lost"
    assert back.frames[1].modes.shape == (0, 4)
    spread = PLANAR.spread(back.frames[1].particles)
    np.testing.assert_allclose(np.diag(back.frames[1].covariance), spread**2)


def share_near(record: FrameRecord, truth: FloatArray) -> float:
    """Weight within 15 cm."""
    is_near = np.linalg.norm(record.particles[:, :2] - truth[:2], axis=1) < 0.15
    return float(np.exp(record.log_weights)[is_near].sum())


def test_a_hypothesis_says_where_to_look_and_not_what_to_believe() -> None:
    alone = mixture_settings(proposal="pnp", start_particles=60)
    truth, wrong = TRUTH[0], TRUTH[0] + [2.2, -0.6, 0.4]
    near, image = truth + 0.05, photo(truth)
    assert share_near(localizer(alone).step(image, hypotheses=np.stack([wrong, near])), truth) > 0.3
    # The few particles that are spread over the place miss it.
    assert share_near(localizer(alone).step(image), truth) < 1e-3
    misled = localizer(mixture_settings()).step(image, hypotheses=wrong[None])
    assert share_near(misled, truth) > 0.3


def test_settings_that_do_not_go_together() -> None:
    with pytest.raises(OptionError, match="nothing is beside it"):
        LocalizerSettings(method="pnp", with_pnp=True)
    with pytest.raises(OptionError, match="takes no proposals"):
        LocalizerSettings(strategy="coarse_to_fine", proposal="both", estimate="mode")
    with pytest.raises(OptionError, match="method 'magic' is none of filter, pnp"):
        LocalizerSettings(method="magic")
