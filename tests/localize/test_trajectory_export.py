"""Exported trajectories, read back by evo and by hand."""

import csv
import io
import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from evo.tools import file_interface

from lfnav_cli.export import command
from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, OptionError, StageError
from pipelines.geometry.pose import planar_state_of
from pipelines.geometry.trajectory import read_tum
from pipelines.localize.run import Run, save_run
from pipelines.localize.state_space import SPATIAL
from pipelines.localize.trajectory_export import FORMATS, export_run_file, export_trajectory
from tests.localize_samples import curved_path, run_along, spatial_path, spatial_run

TIMES: FloatArray = 1305031102.175304 + 0.5 * np.arange(6, dtype=np.float64)


def sample_run(lost: int | None = None) -> Run:
    states = curved_path(6)
    if lost is not None:
        states[lost] = np.nan
    return run_along(states, timestamps=TIMES)


def states_of(poses: list[FloatArray]) -> FloatArray:
    return planar_state_of(np.stack(poses))


def write(folder: Path, name: str, run: Run, format_name: str) -> str:
    (folder / name).write_text(export_trajectory(run, format_name))
    return str(folder / name)


def test_tum_is_read_by_evo_without_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write(tmp_path, "run.tum", sample_run(), "tum")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trajectory = file_interface.read_tum_trajectory_file(path)
        valid, details = trajectory.check()
    assert valid, details
    assert [record for record in caplog.records if record.levelname != "DEBUG"] == []
    np.testing.assert_allclose(states_of(trajectory.poses_se3), curved_path(6), atol=1e-8)
    np.testing.assert_allclose(trajectory.timestamps, TIMES, atol=1e-6)
    np.testing.assert_array_equal(trajectory.positions_xyz[:, 2], 0.0)
    np.testing.assert_allclose(
        planar_state_of(read_tum(Path(path)).poses), curved_path(6), atol=1e-8
    )


def test_kitti_is_read_by_evo(tmp_path: Path) -> None:
    path = write(tmp_path, "run.kitti", sample_run(), "kitti")
    trajectory = file_interface.read_kitti_poses_file(path)
    assert trajectory.check()[0]
    np.testing.assert_allclose(states_of(trajectory.poses_se3), curved_path(6), atol=1e-9)


def test_euroc_is_read_by_evo_and_has_exact_nanoseconds(tmp_path: Path) -> None:
    path = write(tmp_path, "run.csv", sample_run(), "euroc")
    trajectory = file_interface.read_euroc_csv_trajectory(path)
    assert trajectory.check()[0]
    np.testing.assert_allclose(states_of(trajectory.poses_se3), curved_path(6), atol=1e-8)
    header, first = Path(path).read_text().splitlines()[:2]
    assert header.startswith("#timestamp")
    fields = first.split(",")
    assert fields[0] == "1305031102175304000"
    half = curved_path(6)[0, 2] / 2.0
    scalar_first = [float(value) for value in fields[4:8]]
    np.testing.assert_allclose(scalar_first, [np.cos(half), 0.0, 0.0, np.sin(half)], atol=1e-8)


def test_csv_has_a_row_a_frame_with_units_in_the_headings() -> None:
    rows = list(csv.DictReader(io.StringIO(export_trajectory(sample_run(), "csv"))))
    assert len(rows) == 6
    found = np.array([[float(row[key]) for key in ("x_m", "y_m", "heading_deg")] for row in rows])
    found[:, 2] = np.radians(found[:, 2])
    np.testing.assert_allclose(found, curved_path(6), atol=1e-8)
    assert float(rows[0]["timestamp_s"]) == TIMES[0]
    assert rows[0]["status"] == "tracking"


def test_json_holds_state_modes_and_confidence() -> None:
    content = json.loads(export_trajectory(sample_run(), "json", "max_weight"))
    assert content["estimate"] == "max_weight"
    frame = content["frames"][2]
    expected = curved_path(6)[2] + 0.01
    assert list(frame["state"].values()) == pytest.approx(expected)
    assert [mode["share"] for mode in frame["modes"]] == [0.9, 0.1]
    assert frame["confidence"] == 0.7


