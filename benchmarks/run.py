"""CPU time of the fused render-and-compare path, beside the same work done with OpenCV.

``make bench`` prints a Markdown table and writes ``benchmarks/results.json``. Everything is
measured in one process on one thread, in turns (A B A B ...), so that a busy machine slows all
alike; a figure is the median over the turns, 195 particles a turn at 40x30 pixels.

The work is the same for both: three photos are mapped over the scene's plane into the virtual
image, blended with a weight for each pixel, and compared with a camera image by the sum of squared
colour differences. The photos are as fine as the virtual images, and the virtual cameras stand
where all three show every pixel. OpenCV is given what the fused path works out for itself: the
homographies and the blending weights are computed before the clock starts. Of several ways to say
this in OpenCV the fastest was taken (photos as floats, ``accumulateProduct``).
"""

import json
import platform
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from pipelines.artifacts.array_types import Float32Array, FloatArray, ImageArray
from pipelines.artifacts.atomic import write_text
from pipelines.artifacts.progress import no_progress
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.pose import BASE_FROM_FORWARD_CAMERA, inverse, pose_from_rotation
from pipelines.lightfield.blending import Blending
from pipelines.lightfield.comparison import Cost
from pipelines.lightfield.net import pixel_weights
from pipelines.lightfield.reference import render_reference
from pipelines.lightfield.renderer import Renderer
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.stage import ModelSettings, build_scene
from pipelines.lightfield.views import Views
from pipelines.reconstruct.reconstruction import load_reconstruction
from pipelines.reconstruct.stage import ReconstructSettings, reconstruct

ROOT = Path(__file__).resolve().parents[1]
WORKSHOP = ROOT / "sample_data" / "workshop" / "map"
RESULTS = Path(__file__).with_name("results.json")
# Three photos whose centres span a triangle across the line of sight.
CORNERS = (5, 12, 18)
# The virtual cameras stand this far, in metres, behind the middle of that triangle.
STEP_BACK = 0.25
WALL = (0.0, -1.0, 0.0, 0.0)
# Width and height of the virtual images -> particles; fewer where each takes longer.
PARTICLES = {(40, 30): 195, (80, 60): 96, (160, 120): 32}
TURNS = 7
REFERENCE_PARTICLES = 3
OPENCV = "opencv"


@dataclass(frozen=True)
class Work:
    """What is to be done for one size of the virtual image.

    Attributes:
        views: three photos at the resolution of the virtual images.
        scene: the light field of these photos.
        poses: ``(M, 4, 4)`` world_from_camera of the particles.
        intrinsics: of the virtual camera.
        query: ``(H, W, 3)`` the camera image.
    """

    views: Views
    scene: Scene
    poses: FloatArray
    intrinsics: Intrinsics
    query: ImageArray


