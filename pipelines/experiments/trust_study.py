"""Whether status and confidence of a run can be trusted: runs under many conditions."""

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pipelines.artifacts.errors import InputError, LfnavError, OptionError, StageError
from pipelines.artifacts.processes import processor_count
from pipelines.artifacts.stages import Progress, no_progress
from pipelines.dataset.dataset import (
    GROUNDTRUTH_FILE,
    ODOMETRY_FILE,
    Dataset,
    load_dataset,
)
from pipelines.experiments.sweep_result import judged
from pipelines.experiments.trust_conditions import Condition
from pipelines.geometry.interpolation import poses_at_times
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene
from pipelines.localize.run import Run
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.stage import NO_ODOMETRY, RunOrigin, localize_dataset
from pipelines.localize.trust import Trust, pooled, trust_elsewhere, trust_of
from pipelines.render.choices import Channels


@dataclass(frozen=True)
class Task:
    """The runs of one row of the table, which one process executes.

    Attributes:
        condition: sequence and settings.
        odometry: one of the condition's odometry files.
        method: one of the condition's methods.
        channels: one of the condition's channels; None: those of its settings.
        threads: number of threads of the filter.
    """

    condition: Condition
    odometry: Path | None
    method: str
    channels: Channels | None
    threads: int

    @property
    def odometry_name(self) -> str:
        """Name of the odometry in the table; "-" where it is not used, as by single frames."""
        if self.method == "pnp" or self.condition.starts:
            return "-"
        return ODOMETRY_FILE if self.odometry is None else self.odometry.name

    @property
    def method_name(self) -> str:
        """Name of method and channels in the table."""
        return self.method if self.channels is None else f"{self.method}, {self.channels.value}"

    @property
    def settings(self) -> LocalizerSettings:
        """The condition's settings with this method and these channels."""
        own = replace(self.condition.settings, threads=self.threads)
        if self.method == "pnp":
            return replace(own, method="pnp", with_pnp=False, proposal="retrieval", start=None)
        if self.channels is None:
            return own
        return replace(own, likelihood=replace(own.likelihood, channels=self.channels))


@dataclass(frozen=True)
class Row:
    """A row of the table: the runs of a task.

    Attributes:
        name: name of the condition.
        odometry: name of the odometry file; "-" where none is used.
        method: ``filter`` or ``pnp``, and the channels where the condition has several.
        is_elsewhere: whether the images show another place than the scene.
        successes: number of successful runs; None where none can succeed.
        trust: status and confidence of the frames of all runs, with their errors.
        is_of_single_frames: whether each run is a single frame, started around its true pose.
    """

    name: str
    odometry: str
    method: str
    is_elsewhere: bool
    successes: int | None
    trust: Trust
    is_of_single_frames: bool = False


@dataclass(frozen=True)
class _Outcome:
    """Row or failure of a task; a text, since not every exception can be sent between processes."""

    row: Row | None
    failure: str | None = None


