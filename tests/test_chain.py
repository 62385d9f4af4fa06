"""The whole chain through the command line, on the photos of the lobby."""

import json
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from evo.core import metrics, sync
from evo.core.metrics import PoseRelation
from evo.tools import file_interface

from pipelines.localize.run import load_run
from tests.chain_samples import ELEVATORS, first_frames, lfnav, map_elevators, succeed

TEST = ELEVATORS / "test"
STATISTICS = {"median", "rmse", "max", "last5_mean"}
# evo's name of a statistic -> ours.
SHARED_STATISTICS = {"rmse": "rmse", "median": "median", "max": "max"}


@dataclass(frozen=True)
class Chain:
    """What the chain has made: reconstruct, model, localize."""

    folder: Path
    scene: Path
    run: Path


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Chain:
    folder = tmp_path_factory.mktemp("chain")
    # The wall's true plane: estimating it is tested elsewhere and takes longer than all the rest.
    scene = map_elevators(folder, "--plane", "0,1,0,0")
    run = folder / "run.h5"
    succeed("localize", scene, TEST, "-o", run, "--seed", "0")
    return Chain(folder, scene, run)


@pytest.fixture(scope="module")
def evaluation(chain: Chain) -> dict[str, Any]:
    figures = json.loads(succeed("evaluate", chain.run, "--json"))
    assert isinstance(figures, dict)
    return figures


def test_the_robot_is_found_in_front_of_three_equal_doors(
    chain: Chain, evaluation: dict[str, Any]
) -> None:
    assert evaluation["success"] is True
    assert evaluation["frames"] == 20
    assert evaluation["particles"] == 195
    assert evaluation["position_error_m"]["last5_mean"] < 0.15
    assert evaluation["heading_error_deg"]["last5_mean"] < 3.0
    # It was found, not given: before the first image it may be behind any door.
    run = load_run(chain.run)
    assert run.settings["start"] is None
    first = run.frames[0].particles
    assert len(first) > 195
    assert np.ptp(first[:, 0]) > 3.0
    assert np.ptp(first[:, 2]) > np.pi


def test_the_json_has_the_keys_that_scripts_rely_on(evaluation: dict[str, Any]) -> None:
    assert {"odometry", "frames", "particles", "seconds_per_frame"} <= set(evaluation)
    for track in (evaluation, evaluation["odometry"]):
        assert {"position_error_m", "heading_error_deg", "success"} <= set(track)
        assert isinstance(track["success"], bool)
        for errors in (track["position_error_m"], track["heading_error_deg"]):
            assert set(errors) >= STATISTICS
            for name in STATISTICS:
                assert isinstance(errors[name], float)
                assert errors[name] >= 0.0
    assert evaluation["seconds_per_frame"] > 0.0


def test_the_table_shows_the_figures_of_the_json(chain: Chain, evaluation: dict[str, Any]) -> None:
    rows = succeed("evaluate", chain.run).splitlines()
    position = next(row for row in rows if "position" in row and "estimate" in row)
    heading = next(row for row in rows if "heading" in row and "odometry" in row)
    assert f"{evaluation['position_error_m']['last5_mean']:.3f}" in position
    assert f"{evaluation['odometry']['heading_error_deg']['rmse']:.2f}" in heading


def test_the_given_ground_truth_is_the_one_that_the_run_carries(
    chain: Chain, evaluation: dict[str, Any]
) -> None:
    given = succeed("evaluate", chain.run, "--groundtruth", TEST / "groundtruth.txt", "--json")
    assert json.loads(given) == evaluation


def test_evo_reads_the_export_and_finds_the_same_errors(
    chain: Chain, caplog: pytest.LogCaptureFixture
) -> None:
    # The export holds this estimate alone, nothing that stands in for it.
    evaluation = json.loads(succeed("evaluate", chain.run, "--estimate", "refined", "--json"))
    exported = chain.folder / "run.tum"
    succeed("export", chain.run, "--format", "tum", "-o", exported)
    truth = file_interface.read_tum_trajectory_file(str(TEST / "groundtruth.txt"))
    estimate = file_interface.read_tum_trajectory_file(str(exported))
    valid, details = estimate.check()
    assert valid, details
    assert [record for record in caplog.records if record.levelname == "WARNING"] == []
    pair = sync.associate_trajectories(truth, estimate)
    # One image does not decide where the robot is: the first frame may have no refined pose.
    found = ["refined" in frame.estimates for frame in load_run(chain.run).frames]
    assert len(found) == 20
    assert all(found[1:])
    assert pair[0].num_poses == sum(found)
    for relation, key in (
        (PoseRelation.translation_part, "position_error_m"),
        (PoseRelation.rotation_angle_deg, "heading_error_deg"),
    ):
        error = metrics.APE(relation)
        error.process_data(pair)
        found = error.get_all_statistics()
        for name, ours in SHARED_STATISTICS.items():
            assert found[name] == pytest.approx(evaluation[key][ours], abs=1e-6)


