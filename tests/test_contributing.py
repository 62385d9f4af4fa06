"""CONTRIBUTING.md is true: its diffs apply and work, its modules and caches are there."""

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import lfnav
import pipelines.native
from tests.chain_samples import ELEVATORS, first_frames

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text()
# Its examples, in their order.
LIKELIHOOD, MOTION, IMPORTER, ROBOT = DIFFS = re.findall(r"^```diff\n(.*?)^```", TEXT, re.M | re.S)
USES_THE_LIKELIHOOD = """
from lfnav import LocalizerSettings, load_dataset, load_scene, localize_dataset
from my_likelihood import MedianDifference
scene, drive = load_scene("scene.h5"), load_dataset("drive")
model = MedianDifference.of_scene(scene, drive.base_from_camera, LocalizerSettings())
run = localize_dataset(scene, drive, model=model)
print(*(frame.status for frame in run.frames))
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of what the diffs change, with the core that this Python has."""
    if shutil.which("git") is None:
        pytest.skip("no git, which applies the diffs")
    copy = tmp_path / "tree"
    for package in ("lfnav", "lfnav_cli", "pipelines"):
        shutil.copytree(ROOT / package, copy / package, ignore=shutil.ignore_patterns("__pyc*"))
    shutil.copy(str(pipelines.native.__file__), copy / "pipelines")
    for name in re.findall(r"^--- a/(tests/.+)$", "".join(DIFFS), re.M):
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, copy / name)
    return copy


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The lobby's scene model."""
    folder = tmp_path_factory.mktemp("scene")
    settings = lfnav.ReconstructSettings(method="odometry")
    lfnav.reconstruct(ELEVATORS / "map", folder / "map", settings)
    plane = lfnav.ModelSettings(plane=(0.0, 1.0, 0.0, 0.0))
    lfnav.model(folder / "map", folder / "scene.h5", plane)
    return folder / "scene.h5"


def applied(tree: Path, diff: str) -> Path:
    # Not a part of a repository that the copy may happen to lie in.
    alone = {**os.environ, "GIT_CEILING_DIRECTORIES": str(tree.parent)}
    subprocess.run(["git", "apply", "-"], cwd=tree, input=diff, text=True, env=alone, check=True)
    return tree


def python(tree: Path, *arguments: str | Path) -> str:
    """What Python says in a tree, whose packages win over those that are installed."""
    others = [path for path in sys.path if path and Path(path) != ROOT]
    search = os.pathsep.join([str(tree), *others])
    # -S: an editable installation would lead to the packages that it was made from.
    done = subprocess.run(
        [sys.executable, "-S", *map(str, arguments)],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": search},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def command(tree: Path, *arguments: str | Path) -> str:
    return python(tree, "-m", "lfnav_cli.main", *arguments)


def test_a_likelihood(tree: Path, scene: Path) -> None:
    added = [line for line in LIKELIHOOD.splitlines() if re.match(r"\+(?!\+\+)", line)]
    assert len(added) <= 20
    shutil.copy(scene, applied(tree, LIKELIHOOD) / "scene.h5")
    first_frames(ELEVATORS / "test", tree / "drive", 4)
    statuses = python(tree, "-c", USES_THE_LIKELIHOOD).split()
    assert len(statuses) == 4
    assert statuses[-1] == "tracking"


def test_a_motion_model(tree: Path) -> None:
    printed = command(applied(tree, MOTION), "localize", "--print-config", "--alpha5", "0.02")
    assert "alpha5 = 0.02" in printed
    tried = (
        "import numpy as np; from lfnav import PLANAR, MotionModel;"
        "print(MotionModel(0, 0, 0, 0, 0, 0, alpha5=0.5).standard_deviations("
        "PLANAR, np.array([0.6, 0.8, 2.0])))"
    )
    assert python(tree, "-c", tried).strip() == "(0.0, 1.0)"


def test_an_importer(tree: Path) -> None:
    folder = applied(tree, IMPORTER) / "walk"
    folder.mkdir()
    shutil.copy(ELEVATORS / "test" / "rgb" / "0000.jpg", folder / "a.jpg")
    (folder / "frames.csv").write_text("milliseconds,name\n1500,a.jpg\n")
    assert "frames (frames.csv)" in command(tree, "import", "walk", "-o", "place")
    assert (tree / "place" / "rgb.txt").read_text().splitlines()[1:] == ["1.500000000 rgb/a.jpg"]


def test_a_robot(tree: Path, scene: Path) -> None:
    shutil.copy(scene, applied(tree, ROBOT) / "scene.h5")
    robot = ("dock", "scene.h5", "--robot", "my_robot:PerfectRobot")
    assert "in order" in command(tree, *robot, "--dry-run")


@pytest.mark.slow
def test_a_robot_that_docks(tree: Path, scene: Path) -> None:
    shutil.copy(scene, applied(tree, ROBOT) / "scene.h5")
    robot = ("dock", "scene.h5", "--robot", "my_robot:PerfectRobot")
    said = command(tree, *robot, "--goal=-1.15,-1.65,90", "-o", "dock.h5")
    assert re.search(r"outcome +docked", said)


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`([a-z_]+/[\w./-]+\.\w+)`", TEXT))))
def test_what_it_names_is_there(name: str) -> None:
    assert (ROOT / name).is_file()


def is_cached(node: ast.AST) -> bool:
    """Whether a function keeps what it returned."""
    decorators = getattr(node, "decorator_list", [])
    return any(re.search(r"\b(lru_)?cache|cached_", ast.unparse(item)) for item in decorators)


def test_every_function_that_caches_is_in_the_table() -> None:
    table = TEXT[TEXT.index("### What is kept") : TEXT.index("## How code is written here")]
    paths = [path for path in (ROOT / "pipelines").rglob("*.py") if "cache" in path.read_text()]
    caching = {
        path.relative_to(ROOT).as_posix()
        for path in paths
        if any(is_cached(node) for node in ast.walk(ast.parse(path.read_text())))
    }
    assert "pipelines/localize/confidence.py" in caching
    assert {name for name in caching if f"`{name}`" not in table} == set()


def test_hooks_before_a_commit_are_the_checks_of_make_lint() -> None:
    hooks = re.findall(r"^ +entry: (.+)$", (ROOT / ".pre-commit-config.yaml").read_text(), re.M)
    lint = (ROOT / "Makefile").read_text().replace("$(VENV_PYTHON)", ".venv/bin/python")
    lint = lint.replace("$(BIN)", ".venv/bin").replace("$(VENV)", ".venv")
    assert len(hooks) == 5
    assert [hook for hook in hooks if f"\t{hook}" not in lint] == []
