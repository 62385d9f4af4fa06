"""CPU time of the fused render-and-compare path, beside what a user would take instead.

The work is the same for all (``work``): three photos are mapped over the scene's plane into the
virtual image, blended with a weight for each pixel, and compared with a camera image by the sum of
squared colour differences. All run on one thread, in turns. The limit is what the reads and
multiplications alone take.

The filter weighs particles by one pixel in five (``localize.observation``), and so
does the fused path here. Beside it stand the same with all pixels, as all others do it, and OpenCV
with a quarter of the pixels: every other column and row, the nearest to a fifth that a homography
gives.
"""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.limit import SAMPLES_PER_PIXEL, limit_image, limit_work
from benchmarks.opencv_path import opencv_costs, opencv_work
from benchmarks.timing import Timing, markdown_table, median_times
from benchmarks.torch_path import is_installed, torch_costs, torch_work
from benchmarks.work import Work, every_other, work_of
from pipelines.artifacts.arrays import FloatArray
from pipelines.lightfield.scene import Scene
from pipelines.localize.likelihood import PIXEL_SUBSAMPLING
from pipelines.localize.observation import Observation
from pipelines.render.choices import Blending, Cost
from pipelines.render.reference import render_reference
from pipelines.render.renderer import Renderer

# Width and height of the virtual images -> particles; fewer where each takes longer.
PARTICLES = {(40, 30): 195, (80, 60): 195, (160, 120): 64}
TURNS = 7
REFERENCE_PARTICLES = 3
OPENCV = {3: "OpenCV, RGB", 4: "OpenCV, RGB and a fourth channel"}
OPENCV_QUARTER = "OpenCV, RGB and a fourth channel, one pixel in 4"
TORCH = "PyTorch grid_sample"
LIMIT = "the limit: reads and multiplications"


def fused(blending: Blending, views: int = 3, one_in: int = PIXEL_SUBSAMPLING) -> str:
    """How the tables call the fused path."""
    pixels = "all pixels" if one_in == 1 else f"one pixel in {one_in}"
    return f"lfnav, {blending.name.lower()}, {views} views, {pixels}"


def fused_costs(renderer: Renderer, work: Work, one_in: int = 1) -> FloatArray:
    """The work done by the path that the filter uses, for one in so many pixels."""
    image = Observation(work.query.astype(np.float32), work.intrinsics).subsampled(one_in)
    return renderer.costs(work.poses, work.intrinsics, image, Cost.SQUARED, False)


def measure_size(scene: Scene, width: int, height: int, particles: int) -> dict[str, Timing]:
    """Time a particle of each way to do the work."""
    work = work_of(scene, width, height, particles)
    tasks: dict[str, Callable[[], object]] = {}
    for views in (work.scene, scene):
        for blending in Blending:
            renderer = Renderer.of_scene(views, 2 * width, blending, threads=1)
            for one_in in (1, PIXEL_SUBSAMPLING):
                name = fused(blending, len(views), one_in)
                tasks[name] = partial(fused_costs, renderer, work, one_in)
    for channels, name in OPENCV.items():
        tasks[name] = partial(opencv_costs, opencv_work(work, channels))
    tasks[OPENCV_QUARTER] = partial(opencv_costs, opencv_work(every_other(work), 4))
    if is_installed():
        tasks[TORCH] = partial(torch_costs, torch_work(work))
    tasks[LIMIT] = partial(limit_image, limit_work(work), particles)
    times = median_times(tasks, TURNS)
    return {name: value.of_each(particles) for name, value in times.items()}


def measure_reference(scene: Scene, width: int, height: int) -> dict[str, Timing]:
    """Likewise for the readable renderer, once, for a few particles (without the comparison)."""
    work = work_of(scene, width, height, REFERENCE_PARTICLES)
    result = {}
    for blending in Blending:
        start = Timing(time.process_time(), time.perf_counter())
        for pose in work.poses:
            render_reference(work.views, work.scene.plane, pose, work.intrinsics, blending)
        spent = Timing(time.process_time() - start.cpu, time.perf_counter() - start.wall)
        label = f"NumPy reference, {blending.name.lower()}, 3 views"
        result[label] = spent.of_each(len(work.poses))
    return result


