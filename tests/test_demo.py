"""``lfnav demo``: every command runs as printed, and ends with two reports."""

from pathlib import Path

import pytest

from lfnav_cli.demo import chain, sample_drive
from pipelines.localize.run import load_run
from tests.chain_samples import ELEVATORS, lfnav


def test_it_ends_with_a_robot_that_is_docked_and_two_reports(tmp_path: Path) -> None:
    folder = tmp_path / "a folder"
    outcome = lfnav("demo", "-o", folder)
    assert outcome.code == 0, outcome.err
    for name in ("report", "dock-report"):
        page = folder / name / "report.html"
        assert page.is_file()
        assert str(page) in outcome.out
    assert {frame.status for frame in load_run(folder / "run.h5").frames} == {"tracking"}
    docking = load_run(folder / "dock.h5").docking
    assert docking is not None
    assert docking.outcome == "docked"
    # Names with blanks are quoted, as a shell needs them.
    assert f"$ lfnav reconstruct {ELEVATORS}/map -o '{folder}/map'" in outcome.out
    again = lfnav("demo", "-o", folder)
    assert again.code == 1
    assert "exists already; use --overwrite" in again.err


def test_a_command_that_fails_ends_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfnav_cli.demo.sample_drive", lambda: tmp_path / "nothing")
    outcome = lfnav("demo", "-o", tmp_path / "out")
    assert outcome.code == 1
    assert "nothing" in outcome.err
    assert outcome.out.count("$ lfnav") == 1


def test_only_who_asks_for_it_overwrites() -> None:
    for overwrite in (False, True):
        commands = chain(sample_drive(), Path("out"), 0, overwrite)
        assert [("--overwrite" in words) for _, words in commands].count(True) == 6 * overwrite


def test_without_the_drive_it_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipelines.__file__", str(tmp_path / "pipelines" / "__init__.py"))
    outcome = lfnav("demo", "-o", tmp_path / "out")
    assert outcome.code == 1
    assert "is missing from this installation" in outcome.err