def workshop_scene() -> Scene:
    """The workshop's photos with their true poses, and the wall as the surface."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "reconstruction"
        settings = ReconstructSettings("poses", poses=WORKSHOP / "groundtruth.txt")
        reconstruct(WORKSHOP, output, settings, overwrite=False, progress=no_progress)
        source = load_reconstruction(output)
        return build_scene(source, ModelSettings(plane=WALL), no_progress)


def part_of(scene: Scene, indices: tuple[int, ...]) -> Scene:
    """The light field of some of the photos."""
    chosen = list(indices)
    return replace(
        scene,
        image_names=tuple(scene.image_names[index] for index in chosen),
        encoded_images=tuple(scene.encoded_images[index] for index in chosen),
        timestamps=scene.timestamps[chosen],
        camera_index=scene.camera_index[chosen],
        world_from_camera=scene.world_from_camera[chosen],
    )


def particle_poses(scene: Scene, count: int) -> FloatArray:
    """Cameras ``(M, 4, 4)`` around a place behind the middle of the three recording centres."""
    rng = np.random.default_rng(0)
    middle = scene.world_from_camera[:, :3, 3].mean(axis=0) - np.array([0.0, STEP_BACK, 0.0])
    forward = Rotation.from_euler("z", 90.0, degrees=True).as_matrix() @ BASE_FROM_FORWARD_CAMERA
    turns = Rotation.from_rotvec(rng.normal(0.0, np.radians(1.0), (count, 3))).as_matrix()
    return pose_from_rotation(turns @ forward, middle + rng.normal(0.0, 0.02, (count, 3)))


def work_of(scene: Scene, width: int, height: int, count: int) -> Work:
    """The task for virtual images of ``width`` x ``height`` pixels.

    They are the middle half of the camera's field of view, so that photos of twice the size have
    pixels as large as theirs.
    """
    corners = part_of(scene, CORNERS)
    camera = scene.cameras[0].intrinsics.resized(2 * width, 2 * height)
    middle = replace(
        camera, width=width, height=height, cx=camera.cx - width / 2, cy=camera.cy - height / 2
    )
    renderer = Renderer.of_scene(corners, 2 * width, Blending.DELAUNAY, threads=1)
    poses = particle_poses(corners, count)
    query = renderer.render(poses[0], middle).image
    return Work(renderer.views, corners, poses, middle, query)


@dataclass(frozen=True)
class OpenCvWork:
    """What OpenCV is given: everything that does not touch pixels is done.

    Attributes:
        photos: three images, RGB, float32.
        homographies: ``(M, 3, 3, 3)`` from virtual pixels to pixels of each photo.
        weights: ``(M, 3, H, W, 3)``, each weight once a channel.
        query: ``(H, W, 3)`` float32.
    """

    photos: tuple[Float32Array, ...]
    homographies: FloatArray
    weights: Float32Array
    query: Float32Array


def opencv_work(work: Work) -> OpenCvWork:
    """Prepares the task for OpenCV."""
    maps = [homographies(work, pose) for pose in work.poses]
    weights = [net_weights(work.views, pose, work.intrinsics) for pose in work.poses]
    photos = tuple(work.views.level(view, 0).astype(np.float32) for view in range(3))
    return OpenCvWork(
        photos, np.array(maps), np.array(weights, np.float32), work.query.astype(np.float32)
    )


def homographies(work: Work, pose: FloatArray) -> FloatArray:
    """``(3, 3, 3)``: from virtual pixels over the plane to pixels of each photo.

    The ray r of a pixel meets the plane n . x + d = 0 at C - r (n . C + d) / (n . r).
    """
    plane, centre = work.scene.plane, pose[:3, 3]
    rays = pose[:3, :3] @ np.linalg.inv(work.intrinsics.matrix())
    facing = plane.normal @ rays
    points = float(plane.signed_distance(centre)) * rays - np.outer(centre, facing)
    matrices = [
        pinhole.matrix() @ inverse(camera)[:3]
        for pinhole, camera in zip(work.views.intrinsics, work.scene.world_from_camera, strict=True)
    ]
    return np.array([matrix @ np.vstack([points, -facing]) for matrix in matrices])


def net_weights(views: Views, pose: FloatArray, intrinsics: Intrinsics) -> Float32Array:
    """``(3, H, W, 3)``: the weight of each of three views at each pixel, once a channel."""
    net = pixel_weights(views.centres, pose, intrinsics)
    weights = [np.sum(net.weights * (net.views == view), axis=-1) for view in range(3)]
    return np.repeat(np.array(weights, dtype=np.float32)[..., None], 3, axis=-1)


def opencv_image(work: OpenCvWork, particle: int) -> Float32Array:
    """The view at one particle, ``(H, W, 3)``."""
    height, width = work.query.shape[:2]
    blend = np.zeros_like(work.query)
    for view, photo in enumerate(work.photos):
        warped = cv2.warpPerspective(
            photo,
            work.homographies[particle, view],
            (width, height),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        )
        cv2.accumulateProduct(warped, work.weights[particle, view], blend)
    return blend


def opencv_costs(work: OpenCvWork) -> FloatArray:
    """Mean squared difference relative to 255^2 for every particle, as ``Cost.SQUARED``."""
    scale = 1.0 / (255.0**2 * work.query.size)
    return np.array(
        [
            scale * cv2.norm(opencv_image(work, particle), work.query, cv2.NORM_L2SQR)
            for particle in range(len(work.homographies))
        ]
    )


def fused_costs(renderer: Renderer, work: Work) -> FloatArray:
    """The same by the path that the filter uses."""
    return renderer.costs(work.poses, work.intrinsics, work.query, Cost.SQUARED, False)


def median_cpu_seconds(tasks: dict[str, Callable[[], object]], turns: int) -> dict[str, float]:
    """Median CPU time of each task; they take turns, after one turn that does not count."""
    seconds: dict[str, list[float]] = {name: [] for name in tasks}
    for turn in range(turns + 1):
        for name, task in tasks.items():
            start = time.process_time()
            task()
            if turn > 0:
                seconds[name].append(time.process_time() - start)
    return {name: statistics.median(values) for name, values in seconds.items()}


def measure(scene: Scene, width: int, height: int, particles: int) -> dict[str, float]:
    """Microseconds of CPU time a particle of each way to do the work."""
    work = work_of(scene, width, height, particles)
    prepared = opencv_work(work)
    tasks: dict[str, Callable[[], object]] = {OPENCV: partial(opencv_costs, prepared)}
    for blending in Blending:
        for name, views in (("3 views", work.scene), (f"{len(scene)} views", scene)):
            renderer = Renderer.of_scene(views, 2 * width, blending, threads=1)
            label = f"fused, {blending.name.lower()}, {name}"
            tasks[label] = partial(fused_costs, renderer, work)
    seconds = median_cpu_seconds(tasks, TURNS)
    return {name: 1e6 * value / particles for name, value in seconds.items()}


def measure_reference(scene: Scene, width: int, height: int) -> dict[str, float]:
    """Likewise for the readable renderer, once, for a few particles (without the comparison)."""
    work = work_of(scene, width, height, REFERENCE_PARTICLES)
    result = {}
    for blending in Blending:
        start = time.process_time()
        for pose in work.poses:
            render_reference(work.views, work.scene.plane, pose, work.intrinsics, blending)
        spent = time.process_time() - start
        label = f"NumPy reference, {blending.name.lower()}, 3 views"
        result[label] = 1e6 * spent / len(work.poses)
    return result


def machine() -> dict[str, str]:
    """What the figures depend on."""
    cpu = platform.processor() or platform.machine()
    information = Path("/proc/cpuinfo")
    if information.is_file():
        lines = information.read_text(encoding="utf-8").splitlines()
        cpu = next((line.split(":")[1].strip() for line in lines if "model name" in line), cpu)
    packages = ("lfnav", "numpy", "numba", "opencv-python-headless")
    versions = {name: version(name) for name in packages}
    return {"cpu": cpu, "python": platform.python_version(), **versions}


def table(microseconds: dict[str, dict[str, float]]) -> str:
    """The figures as a Markdown table: time a particle, and relative to OpenCV."""
    sizes = list(microseconds)
    lines = [
        "| CPU time a particle | " + " | ".join(f"{size} (µs)" for size in sizes) + " |",
        "|---|" + "---:|" * len(sizes),
    ]
    for name in microseconds[sizes[0]]:
        cells = []
        for size in sizes:
            value = microseconds[size].get(name)
            if value is None:
                cells.append("")
            else:
                cells.append(f"{value:.0f} ({value / microseconds[size][OPENCV]:.2f})")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def ratios(microseconds: dict[str, dict[str, float]], blending: Blending) -> dict[str, float]:
    """Fused time divided by OpenCV's, three views; below 1 the fused path is faster."""
    name = f"fused, {blending.name.lower()}, 3 views"
    return {size: round(row[name] / row[OPENCV], 3) for size, row in microseconds.items()}


def main() -> None:
    """Measures, prints, and writes ``results.json``."""
    cv2.setNumThreads(1)
    scene = workshop_scene()
    microseconds = {
        f"{width}x{height}": measure(scene, width, height, particles)
        for (width, height), particles in PARTICLES.items()
    }
    microseconds["40x30"].update(measure_reference(scene, 40, 30))
    results: dict[str, Any] = {
        "particles": {f"{size[0]}x{size[1]}": count for size, count in PARTICLES.items()},
        "threads": 1,
        "turns": TURNS,
        "ratio_to_opencv": ratios(microseconds, Blending.DELAUNAY),
        "ratio_to_opencv_unstructured": ratios(microseconds, Blending.UNSTRUCTURED),
        "microseconds_per_particle": {
            size: {name: round(value, 1) for name, value in row.items()}
            for size, row in microseconds.items()
        },
        "machine": machine(),
    }
    write_text(RESULTS, json.dumps(results, indent=2) + "\n", overwrite=True)
    print(f"One thread, median of {TURNS} turns; in brackets relative to the same work with")
    print(f"OpenCV {cv2.__version__}. {', '.join(map(str, PARTICLES.values()))} particles.\n")
    print(table(microseconds))
    print(f"\nwritten to {RESULTS.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
