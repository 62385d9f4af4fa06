"""``lfnav report``: a page with figures about a run."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from lfnav_cli.common import common_options, json_option, overwrite_option, print_summary

if TYPE_CHECKING:
    from pipelines.artifacts.stages import Progress


def parse_frames(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[int, ...] | None:
    """A click callback: frame numbers separated by commas."""
    if value is None:
        return None
    try:
        frames = tuple(int(part) for part in value.split(","))
    except ValueError:
        frames = ()
    if not frames or min(frames) < 0:
        raise click.BadParameter(f"{value!r} is not a list of frame numbers like 0,9,19")
    return frames


@click.command("report")
@click.argument("run", metavar="RUN.h5", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to write."
)
@click.option(
    "--scene",
    metavar="SCENE.h5",
    type=click.Path(path_type=Path),
    help="The scene model, where it has been moved since the run was made.",
)
@click.option(
    "--frames",
    metavar="N,N,...",
    callback=parse_frames,
    help="Frames to show, from 0.  [default: first, middle, last]",
)
@click.option(
    "--estimate",
    metavar="NAME",
    help="Estimate to show (lfnav info lists them).  [default: the run's own choice]",
)
@overwrite_option
@json_option
@common_options
def command(
    run: Path,
    output: Path,
    scene: Path | None,
    frames: tuple[int, ...] | None,
    estimate: str | None,
    overwrite: bool,
    as_json: bool,
    progress: "Progress",
) -> None:
    """Writes a report of RUN.h5: report.html, and its figures as PNG and PDF.

    The page shows the place from above, the camera's pictures beside those that the scene model
    renders at the estimate and at odometry, errors where ground truth is known, and the time taken.
    It needs no other file and can be sent as it is.

    \b
    Example:
      lfnav report out/run.h5 -o out/report
      lfnav report out/run.h5 -o out/report --frames 0,5,10 --overwrite
    """
    from pipelines.report.stage import ReportSettings, report

    settings = ReportSettings(frames=frames, estimate=estimate, scene=scene)
    summary = report(run, output, settings, overwrite=overwrite, progress=progress)
    print_summary(summary, as_json)