def rows_of(
    conditions: Sequence[Condition], *, workers: int, progress: Progress
) -> tuple[Row, ...]:
    """Executes all runs.

    Args:
        conditions: each gives a row for each odometry file, method and choice of channels.
        workers: number of processes; 1: this process.
        progress: wraps the loop over rows to report progress.

    Raises:
        OptionError: no workers.
        StageError: the runs of a condition failed; the message names it.
    """
    if workers < 1:
        raise OptionError(f"{workers} workers cannot do any work; give at least 1")
    threads = max(1, processor_count() // workers)
    tasks = tasks_of(conditions, threads)
    rows = []
    outcomes = _outcomes(tasks, workers)
    for task, outcome in zip(tasks, progress(outcomes, "conditions", len(tasks)), strict=True):
        if outcome.row is None:
            raise StageError(f"{task.condition.name}, {task.odometry_name}: {outcome.failure}")
        rows.append(outcome.row)
    return tuple(rows)


def tasks_of(conditions: Sequence[Condition], threads: int) -> tuple[Task, ...]:
    """The rows of the table; PnP uses neither odometry nor channels and has one a condition."""
    return tuple(
        Task(condition, odometry, method, channels, threads)
        for condition in conditions
        for method in condition.methods
        for odometry in (condition.odometry[:1] if method == "pnp" else condition.odometry)
        for channels in ((None,) if method == "pnp" else condition.channels or (None,))
    )


def row_of(task: Task) -> Row:
    """Executes the runs of a task, with scene and data set loaded once.

    Raises:
        InputError: an input cannot be used.
        OptionError: the settings do not fit the scene.
    """
    condition = task.condition
    scene = load_scene(condition.scene)
    is_without = task.odometry == NO_ODOMETRY
    dataset = load_dataset(
        condition.dataset,
        odometry=None if is_without else task.odometry,
        reads_odometry=not is_without,
    )
    source = condition.dataset / ODOMETRY_FILE if task.odometry is None else task.odometry
    successes, parts = 0, []
    for run in _runs(scene, dataset, task.settings, task, source):
        if condition.is_elsewhere:
            parts.append(trust_elsewhere(run))
            continue
        if run.groundtruth is None or not np.any(np.isfinite(run.groundtruth)):
            raise InputError(condition.dataset / GROUNDTRUTH_FILE, "has no pose at any image")
        successes += judged(run, 0.0).success
        parts.append(trust_of(run, run.groundtruth))
    return Row(
        condition.name,
        task.odometry_name,
        task.method_name,
        condition.is_elsewhere,
        None if condition.is_elsewhere else successes,
        pooled(parts),
        is_of_single_frames=condition.starts > 0,
    )


def disturbed_starts(
    dataset: Dataset, settings: LocalizerSettings, starts: int, seeds: Sequence[int]
) -> Iterator[tuple[Dataset, LocalizerSettings, int]]:
    """Single frames, each with random starts around its true pose.

    Args:
        dataset: data set with ground truth; frames without a true pose are left out.
        settings: the filter's settings; their standard deviations of the start are those by which
            starts are drawn.
        starts: number of starts for each frame and seed.
        seeds: seeds of the random starts.

    Yields:
        A data set of one frame, settings with its start, and a seed for the filter.
    """
    if dataset.groundtruth is None:
        return
    space = settings.state_space
    found = poses_at_times(dataset.groundtruth, dataset.timestamps)
    sigmas = np.array(
        [settings.start_position_sigma] * space.positions
        + [settings.start_heading_sigma] * space.angles
    )
    for seed in seeds:
        for frame in np.flatnonzero(found.is_known):
            truth = space.states(found.poses[[frame]])
            rng = np.random.default_rng([seed, int(frame)])
            noise = sigmas * rng.standard_normal((starts, space.dimension))
            for number, start in enumerate(space.moved(np.repeat(truth, starts, axis=0), noise)):
                single = replace(
                    dataset,
                    image_names=(dataset.image_names[frame],),
                    timestamps=dataset.timestamps[[frame]],
                    depth_names=None,
                )
                chosen = replace(settings, start=tuple(map(float, start)))
                yield single, chosen, seed * starts + number


def _runs(
    scene: Scene, dataset: Dataset, settings: LocalizerSettings, task: Task, source: Path
) -> Iterator[Run]:
    """The runs of a task.

    Args:
        scene: the scene model.
        dataset: the sequence with its odometry.
        settings: the filter's settings.
        task: the task.
        source: path of the odometry, for messages.
    """
    condition = task.condition
    # PnP does not depend on the seed.
    seeds = condition.seeds[:1] if task.method == "pnp" else condition.seeds
    chosen: Iterator[tuple[Dataset, LocalizerSettings, int]] = (
        (dataset, settings, seed) for seed in seeds
    )
    if condition.starts:
        chosen = disturbed_starts(dataset, settings, condition.starts, seeds)
    for frames, own, seed in chosen:
        yield localize_dataset(
            scene,
            frames,
            own,
            seed=seed,
            origin=RunOrigin(str(condition.scene), source),
            progress=no_progress,
        )


def _outcome(task: Task) -> _Outcome:
    """Executes a task; an error in it is its outcome."""
    try:
        return _Outcome(row_of(task))
    except (LfnavError, OSError) as error:
        return _Outcome(None, " ".join(str(error).split()))
    except MemoryError:
        return _Outcome(None, "out of memory")


def _outcomes(tasks: Sequence[Task], workers: int) -> Iterator[_Outcome]:
    """Executes tasks; yields their outcomes in order.

    Raises:
        StageError: a process was killed.
    """
    if workers == 1:
        yield from map(_outcome, tasks)
        return
    # Not by a fork, which threads do not survive.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        try:
            yield from pool.map(_outcome, tasks)
        except BrokenProcessPool as error:
            raise StageError(
                "a process was ended from outside; often that means that memory ran out"
            ) from error
