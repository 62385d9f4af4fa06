"""``lfnav localize``: the particle filter over a data set."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfnav_cli.common import (
    common_options,
    json_option,
    max_gap_option,
    overwrite_option,
    print_summary,
)
from lfnav_cli.setting_options import (
    SettingsCommand,
    config_options,
    localizer_entries,
    missing,
    setting_options,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pipelines.artifacts.stages import Progress


@click.command("localize", cls=SettingsCommand)
@click.argument("scene", metavar="SCENE", required=False, type=click.Path(path_type=Path))
@click.argument("dataset", metavar="DATASET|PHOTO", required=False, type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    help="Run file to write; for a photo by itself not needed.",
)
@click.option(
    "--camera",
    metavar="FILE.toml",
    type=click.Path(path_type=Path),
    help="With a photo by itself: its camera. Default: that of its EXIF data, or the map's.",
)
@click.option(
    "--picture",
    metavar="FILE.png",
    type=click.Path(path_type=Path),
    help="With a photo by itself: draw it beside what the map shows from where it was taken.",
)
@config_options
@click.option(
    "--odometry",
    metavar="FILE|none",
    help="TUM file to use instead of the data set's odometry.txt; none: do without, as "
    "--degrees-of-freedom 6 and --method pnp can.",
)
@click.option(
    "--mask",
    metavar="FILE.png",
    type=click.Path(path_type=Path),
    help="8-bit grey PNG of the camera's size to use instead of the data set's mask.png: 0 where "
    "images are not to be used (the robot's bumper).",
)
@click.option(
    "--reconstruction",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="With PnP: take landmarks from the points of the reconstruction that SCENE was made from. "
    "Default: from the scene's depth maps or plane.",
)
@click.option(
    "--memory",
    type=float,
    metavar="MB",
    help="In a world of areas: what localization may take of memory beyond the program itself; "
    "areas are opened and closed within it. Default: 1000.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Random seed.")
@max_gap_option
@overwrite_option
@json_option
@common_options
@setting_options(localizer_entries())
def command(
    scene: Path | None,
    dataset: Path | None,
    output: Path | None,
    camera: Path | None,
    picture: Path | None,
    config: Path | None,
    print_config: bool,
    odometry: str | None,
    mask: Path | None,
    reconstruction: Path | None,
    memory: float | None,
    seed: int,
    chosen: "Mapping[str, Any]",
    max_gap: float,
    overwrite: bool,
    as_json: bool,
    progress: "Progress",
) -> None:
    """Localizes the robot of DATASET in SCENE, frame by frame, and writes a run file.

    SCENE is a scene model, or the folder of a world of several. With a PHOTO in the place of a data
    set it says where that was taken, or that the map does not show it: six degrees of freedom,
    without odometry.

    Every setting of a config file is an option of the same name; those not listed here are printed
    by --print-config and explained in docs/settings.md.

    \b
    Example:
      lfnav localize out/elevators.h5 sample_data/elevators/test -o out/run.h5 --seed 0
      lfnav localize scene.h5 test/ -o run.h5 --start 1.0,-2.5,90
      lfnav localize scene.h5 test/ -o run.h5 --method pnp
      lfnav localize scene.h5 PHOTO.jpg --picture beside.png
      lfnav localize --print-config --particles 500 > settings.toml
      lfnav localize scene.h5 test/ -o run.h5 --config settings.toml
    """
    from pipelines.localize.config import effective_settings, settings_text

    settings = effective_settings(config, chosen)
    if print_config:
        click.echo(settings_text(settings), nl=False)
        return
    if scene is not None and dataset is not None and dataset.is_file():
        unused = {"--odometry": odometry, "--mask": mask, "--reconstruction": reconstruction}
        for option, value in unused.items():
            if value is not None:
                raise click.UsageError(f"{option} is of no use to a photo by itself")
        degrees = chosen.get("degrees_of_freedom", 6)
        if degrees != 6:
            raise click.UsageError("a photo by itself is placed with 6 degrees of freedom")
        from pipelines.report.single_photo import PhotoRequest, localize_photo

        photo = PhotoRequest(
            scene=scene,
            photo=dataset,
            settings=replace(settings, degrees_of_freedom=6),
            camera=camera,
            run=output,
            picture=picture,
            seed=seed,
            overwrite=overwrite,
            memory=memory,
        )
        print_summary(localize_photo(photo), as_json)
        return
    if scene is None or dataset is None or output is None:
        raise missing({"scene": scene, "dataset": dataset, "output": output})
    for option, path in {"--camera": camera, "--picture": picture}.items():
        if path is not None:
            raise click.UsageError(f"{option} goes with a photo by itself, not with a data set")

    from pipelines.localize.stage import LocalizeRequest, localize

    request = LocalizeRequest(
        scene=scene,
        dataset=dataset,
        output=output,
        settings=settings,
        seed=seed,
        odometry=None if odometry in (None, "none") else Path(odometry),
        ignore_odometry=odometry == "none",
        mask=mask,
        reconstruction=reconstruction,
        overwrite=overwrite,
        memory=memory,
        max_gap=max_gap,
    )
    print_summary(localize(request, progress), as_json)
