"""``lfnav sweep``: many runs, one table."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfnav_cli.common import common_options, json_option, overwrite_option, print_summary
from lfnav_cli.setting_options import SettingsCommand, localizer_entries, setting_options

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pipelines.artifacts.stages import Progress


@click.command("sweep", cls=SettingsCommand)
@click.argument("config", metavar="CONFIG.toml", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    metavar="DIR",
    required=True,
    type=click.Path(path_type=Path),
    help="Folder to write; one of an earlier sweep is continued.",
)
@click.option("--seeds", metavar="A-B|N,N,...", help="Seeds instead of those in the config.")
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Dask scheduler to run on, like tcp://host:8786; needs lfnav[cluster]. Its workers need "
    "the same files under the same paths.",
)
@click.option(
    "--processes",
    type=int,
    help="Processes on this machine, with one thread each. Default: one per processor.",
)
@overwrite_option
@json_option
@common_options
@setting_options(localizer_entries())
def command(
    config: Path,
    output: Path,
    seeds: str | None,
    scheduler: str | None,
    processes: int | None,
    chosen: "Mapping[str, Any]",
    overwrite: bool,
    as_json: bool,
    progress: "Progress",
) -> None:
    """Localizes with many seeds and settings; writes one table and figures.

    CONFIG.toml names data sets with ground truth, seeds, and the settings to try. DIR gets
    table.csv, table.json, table.md and figures: success rates, errors, frames until converged,
    seconds per frame.

    Finished runs are kept in DIR/runs. After Ctrl-C the same command continues where it stopped,
    and with more seeds or settings it computes the missing runs. --overwrite computes all of them
    again. A run that fails is reported and does not stop the others.

    Every setting of a config file is an option of the same name, for all runs; those not listed
    here are explained in docs/settings.md.

    \b
    Example:
      lfnav sweep experiments/sweeps/strategies.toml -o out/strategies
      lfnav sweep sweep.toml -o out/sweep --seeds 0-99
      lfnav sweep sweep.toml -o out/sweep --scheduler tcp://10.0.0.1:8786
    """
    from pipelines.experiments.sweep import sweep

    summary = sweep(
        config,
        output,
        seeds=seeds,
        scheduler=scheduler,
        processes=processes,
        options=chosen,
        overwrite=overwrite,
        progress=progress,
    )
    print_summary(summary, as_json)
    if summary.failures:
        raise click.ClickException(
            f"{len(summary.failures)} of {summary.runs} runs broke, see {output / 'table.md'}; "
            "the same command tries them again"
        )
