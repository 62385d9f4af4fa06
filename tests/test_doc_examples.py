"""The Python examples in the documentation run as they stand, one after the other."""

import ast
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import lfnav
from tests.chain_samples import ELEVATORS, map_elevators
from tests.serve_samples import running_server

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = sorted(
    path
    for path in [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("*/README.md")]
    if "```python" in path.read_text()
)
# On the robot's floor: where a simulated one stands in the example of docking.
NEAR_THE_GOAL = (-1.0, -2.1, 1.5)


def examples(document: Path) -> list[str]:
    """The Python of a document, each block at its line, so that errors name it."""
    text = document.read_text()
    found = re.finditer(r"^```python\n(.*?)^```", text, re.M | re.S)
    return ["\n" * text[: match.start(1)].count("\n") + match.group(1) for match in found]


def run(document: Path, blocks: list[str], names: dict[str, Any]) -> dict[str, Any]:
    for block in blocks:
        exec(compile(block, str(document), "exec"), names)  # noqa: S102
    return names


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder of the examples."""
    (tmp_path / "sample_data").symlink_to(ELEVATORS.parent)
    monkeypatch.chdir(tmp_path)
    return tmp_path


class Drive:
    """What stands for the robot in the examples: the first images of the sample data."""

    def __init__(self, count: int) -> None:
        self.data = lfnav.load_dataset(ELEVATORS / "test")
        self.count, self.next = count, 0

    def is_running(self) -> bool:
        return self.next < self.count

    def image(self) -> Any:
        self.next += 1
        return self.data.read_image(self.next - 1)

    def increment(self) -> Any:
        assert self.data.odometry is not None
        poses = self.data.odometry.poses
        before, now = max(0, self.next - 2), self.next - 1
        return lfnav.PLANAR.increment(poses[before], poses[now])


def test_there_are_examples() -> None:
    assert {path.name for path in DOCUMENTS} >= {"library.md", "docking.md"}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_examples_import_nothing_of_lfnav_but_its_public_names(document: Path) -> None:
    for block in examples(document):
        for node in ast.walk(ast.parse(block)):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [str(node.module)]
                if node.module == "lfnav":
                    assert {alias.name for alias in node.names} <= set(lfnav.__all__)
            assert not any(re.match(r"(pipelines|lfnav_cli|lfnav\.)", name) for name in names)


def test_the_library(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive = Drive(4)
    names = run(
        ROOT / "docs" / "library.md",
        examples(ROOT / "docs" / "library.md"),
        {
            "robot_is_running": drive.is_running,
            "grab_image": drive.image,
            "wheels_since_last": drive.increment,
        },
    )
    assert not drive.is_running()
    assert names["frame"].status == "tracking"
    assert "confidence 0." in capsys.readouterr().out
    assert len(names["localizers"]) == 3
    assert names["evaluation"].success
    assert names["rendering"].coverage > 0.5
    assert {path.name for path in folder.iterdir()} >= {"recon", "scene.h5", "run.h5"}


def test_serving(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("fastapi", reason="no fastapi: pip install 'lfnav[serve]'")
    document = ROOT / "docs" / "serve.md"
    scene = map_elevators(folder, "--plane", "0,1,0,0")
    with running_server("serve", scene, "--port", "0") as server:

        def here(text: str) -> str:
            return text.replace("8765", str(server.port))

        names = run(document, [here(block) for block in examples(document)], {})
        lines = capsys.readouterr().out.splitlines()
        assert len(lines) == 3
        truth = lfnav.load_dataset(ELEVATORS / "test").groundtruth
        assert truth is not None
        found = [float(number) for number in lines[-1].split()]
        assert np.allclose(found, lfnav.PLANAR.states(truth.poses[2]), atol=0.05)
        assert names["answer"]["image"] == 2
        shell = re.findall(r"^```sh\n(.*?)^```", document.read_text(), re.M | re.S)
        made = json.loads(curl(here(shell[0])))
        commands = here(shell[1]).replace("SESSION", made["session"])
        assert json.loads(curl(commands))["status"] == "tracking"
        assert server.ask("GET", "/sessions").content == []


def curl(commands: str) -> str:
    """What a shell's commands print."""
    if shutil.which("curl") is None:
        pytest.skip("no curl: apt-get install curl")
    done = subprocess.run(["bash", "-ec", commands], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def serial_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for the library of the serial line, which only a robot needs."""
    monkeypatch.setitem(sys.modules, "serial", ModuleType("serial"))


@pytest.mark.slow
def test_docking(folder: Path, serial_line: None, monkeypatch: pytest.MonkeyPatch) -> None:
    document = ROOT / "docs" / "docking.md"
    driver, program = examples(document)
    own = run(document, [driver], {})["MyRobot"]
    assert isinstance(own.camera, lfnav.Camera)
    assert own.base_from_camera.shape == (4, 4)
    assert all(callable(getattr(own, name)) for name in ("take_image", "move", "stop"))

    lfnav.reconstruct(ELEVATORS / "map", "map", lfnav.ReconstructSettings(method="odometry"))
    lfnav.model("map", "scene.h5", lfnav.ModelSettings(plane=(0.0, 1.0, 0.0, 0.0)))
    scene = lfnav.load_scene("scene.h5")
    module = ModuleType("my_robot")
    options = lfnav.RobotOptions(true_start=NEAR_THE_GOAL)
    vars(module)["MyRobot"] = lambda: lfnav.robot_named("model:scene.h5", scene, options, 0)
    monkeypatch.setitem(sys.modules, "my_robot", module)
    result = run(document, [program], {})["result"]
    assert result.outcome.kind is lfnav.OutcomeKind.DOCKED
    assert np.allclose(result.docking.goal, [-1.15, -1.65, 1.5708])
    assert lfnav.load_run("dock.h5").docking is not None
