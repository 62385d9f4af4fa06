"""Peak memory of building, opening, rendering and scoring, each in a process of its own.

A process starts with what Python and the libraries take ("nothing"); Linux only, since it is the
kernel's own record of the largest resident set (``VmHWM``).
"""

import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.scenes import (
    ROOT,
    WALL,
    repeated,
    with_wall_as_depth,
    workshop_reconstruction,
)
from benchmarks.scoring import WIDTHS, model_of, observations, states_around
from benchmarks.timing import markdown_table
from pipelines.artifacts.stages import no_progress
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene, save_scene
from pipelines.lightfield.size_budget import LOCALIZE_SIDE
from pipelines.lightfield.stage import ModelSettings, build_scene
from pipelines.lightfield.views import views_of_scene
from pipelines.reconstruct.reconstruction import load_reconstruction, with_images
from pipelines.render.choices import Quality
from pipelines.render.renderer import Renderer

RECONSTRUCTION, MANY, DEEP, LOBBY = "reconstruction", "many.h5", "deep.h5", "lobby.h5"
MANY_VIEWS = 100
# Peak memory grows little with more: as many are worked on at a time as there are processors.
DEPTH_VIEWS = 9
PARTICLES, MANY_PARTICLES = 195, 100_000


def _nothing(folder: Path) -> None:
    pass


def _build_plane(folder: Path) -> None:
    source = load_reconstruction(folder / RECONSTRUCTION)
    build_scene(source, ModelSettings(), no_progress)


def _build_depth(folder: Path) -> None:
    source = with_images(load_reconstruction(folder / RECONSTRUCTION), np.arange(DEPTH_VIEWS))
    build_scene(source, ModelSettings(geometry="depth", plane=WALL), no_progress)


def _open(folder: Path) -> None:
    load_scene(folder / MANY)


def _open_small(folder: Path) -> None:
    views_of_scene(load_scene(folder / MANY), LOCALIZE_SIDE)


def _open_full(folder: Path) -> None:
    views_of_scene(load_scene(folder / MANY))


def _render(folder: Path) -> None:
    scene = load_scene(folder / DEEP)
    renderer = Renderer.of_scene(scene, quality=Quality.FINE)
    renderer.render(scene.world_from_camera[0], scene.camera_of(0).intrinsics)


def _score_few(folder: Path) -> None:
    _score(folder, PARTICLES)


def _score_many(folder: Path) -> None:
    _score(folder, MANY_PARTICLES)


def _score(folder: Path, count: int) -> None:
    scene = load_scene(folder / LOBBY)
    image = observations()[WIDTHS[0]]
    model_of(scene, WIDTHS[0], threads=None).log_likelihoods(states_around(count), image)


WORK: dict[str, Callable[[Path], None]] = {
    "nothing": _nothing,
    "build a model, 40 photos, plane from the photos": _build_plane,
    f"build a model, {DEPTH_VIEWS} photos, depth from the photos": _build_depth,
    f"open {MANY_VIEWS} views": _open,
    f"open {MANY_VIEWS} views, with views of {LOCALIZE_SIDE} px": _open_small,
    f"open {MANY_VIEWS} views, with views of full size": _open_full,
    "open 40 views with depth maps and render one of 640x480, fine": _render,
    f"score {PARTICLES} particles": _score_few,
    f"score {MANY_PARTICLES} particles": _score_many,
}


def measure(scene: Scene, lobby: Scene) -> dict[str, Any]:
    """Bytes; plain JSON types."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        workshop_reconstruction(folder / RECONSTRUCTION)
        save_scene(folder / MANY, repeated(scene, MANY_VIEWS), overwrite=False)
        save_scene(folder / LOBBY, lobby, overwrite=False)
        save_scene(folder / DEEP, with_wall_as_depth(scene), overwrite=False)
        return {"peak_memory_bytes": {work: peak_of(work, folder) for work in WORK}}


def peak_of(work: str, folder: Path) -> int:
    """Peak memory, in bytes, of a new process that does one of ``WORK``."""
    command = [sys.executable, "-m", "benchmarks.memory", work, str(folder)]
    output = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    return int(output.stdout)


def own_peak() -> int:
    """Bytes of the largest resident set that this process has had."""
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    kilobytes = next(line.split()[1] for line in lines if line.startswith("VmHWM:"))
    return 1024 * int(kilobytes)


def table(peaks: dict[str, int]) -> str:
    """The figures for people."""
    rows = [(name, f"{value / 1e6:.0f}") for name, value in peaks.items()]
    return markdown_table(("peak memory of a process", "MB"), rows)


if __name__ == "__main__":
    WORK[sys.argv[1]](Path(sys.argv[2]))
    print(own_peak())
