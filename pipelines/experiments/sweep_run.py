"""One run of a sweep: what goes in, what comes out, and how the one becomes the other."""

import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.errors import LfnavError
from pipelines.artifacts.json_fields import JsonFields
from pipelines.artifacts.progress import no_progress
from pipelines.dataset.dataset import ODOMETRY_FILE, Dataset, load_dataset
from pipelines.experiments.sweep_inputs import (
    check_unchanged,
    dataset_hash,
    odometry_hash,
    scene_hash,
)
from pipelines.lightfield.bundle import load_scene
from pipelines.lightfield.scene import Scene
from pipelines.localize.evaluation import RunEvaluation, evaluate_run
from pipelines.localize.run import Run
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.stage import localize_dataset


@dataclass(frozen=True)
class Setup:
    """What the runs of one line of the table have in common: everything but the seed.

    Attributes:
        dataset: its name.
        odometry: name of the odometry file, or ``none``.
        strategy: of the filter.
        likelihood: kind of the comparison.
        particles: kept while tracking.
    """

    dataset: str
    odometry: str
    strategy: str
    likelihood: str
    particles: int


@dataclass(frozen=True)
class SweepRun:
    """What goes into a run.

    Attributes:
        setup: its line in the table.
        scene: scene model, absolute.
        dataset: absolute.
        odometry: TUM file, absolute; None: the data set's own, if there is one.
        settings: of the filter.
        seed: of its random numbers.
        inputs: name of an input -> SHA-256 of its content.
        key: SHA-256 of settings, seed and inputs.
    """

    setup: Setup
    scene: Path
    dataset: Path
    odometry: Path | None
    settings: LocalizerSettings
    seed: int
    inputs: Mapping[str, str]
    key: str


@dataclass(frozen=True)
class RunResult:
    """What comes out of a run.

    Attributes:
        success: the last five frames are on average within 0.15 m and 3 degrees.
        position_error_m: mean over the last five frames; None where there was no estimate.
        heading_error_deg: likewise.
        median_position_error_m: median over the frames that have an estimate.
        median_heading_error_deg: likewise.
        frames_until_converged: None where it never did.
        frames: how many have a truth.
        in_95_region: share of the frames after convergence with the truth in the stated region.
        cpu_seconds_per_frame: processor time of the whole run over the number of frames; on a
            busy machine the one figure that can be compared. (A process that makes several runs at
            once, as Dask's workers may, counts them all in each.)
        seconds_per_frame: wall time, mean over all frames.
        seconds_while_searching: mean over the frames of the global search, None where none was.
        seconds_while_tracking: mean over the frames in which one mode was followed; likewise.
    """

    success: bool
    position_error_m: float | None
    heading_error_deg: float | None
    median_position_error_m: float | None
    median_heading_error_deg: float | None
    frames_until_converged: int | None
    frames: int
    in_95_region: float | None
    cpu_seconds_per_frame: float
    seconds_per_frame: float
    seconds_while_searching: float | None
    seconds_while_tracking: float | None

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        return asdict(self)

    @classmethod
    def of_json(cls, values: JsonFields) -> "RunResult":
        """What ``to_dict`` wrote.

        Raises:
            InputError: a key is missing or holds something else.
        """
        return cls(
            success=values.get("success", bool),
            position_error_m=_number(values, "position_error_m"),
            heading_error_deg=_number(values, "heading_error_deg"),
            median_position_error_m=_number(values, "median_position_error_m"),
            median_heading_error_deg=_number(values, "median_heading_error_deg"),
            frames_until_converged=_count(values, "frames_until_converged"),
            frames=values.get("frames", int),
            in_95_region=_number(values, "in_95_region"),
            cpu_seconds_per_frame=values.number("cpu_seconds_per_frame"),
            seconds_per_frame=values.number("seconds_per_frame"),
            seconds_while_searching=_number(values, "seconds_while_searching"),
            seconds_while_tracking=_number(values, "seconds_while_tracking"),
        )


def _number(values: JsonFields, key: str) -> float | None:
    return None if values.values.get(key, 0) is None else values.number(key)


def _count(values: JsonFields, key: str) -> int | None:
    return None if values.values.get(key, 0) is None else values.get(key, int)


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
        start = time.process_time()
        finished = localize_dataset(
            self._scene(run),
            self._dataset(run),
            run.settings,
            seed=run.seed,
            odometry_source=source,
            scene_path=str(run.scene),
            record={},
            progress=no_progress,
        )
        return judged(finished, time.process_time() - start)

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
            check_unchanged(run.dataset, dataset_hash(loaded), run.inputs["dataset"])
            if loaded.odometry is not None:
                found = odometry_hash(run.dataset, run.odometry)
                check_unchanged(run.odometry or run.dataset, found, run.inputs.get("odometry"))
            self._datasets[place] = loaded
        return self._datasets[place]


def judged(run: Run, cpu_seconds: float) -> RunResult:
    """Holds a run against its ground truth; one that never had an estimate is no success.

    Args:
        run: with ground truth.
        cpu_seconds: processor time that it took.

    Raises:
        InputError: the run carries no ground truth.
    """
    evaluation = evaluate_run(run) if _has_estimate(run) else None
    position = heading = None
    if evaluation is not None:
        position = evaluation.errors.position_error_m
        heading = evaluation.errors.heading_error_deg
    return RunResult(
        success=evaluation is not None and evaluation.success,
        position_error_m=None if position is None else position.last5_mean,
        heading_error_deg=None if heading is None else heading.last5_mean,
        median_position_error_m=None if position is None else position.median,
        median_heading_error_deg=None if heading is None else heading.median,
        frames_until_converged=None if evaluation is None else evaluation.frames_until_converged,
        frames=_frames_with_truth(run),
        in_95_region=_share_in_region(evaluation),
        cpu_seconds_per_frame=cpu_seconds / len(run.frames),
        seconds_per_frame=_seconds(run, None) or 0.0,
        seconds_while_searching=_seconds(run, "global"),
        seconds_while_tracking=_seconds(run, "tracking"),
    )


def _has_estimate(run: Run) -> bool:
    """Whether a frame whose truth is known has an estimate; True where no truth is known."""
    if _frames_with_truth(run) == 0:
        return True
    if not run.estimate_names or run.groundtruth is None:
        return False
    known = np.isfinite(run.groundtruth) & np.isfinite(run.estimated_states())
    return bool(np.any(np.all(known, axis=1)))


def _frames_with_truth(run: Run) -> int:
    if run.groundtruth is None:
        return 0
    return int(np.count_nonzero(np.all(np.isfinite(run.groundtruth), axis=1)))


def _share_in_region(evaluation: RunEvaluation | None) -> float | None:
    if evaluation is None or evaluation.consistency is None:
        return None
    share = evaluation.consistency.in_region
    return share if math.isfinite(share) else None


def _seconds(run: Run, status: str | None) -> float | None:
    """Mean wall time of the frames with a status (None: any); None where there are none."""
    times = [
        sum(frame.seconds.values())
        for frame in run.frames
        if status is None or frame.status == status
    ]
    return float(np.mean(times)) if times else None
