"""What a particle costs: size of the image, surface, threads, number of views and of particles.

Particles stand around the robot's true place in a frame of the lobby's test sequence, as they do
while it is tracked, and are scored as the filter does by default: evidence of local contrast, one
pixel in five, photos eight times as fine as the comparison. Beside that stands what all pixels
cost.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.scenes import ELEVATORS, repeated, with_wall_as_depth
from benchmarks.timing import Timing, markdown_table, median_times
from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.processes import processor_count
from pipelines.dataset.dataset import load_dataset
from pipelines.lightfield.scene import Scene
from pipelines.localize.likelihood import LIKELIHOODS, PIXEL_SUBSAMPLING
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import Observation, Observer
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import PLANAR
from pipelines.render.choices import Quality
from pipelines.render.devices import Device

FRAME = 8
# Particles stand so far apart, standard deviations in metres and radians.
SPREAD = np.array([0.1, 0.1, 0.05])
WIDTHS = (40, 80, 160)
PARTICLES, MANY_PARTICLES = 195, 10_000
VIEWS = (28, 200, 1000)
GROWTH = (195, 1_000, 10_000, 100_000)
# Many particles are a median of their own.
TURNS, TURNS_OF_MANY, TURNS_OF_GROWTH = 7, 1, 3
ALL_PIXELS = ", all pixels"
GEOMETRIES = {"plane": Quality.PLANE, "depth": Quality.MEDIUM}


def states_around(count: int) -> FloatArray:
    """States ``(count, 3)`` around the true one of the frame."""
    dataset = load_dataset(ELEVATORS / "test")
    if dataset.groundtruth is None:
        raise ValueError("the test sequence has no ground truth")
    nearest = dataset.groundtruth.nearest(dataset.timestamps, 0.1)[FRAME]
    truth = PLANAR.states(dataset.groundtruth.poses[[nearest]])
    noise = SPREAD * np.random.default_rng(0).standard_normal((count, 3))
    return PLANAR.moved(np.repeat(truth, count, axis=0), noise)


def observations() -> dict[int, Observation]:
    """The camera image of the frame, by width."""
    dataset = load_dataset(ELEVATORS / "test")
    if dataset.camera is None:
        raise ValueError("the test sequence has no camera")
    return dict(Observer(dataset.camera, WIDTHS)(dataset.read_image(FRAME)).by_width)


def model_of(
    scene: Scene,
    width: int,
    threads: int | None,
    quality: Quality = Quality.PLANE,
    one_in: int = PIXEL_SUBSAMPLING,
) -> MeasurementModel:
    """What the filter scores particles with, for comparisons of some width."""
    settings = LocalizerSettings(
        likelihood=replace(LIKELIHOODS["evidence"], pixel_subsampling=one_in),
        coarse_width=min(WIDTHS),
        fine_width=width,
        refine_width=0,
        quality=quality.name.lower(),
        threads=threads,
        device=Device.CPU,
    )
    mount = load_dataset(ELEVATORS / "test").body_from_camera
    model = MeasurementModel.of_scene(scene, mount, settings)
    # What differences say is learnt once, before any particle.
    model.pixels(width)
    return model


def by_size(scene: Scene) -> dict[str, dict[str, Timing]]:
    """Time a particle: way -> size; both surfaces, few and many particles, one thread and all."""
    processors = processor_count()
    scenes = {"plane": scene, "depth": with_wall_as_depth(scene)}
    images = observations()
    result: dict[str, dict[str, Timing]] = {}
    for width in WIDTHS:
        size = f"{width}x{images[width].image.shape[0]}"
        for count, turns in ((PARTICLES, TURNS), (MANY_PARTICLES, TURNS_OF_MANY)):
            states = states_around(count)
            tasks = {}
            for geometry, quality in GEOMETRIES.items():
                for threads in sorted({1, processors}):
                    name = _row(geometry, count, threads)
                    model = model_of(scenes[geometry], width, threads, quality)
                    tasks[name] = partial(model.log_likelihoods, states, images[width])
                if count == PARTICLES:
                    whole = model_of(scenes[geometry], width, 1, quality, one_in=1)
                    name = _row(geometry, count, 1, ALL_PIXELS)
                    tasks[name] = partial(whole.log_likelihoods, states, images[width])
            # Few particles have loaded everything before many come.
            rehearsals = int(count == PARTICLES)
            for name, timing in median_times(tasks, turns, rehearsals).items():
                result.setdefault(name, {})[size] = timing.of_each(count)
    return result


def by_views(scene: Scene, one_in: int) -> dict[str, Timing]:
    """Time a particle with more and more views of the same place, on one thread."""
    image = observations()[WIDTHS[0]]
    states = states_around(PARTICLES)
    tasks = {}
    for count in VIEWS:
        many = scene if count == len(scene) else repeated(scene, count)
        model = model_of(many, WIDTHS[0], threads=1, one_in=one_in)
        tasks[str(count)] = partial(model.log_likelihoods, states, image)
    return {name: value.of_each(PARTICLES) for name, value in median_times(tasks, TURNS).items()}


def by_particles(scene: Scene) -> dict[str, Timing]:
    """Time a particle for more and more particles, on all processors.

    Few of them are scored again and again, until ``MANY_PARTICLES`` are done: else the first would
    find what the processor has read last pushed out of its caches by the many.
    """
    image, model = observations()[WIDTHS[0]], model_of(scene, WIDTHS[0], threads=None)

    def score(states: FloatArray, calls: int) -> None:
        for _ in range(calls):
            model.log_likelihoods(states, image)

    calls = {count: max(1, MANY_PARTICLES // count) for count in GROWTH}
    tasks = {str(count): partial(score, states_around(count), calls[count]) for count in GROWTH}
    times = median_times(tasks, TURNS_OF_GROWTH, rehearsals=0)
    return {str(count): times[str(count)].of_each(count * calls[count]) for count in GROWTH}


def measure(scene: Scene) -> dict[str, Any]:
    """All of it; plain JSON types, microseconds a particle."""
    sizes, particles = by_size(scene), by_particles(scene)
    views, views_whole = by_views(scene, PIXEL_SUBSAMPLING), by_views(scene, 1)
    return {
        "depth_to_plane": _depth_to_plane(sizes, ""),
        "depth_to_plane_all_pixels": _depth_to_plane(sizes, ALL_PIXELS),
        "views_growth": _relative(views),
        "views_growth_all_pixels": _relative(views_whole),
        "particles_growth": _relative(particles),
        "scoring": {
            "turns": {PARTICLES: TURNS, MANY_PARTICLES: TURNS_OF_MANY},
            "by_size": {name: _microseconds(row) for name, row in sizes.items()},
            "by_views": _microseconds(views),
            "by_views_all_pixels": _microseconds(views_whole),
            "by_particles": _microseconds(particles),
        },
    }


def tables(results: dict[str, Any]) -> str:
    """The figures for people: CPU time and, in brackets, time by the clock on the wall."""
    scoring = results["scoring"]
    sizes = list(next(iter(scoring["by_size"].values())))
    rows = [
        (name, *(_cell(row[size]) for size in sizes)) for name, row in scoring["by_size"].items()
    ]
    by_size_table = markdown_table(("a particle", *(f"{size} (µs)" for size in sizes)), rows)
    growths = (
        ("by_views", "views", "views_growth"),
        ("by_views_all_pixels", "views, all pixels", "views_growth_all_pixels"),
        ("by_particles", "particles", "particles_growth"),
    )
    parts = [by_size_table]
    for key, title, growth in growths:
        rows = [
            (name, _cell(row), f"{results[growth][name]:.2f}") for name, row in scoring[key].items()
        ]
        parts.append(markdown_table((title, "a particle (µs)", "to the first"), rows))
    return "\n\n".join(parts)


def _row(geometry: str, count: int, threads: int, pixels: str = "") -> str:
    """How the table calls a line."""
    return f"{geometry}, {count} particles, {_threads(threads)}{pixels}"


def _depth_to_plane(sizes: dict[str, dict[str, Timing]], pixels: str) -> dict[str, float]:
    plane, depth = (sizes[_row(name, PARTICLES, 1, pixels)] for name in GEOMETRIES)
    return {size: round(depth[size].cpu / plane[size].cpu, 3) for size in plane}


def _threads(count: int) -> str:
    return "1 thread" if count == 1 else f"{count} threads"


def _relative(times: dict[str, Timing]) -> dict[str, float]:
    first = next(iter(times.values())).cpu
    return {name: round(value.cpu / first, 3) for name, value in times.items()}


def _microseconds(times: dict[str, Timing]) -> dict[str, dict[str, float]]:
    return {
        name: {"cpu": round(1e6 * value.cpu, 2), "wall": round(1e6 * value.wall, 2)}
        for name, value in times.items()
    }


def _cell(value: dict[str, float]) -> str:
    return f"{value['cpu']:.1f} ({value['wall']:.1f})"
