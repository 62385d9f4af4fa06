"""``lfnav export``: a run's trajectory, or a scene model, for other programs."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lfnav_cli.common import (
    common_options,
    json_option,
    overwrite_option,
    parse_numbers,
    print_summary,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pipelines.artifacts.stages import Progress


def parse_docks(
    context: click.Context, parameter: click.Parameter, values: tuple[str, ...]
) -> dict[str, tuple[float, float, float]]:
    """``NAME=X,Y,DEG`` as x, y in metres and heading in radians, by name."""
    docks = {}
    for value in values:
        name, equals, numbers = value.partition("=")
        if not equals or not name or name in docks:
            raise click.BadParameter(f"{value!r} is not of the form NAME=X,Y,DEG, each name once")
        parsed = parse_numbers(3, "NAME=X,Y,DEG")(context, parameter, numbers)
        if parsed is not None:
            docks[name] = (parsed[0], parsed[1], math.radians(parsed[2]))
    return docks


@click.command("export")
@click.argument("source", metavar="FILE", type=click.Path(path_type=Path))
@click.option(
    "--format",
    "format_name",
    type=click.Choice(["tum", "kitti", "euroc", "csv", "json", "mcap", "colmap", "nav2-docks"]),
    required=True,
    help="tum, kitti, euroc: poses of the robot's base in the scene's world, z = 0. "
    "csv, json: also status, confidence and, in json, modes and covariance. "
    "mcap: a bag for Foxglove and RViz, with poses, tf, odometry, particles and images. "
    "colmap: of a scene model, its photos and their poses. "
    "nav2-docks: of a scene model or world, the dock database of nav2.",
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
@click.option(
    "--dock",
    "docks",
    multiple=True,
    metavar="NAME=X,Y,DEG",
    callback=parse_docks,
    help="For nav2-docks, once or more: a dock, and the pose of the docked robot in the map.",
)
@click.option(
    "--dock-type",
    metavar="NAME",
    help="For nav2-docks: name of nav2's docking plugin. Default: simple_charging_dock.",
)
@overwrite_option
@json_option
@common_options
def command(
    source: Path,
    format_name: str,
    output: Path,
    estimate: str | None,
    docks: "Mapping[str, tuple[float, float, float]]",
    dock_type: str | None,
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
      lfnav export scene.h5 --format nav2-docks --dock home=-1.15,-1.65,90 -o docks.yaml
    """
    if format_name != "nav2-docks" and (docks or dock_type is not None):
        raise click.UsageError("--dock and --dock-type are for --format nav2-docks")
    if format_name in ("colmap", "nav2-docks") and estimate is not None:
        raise click.UsageError(f"--estimate is for runs, not for --format {format_name}")
    if format_name == "colmap":
        from pipelines.lightfield.colmap_export import export_scene_to_colmap

        print_summary(export_scene_to_colmap(source, output, overwrite), as_json)
        return
    if format_name == "nav2-docks":
        from pipelines.ros.nav2_docks import DOCK_TYPE, export_docks

        kind = DOCK_TYPE if dock_type is None else dock_type
        print_summary(export_docks(source, output, docks, kind, overwrite=overwrite), as_json)
        return
    if format_name == "mcap":
        from pipelines.ros.run_bag import export_run_to_bag

        print_summary(export_run_to_bag(source, output, estimate, overwrite), as_json)
        return
    from pipelines.localize.trajectory_export import export_run_file

    print_summary(export_run_file(source, output, format_name, estimate, overwrite), as_json)
