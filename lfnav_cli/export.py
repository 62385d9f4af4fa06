"""``lfnav export``: a run's trajectory for other programs."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from lfnav_cli.common import common_options, json_option, overwrite_option, print_summary

if TYPE_CHECKING:
    from pipelines.artifacts.progress import Progress


@click.command("export")
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--format",
    "format_name",
    type=click.Choice(["tum", "kitti", "euroc", "csv", "json"]),
    required=True,
    help="tum, kitti, euroc: poses of the robot's base in the scene's world, z = 0. "
    "csv, json: also status, confidence and, in json, modes and covariance.",
)
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), help="File to write."
)
@click.option(
    "--estimate",
    metavar="NAME",
    help="Which estimate is exported (lfnav info lists them); default: the run's own choice.",
)
@overwrite_option
@json_option
@common_options
def command(
    run: Path,
    format_name: str,
    output: Path,
    estimate: str | None,
    overwrite: bool,
    as_json: bool,
    progress: "Progress",
) -> None:
    """Write the estimated trajectory of the run file RUN in another program's format.

    \b
    Example:
      lfnav export run.h5 --format tum -o run.tum
      evo_ape tum sample_data/elevators/test/groundtruth.txt run.tum
    """
    from pipelines.localize.trajectory_export import export_run_file

    print_summary(export_run_file(run, output, format_name, estimate, overwrite), as_json)
