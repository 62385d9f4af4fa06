"""``lfnav reconstruct``: camera poses of a data set."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from lfnav_cli.common import (
    common_options,
    json_option,
    max_gap_option,
    overwrite_option,
    print_summary,
)

if TYPE_CHECKING:
    from pipelines.artifacts.stages import Progress


@click.command("reconstruct")
@click.argument("dataset", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to write."
)
@click.option(
    "--method",
    type=click.Choice(["sfm", "odometry", "poses"]),
    required=True,
    help="sfm: structure from motion; odometry: the data set's odometry.txt; poses: --poses.",
)
@click.option(
    "--poses",
    type=click.Path(path_type=Path),
    help="TUM file of the body's poses in the world, for --method poses.",
)
@click.option(
    "--matcher",
    type=click.Choice(["auto", "spatial", "sequential", "exhaustive"]),
    default="auto",
    show_default=True,
    help="sfm: which images are matched. spatial: those that by odometry see the same, or look "
    "alike. auto: all pairs up to 40 images, neighbours above, spatial above 150 with odometry.",
)
@click.option(
    "--scale",
    type=float,
    metavar="FACTOR",
    help="sfm without odometry: metres per unit of the model (measure it in a first run).",
)
@click.option("--seed", type=int, default=0, show_default=True, help="sfm: random seed.")
@click.option(
    "--max-features",
    type=int,
    metavar="N",
    default=4096,
    show_default=True,
    help="sfm: features per image.",
)
@click.option(
    "--max-size",
    type=int,
    metavar="PX",
    default=960,
    show_default=True,
    help="sfm: longer side of the images in which features are detected.",
)
@click.option(
    "--planar",
    is_flag=True,
    help="sfm: the camera was carried by a robot on a floor; poses are kept on it. Needs odometry.",
)
@max_gap_option
@overwrite_option
@json_option
@common_options
def command(
    dataset: Path,
    output: Path,
    method: str,
    poses: Path | None,
    matcher: str,
    scale: float | None,
    seed: int,
    max_features: int,
    max_size: int,
    planar: bool,
    max_gap: float,
    overwrite: bool,
    as_json: bool,
    progress: "Progress",
) -> None:
    """Finds the camera poses of the images of DATASET and writes a reconstruction folder.

    With odometry the result is metric with z up, also by structure from motion. Without it the
    first camera is the origin, z points against the mean image-down direction, and x where the
    first camera looks.

    \b
    Example:
      lfnav reconstruct sample_data/elevators/map -o out/elevators --method odometry
      lfnav reconstruct sample_data/elevators/map -o out/elevators --method sfm --planar
      lfnav reconstruct sample_data/workshop/map -o out/workshop --method sfm
    """
    from pipelines.reconstruct.stage import ReconstructSettings, reconstruct

    settings = ReconstructSettings(
        method=method,
        poses=poses,
        matcher=matcher,
        scale=scale,
        seed=seed,
        max_features=max_features,
        max_size=max_size,
        planar=planar,
        max_gap=max_gap,
    )
    summary = reconstruct(dataset, output, settings, overwrite=overwrite, progress=progress)
    print_summary(summary, as_json)
