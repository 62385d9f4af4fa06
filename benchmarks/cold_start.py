"""How long it takes until the first answer: processes of their own, from their start to their end.

The first turn of each does not count: Python writes its byte code then, and files are read from the
disk.
"""

import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.processes import process_times
from benchmarks.scenes import ELEVATORS
from benchmarks.timing import medians, timing_table
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import save_scene

TURNS = 5
MODEL, ONE_IMAGE, RUN = "plane.h5", "one-image", "run.h5"
LOCALIZE, LIBRARY, HELP = "lfnav localize, one image", "import the localizer", "lfnav --help"


def measure(scene: Scene) -> dict[str, Any]:
    """Seconds of processes; plain JSON types."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        save_scene(folder / MODEL, scene, overwrite=False)
        drive_of_one_image(folder / ONE_IMAGE)
        times = {
            what: medians(process_times(command, TURNS, rehearsals=1))
            for what, command in commands(folder).items()
        }
    return {
        "start_to_first_pose_s": round(times[LOCALIZE].wall, 2),
        "cold_start": {
            "turns": TURNS,
            "times": {what: value.to_dict() for what, value in times.items()},
        },
    }


def commands(folder: Path) -> dict[str, list[str]]:
    """What is run: the model and the image are in a folder, and the run goes there."""
    lfnav = [sys.executable, "-m", "lfnav_cli.main"]
    model, drive, run = (str(folder / name) for name in (MODEL, ONE_IMAGE, RUN))
    return {
        LOCALIZE: [*lfnav, "localize", model, drive, "-o", run, "--overwrite"],
        LIBRARY: [sys.executable, "-c", "import pipelines.localize.localizer"],
        HELP: [*lfnav, "--help"],
    }


def drive_of_one_image(folder: Path) -> None:
    """Writes the lobby's test sequence up to its first image."""
    source = ELEVATORS / "test"
    shutil.copytree(source, folder)
    lines = (source / "rgb.txt").read_text(encoding="utf-8").splitlines(keepends=True)
    first = next(index for index, line in enumerate(lines) if not line.startswith("#"))
    (folder / "rgb.txt").write_text("".join(lines[: first + 1]), encoding="utf-8")


def table(results: dict[str, Any]) -> str:
    """The figures for people."""
    return timing_table("a process", results["cold_start"]["times"])
