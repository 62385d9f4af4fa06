"""The study of trust from files to files."""

from collections.abc import Mapping
from pathlib import Path

from pipelines.artifacts.atomic import atomic_folder, check_output
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.stages import Progress
from pipelines.experiments.trust_conditions import TrustConditions, read_trust_conditions
from pipelines.experiments.trust_figure import write_reliability
from pipelines.experiments.trust_study import rows_of
from pipelines.experiments.trust_table import as_json, as_markdown, sums_of

TABLE, VALUES, FIGURE = "table.md", "table.json", "reliability.png"


def study_trust(
    conditions_path: Path,
    output: Path,
    *,
    data: Path | None,
    scenes: Mapping[str, Path],
    seeds: str | None,
    workers: int,
    overwrite: bool,
    progress: Progress,
) -> TrustConditions:
    """Localizes under many conditions, and writes a table and the reliability diagram.

    Args:
        conditions_path: TOML file of the format that ``trust_conditions`` describes.
        output: folder for ``table.md``, ``table.json`` and ``reliability.png``.
        data: folder of the sequences given by ``data``; None: their conditions are skipped.
        scenes: scene models that replace those of the same name in the file.
        seeds: seeds that replace those in the file; None: those in the file.
        workers: number of processes.
        overwrite: whether the output may be replaced.
        progress: wraps loops to report progress.

    Returns:
        The conditions that were run and those that were skipped.

    Raises:
        InputError: a file cannot be used, all conditions are skipped, or the output cannot be
            written.
        OptionError: invalid seeds, scenes or number of workers.
        StageError: the runs of a condition failed.
    """
    chosen = read_trust_conditions(conditions_path, data=data, scenes=scenes, seeds=seeds)
    if not chosen.conditions:
        raise InputError(
            conditions_path,
            f"all of its conditions are skipped: no data in {data or 'any folder'}",
            "give the folder with --data",
        )
    check_output(output, overwrite, TABLE)
    rows = rows_of(chosen.conditions, workers=workers, progress=progress)
    with atomic_folder(output, overwrite, TABLE) as folder:
        write_reliability(folder / FIGURE, sums_of(rows) or rows)
        (folder / VALUES).write_text(as_json(rows, chosen.skipped), encoding="utf-8")
        (folder / TABLE).write_text(as_markdown(rows, chosen.skipped), encoding="utf-8")
    return chosen
