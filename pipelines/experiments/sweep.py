"""The stage ``sweep``: many runs of the filter, summarized in a table and figures."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipelines.artifacts.atomic import check_output, write_text
from pipelines.artifacts.cluster import dask_needed
from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.file_content import read_text_file
from pipelines.artifacts.processes import processor_count
from pipelines.artifacts.settings_file import Choices
from pipelines.artifacts.stages import Progress
from pipelines.artifacts.toml_file import MAX_TOML_BYTES
from pipelines.experiments.sweep_config import NO_CHOICES, read_sweep_config
from pipelines.experiments.sweep_inputs import program_hash
from pipelines.experiments.sweep_plan import planned_runs
from pipelines.experiments.sweep_plots import write_plots
from pipelines.experiments.sweep_result import RunResult
from pipelines.experiments.sweep_run import Outcome, SweepRun
from pipelines.experiments.sweep_store import save_result, stored_result
from pipelines.experiments.sweep_tables import (
    Line,
    as_csv,
    as_json,
    as_markdown,
    lines_of,
    rows_for_people,
)
from pipelines.experiments.sweep_workers import run_locally

# Copy of the config; a folder with this file is a sweep's.
CONFIG_COPY = "sweep.toml"
TABLE = "table"

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SweepSummary:
    """Summary of a sweep.

    Attributes:
        output: the folder.
        lines: lines of the table.
        runs: number of runs.
        kept: number of runs whose stored results were reused.
        failures: one line for each run that failed.
    """

    output: Path
    lines: tuple[Line, ...]
    runs: int
    kept: int
    failures: tuple[str, ...]

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        return rows_for_people(self.lines)

    def to_dict(self) -> dict[str, Any]:
        """The same for programs, with all figures."""
        return {
            "output": str(self.output),
            "runs": self.runs,
            "finished_before": self.kept,
            "failures": list(self.failures),
            "lines": [line.to_dict() for line in self.lines],
        }


def sweep(
    config_path: Path,
    output: Path,
    *,
    seeds: str | None,
    options: Choices = NO_CHOICES,
    scheduler: str | None,
    processes: int | None,
    overwrite: bool,
    progress: Progress,
) -> SweepSummary:
    """Executes all runs of a config that are not finished, and writes tables and figures of all.

    Args:
        config_path: TOML file of the format that ``sweep_config`` describes.
        output: folder; that of an earlier sweep is continued. Gets ``runs/`` with a file for each
            finished run, ``table.csv``, ``table.json``, ``table.md``, and figures.
        seeds: seeds that replace those in the config; None: those in the config.
        options: settings of all runs; they win over those of the config.
        scheduler: address of a Dask scheduler; None: this machine executes the runs.
        processes: number of processes on this machine; None: one a processor.
        overwrite: whether finished runs are repeated.
        progress: wraps loops to report progress.

    Raises:
        InputError: the config, a scene or a data set cannot be used, or the output not be written.
        OptionError: no processes, invalid seeds, an option that the config varies, or no scheduler
            at the address.
    """
    if processes is not None and processes < 1:
        raise OptionError(f"{processes} processes cannot do any work; give at least 1")
    config = read_sweep_config(config_path, seeds, options)
    check_output(output, overwrite=True, marker=CONFIG_COPY)
    runs = planned_runs(config, progress)
    text = read_text_file(config_path, MAX_TOML_BYTES)
    write_text(output / CONFIG_COPY, text, overwrite=True)
    program = program_hash()
    found = {} if overwrite else _stored(output, runs, program)
    results = dict(found)
    failures = []
    # A run may belong to several lines: PnP does not depend on what they differ in.
    missing = list({run.key: run for run in reversed(runs) if run.key not in found}.values())
    outcomes = _outcomes(missing[::-1], scheduler, processes)
    for run, outcome in progress(outcomes, "runs", len(missing)):
        if outcome.result is not None:
            save_result(output, run, outcome.result, program)
            results[run.key] = outcome.result
        else:
            failures.append(f"{_name(run)}: {outcome.failure}")
            _log.warning("a run failed: %s", failures[-1])
    lines = lines_of((run.setup, results.get(run.key)) for run in runs)
    _write(output, lines, failures)
    kept = sum(run.key in found for run in runs)
    return SweepSummary(output, lines, len(runs), kept, tuple(failures))


def _stored(output: Path, runs: Sequence[SweepRun], program: str) -> dict[str, RunResult]:
    """Results of finished runs; logs a warning where another program version computed them."""
    found = ((run.key, stored_result(output, run)) for run in runs)
    stored = {key: item for key, item in found if item is not None}
    others = sum(item.program != program for item in stored.values())
    if others:
        # Not repeated automatically: an edit of a comment would cost hours.
        text = "%s: %d of %d finished runs were made by another version of the program; "
        _log.warning(text + "--overwrite repeats all runs", output, others, len(stored))
    return {key: item.result for key, item in stored.items()}


def _outcomes(
    runs: Sequence[SweepRun], scheduler: str | None, processes: int | None
) -> Iterator[tuple[SweepRun, Outcome]]:
    """Executes the runs, on this machine or on a cluster.

    Raises:
        OptionError: Dask is not installed, or no scheduler answers.
    """
    if scheduler is None:
        return run_locally(runs, processes or processor_count())
    with dask_needed():
        from pipelines.experiments.sweep_cluster import run_on_cluster
    return run_on_cluster(runs, scheduler)


def _write(output: Path, lines: Sequence[Line], failures: Sequence[str]) -> None:
    """Writes tables and figures; each file appears whole or not at all."""
    write_text(output / f"{TABLE}.csv", as_csv(lines), overwrite=True)
    write_text(output / f"{TABLE}.json", as_json(lines, failures), overwrite=True)
    write_plots(output, lines)
    # Last: for make, this file says that all are done.
    write_text(output / f"{TABLE}.md", as_markdown(lines, failures), overwrite=True)


def _name(run: SweepRun) -> str:
    """A run's name in messages."""
    setup = run.setup
    parts = [setup.dataset, setup.odometry, setup.contender]
    if setup.likelihood is not None:
        parts += [setup.likelihood, f"{setup.particles} particles"]
    return f"{', '.join(parts)}, seed {run.seed}"
