"""CPU time of the fused render-and-compare path, beside the same work done with OpenCV.

The work is the same for both: three photos are mapped over the scene's plane into the virtual
image, blended with a weight for each pixel, and compared with a camera image by the sum of squared
colour differences. The photos are as fine as the virtual images, and the virtual cameras stand
where all three show every pixel. OpenCV is given what the fused path works out for itself: the
homographies and the blending weights are computed before the clock starts. Of several ways to say
this in OpenCV the fastest was taken (photos as floats, ``accumulateProduct``). All run on one
thread.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.scenes import part_of
from benchmarks.timing import Timing, markdown_table, median_times
from pipelines.artifacts.array_types import Float32Array, FloatArray, ImageArray
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.pose import BASE_FROM_FORWARD_CAMERA, inverse, pose_from_rotation
from pipelines.lightfield.blending import Blending
from pipelines.lightfield.comparison import Cost
from pipelines.lightfield.net import pixel_weights
from pipelines.lightfield.reference import render_reference
from pipelines.lightfield.renderer import Renderer
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.views import Views

# Three photos whose centres span a triangle across the line of sight.
CORNERS = (5, 12, 18)
# The virtual cameras stand this far, in metres, behind the middle of that triangle.
STEP_BACK = 0.25
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


def measure_size(scene: Scene, width: int, height: int, particles: int) -> dict[str, Timing]:
    """Time a particle of each way to do the work."""
    work = work_of(scene, width, height, particles)
    prepared = opencv_work(work)
    tasks: dict[str, Callable[[], object]] = {OPENCV: partial(opencv_costs, prepared)}
    for blending in Blending:
        for name, views in (("3 views", work.scene), (f"{len(scene)} views", scene)):
            renderer = Renderer.of_scene(views, 2 * width, blending, threads=1)
            label = f"fused, {blending.name.lower()}, {name}"
            tasks[label] = partial(fused_costs, renderer, work)
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


def table(microseconds: dict[str, dict[str, float]]) -> str:
    """CPU time a particle, and how many times as fast as OpenCV that is."""
    sizes = list(microseconds)
    rows = []
    for name in microseconds[sizes[0]]:
        cells = []
        for size in sizes:
            value = microseconds[size].get(name)
            ratio = 0.0 if value is None else microseconds[size][OPENCV] / value
            cells.append("" if value is None else f"{value:.0f} ({ratio:.2f})")
        rows.append((name, *cells))
    return markdown_table(("CPU time a particle", *(f"{size} (µs)" for size in sizes)), rows)


def ratios(microseconds: dict[str, dict[str, float]], blending: Blending) -> dict[str, float]:
    """OpenCV's CPU time divided by the fused path's, three views; above 1 that is the faster."""
    name = f"fused, {blending.name.lower()}, 3 views"
    return {size: round(row[OPENCV] / row[name], 3) for size, row in microseconds.items()}


def measure(scene: Scene) -> dict[str, Any]:
    """All sizes; plain JSON types."""
    times = {
        f"{width}x{height}": measure_size(scene, width, height, particles)
        for (width, height), particles in PARTICLES.items()
    }
    times["40x30"].update(measure_reference(scene, 40, 30))
    cpu = {s: {n: round(1e6 * t.cpu, 1) for n, t in row.items()} for s, row in times.items()}
    wall = {s: {n: round(1e6 * t.wall, 1) for n, t in row.items()} for s, row in times.items()}
    return {
        "particles": {f"{size[0]}x{size[1]}": count for size, count in PARTICLES.items()},
        "threads": 1,
        "turns": TURNS,
        "ratio_to_opencv": ratios(cpu, Blending.DELAUNAY),
        "ratio_to_opencv_unstructured": ratios(cpu, Blending.UNSTRUCTURED),
        "microseconds_per_particle": cpu,
        "wall_microseconds_per_particle": wall,
    }
