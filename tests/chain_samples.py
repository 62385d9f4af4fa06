"""The command line as tests call it, and what they make of the sample data with it."""

import contextlib
import io
import shutil
from dataclasses import dataclass
from pathlib import Path

from lfnav_cli.common import run_command
from lfnav_cli.main import main

ELEVATORS = Path(__file__).parents[1] / "sample_data" / "elevators"


@dataclass(frozen=True)
class Outcome:
    """What a command left behind: its exit code and what it printed."""

    code: int
    out: str
    err: str


def lfnav(*arguments: str | Path) -> Outcome:
    """Runs the command line in this process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run_command(main, [str(argument) for argument in arguments])
    return Outcome(code, out.getvalue(), err.getvalue())


def succeed(*arguments: str | Path) -> str:
    """Runs a command that has to work without a word on stderr, and returns what it printed."""
    outcome = lfnav(*arguments)
    assert outcome.code == 0, outcome.err
    assert outcome.err == ""
    return outcome.out


def map_elevators(folder: Path, *model_options: str) -> Path:
    """``folder/scene.h5``: the lobby, mapped by odometry."""
    succeed("reconstruct", ELEVATORS / "map", "-o", folder / "map", "--method", "odometry")
    succeed("model", folder / "map", "-o", folder / "scene.h5", *model_options)
    return folder / "scene.h5"


def first_frames(source: Path, target: Path, count: int) -> Path:
    """Copies the first frames of a data set; a test may damage the copy."""
    entries = [
        line
        for line in (source / "rgb.txt").read_text(encoding="utf-8").splitlines()
        if not line.startswith("#")
    ][:count]
    (target / "rgb").mkdir(parents=True)
    for entry in entries:
        name = entry.split()[1]
        shutil.copyfile(source / name, target / name)
    (target / "rgb.txt").write_text("\n".join(entries) + "\n", encoding="utf-8")
    for path in [source / "camera.toml", *source.glob("*odometry*.txt"), *source.glob("g*.txt")]:
        shutil.copyfile(path, target / path.name)
    return target
