"""``lfnav localize``: the particle filter over a data set."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lfnav_cli.common import (
    blending_option,
    common_options,
    json_option,
    overwrite_option,
    parse_numbers,
    print_summary,
    quality_option,
)

if TYPE_CHECKING:
    from pipelines.artifacts.progress import Progress

parse_start = parse_numbers(3, "X,Y,DEG")


def _parse_init(
    context: click.Context, parameter: click.Parameter, value: str
) -> tuple[float, float, float] | None:
    """``uniform`` becomes None, X,Y,DEG a state in metres and radians."""
    if value == "uniform":
        return None
    numbers = parse_start(context, parameter, value)
    if numbers is None:
        return None
    return numbers[0], numbers[1], math.radians(numbers[2])


@click.command("localize")
@click.argument("scene", type=click.Path(path_type=Path))
@click.argument("dataset", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), help="Run file to write."
)
@click.option(
    "--odometry",
    type=click.Path(path_type=Path),
    help="TUM file to use instead of the data set's odometry.txt.",
)
@click.option(
    "--area",
    metavar="XMIN,XMAX,YMIN,YMAX",
    callback=parse_numbers(4, "XMIN,XMAX,YMIN,YMAX"),
    help="Where the robot may be, metres. Default: the area that the model covers.",
)
@click.option(
    "--init",
    default="uniform",
    show_default=True,
    metavar="uniform|X,Y,DEG",
    callback=_parse_init,
    help="Start anywhere in the area, or around a pose.",
)
@click.option(
    "--particles", type=int, default=195, show_default=True, help="Particles kept while tracking."
)
@click.option(
    "--start-particles",
    type=int,
    help="Particles at the start of a search (coarse_to_fine). Default: 20000, or --particles "
    "where that is more.",
)
@click.option(
    "--strategy",
    type=click.Choice(["coarse_to_fine", "condensation"]),
    default="coarse_to_fine",
    show_default=True,
    help="condensation: the paper's filter, step by step.",
)
@click.option(
    "--likelihood",
    type=click.Choice(["squared", "robust", "zncc", "gradient"]),
    default="squared",
    show_default=True,
    help="How images are compared; squared colour difference is the paper's.",
)
@click.option(
    "--resampling",
    type=click.Choice(["multinomial", "systematic", "stratified", "residual"]),
    help="Default: systematic; with condensation multinomial, as in the paper.",
)
@click.option(
    "--estimate",
    type=click.Choice(["mode", "mean", "max_weight"]),
    help="What stands for the run. Default: mode; with condensation max_weight, as in the paper.",
)
@blending_option
@quality_option("medium")
@click.option("--width", type=int, default=40, show_default=True, help="Pixels across compared.")
@click.option("--threads", type=int, help="Default: all processors.")
@click.option("--seed", type=int, default=0, show_default=True, help="Random seed.")
@overwrite_option
@json_option
@common_options
def command(
    scene: Path,
    dataset: Path,
    output: Path,
    odometry: Path | None,
    area: tuple[float, float, float, float] | None,
    init: tuple[float, float, float] | None,
    particles: int,
    start_particles: int | None,
    strategy: str,
    likelihood: str,
    resampling: str | None,
    estimate: str | None,
    blending: str,
    quality: str | None,
    width: int,
    threads: int | None,
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
    """
    from pipelines.lightfield.blending import Blending
    from pipelines.localize.likelihood import likelihood_named
    from pipelines.localize.settings import LocalizerSettings
    from pipelines.localize.stage import localize

    is_paper = strategy == "condensation"
    if start_particles is None:
        start_particles = max(LocalizerSettings.start_particles, particles)
    settings: LocalizerSettings = LocalizerSettings(
        strategy=strategy,
        particles=particles,
        start_particles=start_particles,
        start=init,
        area=area,
        likelihood=likelihood_named(likelihood),
        resampling=resampling or ("multinomial" if is_paper else "systematic"),
        estimate=estimate or ("max_weight" if is_paper else "mode"),
        blending=Blending[blending.upper()],
        quality=quality,
        coarse_width=max(4, min(20, width)),
        fine_width=width,
        threads=threads,
    )
    summary = localize(
        scene,
        dataset,
        output,
        settings,
        seed=seed,
        odometry=odometry,
        overwrite=overwrite,
        progress=progress,
    )
    print_summary(summary, as_json)
