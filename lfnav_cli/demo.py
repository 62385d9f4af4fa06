"""``lfnav demo``: the whole chain on the drive that comes with lfnav."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lfnav_cli import common

if TYPE_CHECKING:
    from pipelines.artifacts.stages import Progress

# Before the call button, facing it; where the simulated robot begins. x, y, degrees.
GOAL, BEGIN = "-1.15,-1.65,90", "0.5,-3.5,120"


@click.command()
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path("lfnav-demo"),
    show_default=True,
    help="Folder to write.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Random seed.")
@common.overwrite_option
@common.common_options
def command(output: Path, seed: int, overwrite: bool, progress: "Progress") -> int:
    """Maps a lobby with three equal doors, finds a robot in it, and docks at the call button.

    Prints every command before it runs, so that they can be tried with other data. At the end there
    are two reports to look at. Needs no files but lfnav's own and takes half a minute.

    \b
    Example:
      lfnav demo
      lfnav demo -o /tmp/demo --overwrite
    """
    from pipelines.artifacts.atomic import check_output

    check_output(output / "report", overwrite, "report.html")
    quiet = click.get_current_context().meta["lfnav.quiet"]
    for title, words in chain(sample_drive(), output, seed, overwrite):
        if not quiet:
            click.secho(f"\n{title}", bold=True)
            click.echo(f"$ lfnav {shlex.join(words)}")
        code = common.run_command(main_command(), [*words, *["--quiet"] * quiet])
        if code != common.EXIT_OK:
            return code
    if not quiet:
        click.secho("\nDone. Open in a browser:", bold=True)
        for name in ("report", "dock-report"):
            click.echo(f"  {(output / name / 'report.html').absolute()}")
    return common.EXIT_OK


def chain(drive: Path, output: Path, seed: int, overwrite: bool) -> list[tuple[str, list[str]]]:
    """Title and arguments of each command.

    Args:
        drive: folder with the data sets ``map`` and ``test``.
        output: folder to be written.
        seed: of the random numbers.
        overwrite: whether files of an earlier demonstration may be replaced.
    """
    poses, scene, run, docked = (output / n for n in ("map", "scene.h5", "run.h5", "dock.h5"))
    odometry = drive / "test" / "odometry_perturbed.txt"
    again = " --overwrite" * overwrite
    texts = {
        "Where was each photo of the map taken? By the wheels' odometry.": (
            "reconstruct {} -o {} --method odometry" + again,
            (drive / "map", poses),
        ),
        "The scene model: photos, poses, and the plane of the wall.": (
            "model {} -o {}" + again,
            (poses, scene),
        ),
        "Where is the robot? It is told neither place nor heading, and its odometry is bad.": (
            f"localize {{}} {{}} -o {{}} --odometry {{}} --seed {seed}" + again,
            (scene, drive / "test", run, odometry),
        ),
        "How far off was it? Against the truth, which nothing above has used.": (
            "evaluate {}",
            (run,),
        ),
        "What it saw and believed, frame by frame.": (
            "report {} -o {}" + again,
            (run, output / "report"),
        ),
        "A simulated robot, lost as well, drives to the call button.": (
            f"dock {{}} --robot {{}} --goal {GOAL} --true-start {BEGIN} -o {{}} --seed {seed}"
            + again,
            (scene, f"model:{scene}", docked),
        ),
        "How it docked.": ("report {} -o {}" + again, (docked, output / "dock-report")),
    }
    commands = []
    for title, (text, values) in texts.items():
        given = iter(values)
        words = [str(next(given)) if word == "{}" else word for word in text.split()]
        commands.append((title, words))
    return commands


def main_command() -> click.Command:
    """The command whose subcommands are run."""
    from lfnav_cli.main import main

    return main


def sample_drive() -> Path:
    """Where the drive lies: beside the packages in a checkout, inside them in an installation.

    Raises:
        InputError: it was left out of this installation.
    """
    import pipelines
    from pipelines.artifacts.errors import InputError

    package = Path(pipelines.__file__).parent
    places = [base / "sample_data" / "elevators" for base in (package.parent, package)]
    for place in places:
        if (place / "map" / "rgb.txt").is_file():
            return place
    raise InputError(places[-1], "is missing from this installation", "install lfnav anew")
