"""``lfnav export``: a run's trajectory, or a scene model, for other programs."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from lfnav_cli.common import common_options, json_option, overwrite_option, print_summary

if TYPE_CHECKING:
    from pipelines.artifacts.stages import Progress


@click.command("export")
@click.argument("source", metavar="FILE", type=click.Path(path_type=Path))
@click.option(
    "--format",
    "format_name",
    type=click.Choice(["tum", "kitti", "euroc", "csv", "json", "mcap", "colmap"]),
    required=True,
    help="tum, kitti, euroc: poses of the robot's base in the scene's world, z = 0. "
    "csv, json: also status, confidence and, in json, modes and covariance. "
    "mcap: a bag for Foxglove and RViz, with poses, tf, odometry, particles and images. "
    "colmap: of a scene model, its photos and their poses.",
)
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path),
    help="File to write; for colmap a folder.",
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
    source: Path,
    format_name: str,
    output: Path,
    estimate: str | None,
    overwrite: bool,
    as_json: bool,
    progress: "Progress",
) -> None:
    """Writes a run or a scene model in another program's format.

    FILE is a run, of which the estimated trajectory is written (with --format mcap the whole run as
    a ROS bag), or with --format colmap a scene model, of which a COLMAP project is written: images/
    and sparse/.

    \b
    Example:
      lfnav export run.h5 --format tum -o run.tum
      evo_ape tum sample_data/elevators/test/groundtruth.txt run.tum
      lfnav export run.h5 --format mcap -o run.mcap
      lfnav export scene.h5 --format colmap -o project
    """
    if format_name == "colmap":
        from pipelines.lightfield.colmap_export import export_scene_to_colmap

        if estimate is not None:
            raise click.UsageError("--estimate is for runs, not for --format colmap")
        print_summary(export_scene_to_colmap(source, output, overwrite), as_json)
        return
    if format_name == "mcap":
        from pipelines.ros.run_bag import export_run_to_bag

        print_summary(export_run_to_bag(source, output, estimate, overwrite), as_json)
        return
    from pipelines.localize.trajectory_export import export_run_file

    print_summary(export_run_file(source, output, format_name, estimate, overwrite), as_json)
