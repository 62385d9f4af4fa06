"""One run of a sweep: what goes in, what comes out, and how the one becomes the other."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
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
from pipelines.localize.stage import Origin, localize_dataset


@dataclass(frozen=True)
class Setup:
    """What the runs of one line of the table have in common: everything but the seed.

    Attributes:
        dataset: its name.
        odometry: name of the odometry file, or ``none``.
        method: ``filter`` or ``pnp``, which uses nothing of a filter.
        strategy: of the filter; None: there is none. So it is with those that follow.
        proposal: where the strategy looks; None: it takes no proposals.
        likelihood: kind of the comparison, and how many pixels where these are not the usual.
        particles: kept while tracking.
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
        """What tables and figures call the way of localizing."""
        if self.strategy is None:
            return self.method
        usual = self.proposal is None or self.proposal == LocalizerSettings.proposal
        return self.strategy if usual else f"{self.strategy}, proposal {self.proposal}"


@dataclass(frozen=True)
class SweepRun:
    """What goes into a run.

    Attributes:
        setup: its line in the table.
        scene: scene model, absolute.
        dataset: absolute.
        odometry: TUM file, absolute; None: the data set's own, if there is one.
        uses_odometry: False: whatever odometry there is, the run knows nothing of it.
        settings: of the filter.
        seed: of its random numbers.
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
    """How a run ended; one of the two is known.

    Attributes:
        result: of a run that came to its end, wherever that was.
        failure: why there is no result, in one line.
    """

    result: RunResult | None
    failure: str | None = None


class Bench:
    """Makes runs one after the other; scenes and data sets stay loaded between them."""

    def __init__(self) -> None:
        self._scenes: dict[tuple[Path, str], Scene] = {}
        self._datasets: dict[tuple[Path, Path | None, str, str | None], Dataset] = {}

    def outcome(self, run: SweepRun) -> Outcome:
        """Makes a run; whatever goes wrong in it is its outcome."""
        try:
            return Outcome(self.result(run))
        except (LfnavError, OSError) as error:
            return Outcome(None, " ".join(str(error).split()))
        except MemoryError:
            return Outcome(None, "out of memory")
        except Exception as error:  # noqa: BLE001
            # A defect of lfnav; it must not take the other runs with it.
            return Outcome(None, f"internal error, {type(error).__name__}: {error}")

    def result(self, run: SweepRun) -> RunResult:
        """Makes a run.

        Raises:
            InputError: an input cannot be used.
            OptionError: settings that make no sense for this scene.
        """
        source = run.odometry if run.odometry is not None else run.dataset / ODOMETRY_FILE
        start = _cpu_seconds()
        finished = localize_dataset(
            self._scene(run),
            self._dataset(run),
            run.settings,
            seed=run.seed,
            origin=Origin(source, str(run.scene)),
            progress=no_progress,
        )
        return judged(finished, _cpu_seconds() - start)

    def _scene(self, run: SweepRun) -> Scene:
        place = (run.scene, run.inputs["scene"])
        if place not in self._scenes:
            check_unchanged(run.scene, scene_hash(run.scene), run.inputs["scene"])
            self._scenes[place] = load_scene(run.scene)
        return self._scenes[place]

    def _dataset(self, run: SweepRun) -> Dataset:
        place = (run.dataset, run.odometry, run.inputs["dataset"], run.inputs.get("odometry"))
        if place not in self._datasets:
            loaded = load_dataset(run.dataset, odometry=run.odometry)
            if not run.uses_odometry:
                loaded = replace(loaded, odometry=None)
            check_unchanged(run.dataset, dataset_hash(loaded), run.inputs["dataset"])
            if loaded.odometry is not None:
                found = odometry_hash(run.dataset, run.odometry)
                check_unchanged(run.odometry or run.dataset, found, run.inputs.get("odometry"))
            self._datasets[place] = loaded
        return self._datasets[place]


def _cpu_seconds() -> float:
    """Processor time of this process and of those that it has waited for, as PnP's."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system
