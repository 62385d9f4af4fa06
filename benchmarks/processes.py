"""Times of whole processes."""

import os
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage

from benchmarks.scenes import ROOT
from benchmarks.timing import Timing

# The variable that says where compiled functions are kept.
CACHE_VARIABLE = "NUMBA_CACHE_DIR"


def process_times(command: Sequence[str], turns: int, cache: Path | None = None) -> list[Timing]:
    """Runs a command so many times, one after the other.

    Args:
        command: what is run in the repository's folder.
        turns: how many times.
        cache: where compiled functions are kept; None: where they always are.
    """
    environment: Mapping[str, str] = os.environ
    if cache is not None:
        environment = {**os.environ, CACHE_VARIABLE: str(cache)}
    spent = []
    for _ in range(turns):
        before, start = getrusage(RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, cwd=ROOT, env=environment)
        wall = time.perf_counter() - start
        after = getrusage(RUSAGE_CHILDREN)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        spent.append(Timing(cpu, wall))
    return spent
