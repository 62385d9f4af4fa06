"""Times of whole processes."""

import os
import subprocess
import time
from collections.abc import Sequence
from resource import RUSAGE_CHILDREN, getrusage

from benchmarks.scenes import ROOT
from benchmarks.timing import Timing

# Where this is set Python compiles lfnav again at every start, which takes 0.15 s and more.
NO_BYTE_CODE = "PYTHONDONTWRITEBYTECODE"


def process_times(command: Sequence[str], turns: int, rehearsals: int = 0) -> list[Timing]:
    """Runs a command so many times, one after the other, after some turns that do not count.

    Args:
        command: what is run in the repository's folder.
        turns: how many times.
        rehearsals: how many times before.
    """
    # As where lfnav is used, whatever the shell that measures says.
    environment = {name: value for name, value in os.environ.items() if name != NO_BYTE_CODE}
    spent = []
    for _ in range(rehearsals + turns):
        before, start = getrusage(RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, cwd=ROOT, env=environment)
        wall = time.perf_counter() - start
        after = getrusage(RUSAGE_CHILDREN)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        spent.append(Timing(cpu, wall))
    return spent[rehearsals:]
