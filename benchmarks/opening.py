"""How long it takes until something can be asked: opening a scene model, and the front door.

Opening is ``load_scene``: all bytes are read, checksums and hash verified, everything checked. What
localization does next, building views of 320 pixels, decodes every photo, and is timed apart.
"""

import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.processes import process_times
from benchmarks.scenes import repeated
from benchmarks.timing import Timing, median_times, medians, timing_table
from pipelines.lightfield.bundle import load_scene, save_scene
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.size_budget import LOCALIZE_SIDE
from pipelines.lightfield.views import views_of_scene

VIEWS = 100
TURNS = 7


def measure(scene: Scene) -> dict[str, Any]:
    """Seconds to open a scene of ``VIEWS`` views without depth maps, and of ``lfnav --help``."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.h5"
        save_scene(path, repeated(scene, VIEWS), overwrite=False)
        opened = load_scene(path)
        times = median_times(
            {
                f"open {VIEWS} views": lambda: load_scene(path),
                f"build views of {LOCALIZE_SIDE} px": lambda: views_of_scene(opened, LOCALIZE_SIDE),
            },
            TURNS,
        )
        camera, size = opened.cameras[0], path.stat().st_size
    times["lfnav --help"] = help_time()
    return {
        "opening": {
            "views": VIEWS,
            "photo": f"{camera.width}x{camera.height}",
            "file_bytes": size,
            "turns": TURNS,
            "times": {name: value.to_dict() for name, value in times.items()},
        }
    }


def help_time() -> Timing:
    """Median times of ``lfnav --help`` in a process of its own."""
    command = [sys.executable, "-m", "lfnav_cli.main", "--help"]
    process_times(command, turns=1)
    return medians(process_times(command, TURNS))


def table(results: dict[str, Any]) -> str:
    """The figures for people."""
    return timing_table(f"opening ({results['photo']} photos)", results["times"])
