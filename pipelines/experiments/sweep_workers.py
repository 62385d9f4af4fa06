"""Runs of a sweep on this machine: one process a processor, each with one thread.

Processes of its own, and not a pool of the standard library: when one dies (killed for want of
memory), it is known which run it was making, and the others go on; and when this process is killed,
they notice and end.
"""

import multiprocessing
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess

import cv2

from pipelines.experiments.sweep_run import Bench, Outcome, SweepRun


@dataclass(frozen=True)
class _Worker:
    """A process and this end of the pipe to it."""

    process: SpawnProcess
    connection: Connection


def run_locally(runs: Sequence[SweepRun], processes: int) -> Iterator[tuple[SweepRun, Outcome]]:
    """Makes runs in several processes at once.

    Args:
        runs: begun in this order.
        processes: at least 1.

    Yields:
        Each run with its outcome, in the order in which they end. Closing the iterator stops those
        that are under way.
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
    """A new process; not forked, since threads do not survive that."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(there,), daemon=True)
    process.start()
    # Now the other side is the only one that holds it: its death ends the pipe.
    there.close()
    return _Worker(process, here)


def _serve(connection: Connection) -> None:
    """What a process does: runs, until nobody asks for more."""
    # Ctrl-C reaches the whole group; whoever started this process ends it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
    bench = Bench()
    try:
        while True:
            connection.send(bench.outcome(connection.recv()))
    except (EOFError, OSError):
        return


def _send(worker: _Worker, run: SweepRun) -> None:
    try:
        worker.connection.send(run)
    except OSError:
        # It has died; receiving from it will tell.
        return


def _received(worker: _Worker) -> Outcome | None:
    """What a process sent; None where it has died."""
    try:
        outcome = worker.connection.recv()
    except (EOFError, OSError):
        return None
    return outcome if isinstance(outcome, Outcome) else None


def _death(exit_code: int | None) -> str:
    if exit_code is not None and exit_code < 0:
        name = signal.Signals(-exit_code).name
        return f"its process was ended by {name}; SIGKILL often means that memory ran out"
    return f"its process ended with exit code {exit_code}"
