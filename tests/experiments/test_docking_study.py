"""The study of dockings: what is docked in which scenes, and how its table counts."""

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.dock_samples import written_scene

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def docking() -> ModuleType:
    spec = importlib.util.spec_from_file_location("docking", ROOT / "experiments" / "docking.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["docking"] = module
    spec.loader.exec_module(module)
    return module


def result(outcome: str, metres: float) -> dict[str, Any]:
    return {
        "outcome": outcome,
        "exit_code": 0 if outcome == "docked" else 15,
        "true_error": {"position_m": metres, "heading_deg": 10.0 * metres},
        "nearest_m": 1.6,
        "steps": 17,
        "seconds": {"total": 10.0, "robot": 6.0, "filter": 3.0},
    }


def test_the_table_counts_what_is_docked_falsely_and_otherwise(docking: Any) -> None:
    found = [result("docked", metres) for metres in (0.01, 0.02, 0.09)]
    found.append(result("view blocked", 0.7))
    line = docking.table_line("omni scene_evening", found)
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert len(cells) == docking.HEADING.splitlines()[0].strip("|").count("|") + 1
    assert cells[0].endswith(", scene_evening")
    assert cells[1:6] == ["3 of 4", "1 view blocked", "1", "2.0 / 9.0 cm", "0.20 / 0.90°"]
    nobody = docking.table_line("omni", [result("view blocked", 0.7)])
    assert "| 0 of 1 | 1 view blocked | 0 | – | – |" in nobody


def test_a_folder_of_scenes_is_docked_in_start_by_start(docking: Any, tmp_path: Path) -> None:
    robot = f"sim:{tmp_path}"
    chosen = docking.tasks(["omni", "black"], robot, ["scene", "scene_side"], 2)
    assert [(task.key, task.number) for task in chosen] == [
        ("omni scene", 0), ("black scene", 0), ("omni scene_side", 0), ("black scene_side", 0),
        ("omni scene", 1), ("omni scene_side", 1),
    ]  # fmt: skip
    assert chosen[0].robot == f"sim:{tmp_path / 'scene'}.xml"
    single = docking.tasks(["omni"], "sim:scene.xml", ["scene", "scene_side"], 1)
    assert [(task.key, task.robot) for task in single] == [("omni", "sim:scene.xml")]


def test_what_was_done_is_not_done_again(
    docking: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = written_scene(tmp_path)
    place = docking.Place(
        (0.3, -1.2, 1.5708), (-0.5, 0.5), (-2.3, -1.8), (-3, 3), docking.wall_distance
    )
    settings = docking.DockSettings(least_distance=0.4, staging_distance=0.5, max_steps=3)
    row = docking.Row("short", settings, place=place, starts=2)
    monkeypatch.setitem(docking.ROWS, "short", row)
    output = tmp_path / "study"
    arguments = [
        str(scene), f"model:{scene}", "-o", str(output), "--rows", "short", "--starts", "1",
        "--camera-width", "48",
    ]  # fmt: skip
    assert docking.main(arguments) == 0
    record = output / "short" / "start-00.json"
    assert json.loads(record.read_text())["outcome"] == "timed out"
    before = record.stat().st_mtime_ns
    assert docking.main([*arguments[:-4], "--starts", "2", *arguments[-2:]]) == 0
    assert record.stat().st_mtime_ns == before
    assert (output / "short" / "start-01.json").is_file()
    assert "| 0 of 2 | 2 timed out | 0 |" in (output / "table.md").read_text()
