"""Runs of a sweep on a Dask cluster.

The cluster's workers need lfnav, and the scenes and data sets under the same paths. Results are
sent back and stored where the sweep was started.
"""

from collections.abc import Iterator, Sequence

from distributed import Future, Worker, WorkerPlugin, as_completed, get_worker

from pipelines.artifacts.cluster import cluster_at
from pipelines.experiments.sweep_run import Outcome, RunExecutor, SweepRun

PLUGIN = "lfnav-sweep"


class ExecutorPlugin(WorkerPlugin):  # type: ignore[misc]
    """Keeps scenes loaded on a worker from one run to the next."""

    def setup(self, worker: Worker) -> None:
        """Called by Dask on each worker that gets the plugin."""
        self.executor = RunExecutor()


def run_on_cluster(runs: Sequence[SweepRun], address: str) -> Iterator[tuple[SweepRun, Outcome]]:
    """Executes runs on the workers of a cluster.

    Args:
        runs: the runs.
        address: address of the Dask scheduler, for example ``tcp://host:8786``.

    Yields:
        Each run with its outcome, in the order in which they end. Closing the iterator cancels the
        remaining ones.

    Raises:
        OptionError: no scheduler answers at the address.
    """
    with cluster_at(address) as client:
        client.register_plugin(ExecutorPlugin(), name=PLUGIN)
        futures = {client.submit(_outcome, run, pure=False): run for run in runs}
        try:
            for future in as_completed(futures):
                run = futures.pop(future)
                yield run, _outcome_of(future)
        finally:
            client.cancel(list(futures))


def _outcome(run: SweepRun) -> Outcome:
    """Executes a run; called on a worker."""
    plugin = get_worker().plugins[PLUGIN]
    if not isinstance(plugin, ExecutorPlugin):
        return Outcome(None, f"the worker has another plugin named {PLUGIN}")
    return plugin.executor.outcome(run)


def _outcome_of(future: Future) -> Outcome:
    """The outcome of a future; a failure where the worker died or has no lfnav."""
    error = future.exception()
    if error is not None:
        return Outcome(None, f"{type(error).__name__}: {' '.join(str(error).split())}")
    result: Outcome = future.result()
    return result
