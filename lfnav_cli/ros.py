"""``lfnav ros``: nodes of ROS 2."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfnav_cli.common import common_options
from lfnav_cli.setting_options import SettingsCommand, config_file_option, setting_options

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pipelines.artifacts.setting import Entry
    from pipelines.artifacts.stages import Progress

ROS_ARGUMENTS = "--ros-args"


def ros_entries() -> "Sequence[Entry]":
    """The settings of the nodes, and those of the localization."""
    from pipelines.ros.node_settings import ENTRIES

    return ENTRIES


class NodeCommand(SettingsCommand):
    """A command that leaves everything from --ros-args on to ROS."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Keeps ROS's arguments apart."""
        cut = args.index(ROS_ARGUMENTS) if ROS_ARGUMENTS in args else len(args)
        ctx.meta["lfnav.ros_arguments"] = args[cut:]
        return super().parse_args(ctx, args[:cut])


def detector_entries() -> "Sequence[Entry]":
    """The settings of the dock detector, of the nodes, and of the localization."""
    from pipelines.ros.detector_settings import ENTRIES

    return (*ENTRIES, *ros_entries())


memory_option = click.option(
    "--memory",
    type=float,
    metavar="MB",
    help="In a world of areas: what localization may take of memory beyond the program itself. "
    "Default: 1000.",
)
seed_option = click.option("--seed", type=int, default=0, show_default=True, help="Random seed.")
autostart_option = click.option(
    "--autostart", is_flag=True, help="Configure and activate at once, without a lifecycle manager."
)


@click.group("ros")
def command() -> None:
    """Nodes of ROS 2, for a robot."""


@command.command("localize", cls=NodeCommand)
@click.argument("scene", metavar="SCENE.h5|WORLD", type=click.Path(path_type=Path))
@config_file_option
@memory_option
@seed_option
@autostart_option
@common_options
@setting_options(ros_entries())
def localize(
    scene: Path,
    config: Path | None,
    memory: float | None,
    seed: int,
    autostart: bool,
    chosen: "Mapping[str, Any]",
    progress: "Progress",
) -> None:
    """Localizes a robot by its camera, with the topics and services of AMCL.

    A managed node, named amcl. Every setting is an option, and a parameter of that name, which wins
    over it; those not listed here are explained in docs/settings.md. What follows --ros-args is for
    ROS. docs/ros.md says more.

    \b
    Example:
      lfnav ros localize scene.h5 --autostart --image-topic camera/image_raw
      lfnav ros localize world/ --odometry-topic odom --camera camera.toml
      lfnav ros localize scene.h5 --ros-args --params-file nav2.yaml -r __ns:=/robot1
    """
    from pipelines.ros.run_node import run_localizer

    run_localizer(
        scene,
        config,
        chosen,
        seed=seed,
        memory=memory,
        autostart=autostart,
        ros_arguments=click.get_current_context().meta["lfnav.ros_arguments"],
    )


@command.command("dock-detector", cls=NodeCommand)
@click.argument("scene", metavar="SCENE.h5|WORLD", type=click.Path(path_type=Path))
@config_file_option
@memory_option
@seed_option
@autostart_option
@common_options
@setting_options(detector_entries())
def dock_detector(
    scene: Path,
    config: Path | None,
    memory: float | None,
    seed: int,
    autostart: bool,
    chosen: "Mapping[str, Any]",
    progress: "Progress",
) -> None:
    """Tells nav2's docking server where a dock is, by the robot's camera.

    A managed node, named dock_detector. It publishes detected_dock_pose from one call of the
    service detect_dock (std_srvs/Trigger) to the next, and nothing that is old or not sure. Every
    setting is an option, and a parameter of that name. docs/ros.md has nav2's parameters.

    \b
    Example:
      lfnav ros dock-detector scene.h5 --goal -1.15,-1.65,90 --autostart
      lfnav ros dock-detector world/ --ros-args --params-file nav2.yaml
    """
    from pipelines.ros.run_node import run_dock_detector

    run_dock_detector(
        scene,
        config,
        chosen,
        seed=seed,
        memory=memory,
        autostart=autostart,
        ros_arguments=click.get_current_context().meta["lfnav.ros_arguments"],
    )
