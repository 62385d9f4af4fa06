"""How long one virtual view takes, with each quality of the surface."""

from functools import partial
from typing import Any

from benchmarks.scenes import with_wall_as_depth
from benchmarks.timing import median_times, timing_table
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.views import views_of_scene
from pipelines.render.choices import Quality
from pipelines.render.renderer import Renderer

WIDTH, HEIGHT = 640, 480
TURNS = 7
QUALITIES = (Quality.PLANE, Quality.COARSE, Quality.MEDIUM, Quality.FINE)
# The virtual camera stands where this photo was taken, a little aside.
PHOTO, ASIDE = 12, 0.07


def measure(scene: Scene) -> dict[str, Any]:
    """Seconds for a view of 640x480 pixels from all photos, which one thread renders."""
    deep = with_wall_as_depth(scene)
    views = views_of_scene(deep)
    pose = scene.world_from_camera[PHOTO].copy()
    pose[0, 3] += ASIDE
    intrinsics = scene.camera_of(PHOTO).intrinsics.resized(WIDTH, HEIGHT)
    tasks = {
        quality.name.lower(): partial(
            Renderer(views, scene.plane, quality=quality, threads=1).render, pose, intrinsics
        )
        for quality in QUALITIES
    }
    times = median_times(tasks, TURNS)
    return {
        "rendering": {
            "size": f"{WIDTH}x{HEIGHT}",
            "views": len(scene),
            "turns": TURNS,
            "times": {name: value.to_dict() for name, value in times.items()},
        }
    }


def table(results: dict[str, Any]) -> str:
    """The figures for people."""
    title = f"a view of {results['size']} from {results['views']} photos"
    return timing_table(title, results["times"])