def datasets(path: Path) -> dict[str, bytes]:
    """Name, type and content of every dataset of a file."""
    content: dict[str, bytes] = {}

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            values = item[()]
            header = f"{item.dtype} {item.shape} ".encode()
            content[name] = header + np.ascontiguousarray(values).tobytes()

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    return content


def test_the_same_seed_gives_the_same_datasets(chain: Chain, tmp_path: Path) -> None:
    data = first_frames(TEST, tmp_path / "data", 4)
    options = ("--start-particles", "1500", "--seed")
    for name, seed, threads in (("a", 7, 1), ("b", 7, 2), ("c", 8, 2)):
        run = tmp_path / f"{name}.h5"
        succeed(
            "localize", chain.scene, data, "-o", run, "--threads", str(threads), *options, str(seed)
        )
    first, second, other = (datasets(tmp_path / f"{name}.h5") for name in "abc")
    assert sum(name.endswith("particles") for name in first) == 4
    assert first == second
    changed = {name for name in first if first[name] != other[name]}
    assert {"run", "frames/0000/particles", "frames/0003/estimates/mode"} <= changed


def test_the_report_is_one_page_wherever_run_and_scene_lie_together(
    chain: Chain, tmp_path: Path, evaluation: dict[str, Any]
) -> None:
    for path in (chain.run, chain.scene):
        shutil.copyfile(path, tmp_path / path.name)
    succeed("report", tmp_path / "run.h5", "-o", tmp_path / "report", "--frames", "19")
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") >= 1
    assert 'src="http' not in page
    assert "Localized" in page
    assert f"{100.0 * evaluation['position_error_m']['last5_mean']:.1f}" in page
    figures = list((tmp_path / "report" / "figures").iterdir())
    assert {path.suffix for path in figures} == {".png", ".pdf"}


def test_info_knows_every_artifact(chain: Chain) -> None:
    for path, kind in (
        (TEST, "dataset"),
        (chain.folder / "map", "reconstruction"),
        (chain.scene, "scene"),
        (chain.run, "run"),
    ):
        assert json.loads(succeed("info", path, "--json"))["kind"] == kind


def test_a_view_rendered_at_the_last_true_pose_is_covered(chain: Chain, tmp_path: Path) -> None:
    succeed("render", chain.scene, "--pose", "-1.15,-1.65,90", "-o", tmp_path / "view.png")
    assert (tmp_path / "view.png").stat().st_size > 10_000


def test_the_paper_s_filter_runs_with_its_own_defaults(chain: Chain, tmp_path: Path) -> None:
    data = first_frames(TEST, tmp_path / "data", 3)
    run = tmp_path / "run.h5"
    output = succeed(
        "localize", chain.scene, data, "-o", run, "--strategy", "condensation", "--json"
    )
    settings = json.loads(output)["settings"]
    assert settings["resampling"] == "multinomial"
    assert settings["estimate"] == "max_weight"
    assert json.loads(output)["particles"] == [195, 195, 195]


def test_another_odometry_file_is_used_and_remembered(chain: Chain, tmp_path: Path) -> None:
    data = first_frames(TEST, tmp_path / "data", 3)
    options = ("--particles", "20", "--start-particles", "20", "--json")
    inputs = []
    for name in ("odometry.txt", "odometry_perturbed.txt"):
        run = tmp_path / f"{name}.h5"
        succeed("localize", chain.scene, data, "-o", run, "--odometry", data / name, *options)
        inputs.append(json.loads(succeed("info", run, "--json"))["provenance"]["inputs"])
    assert inputs[0]["scene"] == inputs[1]["scene"]
    assert inputs[0]["odometry"] != inputs[1]["odometry"]


def test_the_installed_command_is_the_same_program(
    chain: Chain, evaluation: dict[str, Any]
) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "lfnav_cli.main", "evaluate", str(chain.run), "--json"],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=ELEVATORS.parents[1],
    )
    assert result.returncode == 0
    assert result.stderr == ""
    assert json.loads(result.stdout) == evaluation


def test_quiet_says_nothing(chain: Chain) -> None:
    outcome = lfnav("evaluate", chain.run, "--quiet")
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")
