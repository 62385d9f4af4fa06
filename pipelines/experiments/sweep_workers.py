"""Runs of a sweep on this machine: one process a processor, each with one thread.

The processes are no pool of the standard library. When one dies (killed for lack of memory), the
run that it was executing is known and the others go on. When the parent process is killed, they end
too.
"""

import multiprocessing
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess

import cv2

from pipelines.experiments.sweep_run import Outcome, RunExecutor, SweepRun


@dataclass(frozen=True)
class _Worker:
    """A process and the parent's end of the pipe to it."""

    process: SpawnProcess
    connection: Connection


def run_locally(runs: Sequence[SweepRun], processes: int) -> Iterator[tuple[SweepRun, Outcome]]:
    """Executes runs in several processes at once.

    Args:
        runs: the runs, started in this order.
        processes: number of processes, at least 1.

    Yields:
        Each run with its outcome, in the order in which they end. Closing the iterator stops those
        in progress.
    """
    waiting = deque(runs)
    workers: list[_Worker] = []
    busy: dict[object, tuple[_Worker, SweepRun]] = {}
    idle: list[_Worker] = []
    try:
        while waiting or busy:
            while waiting and len(busy) < processes:
                if not idle:
                    idle.append(_started())
                    workers.append(idle[-1])
                worker = idle.pop()
                run = waiting.popleft()
                busy[worker.connection] = (worker, run)
                _send(worker, run)
            for connection in wait([worker.connection for worker, _ in busy.values()]):
                worker, run = busy.pop(connection)
                outcome = _received(worker)
                if outcome is None:
                    worker.process.join()
                    outcome = Outcome(None, _death(worker.process.exitcode))
                else:
                    idle.append(worker)
                yield run, outcome
    finally:
        for worker in workers:
            worker.connection.close()
            worker.process.terminate()
        for worker in workers:
            worker.process.join()


def _started() -> _Worker:
    """Starts a process; not by a fork, which threads do not survive."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(there,), daemon=True)
    process.start()
    # The child now holds the only copy of its end: when it dies, the pipe closes.
    there.close()
    return _Worker(process, here)


def _serve(connection: Connection) -> None:
    """Main function of a process: executes runs until the pipe closes."""
    # Ctrl-C reaches the whole process group; the parent ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
    executor = RunExecutor()
    try:
        while True:
            connection.send(executor.outcome(connection.recv()))
    except (EOFError, OSError):
        return


def _send(worker: _Worker, run: SweepRun) -> None:
    """Sends a run to a process."""
    try:
        worker.connection.send(run)
    except OSError:
        # It has died; ``_received`` will say so.
        return


def _received(worker: _Worker) -> Outcome | None:
    """The outcome that a process sent; None where it has died."""
    try:
        outcome = worker.connection.recv()
    except (EOFError, OSError):
        return None
    return outcome if isinstance(outcome, Outcome) else None


def _death(exit_code: int | None) -> str:
    """The failure of a run whose process died."""
    if exit_code is not None and exit_code < 0:
        name = signal.Signals(-exit_code).name
        return f"its process was ended by {name}; SIGKILL often means that memory ran out"
    return f"its process ended with exit code {exit_code}"
