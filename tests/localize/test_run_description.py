"""What ``lfnav info`` says about a run."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from lfnav_cli.common import format_table
from pipelines.localize.description import describe_run, notes_of
from pipelines.localize.run import Run, save_run
from tests.localize_samples import curved_path, run_along, spatial_run


def described(tmp_path: Path, run: Run) -> tuple[str, dict[str, object]]:
    save_run(tmp_path / "run.h5", run, overwrite=False)
    summary = describe_run(tmp_path / "run.h5")
    return format_table(summary.table()), json.loads(json.dumps(summary.to_dict(), allow_nan=False))


def test_a_run_is_described_by_its_last_estimate_and_settings(tmp_path: Path) -> None:
    states = curved_path(3)
    states[2] = [1.25, -0.5, np.pi / 2.0]
    table, content = described(tmp_path, run_along(states))
    assert "mode: x 1.250 m, y -0.500 m, heading 90.0 deg" in table
    assert "setting strategy" in table
    assert content["frames"] == 3
    assert content["particles"] == [30, 30, 30]
    assert content["status"] == {"global": 0, "tracking": 3, "blind": 0, "stale": 0, "lost": 0}


def test_a_run_that_ends_lost_gets_no_last_estimate(tmp_path: Path) -> None:
    states = curved_path(3)
    states[2] = np.nan
    table, _ = described(tmp_path, run_along(states))
    assert "none (lost)" in table


def test_a_run_that_was_lost_throughout_is_described_too(tmp_path: Path) -> None:
    run = run_along(curved_path(2))
    lost = tuple(replace(frame, estimates={}, status="lost") for frame in run.frames)
    table, content = described(tmp_path, replace(run, frames=lost))
    assert "lost 2" in table
    assert content["estimates"] == []


def test_a_spatial_run_is_described_with_its_rotation(tmp_path: Path) -> None:
    table, content = described(tmp_path, spatial_run(2))
    # The last of the path: (1, -0.5, 1.5) and (0.3 sin 3, 1.7, 1) in degrees.
    expected = "refined: x 1.000 m, y -0.500 m, z 1.500 m, rotation vector 2.4, 97.4, 57.3 deg"
    assert expected in table
    assert content["status"] == {"global": 0, "tracking": 2, "blind": 0, "stale": 0, "lost": 0}


def test_a_run_that_ends_blind_says_so(tmp_path: Path) -> None:
    run = run_along(curved_path(2))
    blind = replace(run.frames[1], status="blind", estimates={"max_weight": np.zeros(3)})
    table, _ = described(tmp_path, replace(run, frames=(run.frames[0], blind)))
    assert "none (blind)" in table
    assert "tracking 1, blind 1" in table


def test_notes_are_a_line_each_whatever_a_file_holds(tmp_path: Path) -> None:
    run = replace(run_along(curved_path(2)), provenance={"notes": ["the ground\n  slopes"]})
    table, content = described(tmp_path, run)
    assert content["notes"] == ["the ground slopes"]
    assert table.splitlines()[-1].split("  ")[0] == "note"
    assert notes_of(replace(run, provenance={"notes": 3})) == ()
