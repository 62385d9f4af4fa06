"""``lfnav render``: virtual views of a scene model."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lfnav_cli.common import (
    blending_option,
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


@click.command("render")
@click.argument("scene", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path),
    help="Folder, or NAME.png for one view, or NAME.mp4 for a video.",
)
@click.option(
    "--pose",
    metavar="X,Y,HEADING_DEG",
    callback=parse_numbers(3, "X,Y,HEADING_DEG"),
    help="Pose of the robot: metres, degrees.",
)
@click.option(
    "--poses",
    type=click.Path(path_type=Path),
    help="TUM file of robot poses (camera poses where the scene knows no mount).",
)
@click.option("--width", type=int, help="Width of the views, pixels. Default: as recorded.")
@blending_option
@quality_option
@click.option(
    "--fps", type=float, default=10.0, show_default=True, help="Frames per second of a video."
)
@device_option
@overwrite_option
@json_option
@common_options
def command(
    scene: Path,
    output: Path,
    pose: tuple[float, float, float] | None,
    poses: Path | None,
    width: int | None,
    blending: str,
    quality: str | None,
    fps: float,
    device: str,
    overwrite: bool,
    as_json: bool,
    progress: "Progress",
) -> None:
    """Renders virtual views of SCENE, each with a mask: white where some photo shows the pixel.

    \b
    Example:
      lfnav render out/elevators.h5 --pose -1.2,-2.0,90 -o view.png
      lfnav render out/elevators.h5 --poses sample_data/elevators/test/groundtruth.txt -o views/
    """
    if (pose is None) == (poses is None):
        raise click.UsageError("give either --pose or --poses")
    from pipelines.render.choices import Blending
    from pipelines.render.devices import Device
    from pipelines.render.stage import RenderSettings, render

    settings = RenderSettings(
        pose=None if pose is None else (pose[0], pose[1], math.radians(pose[2])),
        poses=poses,
        width=width,
        blending=Blending[blending.upper()],
        quality=quality,
        frames_per_second=fps,
        device=Device(device),
    )
    summary = render(scene, output, settings, overwrite=overwrite, progress=progress)
    print_summary(summary, as_json)
