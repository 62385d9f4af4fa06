"""The report of a docking: its verdict, its figure, its animation."""

from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib.patches import Circle
from PIL import Image

from pipelines.artifacts.stages import no_progress
from pipelines.dock.robots.faults import FaultyRobot
from pipelines.dock.settings import DockSettings
from pipelines.dock.states import OutcomeKind
from pipelines.localize.docking_record import DockingRecord
from pipelines.localize.run import Run
from pipelines.report.animation import animation
from pipelines.report.docking import docking_figure, docking_verdict
from pipelines.report.stage import ReportSettings, report
from pipelines.report.surroundings import surroundings_of
from pipelines.report.tracks import tracks_of
from tests.dock_samples import GOAL, PaintedRobot, docked, wall_scene, written

SETTINGS = DockSettings(least_distance=0.4, staging_distance=0.5)


@pytest.fixture(scope="module")
def run() -> Run:
    return docked(PaintedRobot(), SETTINGS)[1]


def test_the_figure_shows_estimated_and_true_distance(run: Run) -> None:
    tracks = tracks_of(run, None)
    figure = docking_figure(run, surroundings_of(wall_scene(), tracks), tracks)
    lines = {line.get_label(): np.asarray(line.get_ydata()) for line in figure.axes[1].lines}
    assert run.groundtruth is not None
    expected = np.hypot(*(run.groundtruth[:, :2] - GOAL[:2]).T)
    np.testing.assert_allclose(lines["true"], expected)
    known = np.isfinite(lines["estimated"])
    assert known[-1]
    assert abs(lines["estimated"][known] - expected[known]).max() < 0.1


def test_the_figure_shows_what_stood_in_the_way_and_the_size_of_the_robot(run: Run) -> None:
    tracks = tracks_of(run, None)
    pillars = np.array([[0.4, -1.0], [-0.4, -1.0]])
    around = replace(surroundings_of(wall_scene(), tracks), obstacles=pillars)
    record = run.docking
    assert record is not None
    sized = replace(run, docking=replace(record, settings={"robot_radius": 0.3}))
    above = docking_figure(sized, around, tracks).axes[0]
    lines = {line.get_label(): line for line in above.lines}
    dots = np.asarray(lines["obstacle points"].get_xydata())
    np.testing.assert_array_equal(dots, pillars)
    circles = [patch for patch in above.patches if isinstance(patch, Circle)]
    assert len(circles) == len(run.frames)
    assert {circle.radius for circle in circles} == {0.3}
    unsized = docking_figure(run, around, tracks).axes[0]
    assert not any(isinstance(patch, Circle) for patch in unsized.patches)


def test_the_animation_has_a_picture_a_step(run: Run) -> None:
    tracks = tracks_of(run, None)
    short = replace(
        run,
        frames=run.frames[:3],
        encoded_images=run.encoded_images[:3],
        odometry=None,
        groundtruth=None,
        docking=_cut(run, 3),
    )
    data = animation(
        short, surroundings_of(wall_scene(), tracks), tracks_of(short, None), no_progress
    )
    picture = Image.open(BytesIO(data))
    assert picture.format == "GIF"
    assert getattr(picture, "n_frames", 0) == 3


def test_the_page_of_a_docking(tmp_path: Path) -> None:
    _, blocked = docked(FaultyRobot(PaintedRobot(), "blocked", 1), SETTINGS)
    files = written(tmp_path, blocked)
    summary = report(files.run, tmp_path / "report", ReportSettings(frames=(0,)))
    assert "figures/animation.gif" in summary.files
    assert "figures/docking.png" in summary.files
    page = (tmp_path / "report" / "report.html").read_text()
    assert "data:image/gif;base64," in page
    assert summary.verdict.kind == "bad"
    assert summary.verdict.sentence.startswith("Blocked after ")
    assert "In truth the robot is" in summary.verdict.sentence


def test_a_docking_far_from_the_goal_in_truth_is_no_success(run: Run) -> None:
    assert docking_verdict(run).kind == "good"
    assert run.groundtruth is not None
    elsewhere = replace(run, groundtruth=run.groundtruth + np.array([0.1, 0.0, 0.0]))
    assert docking_verdict(elsewhere).kind == "bad"
    assert run.docking is not None
    assert run.docking.exit_code == OutcomeKind.DOCKED.value


def _cut(run: Run, count: int) -> DockingRecord:
    record = run.docking
    assert record is not None
    return replace(
        record,
        states=record.states[:count],
        commands=record.commands[:count],
        measured=record.measured[:count],
    )
