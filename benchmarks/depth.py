"""How long the depth map of one view takes, its share of the fusion included."""

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.scenes import WALL, workshop_reconstruction
from benchmarks.timing import median_times, timing_table
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.images import decode_image, read_image_bytes
from pipelines.geometry.camera import Undistorter
from pipelines.geometry.plane import plane_from_coefficients
from pipelines.lightfield.depth_maps import depth_from_photos
from pipelines.lightfield.stereo_depth import DepthSettings
from pipelines.reconstruct.reconstruction import with_images

# One more than a view is compared with: each has as many neighbours as it wants.
VIEWS = 9
TURNS = 3


def depth_of_some_views(views: int, settings: DepthSettings) -> Callable[[], object]:
    """Computes the depth maps of the first photos of the workshop."""
    with tempfile.TemporaryDirectory() as folder:
        whole = workshop_reconstruction(Path(folder) / "reconstruction")
        source = with_images(whole, np.arange(views))
        undistorters = [Undistorter(camera) for camera in source.cameras]
        chosen = [undistorters[int(index)] for index in source.camera_index]
        photos = [
            undistorter(decode_image(read_image_bytes(source.image_root / name), name))
            for undistorter, name in zip(chosen, source.image_names, strict=True)
        ]
    return partial(
        depth_from_photos,
        source,
        photos,
        [undistorter.intrinsics for undistorter in chosen],
        plane_from_coefficients(WALL),
        settings,
        None,
        no_progress,
    )


def measure() -> dict[str, Any]:
    """Seconds a view at the usual resolution, on all processors."""
    settings = DepthSettings()
    label = f"a view at {settings.largest_side} px"
    times = median_times({label: depth_of_some_views(VIEWS, settings)}, TURNS)
    return {
        "depth": {
            "views": VIEWS,
            "turns": TURNS,
            "times": {name: value.of_each(VIEWS).to_dict() for name, value in times.items()},
        }
    }


def table(results: dict[str, Any]) -> str:
    """The figures for people."""
    return timing_table("depth map", results["times"])
