"""The study of trust from files to files."""

from pathlib import Path

from pipelines.artifacts.atomic import atomic_folder, check_output
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.stages import Progress
from pipelines.experiments.trust_conditions import TrustConditions
from pipelines.experiments.trust_figure import write_reliability
from pipelines.experiments.trust_study import rows_of
from pipelines.experiments.trust_table import as_json, as_markdown, sums_of

TABLE, VALUES, FIGURE = "table.md", "table.json", "reliability.png"


def study_trust(
    chosen: TrustConditions,
    output: Path,
    *,
    workers: int,
    overwrite: bool,
    progress: Progress,
) -> None:
    """Localizes under many conditions, and writes a table and the reliability diagram.

    Args:
        chosen: the conditions, as ``read_trust_conditions`` has read them.
        output: folder for ``table.md``, ``table.json`` and ``reliability.png``.
        workers: number of processes.
        overwrite: whether the output may be replaced.
        progress: wraps loops to report progress.

    Raises:
        InputError: all conditions are skipped, or the output cannot be written.
        OptionError: an invalid number of workers.
        StageError: the runs of a condition failed.
    """
    if not chosen.conditions:
        raise InputError(
            chosen.path,
            f"all of its conditions are skipped: no data in {chosen.data or 'any folder'}",
            "give the folder with --data",
        )
    check_output(output, overwrite, TABLE)
    rows = rows_of(chosen.conditions, workers=workers, progress=progress)
    with atomic_folder(output, overwrite, TABLE) as folder:
        write_reliability(folder / FIGURE, sums_of(rows) or rows)
        (folder / VALUES).write_text(as_json(rows, chosen.skipped), encoding="utf-8")
        (folder / TABLE).write_text(as_markdown(rows, chosen.skipped), encoding="utf-8")