def test_frames_without_an_estimate_are_left_out_or_null_never_made_up() -> None:
    run = sample_run(lost=2)
    kept = np.delete(TIMES, 2)
    tum = [line.split()[0] for line in export_trajectory(run, "tum").splitlines()[1:]]
    np.testing.assert_allclose(np.array(tum, dtype=np.float64), kept, atol=1e-6)
    assert len(export_trajectory(run, "euroc").splitlines()) == 1 + 5
    frames = [row["frame"] for row in csv.DictReader(io.StringIO(export_trajectory(run, "csv")))]
    assert frames == ["0", "1", "3", "4", "5"]
    content = json.loads(export_trajectory(run, "json"))
    assert content["frames"][2]["state"] is None
    assert content["frames"][2]["status"] == "lost"
    with pytest.raises(StageError, match="frame 2 has no estimate"):
        export_trajectory(run, "kitti")


def test_an_image_name_with_a_comma_stays_one_field() -> None:
    from dataclasses import replace

    run = sample_run()
    named = replace(run.frames[0], image_name='a,"b".png')
    run = replace(run, frames=(named, *run.frames[1:]))
    rows = list(csv.DictReader(io.StringIO(export_trajectory(run, "csv"))))
    assert rows[0]["image"] == 'a,"b".png'


def test_unknown_format_and_estimate_are_refused() -> None:
    with pytest.raises(OptionError, match="'ply' is none of tum, kitti"):
        export_trajectory(sample_run(), "ply")
    with pytest.raises(OptionError, match="no estimate 'best'"):
        export_trajectory(sample_run(), "tum", "best")


def test_the_command_writes_each_format_and_respects_what_exists(tmp_path: Path) -> None:
    save_run(tmp_path / "run.h5", sample_run(), overwrite=False)
    for name in FORMATS:
        output = tmp_path / f"run.{name}"
        arguments = [str(tmp_path / "run.h5"), "--format", name, "-o", str(output)]
        result = CliRunner().invoke(command, arguments, catch_exceptions=False)
        assert result.exit_code == 0
        assert output.read_text() == export_trajectory(sample_run(), name)
    output.write_text("mine")
    with pytest.raises(InputError, match="--overwrite"):
        export_run_file(tmp_path / "run.h5", output, "json", None, overwrite=False)
    assert output.read_text() == "mine"


def test_a_failed_export_leaves_nothing_behind(tmp_path: Path) -> None:
    save_run(tmp_path / "run.h5", sample_run(lost=1), overwrite=False)
    with pytest.raises(StageError):
        export_run_file(tmp_path / "run.h5", tmp_path / "out.txt", "kitti", None, overwrite=False)
    assert [path.name for path in tmp_path.iterdir()] == ["run.h5"]


# --- six degrees of freedom --------------------------------------------------------------------


def test_a_spatial_run_is_exported_with_its_full_poses(tmp_path: Path) -> None:
    run = spatial_run(4)
    poses = SPATIAL.poses(spatial_path(4))
    tum = file_interface.read_tum_trajectory_file(write(tmp_path, "run.tum", run, "tum"))
    assert tum.check()[0]
    np.testing.assert_allclose(np.stack(tum.poses_se3), poses, atol=1e-8)
    kitti = file_interface.read_kitti_poses_file(write(tmp_path, "run.kitti", run, "kitti"))
    np.testing.assert_allclose(np.stack(kitti.poses_se3), poses, atol=1e-9)
    euroc = file_interface.read_euroc_csv_trajectory(write(tmp_path, "run.csv", run, "euroc"))
    np.testing.assert_allclose(np.stack(euroc.poses_se3), poses, atol=1e-8)


def test_tables_of_a_spatial_run_name_all_six_numbers() -> None:
    run, names = spatial_run(4), ("x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg")
    rows = list(csv.DictReader(io.StringIO(export_trajectory(run, "csv"))))
    found = np.array([[float(row[name]) for name in names] for row in rows])
    found[:, 3:] = np.radians(found[:, 3:])
    np.testing.assert_allclose(found, spatial_path(4), atol=1e-8)
    frame = json.loads(export_trajectory(run, "json"))["frames"][1]
    assert list(frame["state"]) == ["x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad"]
    assert list(frame["state"].values()) == pytest.approx(spatial_path(4)[1])
    assert [mode["share"] for mode in frame["modes"]] == [0.9, 0.1]
