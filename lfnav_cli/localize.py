"""``lfnav localize``: the particle filter over a data set."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfnav_cli.common import (
    common_options,
    device_option,
    json_option,
    overwrite_option,
    parse_numbers,
    print_summary,
    quality_option,
)

if TYPE_CHECKING:
    from pipelines.artifacts.stages import Progress

parse_planar_start = parse_numbers(3, "X,Y,DEG")
parse_spatial_start = parse_numbers(6, "uniform, X,Y,DEG or X,Y,Z,RX,RY,RZ")


def _parse_init(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[float, ...] | None:
    """``uniform`` becomes (), X,Y,DEG or X,Y,Z,RX,RY,RZ a state in metres and radians."""
    if value is None:
        return None
    if value == "uniform":
        return ()
    is_planar = value.count(",") == 2
    numbers = (parse_planar_start if is_planar else parse_spatial_start)(context, parameter, value)
    if numbers is None:
        return None
    positions = 2 if is_planar else 3
    return (*numbers[:positions], *map(math.radians, numbers[positions:]))


def _missing(values: Mapping[str, Path | None]) -> click.MissingParameter:
    """The error for the first parameter that has no value: only --print-config does without."""
    context = click.get_current_context()
    missing = [item for item in context.command.params if item.name in values]
    return click.MissingParameter(
        ctx=context, param=next(item for item in missing if values[item.name or ""] is None)
    )


@click.command("localize")
@click.argument("scene", metavar="SCENE", required=False, type=click.Path(path_type=Path))
@click.argument("dataset", metavar="DATASET", required=False, type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Run file to write.")
@click.option(
    "--config",
    metavar="FILE.toml",
    type=click.Path(path_type=Path),
    help="Settings; options given here win over it, and it wins over the defaults.",
)
@click.option(
    "--print-config",
    is_flag=True,
    help="Print all settings as a config file and end; needs no SCENE, DATASET or -o.",
)
@click.option(
    "--odometry",
    metavar="FILE|none",
    help="TUM file to use instead of the data set's odometry.txt; none: do without, as --dof 6 and "
    "--method pnp can.",
)
@click.option(
    "--mask",
    metavar="FILE.png",
    type=click.Path(path_type=Path),
    help="8-bit grey PNG of the camera's size to use instead of the data set's mask.png: 0 where "
    "images are not to be used (the robot's bumper).",
)
@click.option(
    "--area",
    metavar="XMIN,XMAX,YMIN,YMAX",
    callback=parse_numbers(4, "XMIN,XMAX,YMIN,YMAX"),
    help="Where the robot may be, metres. Default: the area that the model covers.",
)
@click.option(
    "--init",
    metavar="uniform|X,Y,DEG|X,Y,Z,RX,RY,RZ",
    callback=_parse_init,
    help="Start anywhere in the area (the default), or around a pose; with --dof 6 RX,RY,RZ is its "
    "rotation vector in degrees.",
)
@click.option(
    "--dof",
    "degrees_of_freedom",
    type=click.Choice(["3", "6"]),
    help="3: a robot on the floor (the default). 6: a hand-held camera or a drone.",
)
@click.option(
    "--method",
    type=click.Choice(["filter", "pnp"]),
    help="filter (the default). pnp: each image for itself, by SIFT features and their places in "
    "the map; a pose, or none.",
)
@click.option(
    "--with-pnp", is_flag=True, help="Beside the filter, note the pose by features, to compare."
)
@click.option(
    "--proposal",
    type=click.Choice(["appearance", "pnp", "both"]),
    help="Where the strategy informed looks for the robot: where the scene looks like the image "
    "(the default), where its features say, or both.",
)
@click.option(
    "--reconstruction",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="With PnP: take the features' places from the points of the reconstruction that SCENE was "
    "made from. Default: from the scene's depth maps or plane.",
)
@click.option("--particles", type=int, help="Particles kept while tracking. Default: 195.")
@click.option(
    "--start-particles",
    type=int,
    help="Hypotheses that a search begins with. Default: 6000 (informed), 20000 (coarse_to_fine).",
)
@click.option(
    "--strategy",
    type=click.Choice(["informed", "coarse_to_fine", "condensation"]),
    help="informed (the default): the image says where to look. condensation: the paper's filter, "
    "step by step.",
)
@click.option(
    "--likelihood",
    type=click.Choice(["evidence", "squared", "robust", "zncc", "gradient"]),
    help="How images are compared. Default: evidence (local contrast, against an image that does "
    "not show the map); with condensation squared, as in the paper.",
)
@click.option(
    "--resampling",
    type=click.Choice(["multinomial", "systematic", "stratified", "residual"]),
    help="Default: systematic; with condensation multinomial, as in the paper.",
)
@click.option(
    "--estimate",
    type=click.Choice(["refined", "mode", "mean", "max_weight"]),
    help="What stands for the run. Default: refined (aligned with the image); with condensation "
    "max_weight, as in the paper.",
)
@click.option(
    "--blending",
    type=click.Choice(["unstructured", "delaunay"]),
    help="How views are blended: unstructured (the default), by viewing angle; delaunay, by the "
    "paper's net of triangles.",
)
@quality_option("medium")
@click.option("--width", type=int, help="Pixels across compared. Default: 40.")
@click.option(
    "--refine-width",
    type=int,
    help="Pixels across in the last step of the alignment; 0: no refined estimate. Default: 160.",
)
@click.option("--threads", type=int, help="Default: all processors.")
@device_option(None)
@click.option("--seed", type=int, default=0, show_default=True, help="Random seed.")
@overwrite_option
@json_option
@common_options
def command(
    scene: Path | None,
    dataset: Path | None,
    output: Path | None,
    config: Path | None,
    print_config: bool,
    odometry: str | None,
    mask: Path | None,
    area: tuple[float, float, float, float] | None,
    init: tuple[float, ...] | None,
    degrees_of_freedom: str | None,
    method: str | None,
    with_pnp: bool,
    proposal: str | None,
    reconstruction: Path | None,
    particles: int | None,
    start_particles: int | None,
    strategy: str | None,
    likelihood: str | None,
    resampling: str | None,
    estimate: str | None,
    blending: str | None,
    quality: str | None,
    width: int | None,
    refine_width: int | None,
    threads: int | None,
    device: str | None,
    seed: int,
    overwrite: bool,
    as_json: bool,
    progress: "Progress",
) -> None:
    """Localizes the robot of DATASET in SCENE, frame by frame, and writes a run file.

    \b
    Example:
      lfnav localize out/elevators.h5 sample_data/elevators/test -o out/run.h5 --seed 0
      lfnav localize scene.h5 drive/ -o run.h5 --init 1.0,-2.5,90
      lfnav localize scene.h5 drive/ -o run.h5 --method pnp
      lfnav localize --print-config --particles 500 > settings.toml
      lfnav localize scene.h5 drive/ -o run.h5 --config settings.toml
    """
    from pipelines.localize.config import effective_settings, settings_text
    from pipelines.localize.stage import localize
    from pipelines.render.choices import Blending, Cost
    from pipelines.render.devices import Device

    options: dict[str, Any] = {
        "method": method,
        "with_pnp": with_pnp or None,
        "proposal": proposal,
        "strategy": strategy,
        "degrees_of_freedom": None if degrees_of_freedom is None else int(degrees_of_freedom),
        "particles": particles,
        "start_particles": start_particles,
        "area": area,
        "likelihood.cost": None if likelihood is None else Cost[likelihood.upper()],
        "resampling": resampling,
        "estimate": estimate,
        "blending": None if blending is None else Blending[blending.upper()],
        "quality": quality,
        "fine_width": width,
        "refine_width": refine_width,
        "threads": threads,
        "device": None if device is None else Device(device),
    }
    chosen = {name: value for name, value in options.items() if value is not None}
    if init is not None:
        chosen["start"] = init or None
    settings = effective_settings(config, chosen)
    if print_config:
        click.echo(settings_text(settings), nl=False)
        return
    if scene is None or dataset is None or output is None:
        raise _missing({"scene": scene, "dataset": dataset, "output": output})
    summary = localize(
        scene,
        dataset,
        output,
        settings,
        seed=seed,
        odometry=None if odometry in (None, "none") else Path(odometry),
        ignore_odometry=odometry == "none",
        overwrite=overwrite,
        progress=progress,
        reconstruction=reconstruction,
        mask=mask,
    )
    print_summary(summary, as_json)
