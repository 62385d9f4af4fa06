"""Stored results of a sweep: one JSON file for each finished run, named after the run's key."""

import json
import logging
from dataclasses import dataclass
from pathlib import Path

from pipelines.artifacts.atomic import write_text
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.file_content import is_file
from pipelines.artifacts.json_fields import JsonFields, read_json_object
from pipelines.experiments.sweep_result import RunResult
from pipelines.experiments.sweep_run import SweepRun

RUN_FOLDER = "runs"
FORMAT = "lfnav sweep run"
MAX_RESULT_BYTES = 1024**2

_log = logging.getLogger(__name__)


def result_path(folder: Path, run: SweepRun) -> Path:
    """Path of a run's stored result."""
    return folder / RUN_FOLDER / f"{run.key}.json"


@dataclass(frozen=True)
class StoredResult:
    """The stored result of a finished run.

    Attributes:
        result: the result.
        program: ``program_hash`` of the program that computed it.
    """

    result: RunResult
    program: str


def save_result(folder: Path, run: SweepRun, result: RunResult, program: str) -> None:
    """Stores a result; the file appears whole or not at all.

    Args:
        folder: of the sweep.
        run: the run's inputs.
        result: the run's result.
        program: ``program_hash`` of the program that computed it.

    Raises:
        InputError: the file cannot be written.
    """
    content = {
        "format": FORMAT,
        "key": run.key,
        "program": program,
        "seed": run.seed,
        "inputs": dict(run.inputs),
        "settings": run.settings.to_dict(),
        "result": result.to_dict(),
    }
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    write_text(result_path(folder, run), text, overwrite=True)


def stored_result(folder: Path, run: SweepRun) -> StoredResult | None:
    """The stored result of a run; None where there is no intact one."""
    path = result_path(folder, run)
    if not is_file(path):
        return None
    try:
        content = read_json_object(path, MAX_RESULT_BYTES)
        content.choice("format", (FORMAT,))
        content.choice("key", (run.key,))
        result = JsonFields(path, content.get("result", dict), "result.")
        return StoredResult(RunResult.of_json(result), content.get("program", str))
    except InputError as error:
        _log.warning("%s; the run is repeated", error)
        return None
