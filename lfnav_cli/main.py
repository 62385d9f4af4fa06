"""The ``lfnav`` command: finds the subcommand's module, maps errors to one line and exit codes."""

import importlib
import signal
import sys
from types import FrameType

import click

from lfnav_cli import common

# Subcommand -> its one line in ``lfnav --help``. Its module (see ``module_of``) is imported only
# when the subcommand is used, so that the help text appears at once.
COMMANDS = {
    "import": "A data set from a ROS bag, COLMAP, nerfstudio, KITTI, 7-Scenes, a grid or a video.",
    "reconstruct": "Camera poses of a data set: structure from motion, odometry, or given.",
    "model": "A light-field scene model from a reconstruction.",
    "render": "Virtual views of a scene model.",
    "localize": "Where was the robot? A particle filter over a data set.",
    "dock": "Drives a robot to a place by what its camera sees.",
    "ros": "Nodes of ROS 2: where is this robot, from its camera's topic?",
    "evaluate": "Errors of a run against ground truth.",
    "report": "A page with figures that shows how a run went.",
    "sweep": "Many runs with other seeds and settings, one table.",
    "export": "A run as TUM, KITTI, EuRoC, CSV, JSON or a ROS bag; a scene model for COLMAP.",
    "demo": "The whole chain on a drive that comes with lfnav.",
    "info": "What a file or folder made by lfnav, a data set or a ROS bag contains.",
}

# Names that Python keeps for itself cannot be those of modules.
_MODULES = {"import": "import_command"}


def module_of(command_name: str) -> str:
    """Name of the module in ``lfnav_cli`` that holds a subcommand."""
    return _MODULES.get(command_name, command_name)


class LazyGroup(click.Group):
    """A group whose commands live in modules that are imported on first use."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order in which data flows through them."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command, imported now; None where there is none of that name."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"lfnav_cli.{module_of(cmd_name)}")
        command = module.command
        if not isinstance(command, click.Command):
            raise TypeError(f"{module.__name__}.command is not a click command")
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Lists the commands from their one-liners alone."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(
    cls=LazyGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)
@click.version_option(package_name="lfnav", prog_name="lfnav")
@click.pass_context
def main(context: click.Context) -> None:
    """Localize and dock a robot with one camera and an image-based scene model.

    Files chain the commands: reconstruct -> model -> localize -> evaluate, report.
    'lfnav COMMAND --help' explains one of them.

    \b
    Example:
      lfnav demo
      lfnav reconstruct MAP_DATASET -o map --method odometry
      lfnav model map -o scene.h5
      lfnav localize scene.h5 TEST_DATASET -o run.h5
      lfnav report run.h5 -o report/
    """
    if context.invoked_subcommand is None:
        # Releases of click differ in stream and exit code here.
        click.echo(context.get_help(), err=True)
        context.exit(common.EXIT_USAGE)


def run() -> None:
    """Entry point of the console script: exit code 0, 1 (one-line error) or 2 (wrong usage)."""
    signal.signal(signal.SIGTERM, stop_cleanly)
    sys.exit(common.run_command(main))


def stop_cleanly(signal_number: int, frame: FrameType | None) -> None:
    """Ends the program by an exception, so that temporary files are removed on the way out."""
    sys.exit(128 + signal_number)


if __name__ == "__main__":
    run()
