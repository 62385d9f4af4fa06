"""How long it takes until the first answer: processes of their own, with and without machine code.

Compiled functions are kept on disk, in the folder that ``NUMBA_CACHE_DIR`` names; an empty one is a
cold start, as after installing. What compiling takes is the difference in processor time between a
process that finds nothing there and one that finds everything.
"""

import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.processes import process_times
from benchmarks.scenes import ELEVATORS, with_wall_as_depth
from benchmarks.timing import medians, timing_table
from pipelines.lightfield.bundle import load_scene, save_scene
from pipelines.lightfield.scene import Scene

WARM_TURNS = 3
PLANE, DEEP, ONE_IMAGE, RUN = "plane.h5", "deep.h5", "one-image", "run.h5"


def first_frame(folder: Path) -> None:
    """What a robot program does: imports, opens a scene, takes the first image."""
    from benchmarks.tracking import SETTINGS, drive
    from pipelines.dataset.dataset import load_dataset

    dataset = load_dataset(folder / ONE_IMAGE)
    drive(load_scene(folder / PLANE), dataset, SETTINGS["tracking_refined"], seed=0)


def all_kernels(folder: Path) -> None:
    """Uses every compiled function of rendering, comparison, alignment and filter once."""
    from benchmarks.scoring import WIDTHS, observations, states_around
    from benchmarks.tracking import SETTINGS, drive
    from pipelines.dataset.dataset import load_dataset
    from pipelines.lightfield.blending import Blending
    from pipelines.lightfield.comparison import (
        EVIDENCE_BINS,
        EVIDENCE_ROWS,
        Cost,
        PixelEvidence,
    )
    from pipelines.lightfield.proxy import Quality
    from pipelines.lightfield.renderer import Renderer
    from pipelines.localize.state_space import PLANAR

    scene, dataset = load_scene(folder / DEEP), load_dataset(ELEVATORS / "test")
    image = observations()[WIDTHS[0]]
    poses = PLANAR.poses(states_around(2)) @ dataset.body_from_camera
    edges = np.arange(1, EVIDENCE_ROWS, dtype=np.float32)
    blank = PixelEvidence(
        edges,
        np.zeros((EVIDENCE_ROWS, EVIDENCE_BINS), dtype=np.float32),
        np.zeros(EVIDENCE_ROWS, dtype=np.float32),
    )
    for blending in Blending:
        for quality in (Quality.PLANE, Quality.MEDIUM):
            renderer = Renderer.of_scene(scene, WIDTHS[0], blending, quality, threads=1)
            renderer.render_many(poses, image.intrinsics)
            for cost in Cost:
                table = blank if cost is Cost.EVIDENCE else None
                renderer.costs(poses, image.intrinsics, image.image, cost, table is None, table)
    # The second frame has a prior; both are aligned.
    drive(load_scene(folder / PLANE), dataset, SETTINGS["tracking_refined"], seed=0, most=3)


WORK: dict[str, Callable[[Path], None]] = {
    "first frame": first_frame,
    "rendering, comparison, alignment, filter": all_kernels,
}


def measure(scene: Scene) -> dict[str, Any]:
    """Seconds of processes; plain JSON types."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        save_scene(folder / PLANE, scene, overwrite=False)
        save_scene(folder / DEEP, with_wall_as_depth(scene), overwrite=False)
        drive_of_one_image(folder / ONE_IMAGE)
        times = {}
        for work in WORK:
            own = [sys.executable, "-m", "benchmarks.cold_start", work, name]
            cache = folder / work.replace(" ", "-")
            times[f"{work}, cold"] = medians(process_times(own, 1, cache))
            times[f"{work}, warm"] = medians(process_times(own, WARM_TURNS, cache))
        command = [sys.executable, "-m", "lfnav_cli.main", "localize", str(folder / PLANE)]
        command += [str(folder / ONE_IMAGE), "-o", str(folder / RUN), "--overwrite"]
        label = "lfnav localize, one image, warm"
        times[label] = medians(process_times(command, WARM_TURNS, folder / "first-frame"))
    return {
        "compile_cpu_s": {
            work: round(times[f"{work}, cold"].cpu - times[f"{work}, warm"].cpu, 2) for work in WORK
        },
        "warm_start_to_first_pose_s": round(times[label].wall, 2),
        "cold_start": {
            "warm_turns": WARM_TURNS,
            "times": {name: value.to_dict() for name, value in times.items()},
        },
    }


def drive_of_one_image(folder: Path) -> None:
    """Writes the lobby's test drive up to its first image."""
    source = ELEVATORS / "test"
    shutil.copytree(source, folder)
    lines = (source / "rgb.txt").read_text(encoding="utf-8").splitlines(keepends=True)
    first = next(index for index, line in enumerate(lines) if not line.startswith("#"))
    (folder / "rgb.txt").write_text("".join(lines[: first + 1]), encoding="utf-8")


def table(results: dict[str, Any]) -> str:
    """The figures for people."""
    lines = [timing_table("a process", results["cold_start"]["times"]), ""]
    compiling = results["compile_cpu_s"].items()
    lines += [
        f"compiling, seconds of processor time: {name} {value:.1f}" for name, value in compiling
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    WORK[sys.argv[1]](Path(sys.argv[2]))
