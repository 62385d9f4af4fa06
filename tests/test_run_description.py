"""What ``lfnav info`` says about a run."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from lfnav_cli.common import format_table
from pipelines.localize.description import describe_run
from pipelines.localize.run import Run, save_run
from tests.localize_samples import curved_path, run_along


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
    assert content["status"] == {"global": 0, "tracking": 3, "lost": 0}


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
