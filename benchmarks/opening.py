"""How long it takes until something can be asked of a scene model.

Opening is ``load_scene``: all bytes are read, checksums and hash verified, everything checked. What
localization does next, building views of 320 pixels, decodes every photo, and is timed apart.
"""

import tempfile
from pathlib import Path
from typing import Any

from benchmarks.scenes import repeated
from benchmarks.timing import median_times, timing_table
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene, save_scene
from pipelines.lightfield.size_budget import LOCALIZE_SIDE
from pipelines.lightfield.views import views_of_scene

VIEWS = 100
TURNS = 7


def measure(scene: Scene) -> dict[str, Any]:
    """Seconds to open a scene of ``VIEWS`` views without depth maps."""
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
    return {
        "opening": {
            "views": VIEWS,
            "photo": f"{camera.width}x{camera.height}",
            "file_bytes": size,
            "turns": TURNS,
            "times": {name: value.to_dict() for name, value in times.items()},
        }
    }


def table(results: dict[str, Any]) -> str:
    """The figures for people."""
    return timing_table(f"opening ({results['photo']} photos)", results["times"])
