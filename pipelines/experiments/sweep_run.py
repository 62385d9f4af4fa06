"""One run of a sweep: its inputs, its outcome, and its execution."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pipelines.artifacts.errors import LfnavError
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.dataset import ODOMETRY_FILE, Dataset, load_dataset
from pipelines.experiments.sweep_inputs import (
    check_unchanged,
    dataset_hash,
    odometry_hash,
    scene_hash,
)
from pipelines.experiments.sweep_result import RunResult, judged
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.stage import RunOrigin, localize_dataset


@dataclass(frozen=True)
class Setup:
    """What the runs of one line of the table have in common: everything but the seed.

    Attributes:
        dataset: name of the data set.
        odometry: name of the odometry file, or ``none``.
        method: ``filter`` or ``pnp``; the attributes below are None with ``pnp``.
        strategy: the filter's strategy.
        proposal: source of the strategy's proposals; None where it draws none.
        likelihood: name of the likelihood, and its pixel subsampling unless that is usual.
        particles: number of particles while tracking.
    """

    dataset: str
    odometry: str
    method: str
    strategy: str | None
    proposal: str | None
    likelihood: str | None
    particles: int | None

    @property
    def contender(self) -> str:
        """Name of method, strategy and proposal in tables and figures."""
        if self.strategy is None:
            return self.method
        usual = self.proposal is None or self.proposal == LocalizerSettings.proposal
        return self.strategy if usual else f"{self.strategy}, proposal {self.proposal}"


@dataclass(frozen=True)
class SweepRun:
    """Inputs of a run.

    Attributes:
        setup: its line in the table.
        scene: absolute path of the scene model.
        dataset: absolute path of the data set.
        odometry: absolute path of a TUM file; None: the data set's own odometry, if there is any.
        uses_odometry: whether the run uses odometry at all.
        settings: the filter's settings.
        seed: seed of the filter's random numbers.
        inputs: name of an input -> SHA-256 of its content.
        key: SHA-256 of settings, seed and inputs.
    """

    setup: Setup
    scene: Path
    dataset: Path
    odometry: Path | None
    uses_odometry: bool
    settings: LocalizerSettings
    seed: int
    inputs: Mapping[str, str]
    key: str


@dataclass(frozen=True)
class Outcome:
    """How a run ended: with a result or with a failure.

    Attributes:
        result: of a run that was executed to its end; else None.
        failure: one line that says why there is no result; else None.
    """

    result: RunResult | None
    failure: str | None = None


class RunExecutor:
    """Executes runs one after the other; scenes and data sets stay loaded between them."""

    def __init__(self) -> None:
        self._scenes: dict[tuple[Path, str], Scene] = {}
        self._datasets: dict[tuple[Path, Path | None, str, str | None], Dataset] = {}

    def outcome(self, run: SweepRun) -> Outcome:
        """Executes a run; an error in it is its outcome."""
        try:
            return Outcome(self.result(run))
        except (LfnavError, OSError) as error:
            return Outcome(None, " ".join(str(error).split()))
        except MemoryError:
            return Outcome(None, "out of memory")
        except Exception as error:  # noqa: BLE001
            # A defect of lfnav must not end the other runs.
            return Outcome(None, f"internal error, {type(error).__name__}: {error}")

    def result(self, run: SweepRun) -> RunResult:
        """Executes a run.

        Raises:
            InputError: an input cannot be used.
            OptionError: the settings do not fit the scene.
        """
        source = run.odometry if run.odometry is not None else run.dataset / ODOMETRY_FILE
        start = _cpu_seconds()
        finished = localize_dataset(
            self._scene(run),
            self._dataset(run),
            run.settings,
            seed=run.seed,
            origin=RunOrigin(str(run.scene), source),
            progress=no_progress,
        )
        return judged(finished, _cpu_seconds() - start)

    def _scene(self, run: SweepRun) -> Scene:
        """The run's scene, loaded once."""
        place = (run.scene, run.inputs["scene"])
        if place not in self._scenes:
            check_unchanged(run.scene, scene_hash(run.scene), run.inputs["scene"])
            self._scenes[place] = load_scene(run.scene)
        return self._scenes[place]

    def _dataset(self, run: SweepRun) -> Dataset:
        """The run's data set with its odometry, loaded once."""
        place = (run.dataset, run.odometry, run.inputs["dataset"], run.inputs.get("odometry"))
        if place not in self._datasets:
            loaded = load_dataset(
                run.dataset, odometry=run.odometry, reads_odometry=run.uses_odometry
            )
            check_unchanged(run.dataset, dataset_hash(loaded), run.inputs["dataset"])
            if loaded.odometry is not None:
                found = odometry_hash(run.dataset, run.odometry)
                check_unchanged(run.odometry or run.dataset, found, run.inputs.get("odometry"))
            self._datasets[place] = loaded
        return self._datasets[place]


def _cpu_seconds() -> float:
    """Processor time of this process and of finished child processes, as PnP's."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system
