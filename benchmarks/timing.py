"""How things are measured: medians of CPU and wall time over repeats, and on what machine.

What is compared takes turns (A B A B ...), so that a busy machine slows all alike; the first turn,
in which compiled functions are loaded, does not count.
"""

import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path


@dataclass(frozen=True)
class Timing:
    """Seconds of all processors together, and by the clock on the wall."""

    cpu: float
    wall: float

    def of_each(self, count: int) -> "Timing":
        """The time of one of ``count`` equal parts."""
        return Timing(self.cpu / count, self.wall / count)

    def to_dict(self) -> dict[str, float]:
        """Plain JSON types."""
        return {"cpu_s": round(self.cpu, 5), "wall_s": round(self.wall, 5)}


def median_times(tasks: Mapping[str, Callable[[], object]], turns: int) -> dict[str, Timing]:
    """Median times of each task; they take turns, after one turn that does not count."""
    cpu: dict[str, list[float]] = {name: [] for name in tasks}
    wall: dict[str, list[float]] = {name: [] for name in tasks}
    for turn in range(turns + 1):
        for name, task in tasks.items():
            start_cpu, start_wall = time.process_time(), time.perf_counter()
            task()
            if turn > 0:
                cpu[name].append(time.process_time() - start_cpu)
                wall[name].append(time.perf_counter() - start_wall)
    return {
        name: Timing(statistics.median(cpu[name]), statistics.median(wall[name])) for name in tasks
    }


def machine() -> dict[str, str]:
    """What the figures depend on."""
    cpu = platform.processor() or platform.machine()
    information = Path("/proc/cpuinfo")
    if information.is_file():
        lines = information.read_text(encoding="utf-8").splitlines()
        cpu = next((line.split(":")[1].strip() for line in lines if "model name" in line), cpu)
    packages = ("lfnav", "numpy", "numba", "opencv-python-headless")
    versions = {name: version(name) for name in packages}
    return {"cpu": cpu, "python": platform.python_version(), **versions}


def markdown_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table whose columns, but for the first, are set to the right."""
    lines = [headings, ["---", *["---:"] * (len(headings) - 1)], *rows]
    texts = [f"| {' | '.join(line)} |" for line in lines]
    texts[1] = texts[1].replace(" ", "")
    return "\n".join(texts)


def timing_table(title: str, times: dict[str, dict[str, float]]) -> str:
    """Rows of CPU and wall time in milliseconds."""
    rows = [
        (name, f"{1e3 * of['cpu_s']:.0f}", f"{1e3 * of['wall_s']:.0f}")
        for name, of in times.items()
    ]
    return markdown_table((title, "CPU (ms)", "wall (ms)"), rows)
