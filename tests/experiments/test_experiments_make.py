"""``make experiments`` rebuilds what follows from a change, and nothing else.

Runs the real Makefile on a small copy with a stand-in for ``lfnav`` that notes how it is called.
"""

import os
import shutil
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipelines.experiments.disturbed_sequences import disturbances
from pipelines.experiments.sweep_config import read_sweep_config

ROOT = Path(__file__).resolve().parents[2]

# Shell, since starting Python fifty times would be most of the time that these tests take.
STAND_IN = """#!/bin/sh
echo "$*" >> calls.log
command=$1
while [ "$1" != -o ]; do shift; done
output=$2
case $command in
    reconstruct) output=$output/reconstruction.json ;;
    report) output=$output/report.html ;;
    sweep | view-dependence) output=$output/table.md ;;
    robustness) output=$output/disturbed.json ;;
    trust) output=$output/table.md ;;
    troubles) output=$output/troubles.json ;;
esac
mkdir -p "$(dirname "$output")"
echo made > "$output"
"""

# Sweeps find out by themselves what is left to do, and are asked each time.
SWEEPS = ["sweep"] * 7

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="needs make")


class Workspace:
    """A copy of the Makefile, the settings and the shape of the sample data."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.stand_in = root / "lfnav"

    def fill(self) -> None:
        """Writes the inputs."""
        root = self.root
        shutil.copy(ROOT / "Makefile", root)
        shutil.copytree(ROOT / "experiments", root / "experiments")
        for part in ("elevators/map", "elevators/test", "workshop/map", "workshop/test"):
            folder = root / "sample_data" / part
            (folder / "rgb").mkdir(parents=True)
            names = ["camera.toml", "rgb.txt", "odometry.txt", "groundtruth.txt"]
            for name in [*names, "odometry_perturbed.txt", "rgb/0000.jpg", "rgb/0001.jpg"]:
                (folder / name).write_text("input")
        self.stand_in.write_text(STAND_IN)
        self.stand_in.chmod(self.stand_in.stat().st_mode | stat.S_IXUSR)
        self.age_everything()

    def age_everything(self) -> None:
        """Moves all files into the past, keeping their order, so that no clock tick is needed."""
        files = [path for path in self.root.rglob("*") if path.is_file()]
        for path in files:
            state = path.stat()
            os.utime(path, ns=(state.st_atime_ns - 10**12, state.st_mtime_ns - 10**12))

    def make(self, *arguments: str, target: str = "experiments") -> list[str]:
        """Runs ``make``, and returns the calls of lfnav that it made."""
        log = self.root / "calls.log"
        log.unlink(missing_ok=True)
        # MAKEFLAGS of the make that runs these tests would change what this one does.
        environment = {
            name: value
            for name, value in os.environ.items()
            if name not in {"MAKEFLAGS", "MAKELEVEL", "MFLAGS"}
        }
        overrides = [f"LFNAV={self.stand_in}", "STAMP=", f"VENV_PYTHON={sys.executable}"]
        overrides.append(f"VIEW_DEPENDENCE={self.stand_in} view-dependence")
        overrides.append(f"ROBUSTNESS={self.stand_in} robustness")
        overrides.append(f"TROUBLE={self.stand_in} troubles")
        overrides.append(f"TRUST={self.stand_in} trust")
        result = subprocess.run(
            ["make", target, *overrides, *arguments],
            cwd=self.root,
            env=environment,
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert result.returncode == 0, result.stderr
        return log.read_text().splitlines() if log.exists() else []

    def change(self, name: str) -> None:
        """Gives a file a newer time than everything that was made."""
        path = self.root / name
        assert path.is_file(), name
        self.age_everything()
        now = time.time_ns()
        os.utime(path, ns=(now, now))


@pytest.fixture(scope="module")
def built_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    workspace = Workspace(tmp_path_factory.mktemp("workspace"))
    workspace.fill()
    calls = workspace.make()
    # 2 maps and 2 models, and the same at true poses; disturbed drives; the sweeps; 2 runs with a
    # report each; the study of appearance.
    assert len(calls) == 4 + 4 + 1 + len(SWEEPS) + 2 * 2 + 1
    return workspace.root


@pytest.fixture
def built(built_once: Path, tmp_path: Path) -> Workspace:
    root = tmp_path / "workspace"
    shutil.copytree(built_once, root)
    return Workspace(root)


def commands(calls: list[str]) -> list[str]:
    return sorted(call.split()[0] for call in calls)


def test_nothing_changed_makes_nothing(built: Workspace) -> None:
    calls = built.make()
    assert commands(calls) == SWEEPS
    assert {call.split(" -o ")[1] for call in calls} == {
        f"out/experiments/{name}"
        for name in (
            "every-start",
            "strategies",
            "robustness",
            "true-poses",
            "proposals",
            "particles",
            "pixels",
        )
    }


def test_sweeps_come_after_their_scenes(built: Workspace) -> None:
    built.change("sample_data/workshop/map/rgb/0001.jpg")
    calls = built.make()
    assert commands(calls) == sorted(["model", "reconstruct"] * 2 + SWEEPS)
    sweeps = [number for number, call in enumerate(calls) if call.startswith("sweep")]
    models = {call.split(" -o ")[1].split()[0]: n for n, call in enumerate(calls)}
    assert all("workshop" in call for call in calls if not call.startswith("sweep"))
    assert models["out/experiments/workshop/scene.h5"] < sweeps[0]
    true_poses = models["out/experiments/true-poses"]
    assert models["out/experiments/true-maps/workshop/scene.h5"] < true_poses


def test_a_map_image_rebuilds_its_set_only(built: Workspace) -> None:
    built.change("sample_data/elevators/map/rgb/0001.jpg")
    calls = built.make()
    expected = {"reconstruct": 2, "model": 2, "localize": 2, "report": 2, "sweep": len(SWEEPS)}
    expected["view-dependence"] = 1
    assert commands(calls) == sorted(name for name, n in expected.items() for _ in range(n))
    assert not [call for call in calls if "workshop" in call]


def test_a_test_image_leaves_the_map_alone(built: Workspace) -> None:
    built.change("sample_data/elevators/test/rgb/0000.jpg")
    expected = {"localize": 2, "report": 2, "view-dependence": 1, "sweep": len(SWEEPS)}
    expected["robustness"] = 1
    calls = built.make()
    assert commands(calls) == sorted(name for name, n in expected.items() for _ in range(n))
    built.change("sample_data/workshop/test/rgb/0000.jpg")
    assert commands(built.make()) == SWEEPS


def test_an_input_of_one_run_makes_that_run_only(built: Workspace) -> None:
    built.change("sample_data/elevators/test/odometry_perturbed.txt")
    calls = built.make()
    assert commands(calls) == ["localize", "report", "robustness", *SWEEPS]
    assert all("/figure-7/" in call for call in calls if call.startswith(("localize", "report")))


def test_the_settings_of_a_model_do_not_touch_the_reconstruction(built: Workspace) -> None:
    built.change("experiments/settings/elevators/model.flags")
    kinds = commands(built.make())
    assert "reconstruct" not in kinds
    assert kinds.count("model") == 1
    assert kinds.count("localize") == 2


def test_settings_reach_the_command(built: Workspace) -> None:
    name = "experiments/settings/elevators/figures.flags"
    (built.root / name).write_text("# a comment\n--particles 77\n--cost zncc\n")
    built.change(name)
    calls = [call for call in built.make() if call.startswith("localize")]
    assert len(calls) == 2
    assert all("--particles 77 --cost zncc" in call for call in calls)


def test_seeds_reach_the_sweeps(built: Workspace) -> None:
    assert not [call for call in built.make() if "--seeds" in call]
    calls = built.make("SEEDS=0-99")
    assert commands(calls) == SWEEPS
    assert all("--seeds 0-99" in call for call in calls)


def test_the_configs_of_the_sweeps_are_what_they_are_given(built: Workspace) -> None:
    for call in built.make():
        config, output = call.split()[1], call.split()[3]
        assert (ROOT / config).is_file()
        assert Path(config).stem == Path(output).name
        content = read_sweep_config(ROOT / config)
        disturbed = {ROOT / "out/experiments/disturbed" / kind.name for kind in disturbances(20)}
        # Drives that are made have the odometry files of the recorded one.
        for data in content.datasets:
            is_made = data.path.resolve() in disturbed
            folder = ROOT / "sample_data/elevators/test" if is_made else data.path
            files = [folder / path.name for path in data.odometry if path is not None]
            assert len(files) == len(data.odometry)
            assert all(path.is_file() for path in files)
        scenes = {data.scene.resolve().relative_to(ROOT) for data in content.datasets}
        assert all((built.root / scene).is_file() for scene in scenes)


def test_ground_truth_is_no_input_of_a_map_that_is_localized_in(built: Workspace) -> None:
    built.change("sample_data/elevators/map/groundtruth.txt")
    calls = built.make()
    assert commands(calls) == ["model", "reconstruct", *SWEEPS, "view-dependence"]
    maps = [call for call in calls if call.startswith(("model", "reconstruct"))]
    assert all(" -o out/experiments/true-maps/elevators/" in call for call in maps)


def test_the_parts_of_a_study_are_its_own(built: Workspace) -> None:
    built.change("experiments/settings/elevators/doors.toml")
    assert commands(built.make()) == [*SWEEPS, "view-dependence"]


def test_the_study_of_trust_is_made_on_demand(built: Workspace) -> None:
    table = "out/experiments/trust/table.md"
    calls = built.make("SEEDS=0-1", target=table)
    assert commands(calls) == ["troubles", "trust"]
    assert "trust experiments/conditions/trust.toml -o out/experiments/trust" in calls[-1]
    assert calls[-1].endswith("--seeds 0-1")
    # A program that has changed shows in no file's time: asked for, it is made.
    assert commands(built.make(target=table)) == ["trust"]
    (days,) = built.make("DAYS=some/folder", target="out/experiments/days/table.md")
    assert days.startswith("trust experiments/conditions/days.toml -o out/experiments/days")
    assert days.endswith("--data some/folder")


def test_a_failed_stage_stops_and_is_tried_again(built: Workspace) -> None:
    built.change("sample_data/elevators/map/odometry.txt")
    with pytest.raises(AssertionError, match="Error"):
        built.make("LFNAV=false")
    assert commands(built.make()).count("reconstruct") == 1