Microseconds = dict[str, dict[str, float]]


def fastest_opencv(row: dict[str, float]) -> float:
    """The faster of the ways to do it in OpenCV."""
    return min(row[name] for name in OPENCV.values())


def ratios(microseconds: Microseconds, blending: Blending, one_in: int) -> dict[str, float]:
    """OpenCV's CPU time divided by the fused path's, three views; above 1 that is the faster."""
    name = fused(blending, one_in=one_in)
    return {size: round(fastest_opencv(row) / row[name], 3) for size, row in microseconds.items()}


def times_limit(microseconds: Microseconds, blending: Blending) -> dict[str, float]:
    """The fused path's CPU time divided by the limit's, three views, all pixels."""
    name = fused(blending, one_in=1)
    return {size: round(row[name] / row[LIMIT], 3) for size, row in microseconds.items()}


def nanoseconds_per_sample(microseconds: Microseconds) -> dict[str, float]:
    """What the limit takes to read one photo at one pixel."""
    result = {}
    for size, row in microseconds.items():
        width, height = map(int, size.split("x"))
        result[size] = round(1e3 * row[LIMIT] / (SAMPLES_PER_PIXEL * width * height), 3)
    return result


def table(microseconds: Microseconds) -> str:
    """CPU time a particle, how many times as fast as OpenCV that is, and how many limits."""
    sizes = list(microseconds)
    rows = []
    for name in dict.fromkeys(name for size in sizes for name in microseconds[size]):
        cells = []
        for size in sizes:
            row = microseconds[size]
            value = row.get(name)
            if value is None:
                cells.append("")
                continue
            faster, limits = fastest_opencv(row) / value, value / row[LIMIT]
            cells.append(f"{value:.1f} ({faster:.2f}; {limits:.1f})")
        rows.append((name, *cells))
    return markdown_table(("CPU time a particle", *(f"{size} (µs)" for size in sizes)), rows)


def measure(scene: Scene) -> dict[str, Any]:
    """All sizes; plain JSON types."""
    times = {
        f"{width}x{height}": measure_size(scene, width, height, particles)
        for (width, height), particles in PARTICLES.items()
    }
    times["40x30"].update(measure_reference(scene, 40, 30))
    cpu = {s: {n: round(1e6 * t.cpu, 2) for n, t in row.items()} for s, row in times.items()}
    wall = {s: {n: round(1e6 * t.wall, 2) for n, t in row.items()} for s, row in times.items()}
    return {
        "ratio_to_opencv": ratios(cpu, Blending.DELAUNAY, PIXEL_SUBSAMPLING),
        "ratio_to_opencv_unstructured": ratios(cpu, Blending.UNSTRUCTURED, PIXEL_SUBSAMPLING),
        "ratio_to_opencv_all_pixels": ratios(cpu, Blending.DELAUNAY, 1),
        "ratio_to_opencv_all_pixels_unstructured": ratios(cpu, Blending.UNSTRUCTURED, 1),
        "ratio_to_opencv_of_a_quarter": {
            size: round(row[OPENCV_QUARTER] / row[fused(Blending.DELAUNAY)], 3)
            for size, row in cpu.items()
        },
        "times_limit": times_limit(cpu, Blending.DELAUNAY),
        "times_limit_unstructured": times_limit(cpu, Blending.UNSTRUCTURED),
        "limit_nanoseconds_per_sample": nanoseconds_per_sample(cpu),
        "comparison": {
            "particles": {f"{size[0]}x{size[1]}": count for size, count in PARTICLES.items()},
            "threads": 1,
            "turns": TURNS,
            "torch_installed": is_installed(),
            "microseconds_per_particle": cpu,
            "wall_microseconds_per_particle": wall,
        },
    }
