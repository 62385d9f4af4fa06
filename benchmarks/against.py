"""The same work by this lfnav and by an older revision of it, in turns.

    python -m benchmarks.against [REVISION] [--level x86-64-v3] [--turns 7] [--only WORDS]

The revision, by default the last one whose kernels were compiled by numba, is unpacked and
installed into an environment of its own below ``out/against``, once. Both sides are processes that
do pieces of work when asked (``against_worker``), one at a time: on a busy machine both are slowed
alike. ``--level`` limits this side's C++ to an older processor; numba always compiles for the one
that is there. A table of medians and their ratios is printed; processor time decides.
"""

import argparse
import io
import json
import os
import statistics
import subprocess
import sys
import tarfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from benchmarks.scenes import (
    ELEVATORS,
    ROOT,
    elevators_scene,
    repeated,
    with_wall_as_depth,
    workshop_reconstruction,
)
from benchmarks.timing import Timing, machine, markdown_table, medians
from pipelines.lightfield.scene_file import save_scene

LAST_WITH_NUMBA = "467e3eb"
FOLDER = ROOT / "out" / "against"
MANY_VIEWS = 1000
# A turn repeats its work for so long.
TURN_SECONDS = 0.3


def installed(revision: str) -> Path:
    """The Python of an environment into which a revision is installed, not in place."""
    name = ["git", "-C", str(ROOT), "rev-parse", "--short=12", f"{revision}^{{commit}}"]
    commit = subprocess.run(name, check=True, capture_output=True, text=True).stdout.strip()
    tree = FOLDER / commit
    python = tree / ".venv" / "bin" / "python"
    done = tree / ".venv" / "installed"
    if not done.is_file():
        archive = subprocess.run(
            ["git", "-C", str(ROOT), "archive", commit], check=True, capture_output=True
        ).stdout
        with tarfile.open(fileobj=io.BytesIO(archive)) as files:
            files.extractall(tree, filter="data")
        subprocess.run([sys.executable, "-m", "venv", "--clear", tree / ".venv"], check=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", tree], check=True)
        done.touch()
    return python


def inputs() -> Path:
    """The folder with what both sides work on, made once."""
    folder = FOLDER / "inputs"
    done = folder / "done"
    if not done.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        scene = elevators_scene()
        save_scene(folder / "plane.h5", scene, overwrite=True)
        save_scene(folder / "depth.h5", with_wall_as_depth(scene), overwrite=True)
        save_scene(folder / f"plane-{MANY_VIEWS}.h5", repeated(scene, MANY_VIEWS), overwrite=True)
        if not (folder / "map").is_dir():
            workshop_reconstruction(folder / "map")
        if not (folder / "test").exists():
            (folder / "test").symlink_to(ELEVATORS / "test")
        done.touch()
    return folder


class Side:
    """A process that does the work.

    Args:
        process: of ``against_worker``.
    """

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process
        self.works: list[str] = json.loads(self._answer())

    def time(self, work: str, seconds: float) -> Timing:
        """Of one particle, view, alignment or depth map; the work is repeated for some seconds."""
        if self._process.stdin is None:
            raise ValueError("the process cannot be asked")
        self._process.stdin.write(json.dumps({"work": work, "seconds": seconds}) + "\n")
        self._process.stdin.flush()
        spent = json.loads(self._answer())
        return Timing(spent["cpu_s"], spent["wall_s"])

    def _answer(self) -> str:
        line = self._process.stdout.readline() if self._process.stdout else ""
        if not line:
            raise RuntimeError("the process has ended; its last words stand above")
        return line


@contextmanager
def side(python: Path, folder: Path, level: str | None) -> Iterator[Side]:
    """Starts a process of some Python, and ends it."""
    environment = dict(os.environ)
    if level is not None:
        environment["LFNAV_INSTRUCTION_SET"] = level
    worker = Path(__file__).with_name("against_worker.py")
    # -P: the folder of the worker is not searched for modules.
    command = [str(python), "-P", str(worker), str(folder)]
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command, stdin=pipe, stdout=pipe, text=True, env=environment, cwd=folder
    ) as process:
        try:
            yield Side(process)
        finally:
            process.kill()


def compared(sides: Sequence[Side], work: str, turns: int) -> list[Timing]:
    """Median times of a piece of work by each of the sides, which take turns."""
    spent: list[list[Timing]] = [[] for _ in sides]
    # In the first turn, which does not count, scenes and functions are loaded.
    for turn in range(1 + turns):
        for times, each in zip(spent, sides, strict=True):
            timing = each.time(work, TURN_SECONDS if turn else 0.0)
            if turn:
                times.append(timing)
    return [medians(times) for times in spent]


def main(arguments: Sequence[str]) -> int:
    """Measures and prints."""
    parser = argparse.ArgumentParser(prog="benchmarks.against", description=__doc__.splitlines()[0])
    parser.add_argument("revision", nargs="?", default=LAST_WITH_NUMBA)
    parser.add_argument("--level", help="of this side's C++: baseline or x86-64-v3")
    parser.add_argument("--turns", type=int, default=7)
    parser.add_argument("--only", default="", help="works whose name contains this")
    options = parser.parse_args(arguments)
    folder, old = inputs(), installed(options.revision)
    rows, ratios = [], []
    with (
        side(old, folder, None) as before,
        side(Path(sys.executable), folder, options.level) as now,
    ):
        for work in now.works:
            if options.only not in work or work not in before.works:
                continue
            then, this = compared((before, now), work, options.turns)
            ratios.append(this.cpu / then.cpu)
            rows.append((work, _cell(then), _cell(this), f"{ratios[-1]:.2f}"))
            print(f"{work}: {ratios[-1]:.2f}", file=sys.stderr, flush=True)
    print(", ".join(f"{name}: {value}" for name, value in machine().items()) + "\n")
    heading = ("a particle, a view, an alignment, a depth map", options.revision, "now", "ratio")
    print(markdown_table((heading[0], f"{heading[1]} (ms)", "now (ms)", heading[3]), rows))
    print(f"\nmedian ratio {statistics.median(ratios):.2f}, largest {max(ratios):.2f}")
    return 0


def _cell(timing: Timing) -> str:
    """Processor time and, in brackets, time by the clock, milliseconds."""
    return f"{1e3 * timing.cpu:.3f} ({1e3 * timing.wall:.3f})"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
