"""Whole frames of ``localize``: the search over the model's area, and tracking after it.

Frames of the lobby's test sequence go through ``Localizer.step`` with the default settings and the
wheels' odometry, as in ``make demo``, on the CPU; once with the alignment that refines the
estimate, once without it. Reading an image file is not part of it.
"""

import statistics
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.scenes import ELEVATORS
from benchmarks.timing import Timing, markdown_table, medians
from pipelines.dataset.dataset import ODOMETRY_FILE, Dataset, load_dataset
from pipelines.dataset.pairing import poses_at_images
from pipelines.lightfield.scene import Scene
from pipelines.localize.localizer import Localizer
from pipelines.localize.settings import LocalizerSettings
from pipelines.render.devices import Device

RUNS = 3
SETTINGS = {
    "tracking": LocalizerSettings(refine_width=0, device=Device.CPU),
    "tracking_refined": LocalizerSettings(device=Device.CPU),
}


@dataclass(frozen=True)
class Frame:
    """One frame of a sequence.

    Attributes:
        status: what the filter called it.
        time: that it took.
        stages: seconds by the clock on the wall of each stage.
    """

    status: str
    time: Timing
    stages: dict[str, float]


def drive(
    scene: Scene, dataset: Dataset, settings: LocalizerSettings, seed: int, most: int | None = None
) -> list[Frame]:
    """Localizes the frames of a sequence, at most so many."""
    if dataset.camera is None or dataset.odometry is None:
        raise ValueError("the sequence has no camera or no odometry")
    space = settings.state_space
    rng = np.random.default_rng(seed)
    robot = Localizer(scene, dataset.camera, dataset.body_from_camera, settings, rng)
    poses = poses_at_images(dataset, dataset.odometry, dataset.root / ODOMETRY_FILE)
    frames = []
    for index in range(len(dataset))[:most]:
        motion = space.increment(poses[index - 1], poses[index]) if index else None
        image, moment = dataset.read_image(index), float(dataset.timestamps[index])
        start = Timing(time.process_time(), time.perf_counter())
        record = robot.step(image, motion, moment, dataset.image_names[index])
        end = Timing(time.process_time(), time.perf_counter())
        spent = Timing(end.cpu - start.cpu, end.wall - start.wall)
        frames.append(Frame(record.status, spent, dict(record.seconds)))
    return frames


def measure(scene: Scene) -> dict[str, Any]:
    """Frames a second and seconds of the search; medians over the frames of some runs."""
    dataset = load_dataset(ELEVATORS / "test")
    runs: dict[str, list[list[Frame]]] = {name: [] for name in SETTINGS}
    for settings in SETTINGS.values():
        # Libraries are loaded, and what is made once.
        drive(scene, dataset, settings, 0, most=3)
    for seed in range(RUNS):
        for name, settings in SETTINGS.items():
            runs[name].append(drive(scene, dataset, settings, seed))
    everything = [each for frames_of_runs in runs.values() for each in frames_of_runs]
    first = medians([each[0].time for each in everything])
    tracked = {name: tracked_frames(each) for name, each in runs.items()}
    times = {name: medians([frame.time for frame in frames]) for name, frames in tracked.items()}
    return {
        "frames_per_second": {name: round(1.0 / value.wall, 1) for name, value in times.items()},
        "global_start_s": round(first.wall, 3),
        "global_start_cpu_s": round(first.cpu, 3),
        "localize": {
            "runs": RUNS,
            "frames_tracked": {name: len(frames) for name, frames in tracked.items()},
            "first_frame": first.to_dict(),
            "times": {name: value.to_dict() for name, value in times.items()},
            "stages_wall_s": {name: _stages(frames) for name, frames in tracked.items()},
        },
    }


def table(results: dict[str, Any]) -> str:
    """The figures for people."""
    localize = results["localize"]
    first = localize["first_frame"]
    rows = [("first frame: search over the model's area", *_cells(first))]
    labels = {"tracking": "tracking", "tracking_refined": "tracking, refined"}
    rows += [(labels[name], *_cells(value)) for name, value in localize["times"].items()]
    return markdown_table(("a frame", "CPU (ms)", "wall (ms)", "frames a second"), rows)


def tracked_frames(runs: list[list[Frame]]) -> list[Frame]:
    """The frames in which one mode was followed."""
    return [frame for frames in runs for frame in frames[1:] if frame.status == "tracking"]


def _stages(frames: list[Frame]) -> dict[str, float]:
    names = frames[0].stages
    return {
        name: round(statistics.median(frame.stages[name] for frame in frames), 5) for name in names
    }


def _cells(value: dict[str, float]) -> tuple[str, str, str]:
    milliseconds = f"{1e3 * value['cpu_s']:.1f}", f"{1e3 * value['wall_s']:.1f}"
    return (*milliseconds, f"{1.0 / value['wall_s']:.1f}")
