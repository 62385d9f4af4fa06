"""Sweeps: the figures of single runs, nothing computed twice, nothing lost, nobody stopped."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from pipelines.artifacts.stages import no_progress
from pipelines.experiments.sweep_config import read_sweep_config
from pipelines.experiments.sweep_inputs import program_hash
from pipelines.experiments.sweep_plan import planned_runs
from pipelines.experiments.sweep_store import stored_result
from pipelines.experiments.sweep_workers import run_locally
from pipelines.lightfield.scene_file import save_scene
from pipelines.render.devices import Device, resolved_device
from tests.chain_samples import ELEVATORS, first_frames, lfnav, map_elevators, succeed
from tests.pnp_samples import WORKSHOP, workshop_scene

# What two ways to compute the same must agree in.
NOT_TIMES = ("success", "position_error_m", "heading_error_deg", "frames_until_converged", "frames")
CONFIG = """
[sweep]
seeds = [3, 4]
particles = 30
[filter]
strategy = "condensation"
[start]
start = [-3.30, -4.30, 66]
[rendering]
fine_width = 20
[[dataset]]
name = "good"
scene = "scene.h5"
path = "good"
odometry = ["odometry.txt", "odometry_perturbed.txt"]
"""
BROKEN = """
[[dataset]]
name = "broken"
scene = "scene.h5"
path = "broken"
"""


@dataclass(frozen=True)
class Swept:
    """A sweep that was killed and continued.

    Attributes:
        root: the folder with ``sweep.toml``; the results are in ``out``.
        before: name of a result -> time of the file, when the sweep had been killed.
        summary: what the command printed in the end, as JSON.
        err: what it printed on stderr.
        code: its exit code.
    """

    root: Path
    before: Mapping[str, int]
    summary: dict[str, Any]
    err: str
    code: int


def results(folder: Path) -> dict[str, int]:
    # What a kill leaves half written begins with a dot.
    return {path.name: path.stat().st_mtime_ns for path in (folder / "runs").glob("[!.]*.json")}


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Swept:
    root = tmp_path_factory.mktemp("sweep")
    map_elevators(root, "--plane", "0,1,0,0")
    first_frames(ELEVATORS / "test", root / "good", 4)
    spoilt = first_frames(ELEVATORS / "test", root / "broken", 3) / "rgb/0001.jpg"
    spoilt.write_bytes(spoilt.read_bytes()[:20_000])
    (root / "sweep.toml").write_text(CONFIG + BROKEN, encoding="utf-8")
    arguments: list[str | Path] = [
        "sweep",
        root / "sweep.toml",
        "-o",
        root / "out",
        "--processes",
        "1",
    ]
    program = [sys.executable, "-m", "lfnav_cli.main", *map(str, arguments)]
    with subprocess.Popen(program, stderr=subprocess.PIPE) as process:
        while process.poll() is None and not results(root / "out"):
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
    before = results(root / "out")
    assert 1 <= len(before) < 4
    outcome = lfnav(*arguments, "--json")
    return Swept(root, before, json.loads(outcome.out), outcome.err, outcome.code)


def test_after_a_kill_only_what_is_missing_is_made(swept: Swept) -> None:
    after = results(swept.root / "out")
    assert len(after) == 4
    assert {name: after[name] for name in swept.before} == swept.before
    assert swept.summary["finished_before"] == len(swept.before)
    assert swept.summary["runs"] == 6


def test_runs_that_break_are_reported_and_stop_nobody(swept: Swept) -> None:
    assert swept.code == 1
    lines = swept.summary["lines"]
    assert [(line["dataset"], line["runs"], line["broken"]) for line in lines] == [
        ("good", 2, 0),
        ("good", 2, 0),
        ("broken", 0, 2),
    ]
    assert len(swept.summary["failures"]) == 2
    for failure in swept.summary["failures"]:
        assert "broken, odometry.txt, condensation, squared, " in failure
        assert "0001.jpg" in failure
        assert failure in (swept.root / "out/table.md").read_text(encoding="utf-8")
    *warnings, last = swept.err.splitlines()
    assert len(warnings) == 2
    assert last.startswith("lfnav: 2 of 6 runs broke, see ")


def test_a_run_of_a_sweep_is_the_run_of_the_other_commands(swept: Swept, tmp_path: Path) -> None:
    root, run = swept.root, tmp_path / "run.h5"
    start = next(line for line in CONFIG.splitlines() if line.startswith("start = "))
    text = f"[start]\n{start}\n[rendering]\nfine_width = 20\n"
    (tmp_path / "settings.toml").write_text(text, encoding="utf-8")
    options = ("--strategy", "condensation", "--particles", "30", "--seed", "4")
    succeed(
        "localize", root / "scene.h5", root / "good", "-o", run, *options,
        "--config", tmp_path / "settings.toml",
        "--odometry", root / "good/odometry_perturbed.txt",
    )  # fmt: skip
    evaluation = json.loads(succeed("evaluate", run, "--json"))
    planned = planned_runs(read_sweep_config(root / "sweep.toml"), no_progress)
    same = [
        item
        for item in planned
        if (item.setup.odometry, item.setup.particles, item.seed)
        == ("odometry_perturbed.txt", 30, 4)
    ]
    assert len(same) == 1
    kept = stored_result(root / "out", same[0])
    assert kept is not None
    assert kept.program == program_hash()
    result = kept.result
    assert result.position_error_m == evaluation["position_error_m"]["last5_mean"]
    assert result.median_heading_error_deg == evaluation["heading_error_deg"]["median"]
    assert result.frames_until_converged == evaluation["frames_until_converged"]
    assert (result.success, result.frames) == (evaluation["success"], 4)
    content = json.loads(next((root / "out/runs").glob(f"{same[0].key}*")).read_text())
    assert content["settings"]["particles"] == 30
    assert content["seed"] == 4


def test_keys_stand_for_everything_that_goes_in(swept: Swept, tmp_path: Path) -> None:
    runs = planned_runs(read_sweep_config(swept.root / "sweep.toml"), no_progress)
    assert len({run.key for run in runs}) == len(runs) == 6
    # The same content under other names and with other threads is the same run.
    copy = first_frames(swept.root / "good", tmp_path / "copy", 4)
    config = CONFIG.replace('"good"', f'"{copy}"').replace('"scene.h5"', f'"{swept.root}/scene.h5"')
    config = config.replace("fine_width", "threads = 2\nfine_width")
    (tmp_path / "sweep.toml").write_text(config, encoding="utf-8")
    copied = planned_runs(read_sweep_config(tmp_path / "sweep.toml"), no_progress)
    assert [run.key for run in copied] == [run.key for run in runs[:4]]
    # What "auto" means is decided for all of them at once, and another device is another run.
    assert {run.settings.device for run in runs} == {Device.CPU}
    for device, meant in (("auto", resolved_device(Device.AUTO)), ("gpu", Device.GPU)):
        on_other = config.replace("threads = 2", f'device = "{device}"')
        (tmp_path / "sweep.toml").write_text(on_other, encoding="utf-8")
        elsewhere = planned_runs(read_sweep_config(tmp_path / "sweep.toml"), no_progress)
        assert {run.settings.device for run in elsewhere} == {meant}
        is_other = meant is not Device.CPU
        assert {run.key for run in elsewhere}.isdisjoint(run.key for run in runs) == is_other
    (tmp_path / "sweep.toml").write_text(config, encoding="utf-8")
    for name in ("rgb/0000.jpg", "groundtruth.txt", "odometry.txt"):
        original = (copy / name).read_bytes()
        (copy / name).write_bytes(original + b"\n")
        changed = planned_runs(read_sweep_config(tmp_path / "sweep.toml"), no_progress)
        differing = [one.key != other.key for one, other in zip(changed, copied, strict=True)]
        assert differing == ([True] * 2 + [name != "odometry.txt"] * 2)
        (copy / name).write_bytes(original)


def test_tables_say_which_pixels_were_compared_where_not_the_usual_ones(
    swept: Swept, tmp_path: Path
) -> None:
    config = CONFIG.replace('"good"', f'"{swept.root}/good"')
    config = config.replace('"scene.h5"', f'"{swept.root}/scene.h5"')
    config = config.replace("[sweep]", "[sweep]\none_pixel_in = [1, 2, 5]")
    (tmp_path / "sweep.toml").write_text(config, encoding="utf-8")
    runs = planned_runs(read_sweep_config(tmp_path / "sweep.toml"), no_progress)
    assert {run.setup.likelihood for run in runs} == {
        "squared, all pixels",
        "squared, pixel subsampling 2",
        "squared",
    }


def test_a_damaged_result_is_computed_again(
    swept: Swept, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run = planned_runs(read_sweep_config(swept.root / "sweep.toml"), no_progress)[0]
    source = swept.root / "out" / "runs" / f"{run.key}.json"
    target = tmp_path / "runs" / source.name
    target.parent.mkdir()
    text = source.read_text(encoding="utf-8")
    for damaged in (text[:100], text.replace('"success"', '"succes"'), text.replace(run.key, "0")):
        target.write_text(damaged, encoding="utf-8")
        caplog.clear()
        assert stored_result(tmp_path, run) is None
        assert "the run is repeated" in caplog.text
    target.write_text(text, encoding="utf-8")
    assert stored_result(tmp_path, run) is not None


def test_results_of_another_program_are_named(swept: Swept, tmp_path: Path) -> None:
    shutil.copytree(swept.root / "out", tmp_path / "out")
    kept = [path for path in (tmp_path / "out/runs").iterdir() if '"seed": 3' in path.read_text()]
    kept[0].write_text(kept[0].read_text().replace(program_hash(), "0" * 64))
    config = tmp_path / "sweep.toml"
    text = CONFIG.replace('"good"', f'"{swept.root}/good"').replace(
        "scene.h5", f"{swept.root}/scene.h5"
    )
    config.write_text(text)
    outcome = lfnav("sweep", config, "-o", tmp_path / "out", "--seeds", "3")
    assert outcome.code == 0
    assert "1 of 2 finished runs were made by another version of the program" in outcome.err


def test_features_stand_beside_the_filter_and_are_sought_once(tmp_path: Path) -> None:
    save_scene(tmp_path / "scene.h5", workshop_scene(), overwrite=False)
    drive = first_frames(WORKSHOP / "test", tmp_path / "drive", 2)
    text = """
    [sweep]
    seeds = 5
    method = ["pnp", "filter"]
    particles = 20
    [filter]
    start_particles = 200
    [rendering]
    refine_width = 0
    [[dataset]]
    scene = "scene.h5"
    path = "drive"
    odometry = ["odometry.txt", "odometry_perturbed.txt"]
    """
    config, output, run = tmp_path / "sweep.toml", tmp_path / "out", tmp_path / "run.h5"
    config.write_text(text, encoding="utf-8")
    lines = json.loads(succeed("sweep", config, "-o", output, "--processes", "1", "--json"))[
        "lines"
    ]
    assert [(line["odometry"], line["method"], line["strategy"]) for line in lines] == [
        ("odometry.txt", "pnp", None),
        ("odometry.txt", "filter", "mixture"),
        ("odometry_perturbed.txt", "pnp", None),
        ("odometry_perturbed.txt", "filter", "mixture"),
    ]
    assert len(results(output)) == 3
    assert {**lines[0], "odometry": ""} == {**lines[2], "odometry": ""}
    options = ("--method", "pnp", "--seed", "5", "--odometry", "none")
    succeed("localize", tmp_path / "scene.h5", drive, "-o", run, *options)
    evaluation = json.loads(succeed("evaluate", run, "--json"))
    assert evaluation["odometry"] is None
    assert lines[0]["position_error_m_q50"] == evaluation["position_error_m"]["last5_mean"]
    # The worker's time counts too: it does nearly all of the work.
    assert lines[0]["cpu_seconds_per_frame_q50"] > evaluation["seconds_per_frame"] / 2.0


class Deadly(dict[str, str]):
    """Ends the process that looks into it, as the system does when memory runs out."""

    def __getitem__(self, name: str) -> str:
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError


@pytest.mark.slow
def test_a_process_that_dies_takes_its_own_run_only(swept: Swept) -> None:
    runs = planned_runs(read_sweep_config(swept.root / "sweep.toml"), no_progress)[:3]
    doomed = replace(runs[1], inputs=Deadly(runs[1].inputs))
    made = list(run_locally([runs[0], doomed, runs[2]], 1))
    assert [run.key for run, _ in made] == [run.key for run in runs]
    first, second, third = (outcome for _, outcome in made)
    assert second.result is None
    assert second.failure is not None
    assert "SIGKILL" in second.failure
    for run, outcome in ((runs[0], first), (runs[2], third)):
        kept = stored_result(swept.root / "out", run)
        assert kept is not None
        assert outcome.result is not None
        assert [getattr(outcome.result, name) for name in NOT_TIMES] == [
            getattr(kept.result, name) for name in NOT_TIMES
        ]


def test_a_cluster_gives_the_same_results(swept: Swept, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    output = tmp_path / "out"
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        local_directory=str(tmp_path / "dask"),
    ) as cluster:
        arguments = ("sweep", swept.root / "sweep.toml", "-o", output, "--seeds", "3")
        outcome = lfnav(*arguments, "--scheduler", cluster.scheduler_address, "--json")
    assert outcome.code == 1
    summary = json.loads(outcome.out)
    assert len(summary["failures"]) == 1
    assert all("0001.jpg" in failure for failure in summary["failures"])
    runs = planned_runs(read_sweep_config(swept.root / "sweep.toml", "3"), no_progress)
    good = [run for run in runs if run.setup.dataset == "good"]
    assert len(results(output)) == len(good) == 2
    for run in good:
        here, there = stored_result(swept.root / "out", run), stored_result(output, run)
        assert here is not None
        assert there is not None
        assert [getattr(there.result, name) for name in NOT_TIMES] == [
            getattr(here.result, name) for name in NOT_TIMES
        ]


def test_bad_input_is_one_line_and_leaves_nothing(swept: Swept, tmp_path: Path) -> None:
    config = tmp_path / "sweep.toml"
    good = f'[sweep]\nseeds = 1\n[[dataset]]\nscene = "{swept.root}/scene.h5"\n'
    cases = {
        good + 'path = "nowhere"\n': "nowhere: does not exist",
        good + f'path = "{swept.root}/good"\nodometry = "no.txt"\n': "good/no.txt",
        good + f'path = "{swept.root}/good"\nodometry = "none"\n': "none: is missing: a planar",
        good + f'path = "{ELEVATORS}/map/rgb"\n': "groundtruth.txt: is missing: a sweep measures",
        good.replace("scene.h5", "x.h5") + f'path = "{swept.root}/good"\n': "x.h5",
        good: "data set 1: path is missing",
    }
    for text, reason in cases.items():
        config.write_text(text, encoding="utf-8")
        outcome = lfnav("sweep", config, "-o", tmp_path / "out")
        assert (outcome.code, outcome.out) == (1, ""), text
        assert outcome.err.startswith("lfnav: ")
        assert outcome.err.count("\n") == 1
        assert reason in outcome.err
    config.write_text(good + f'path = "{swept.root}/good"\n', encoding="utf-8")
    for options, reason in {
        ("--processes", "0"): "0 processes",
        ("--seeds", "9-3"): "seeds '9-3'",
    }.items():
        outcome = lfnav("sweep", config, "-o", tmp_path / "out", *options)
        assert (outcome.code, outcome.err.count("\n")) == (1, 1)
        assert reason in outcome.err
    (tmp_path / "full").mkdir()
    (tmp_path / "full/thesis.tex").write_text("my thesis")
    outcome = lfnav("sweep", config, "-o", tmp_path / "full")
    assert "full: will not be overwritten" in outcome.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["full", "sweep.toml"]
