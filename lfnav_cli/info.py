"""``lfnav info``: what a file or folder contains."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from lfnav_cli.common import common_options, json_option, overwrite_option, print_summary

if TYPE_CHECKING:
    from pipelines.artifacts.stages import Progress, Summary


@click.command()
@click.argument("path", type=click.Path(path_type=Path))
@click.option(
    "--picture",
    type=click.Path(path_type=Path),
    metavar="FILE.png",
    help="Also draw the areas of a world from above.",
)
@overwrite_option
@json_option
@common_options
def command(
    path: Path, picture: Path | None, overwrite: bool, as_json: bool, progress: "Progress"
) -> None:
    """Prints what PATH contains: a data set, reconstruction, scene model, world, run or ROS bag.

    \b
    Example:
      lfnav info sample_data/elevators/map
      lfnav info run.h5 --json
      lfnav info out/floor_world --picture areas.png
    """
    if picture is not None:
        _draw(path, picture, overwrite)
    print_summary(_describe(path, progress), as_json)


def _draw(path: Path, picture: Path, overwrite: bool) -> None:
    from pipelines.artifacts.kinds import kind_of

    if kind_of(path) != "world":
        raise click.UsageError(f"--picture is for worlds; {path} is none")
    from pipelines.report.world_map import draw_world

    draw_world(path, picture, overwrite)


def _describe(path: Path, progress: "Progress") -> "Summary":
    from pipelines.artifacts.kinds import kind_of

    kind = kind_of(path)
    if kind == "reconstruction":
        from pipelines.reconstruct.description import describe_reconstruction

        return describe_reconstruction(path)
    if kind == "scene":
        from pipelines.lightfield.description import describe_scene

        return describe_scene(path)
    if kind == "world":
        from pipelines.lightfield.world_description import describe_world

        return describe_world(path)
    if kind == "run":
        from pipelines.localize.description import describe_run

        return describe_run(path)
    if kind == "bag":
        from pipelines.ros.bag_description import describe_bag

        return describe_bag(path, progress)
    from pipelines.dataset.description import describe_dataset

    return describe_dataset(path)
