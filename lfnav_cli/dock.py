"""``lfnav dock``: drives a robot to a goal pose by what its camera sees."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfnav_cli.common import (
    common_options,
    json_option,
    overwrite_option,
    parse_numbers,
    print_summary,
)
from lfnav_cli.setting_options import (
    SettingsCommand,
    config_options,
    dock_entries,
    missing,
    setting_options,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pipelines.artifacts.stages import Progress
    from pipelines.dock.dock import Report

parse_pose = parse_numbers(3, "X,Y,DEG")


def parse_state(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[float, float, float] | None:
    """A click callback: X,Y,DEG as metres and radians."""
    numbers = parse_pose(context, parameter, value)
    if numbers is None:
        return None
    x, y, degrees = numbers
    return x, y, math.radians(degrees)


def parse_fault(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> tuple[str, int] | None:
    """A click callback: KIND:STEP."""
    if value is None:
        return None
    kind, _, step = value.partition(":")
    if not step.isdecimal():
        raise click.BadParameter(f"{value!r} is not of the form KIND:STEP, like blocked:8")
    return kind, int(step)


@click.command("dock", cls=SettingsCommand)
@click.argument("scene", metavar="SCENE.h5|WORLD", required=False, type=click.Path(path_type=Path))
@click.option(
    "--robot",
    metavar="NAME",
    help="Your robot as package.module:Class, or a simulated one: model:SCENE.h5, "
    "model:WORLD, sim:SCENE.xml, replay:DATASET; one that is driven over ROS 2: ros2:, "
    "ros2:ROBOT.toml.",
)
@click.option("--goal", metavar="X,Y,DEG", callback=parse_state, help="Goal pose: metres, degrees.")
@click.option(
    "--goal-view",
    type=int,
    metavar="INDEX",
    help="Goal: where this photo of SCENE was taken, from 0.",
)
@click.option(
    "--goal-image",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Goal: where the robot's camera sees this image.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    help="Run file to write; not needed with --dry-run.",
)
@config_options
@click.option(
    "--mask",
    type=click.Path(path_type=Path),
    metavar="FILE.png",
    help="8-bit grey PNG of the size of the robot's camera: 0 where its images are not to be used "
    "(the robot's bumper).",
)
@click.option(
    "--memory",
    type=float,
    metavar="MB",
    help="In a world of areas: what localizing and docking may take of memory beyond the program "
    "itself; areas are opened and closed within it. Default: 1000.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Random seed.")
@click.option(
    "--dry-run",
    "is_dry",
    is_flag=True,
    help="Check the robot's driver, and that the goal can be seen; nothing moves.",
)
@click.option(
    "--true-start",
    metavar="X,Y,DEG",
    callback=parse_state,
    help="Simulated robots: true start pose. Default: random, by the seed.",
)
@click.option(
    "--camera",
    type=click.Path(path_type=Path),
    metavar="camera.toml",
    help="Simulated robots: camera and mount. Default: the scene's, --camera-width pixels wide.",
)
@click.option(
    "--camera-width",
    type=int,
    default=240,
    show_default=True,
    help="Simulated robots: width of the camera's images, without --camera.",
)
@click.option(
    "--motion-noise",
    metavar="SHARE,DEG",
    default="0.02,0.5",
    show_default=True,
    callback=parse_numbers(2, "SHARE,DEG"),
    help="Simulated robots: random errors of odometry, a share of the distance and degrees a step.",
)
@click.option(
    "--motion-bias",
    metavar="SHARE,DEG",
    default="0,0",
    show_default=True,
    callback=parse_numbers(2, "SHARE,DEG"),
    help="Simulated robots: systematic errors of odometry, a share of the distance and degrees a "
    "metre.",
)
@click.option(
    "--actuation-noise",
    type=float,
    default=0.02,
    show_default=True,
    help="Simulated robots: random error of each movement, as a share of it.",
)
@click.option(
    "--slip",
    type=float,
    default=0.0,
    show_default=True,
    help="Simulated robots: probability that the wheels slip in a step, which halves the movement "
    "but not what odometry measures.",
)
@click.option(
    "--sensor-noise",
    metavar="LEVELS,GAIN",
    default="2,0.05",
    show_default=True,
    callback=parse_numbers(2, "LEVELS,GAIN"),
    help="Simulated robots: noise of each pixel in grey levels; largest random change of "
    "an image's brightness, as a share.",
)
@click.option(
    "--samples", type=int, default=16, show_default=True, help="sim: paths traced for each pixel."
)
@click.option(
    "--variant",
    type=click.Choice(["fastest", "llvm_ad_rgb", "scalar_rgb"]),
    default="fastest",
    show_default=True,
    help="sim: variant of Mitsuba. llvm_ad_rgb needs the library LLVM; fastest: that one where "
    "LLVM loads, else scalar_rgb.",
)
@click.option(
    "--fault",
    metavar="KIND:STEP",
    callback=parse_fault,
    help="Simulated robots: a fault from this step on; blocked, slipping, black, frozen, people, "
    "cover or driver; or door@X,Y:STEP, a doorway that is closed although the map shows it open.",
)
@overwrite_option
@json_option
@common_options
@setting_options(dock_entries())
def command(
    scene: Path | None,
    robot: str | None,
    goal: tuple[float, float, float] | None,
    goal_view: int | None,
    goal_image: Path | None,
    output: Path | None,
    config: Path | None,
    print_config: bool,
    mask: Path | None,
    memory: float | None,
    seed: int,
    is_dry: bool,
    true_start: tuple[float, float, float] | None,
    camera: Path | None,
    camera_width: int,
    motion_noise: tuple[float, float],
    motion_bias: tuple[float, float],
    actuation_noise: float,
    slip: float,
    sensor_noise: tuple[float, float],
    samples: int,
    variant: str,
    fault: tuple[str, int] | None,
    chosen: "Mapping[str, Any]",
    overwrite: bool,
    as_json: bool,
    progress: "Progress",
) -> int:
    """Drives a robot to a goal in SCENE.h5, or in a WORLD of areas, by what its camera sees.

    The run is written, however docking ends.

    The robot rotates until it is localized, drives to a staging pose behind the goal, and
    approaches in smaller and smaller steps. Where the surface lies in between, in another room, it
    takes a route over places where the map's photos were taken. Exit codes: 0 docked, 10 lost, 11
    blocked, 12 out of the allowed area, 13 timed out, 14 robot failed, 15 view blocked, 16 no way,
    130 interrupted; the robot is stopped and the run is saved in every case.

    Every setting of a config file is an option of the same name, those of lfnav localize among
    them; those not listed here are printed by --print-config and explained in docs/settings.md.

    \b
    Example:
      lfnav dock scene.h5 --robot my_robot:MyRobot --goal -1.15,-1.65,90 --dry-run
      lfnav dock scene.h5 --robot my_robot:MyRobot --goal -1.15,-1.65,90 -o dock.h5
      lfnav dock scene.h5 --robot sim:sample_data/elevators/scene/scene.xml --goal-view 3 -o dock.h5
    """
    from pipelines.dock.config import effective_settings, settings_text

    both = effective_settings(config, chosen)
    if print_config:
        click.echo(settings_text(both), nl=False)
        return 0
    if scene is None or robot is None:
        raise missing({"scene": scene, "robot": robot})
    if output is None and not is_dry:
        raise click.UsageError("give the run file with -o, or --dry-run")

    from pipelines.dock.goals import Goal
    from pipelines.dock.robots.choice import RobotOptions
    from pipelines.dock.robots.noise import MotionNoise, SensorNoise
    from pipelines.dock.robots.simulator import PathTracing
    from pipelines.dock.stage import DockRequest, dock_robot, dry_run

    options = RobotOptions(
        true_start=true_start,
        camera=camera,
        camera_width=camera_width,
        motion=MotionNoise(
            actuation=actuation_noise,
            odometry=motion_noise[0],
            odometry_turn=math.radians(motion_noise[1]),
            scale=motion_bias[0],
            drift=math.radians(motion_bias[1]),
            slip=slip,
        ),
        sensor=SensorNoise(*sensor_noise),
        tracing=PathTracing(samples, variant=variant),
        fault=fault,
    )
    has_goal = [goal, goal_view, goal_image].count(None) < 3
    request = DockRequest(
        scene=scene,
        robot=robot,
        # Only a robot that is to move needs one.
        goal=Goal(goal, goal_view, goal_image) if has_goal or not is_dry else None,
        filter_settings=both[0],
        settings=both[1],
        robot_options=options,
        seed=seed,
        mask=mask,
        memory=memory,
    )
    if output is None or is_dry:
        looked = dry_run(request)
        print_summary(looked, as_json)
        return looked.exit_code
    listener = _silent if _is_quiet() else _print_step
    summary = dock_robot(request, output, overwrite=overwrite, listener=listener)
    print_summary(summary, as_json)
    if _is_quiet() and summary.exit_code != 0:
        outcome = summary.docking.outcome
        click.echo(f"lfnav: {outcome.kind.word}: {outcome.reason}", err=True)
    return summary.exit_code


def _is_quiet() -> bool:
    return bool(click.get_current_context().meta.get("lfnav.quiet", False))


def _silent(report: "Report") -> None:
    """Says nothing of a step."""


def _print_step(report: "Report") -> None:
    """A line for each step, on stderr."""
    place = "place unknown"
    if report.estimate is not None:
        x, y, heading = report.estimate
        place = f"x {x:6.2f}  y {y:6.2f}  {math.degrees(heading):6.1f} deg  +-{report.sigma:.2f} m"
    distance = "" if report.distance is None else f"  {report.distance:.2f} m to the goal"
    objection = f", but {report.objection}" if report.objection else ""
    line = f"{report.step:4d}  {report.state:9s}  {report.status:8s}  {place}{distance}{objection}"
    click.echo(line, err=True)
