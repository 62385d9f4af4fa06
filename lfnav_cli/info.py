"""``lfnav info``: what a file or folder contains."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from lfnav_cli.common import common_options, json_option, print_summary

if TYPE_CHECKING:
    from pipelines.artifacts.stages import Progress, Summary


@click.command()
@click.argument("path", type=click.Path(path_type=Path))
@json_option
@common_options
def command(path: Path, as_json: bool, progress: "Progress") -> None:
    """Prints what PATH contains: a data set, a reconstruction, a scene model or a run.

    \b
    Example:
      lfnav info sample_data/elevators/map
      lfnav info run.h5 --json
    """
    print_summary(_describe(path), as_json)


def _describe(path: Path) -> "Summary":
    from pipelines.artifacts.kinds import kind_of

    kind = kind_of(path)
    if kind == "reconstruction":
        from pipelines.reconstruct.description import describe_reconstruction

        return describe_reconstruction(path)
    if kind == "scene":
        from pipelines.lightfield.description import describe_scene

        return describe_scene(path)
    if kind == "run":
        from pipelines.localize.description import describe_run

        return describe_run(path)
    from pipelines.dataset.description import describe_dataset

    return describe_dataset(path)
