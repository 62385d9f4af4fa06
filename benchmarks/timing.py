"""How things are measured: medians of CPU and wall time over repeats, and on what machine.

What is compared takes turns (A B A B ...), so that a busy machine slows all alike; the first turn,
in which memory and the processor's caches are still to be filled, does not count.
"""

import contextlib
import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from pipelines.artifacts.processes import processor_count


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


def medians(times: Sequence[Timing]) -> Timing:
    """Medians of CPU and of wall time."""
    return Timing(
        statistics.median(each.cpu for each in times),
        statistics.median(each.wall for each in times),
    )


def median_times(
    tasks: Mapping[str, Callable[[], object]], turns: int, rehearsals: int = 1
) -> dict[str, Timing]:
    """Median times of each task; they take turns, after some turns that do not count."""
    spent: dict[str, list[Timing]] = {name: [] for name in tasks}
    for turn in range(rehearsals + turns):
        for name, task in tasks.items():
            start = Timing(time.process_time(), time.perf_counter())
            task()
            end = Timing(time.process_time(), time.perf_counter())
            if turn >= rehearsals:
                spent[name].append(Timing(end.cpu - start.cpu, end.wall - start.wall))
    return {name: medians(times) for name, times in spent.items()}


def machine() -> dict[str, str]:
    """What the figures depend on."""
    cpu = platform.processor() or platform.machine()
    information = Path("/proc/cpuinfo")
    if information.is_file():
        lines = information.read_text(encoding="utf-8").splitlines()
        cpu = next((line.split(":")[1].strip() for line in lines if "model name" in line), cpu)
    processors = str(processor_count())
    python = platform.python_version()
    return {"cpu": cpu, "processors": processors, "python": python, **_versions()}


def _versions() -> dict[str, str]:
    """Of the packages that matter, where they are installed."""
    found = {}
    for name in ("lfnav", "numpy", "scipy", "opencv-python-headless", "torch"):
        with contextlib.suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


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
