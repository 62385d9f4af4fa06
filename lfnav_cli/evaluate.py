"""``lfnav evaluate``: errors of a run against ground truth."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from lfnav_cli.common import common_options, json_option, print_summary

if TYPE_CHECKING:
    from pipelines.artifacts.progress import Progress
    from pipelines.artifacts.summary import Summary


@click.command("evaluate")
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--groundtruth",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="TUM file of true poses of the robot's base; default: those that the run carries.",
)
@click.option(
    "--estimate",
    metavar="NAME",
    help="Which estimate is judged (lfnav info lists them); default: the run's own choice.",
)
@json_option
@common_options
def command(
    run: Path,
    groundtruth: Path | None,
    estimate: str | None,
    as_json: bool,
    progress: "Progress",
) -> None:
    """Errors of the run file RUN against ground truth, and those of odometry alone.

    A run succeeds when the errors' means over the last five frames are below 0.15 m and 3 degrees.
    Ground truth and frames pair up by time; frames without ground truth do not count.

    \b
    Example:
      lfnav evaluate run.h5
      lfnav evaluate run.h5 --groundtruth sample_data/elevators/test/groundtruth.txt --json
    """
    print_summary(_evaluate(run, groundtruth, estimate), as_json)


def _evaluate(run: Path, groundtruth: Path | None, estimate: str | None) -> "Summary":
    from pipelines.localize.evaluation import evaluate_run_file

    return evaluate_run_file(run, groundtruth, estimate)
