"""Work in a process of its own that talks in JSON lines, and how many processors there are.

Some libraries crash their process when they fail, or cannot be stopped. A worker runs them: the
parent starts it here and reads events from its stdout; its stdin is open as long as the parent
lives. What libraries print goes to a log file, of which the most informative line is quoted when
the worker crashes.
"""

import ctypes
import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import IO, Any, TypeVar

import pipelines
from pipelines.artifacts.errors import StageError, quoted

QUOTED_CHARACTERS = 300
Item = TypeVar("Item")
Result = TypeVar("Result")

PR_SET_PDEATHSIG = 1  # from linux/prctl.h


def in_threads(
    work: Callable[[Item], Result], items: Sequence[Item], threads: int | None = None
) -> Iterator[Result]:
    """Yields what ``work`` makes of each item, in order, done by so many threads at once.

    It pays for work that OpenCV, Pillow, the C++ core or NumPy do on arrays of some size: meanwhile
    they let other threads run.

    Args:
        work: raises what is raised here.
        items: what to work on.
        threads: None: one a processor.
    """
    with ThreadPoolExecutor(threads or processor_count()) as pool:
        yield from pool.map(work, items)


def processor_count() -> int:
    """How many processors this process may use."""
    # macOS and Windows cannot restrict a process to some of them.
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def worker_command(module: str) -> tuple[str, ...]:
    """The command that runs a module of this project as a worker."""
    # -P: without the current folder among the places that are searched for modules.
    return (sys.executable, "-P", "-m", module)


class WorkerError(StageError):
    """A worker ended before it was done; what it has finished may still be used."""


class WorkerProcess:
    """The parent's end; the worker is killed when the block ends, however it ends.

    Args:
        command: program and arguments.
        folder: the worker runs in it and its log comes there.
        work: what it does, as errors name it.
        environment: variables beside the parent's own.
    """

    def __init__(
        self,
        command: Sequence[str],
        folder: Path,
        work: str,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._command = tuple(command)
        self._folder = folder
        self._work = work
        self._environment = dict(environment or {})
        self._log_path = folder / "worker.log"
        self._lines: queue.Queue[str | None] = queue.Queue()

    def __enter__(self) -> "WorkerProcess":
        # With -P and the explicit path nothing is imported from whatever folder this runs in.
        home = str(Path(next(iter(pipelines.__path__))).parent)
        search = [home, *filter(None, [os.environ.get("PYTHONPATH")])]
        with self._log_path.open("wb") as log:
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                cwd=self._folder,
                env={**os.environ, **self._environment, "PYTHONPATH": os.pathsep.join(search)},
                text=True,
                encoding="utf-8",
            )
        output = self._process.stdout
        if output is None:
            raise StageError(f"the worker for {self._work} has no output")
        threading.Thread(target=self._read, args=(output,), daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                try:
                    stream.close()
                except OSError:
                    # What was not yet written has nobody left to read it.
                    continue

    def _read(self, output: IO[str]) -> None:
        for line in output:
            self._lines.put(line)
        self._lines.put(None)

    def read(self, timeout: float | None = None) -> dict[str, Any]:
        """The next thing that the worker says; ``queue.Empty`` after ``timeout`` seconds.

        Raises:
            WorkerError: the worker ended.
            StageError: it said something that is no JSON object.
        """
        line = self._lines.get(timeout=timeout)
        if line is None:
            raise WorkerError(self._epitaph())
        try:
            event = json.loads(line)
        except ValueError:
            event = None
        if not isinstance(event, dict):
            raise StageError(f"the worker for {self._work} said {quoted(line)}")
        return event

    def _epitaph(self) -> str:
        """Why the worker ended, in one line."""
        code = self._process.wait()
        said = last_words(self._log_path)
        how = f"exit code {code}"
        if code < 0:
            how = signal.Signals(-code).name
            if -code == signal.SIGKILL:
                how += ", out of memory?"
        return f"{self._work} crashed ({how}): {said}"


def last_words(log_path: Path) -> str:
    """The line of a log that tells best what went wrong."""
    lines = log_path.read_text(encoding="utf-8", errors="replace").splitlines()
    lines = [line.strip() for line in lines if line.strip()]
    # glog marks errors by E and fatal ones by F and the date; stack traces begin with an @.
    grave = [line for line in lines if line[:1] in "EF" and line[1:5].isdigit()]
    spoken = [line for line in lines if not line.startswith(("@", "***"))]
    chosen = (grave or spoken or ["it left no message"])[-1]
    return chosen[:QUOTED_CHARACTERS]


def die_with_parent() -> None:
    """Called by a worker: it is killed when its parent is gone, however that went.

    Only Linux can do this. Elsewhere a worker has to notice the end of its input.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def own_output() -> IO[str]:
    """Called by a worker: its stdout, which from now on nobody else writes to."""
    events = os.fdopen(os.dup(1), "w", buffering=1, encoding="utf-8")
    os.dup2(2, 1)
    return events
