"""Finished runs of a sweep on disk: a small JSON file each, named after the run's key."""

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
    """Where a run's result is kept."""
    return folder / RUN_FOLDER / f"{run.key}.json"


@dataclass(frozen=True)
class Kept:
    """A result of a run that was finished before.

    Attributes:
        result: what it came to.
        program: ``program_hash`` of what made it.
    """

    result: RunResult
    program: str


def save_result(folder: Path, run: SweepRun, result: RunResult, program: str) -> None:
    """Keeps a result, whole or not at all.

    Args:
        folder: of the sweep.
        run: what went in.
        result: what came out.
        program: ``program_hash`` of what made it.

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


def kept_result(folder: Path, run: SweepRun) -> Kept | None:
    """The result of a run that was finished before; None where there is none that is intact."""
    path = result_path(folder, run)
    if not is_file(path):
        return None
    try:
        content = read_json_object(path, MAX_RESULT_BYTES)
        content.choice("format", (FORMAT,))
        content.choice("key", (run.key,))
        result = JsonFields(path, content.get("result", dict), "result.")
        return Kept(RunResult.of_json(result), content.get("program", str))
    except InputError as error:
        _log.warning("%s; the run is made again", error)
        return None
