"""``lfnav evaluate``: errors of a run against ground truth; how well a scene model renders."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from lfnav_cli.common import common_options, json_option, max_gap_option, print_summary

if TYPE_CHECKING:
    from pipelines.artifacts.stages import Progress, Summary


@click.command("evaluate")
@click.argument("path", metavar="RUN|SCENE", type=click.Path(path_type=Path))
@click.option(
    "--groundtruth",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="RUN: TUM file of true poses of the robot's base; default: those that the run carries.",
)
@click.option(
    "--estimate",
    metavar="NAME",
    help="RUN: which estimate is judged (lfnav info lists them); default: the run's own choice.",
)
@click.option(
    "--dataset",
    type=click.Path(path_type=Path),
    help="SCENE: photos with known poses to compare rendered views with.",
)
@click.option(
    "--poses",
    type=click.Path(path_type=Path),
    help="SCENE: TUM file of their poses; default: the data set's ground truth.",
)
@click.option(
    "--leave-one-out",
    is_flag=True,
    help="SCENE: compare each photo with its view rendered from all others.",
)
@click.option(
    "--interior",
    is_flag=True,
    help="With --leave-one-out: only photos taken in the interior of the camera positions.",
)
@click.option(
    "--quality",
    type=click.Choice(["plane", "coarse", "medium", "fine"]),
    help="SCENE: how finely the surface follows the depth maps. Default: fine.",
)
@click.option(
    "--blending",
    type=click.Choice(["unstructured", "delaunay"]),
    help="SCENE: how views are blended. Default: unstructured.",
)
@max_gap_option
@json_option
@common_options
def command(
    path: Path,
    groundtruth: Path | None,
    estimate: str | None,
    dataset: Path | None,
    poses: Path | None,
    leave_one_out: bool,
    interior: bool,
    quality: str | None,
    blending: str | None,
    max_gap: float,
    as_json: bool,
    progress: "Progress",
) -> None:
    """Computes the errors of a run and of odometry alone, or how well a scene model renders.

    A run succeeds when its mean errors over the last five frames are below 0.15 m and 3 degrees.
    Ground truth and frames pair up by time; frames without ground truth do not count.

    A scene is judged by photos that it does not hold: PSNR (after one brightness factor), SSIM and
    coverage, beside the nearest photo and the rendering over a single plane.

    \b
    Example:
      lfnav evaluate run.h5
      lfnav evaluate run.h5 --groundtruth sample_data/elevators/test/groundtruth.txt --json
      lfnav evaluate scene.h5 --dataset sample_data/elevators/test
      lfnav evaluate scene.h5 --leave-one-out
      lfnav evaluate scene.h5 --leave-one-out --interior
    """
    from pipelines.artifacts.kinds import kind_of, refuse_world

    refuse_world(path)
    if kind_of(path) != "scene":
        of_scene = (dataset, poses, leave_one_out or None, interior or None, quality, blending)
        if any(option is not None for option in of_scene):
            raise click.UsageError(f"{path} is no scene model; those options are for scenes")
        print_summary(_evaluate_run(path, groundtruth, estimate, max_gap), as_json)
        return
    if groundtruth is not None or estimate is not None:
        raise click.UsageError("--groundtruth and --estimate are for runs")
    if (dataset is None) != leave_one_out:
        raise click.UsageError("a scene is evaluated with either --dataset or --leave-one-out")
    if poses is not None and dataset is None:
        raise click.UsageError("--poses goes with --dataset")
    if interior and not leave_one_out:
        raise click.UsageError("--interior goes with --leave-one-out")
    rule = blending or "unstructured"
    summary = _evaluate_scene(
        path, dataset, poses, quality, rule, progress, interior=interior, max_gap=max_gap
    )
    print_summary(summary, as_json)


def _evaluate_run(
    run: Path, groundtruth: Path | None, estimate: str | None, max_gap: float
) -> "Summary":
    from pipelines.localize.evaluation import evaluate_run_file

    return evaluate_run_file(run, groundtruth, estimate, max_gap)


def _evaluate_scene(
    scene: Path,
    dataset: Path | None,
    poses: Path | None,
    quality: str | None,
    blending: str,
    progress: "Progress",
    *,
    interior: bool,
    max_gap: float,
) -> "Summary":
    from pipelines.render.choices import Blending
    from pipelines.render.evaluation import evaluate_scene

    rule = Blending[blending.upper()]
    return evaluate_scene(
        scene, dataset, poses, quality, rule, progress, interior=interior, max_gap=max_gap
    )
