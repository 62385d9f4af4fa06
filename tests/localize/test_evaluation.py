"""Errors of runs, against numbers made by hand and against evo."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from evo.core import metrics, sync
from evo.tools import file_interface

from lfnav_cli.evaluate import command
from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, OptionError
from pipelines.geometry.pose import world_from_base_planar, wrap_angle
from pipelines.geometry.trajectory import Trajectory, format_tum
from pipelines.localize.description import describe_run
from pipelines.localize.evaluation import evaluate_run, evaluate_run_file, odometry_states
from pipelines.localize.run import Run, save_run
from pipelines.localize.state_space import SPATIAL
from pipelines.localize.trajectory_export import export_trajectory
from tests.localize_samples import curved_path, run_along, spatial_path, spatial_run


def noisy(states: FloatArray, seed: int, scale: float = 0.05) -> FloatArray:
    drawn = states + np.random.default_rng(seed).normal(0.0, scale, states.shape)
    drawn[:, 2] = wrap_angle(drawn[:, 2])
    return drawn


def trajectory(states: FloatArray, timestamps: FloatArray) -> Trajectory:
    return Trajectory(timestamps, world_from_base_planar(states))


def evo_ape(truth: Path, estimate: Path, relation: metrics.PoseRelation) -> metrics.APE:
    reference, estimated = sync.associate_trajectories(
        file_interface.read_tum_trajectory_file(str(truth)),
        file_interface.read_tum_trajectory_file(str(estimate)),
        max_diff=0.02,
    )
    ape = metrics.APE(relation)
    ape.process_data((reference, estimated))
    return ape


def test_errors_agree_with_evo(tmp_path: Path) -> None:
    truth = curved_path(25)
    times: FloatArray = 1305031102.175304 + 0.1 * np.arange(25, dtype=np.float64)
    run = run_along(noisy(truth, 1), timestamps=times)
    run = replace(run, odometry=noisy(truth, 2))
    reference = trajectory(truth, times)
    (tmp_path / "truth.tum").write_text(format_tum(reference))
    (tmp_path / "run.tum").write_text(export_trajectory(run, "tum"))
    placed = trajectory(odometry_states(run, truth), times)
    (tmp_path / "odometry.tum").write_text(format_tum(placed))

    evaluation = evaluate_run(run, reference)
    assert evaluation.odometry is not None
    for name, track in (("run", evaluation.errors), ("odometry", evaluation.odometry)):
        for relation, statistics in (
            (metrics.PoseRelation.translation_part, track.position_error_m),
            (metrics.PoseRelation.rotation_angle_deg, track.heading_error_deg),
        ):
            ape = evo_ape(tmp_path / "truth.tum", tmp_path / f"{name}.tum", relation)
            figures = ape.get_all_statistics()
            assert figures["rmse"] > 0.01
            for key in ("rmse", "median", "max"):
                assert getattr(statistics, key) == pytest.approx(figures[key], abs=1e-6)
            np.testing.assert_allclose(statistics.per_frame, ape.error, atol=1e-6)


def test_lengths_are_units_where_the_scale_of_the_scene_is_unknown(tmp_path: Path) -> None:
    truth = curved_path(6)
    run = run_along(truth, groundtruth=truth)
    for unit, record in (("m", {}), ("units", {"unit_of_length": "units"})):
        path = tmp_path / f"{unit}.h5"
        save_run(path, replace(run, provenance={**run.provenance, **record}), overwrite=False)
        assert evaluate_run_file(path).table()[1][0].endswith(f": position ({unit})")
        (shown,) = [row[1] for row in describe_run(path).table() if row[0] == "last estimate"]
        assert f" {unit}, y " in shown


def test_figures_are_those_computed_by_hand() -> None:
    truth = np.zeros((6, 3))
    truth[:, 2] = np.pi
    distances = np.array([3.0, 1.0, 0.0, 0.1, 0.2, 0.3])
    states = truth.copy()
    states[:, 0] += 0.6 * distances
    states[:, 1] -= 0.8 * distances
    # On the other side of the jump from pi to -pi.
    states[:, 2] = -np.pi + np.radians([50.0, 1.0, 2.0, 3.0, 4.0, 0.0])
    evaluation = evaluate_run(run_along(states, groundtruth=truth))
    position, heading = evaluation.errors.position_error_m, evaluation.errors.heading_error_deg
    np.testing.assert_allclose(position.per_frame, distances, atol=1e-12)
    assert position.median == pytest.approx(0.25)
    assert position.rmse == pytest.approx(np.sqrt((9.0 + 1.0 + 0.01 + 0.04 + 0.09) / 6.0))
    assert position.max == pytest.approx(3.0)
    assert position.last == pytest.approx(0.3)
    assert position.last5_mean == pytest.approx(1.6 / 5.0)
    np.testing.assert_allclose(heading.per_frame, [50.0, 1.0, 2.0, 3.0, 4.0, 0.0], atol=1e-9)
    assert heading.last5_mean == pytest.approx(2.0)
    assert evaluation.odometry is None


@pytest.mark.parametrize(
    ("distance", "degrees", "success"),
    [(0.149, 2.99, True), (0.151, 0.0, False), (0.0, 3.01, False), (0.0, 0.0, True)],
)
def test_success_takes_both_position_and_heading_of_the_last_five(
    distance: float, degrees: float, success: bool
) -> None:
    truth = curved_path(9)
    states = truth.copy()
    states[:4] += 1.0
    states[4:, 0] += distance
    states[4:, 2] -= np.radians(degrees)
    assert evaluate_run(run_along(states, groundtruth=truth)).success is success


def test_success_needs_an_estimate_in_each_of_the_last_five_frames() -> None:
    truth = curved_path(12)
    states = truth.copy()
    states[9] = np.nan
    evaluation = evaluate_run(run_along(states, groundtruth=truth))
    assert evaluation.errors.position_error_m.max == pytest.approx(0.0)
    assert not evaluation.success
    assert evaluation.frames_without_estimate == 1
    assert evaluation.to_dict()["position_error_m"]["per_frame"][9] is None
    states = truth.copy()
    states[0] = np.nan
    assert evaluate_run(run_along(states, groundtruth=truth)).success


def test_odometry_starts_at_the_true_first_pose() -> None:
    truth = curved_path(8)
    # The same path in a world that is turned and shifted, as odometry's is.
    angle, shift = 1.1, np.array([5.0, -7.0])
    cosine, sine = np.cos(angle), np.sin(angle)
    own = truth.copy()
    own[:, :2] = truth[:, :2] @ np.array([[cosine, sine], [-sine, cosine]]) + shift
    own[:, 2] = wrap_angle(truth[:, 2] + angle)
    run = run_along(noisy(truth, 3), groundtruth=truth, odometry=own)
    np.testing.assert_allclose(odometry_states(run), truth, atol=1e-12)
    evaluation = evaluate_run(run)
    assert evaluation.odometry is not None
    assert evaluation.odometry.success
    assert evaluation.odometry.position_error_m.max == pytest.approx(0.0, abs=1e-12)


def test_odometry_without_truth_starts_at_the_first_estimate() -> None:
    path = curved_path(5)
    states = noisy(path, 4)
    states[0] = np.nan
    placed = odometry_states(run_along(states, odometry=path - 2.0))
    np.testing.assert_allclose(placed[1], states[1], atol=1e-12)
    truth = path.copy()
    truth[:2] = np.nan
    placed = odometry_states(run_along(states, groundtruth=truth, odometry=path - 2.0))
    np.testing.assert_allclose(placed[2], truth[2], atol=1e-12)
    with pytest.raises(OptionError, match="no odometry"):
        odometry_states(run_along(path))


def test_frames_without_ground_truth_are_counted_and_left_out() -> None:
    truth = curved_path(10)
    run = run_along(truth + 0.01)
    times = run.timestamps
    part = trajectory(truth[2:7], times[2:7])
    evaluation = evaluate_run(run, part)
    assert evaluation.frames == 5
    assert evaluation.frames_without_groundtruth == 5
    per_frame = evaluation.to_dict()["position_error_m"]["per_frame"]
    assert [error is None for error in per_frame] == [True] * 2 + [False] * 5 + [True] * 3
    with pytest.raises(InputError, match=r"truth\.txt: no pose lies within 0\.02 s"):
        evaluate_run(run, trajectory(truth, times + 0.1), groundtruth_path="truth.txt")


def test_without_ground_truth_there_is_no_evaluation() -> None:
    with pytest.raises(InputError, match=r"run\.h5: carries no ground truth; .*--groundtruth"):
        evaluate_run(run_along(curved_path(3)), run_path="run.h5")


def test_ground_truth_that_is_handed_in_goes_before_the_runs_own() -> None:
    path = curved_path(6)
    run = run_along(path, groundtruth=path + 1.0)
    assert evaluate_run(run, trajectory(path, run.timestamps)).errors.position_error_m.max < 1e-9


def test_the_estimate_can_be_chosen() -> None:
    path = curved_path(6)
    run = run_along(path, groundtruth=path)
    assert evaluate_run(run).estimate == "mode"
    other = evaluate_run(run, estimate="max_weight")
    assert other.errors.position_error_m.median == pytest.approx(0.01 * np.sqrt(2.0))
    with pytest.raises(OptionError, match="it has max_weight, mode"):
        evaluate_run(run, estimate="best")


def saved(tmp_path: Path, run: Run) -> Path:
    save_run(tmp_path / "run.h5", run, overwrite=False)
    return tmp_path / "run.h5"


def test_the_command_prints_the_keys_that_scripts_rely_on(tmp_path: Path) -> None:
    truth = curved_path(7)
    path = saved(tmp_path, run_along(truth, groundtruth=truth, odometry=noisy(truth, 5)))
    result = CliRunner().invoke(command, [str(path), "--json"], catch_exceptions=False)
    found = json.loads(result.stdout)
    assert found["success"] is True
    assert (found["frames"], found["particles"]) == (7, 30)
    assert found["frames_without_groundtruth"] == 0
    assert found["seconds_per_frame"] == pytest.approx(0.75)
    for track in (found, found["odometry"]):
        for kind in ("position_error_m", "heading_error_deg"):
            keys = {"median", "rmse", "max", "last", "last5_mean", "per_frame"}
            assert set(track[kind]) == keys
            assert len(track[kind]["per_frame"]) == 7
    assert found["odometry"]["success"] in (True, False)


def test_the_command_prints_a_table_and_reads_a_file_of_truth(tmp_path: Path) -> None:
    truth = curved_path(7)
    run = run_along(truth + np.array([0.03, 0.04, 0.0]))
    path = saved(tmp_path, run)
    (tmp_path / "truth.tum").write_text(format_tum(trajectory(truth, run.timestamps)))
    arguments = [str(path), "--groundtruth", str(tmp_path / "truth.tum")]
    result = CliRunner().invoke(command, arguments, catch_exceptions=False)
    position = next(line for line in result.stdout.splitlines() if "position (m)" in line)
    assert position.split()[-5:] == ["0.050"] * 5
    assert evaluate_run_file(path, tmp_path / "truth.tum").frames == 7


# --- six degrees of freedom --------------------------------------------------------------------


def test_errors_of_a_spatial_run_agree_with_evo(tmp_path: Path) -> None:
    run, poses = spatial_run(6), SPATIAL.poses(spatial_path(6))
    rng = np.random.default_rng(9)
    truth = SPATIAL.moved(spatial_path(6), rng.normal(0.0, 0.05, (6, 6)))
    reference = Trajectory(run.timestamps, SPATIAL.poses(truth))
    (tmp_path / "truth.tum").write_text(format_tum(reference))
    (tmp_path / "run.tum").write_text(format_tum(Trajectory(run.timestamps, poses)))
    evaluation = evaluate_run(run, reference)
    for relation, statistics in (
        (metrics.PoseRelation.translation_part, evaluation.errors.position_error_m),
        (metrics.PoseRelation.rotation_angle_deg, evaluation.errors.heading_error_deg),
    ):
        ape = evo_ape(tmp_path / "truth.tum", tmp_path / "run.tum", relation)
        np.testing.assert_allclose(statistics.per_frame, ape.error, atol=1e-5)
        assert statistics.rmse > 0.01


def test_odometry_of_a_spatial_run_starts_at_the_true_pose() -> None:
    run = spatial_run(5)
    placed = odometry_states(run, spatial_path(5))
    np.testing.assert_allclose(placed, spatial_path(5), atol=1e-9)
