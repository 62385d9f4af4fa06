"""``lfnav model``: a scene model from a reconstruction."""

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
    from pipelines.artifacts.stages import Progress


@click.command("model")
@click.argument("reconstruction", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path),
    help="File to write; with --areas folder to write.",
)
@click.option(
    "--geometry",
    type=click.Choice(["plane", "depth"]),
    default="plane",
    show_default=True,
    help="Surface of the scene: one plane, or depth maps.",
)
@click.option(
    "--depth",
    type=click.Choice(["photos", "given"]),
    default="photos",
    show_default=True,
    help="With --geometry depth: computed from the photos, or the data set's depth images.",
)
@click.option(
    "--plane",
    metavar="A,B,C,D",
    callback=parse_numbers(4, "A,B,C,D"),
    help="The plane a x + b y + c z + d = 0 in world coordinates. Default: estimated.",
)
@click.option(
    "--images",
    type=click.Path(path_type=Path),
    help="Folder of the photos, where they have been moved since the reconstruction.",
)
@click.option(
    "--max-views",
    type=int,
    metavar="N",
    help="Keep the N photos that together show best what all of them show. Default: all.",
)
@click.option(
    "--storage",
    type=click.Choice(["full", "compact"]),
    default="full",
    show_default=True,
    help="Photos as recorded, or as small as localization and docking allow.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Random seed.")
@click.option(
    "--areas",
    metavar="auto|FILE.toml",
    help="Make a world: a scene for each area. Areas are found, or are the rectangles of FILE.",
)
@click.option(
    "--area-views", type=int, metavar="N", help="The most photos of an area. Default: 150."
)
@click.option(
    "--area-memory",
    type=float,
    metavar="MB",
    help="Instead: what an area may take in memory as localize opens it.",
)
@click.option(
    "--jobs",
    type=int,
    metavar="N",
    help="Areas that are built at once, each in a process. Default: 1.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Dask scheduler whose workers build the areas, like tcp://host:8786; needs "
    "lfnav[cluster]. Its workers need the same files under the same paths.",
)
@overwrite_option
@json_option
@common_options
def command(
    reconstruction: Path,
    output: Path,
    geometry: str,
    depth: str,
    plane: tuple[float, ...] | None,
    images: Path | None,
    max_views: int | None,
    storage: str,
    seed: int,
    areas: str | None,
    area_views: int | None,
    area_memory: float | None,
    jobs: int | None,
    scheduler: str | None,
    overwrite: bool,
    as_json: bool,
    progress: "Progress",
) -> None:
    """Turns the folder RECONSTRUCTION into a light-field scene model.

    The scene's surface is one plane, or with --geometry depth a depth map for every photo. The
    plane is estimated from the sparse points where the reconstruction has some, else from the
    photos: the plane over which they agree best. Depth maps that are finished when the command is
    stopped are not computed again. Of many photos taken close together, --max-views keeps those
    that matter: memory, and time for a rendered view, grow with their number. --storage compact
    makes the file about a tenth as large; --storage full keeps the photos' files.

    With --areas the output is a folder: a world, whose areas are scenes of their own that overlap
    at the doorways. Areas that are finished when the command is stopped are not built again.

    \b
    Example:
      lfnav model out/elevators -o out/elevators.h5
      lfnav model out/elevators -o out/elevators.h5 --plane 0,1,0,0
      lfnav model out/workshop -o out/workshop.h5 --geometry depth
      lfnav model out/workshop -o out/workshop.h5 --max-views 100
      lfnav model out/floor -o out/floor_world --areas auto --area-views 120 --geometry depth
      lfnav model out/workshop -o out/workshop.h5 --storage compact
    """
    from pipelines.lightfield.stage import ModelSettings, model

    settings = ModelSettings(
        geometry=geometry,
        depth=depth,
        plane=plane,
        images=images,
        seed=seed,
        max_views=max_views,
        storage=storage,
    )
    if areas is not None:
        from pipelines.lightfield.world import AUTOMATIC, AreaSettings, model_world

        divided = AreaSettings(
            file=None if areas == AUTOMATIC else Path(areas),
            views=area_views,
            megabytes=area_memory,
            jobs=1 if jobs is None else jobs,
            scheduler=scheduler,
        )
        world = model_world(
            reconstruction, output, divided, settings, overwrite=overwrite, progress=progress
        )
        print_summary(world, as_json)
        return
    for name, value in {
        "--area-views": area_views,
        "--area-memory": area_memory,
        "--jobs": jobs,
        "--scheduler": scheduler,
    }.items():
        if value is not None:
            raise click.UsageError(f"{name} goes with --areas")
    summary = model(reconstruction, output, settings, overwrite=overwrite, progress=progress)
    print_summary(summary, as_json)
