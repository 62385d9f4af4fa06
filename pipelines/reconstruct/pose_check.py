"""Whether photos agree with the poses that somebody gave for them.

Two photos of one surface tell how the camera turned and in which direction it moved, though not how
far. Poses of left-handed axes, with quaternions in another order, the wrong way about or with a
camera's axes as OpenGL has them say something else. A few pairs of photos are matched; where the
poses do not explain the matches and the same poses read otherwise do, that is said.
"""

from collections.abc import Callable, Iterator

import cv2
import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dataset.dataset import Dataset
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import inverse, pose_from_quaternion, quaternion_of
from pipelines.reconstruct.known_poses import KnownPoses

PAIRS = 4
FEATURES = 800
# A match is taken where the next best one is farther by this factor (Lowe 2004).
LOWE_RATIO = 0.75
FEWEST_MATCHES = 20
# Pixels from the epipolar line within which poses explain a match; poses measured by other means
# than photos are wrong by that much.
EXPLAINED_PIXELS = 4.0
# Share of the matches that another reading explains, and that the given poses at most do then.
AGREES, DOES_NOT = 0.5, 0.6
_MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
# What else poses may mean, as world_from_body that lfnav would read.
READINGS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "left-handed axes (one of them mirrored)": lambda poses: _MIRROR @ poses @ _MIRROR,
    "quaternions with w first": lambda poses: pose_from_quaternion(
        poses[:, :3, 3], np.roll(quaternion_of(poses), -1, axis=-1)
    ),
    "body_from_world, the inverse": inverse,
}
OF_THE_CAMERA = "poses of the camera itself, without the [mount] of camera.toml"
OPENGL_AXES = "cameras with y up and z backwards, as OpenGL has them"


def note_on_poses(data: Dataset, poses: KnownPoses) -> str | None:
    """What is wrong with given poses by the photos, in words; None where nothing shows.

    Args:
        data: the photos, with their camera.
        poses: what was given for them.

    Raises:
        InputError: a photo cannot be read.
    """
    if data.camera is None or len(poses.image_index) < 2:
        return None
    mount = data.body_from_camera
    bodies = poses.world_from_camera @ inverse(mount)
    readings = {name: read(bodies) @ mount for name, read in READINGS.items()}
    readings[OPENGL_AXES] = bodies @ np.diag([1.0, -1.0, -1.0, 1.0]) @ mount
    if data.base_from_camera is not None:
        readings[OF_THE_CAMERA] = bodies
    given: list[float] = []
    others: dict[str, list[float]] = {name: [] for name in readings}
    for first, second, rays in _matched_pairs(data, poses):
        given.append(_explained(poses.world_from_camera[[first, second]], rays, data.camera))
        for name, read in readings.items():
            others[name].append(_explained(read[[first, second]], rays, data.camera))
    if not given:
        return None
    best = max(others, key=lambda name: float(np.median(others[name])))
    share, explained = float(np.median(given)), float(np.median(others[best]))
    if explained < AGREES or share > DOES_NOT * explained:
        return None
    return (
        f"the photos do not agree with these poses ({share:.0%} of the matches lie where the poses "
        f"say); read as {best} they would ({explained:.0%})"
    )


def _matched_pairs(
    data: Dataset, poses: KnownPoses
) -> Iterator[tuple[int, int, tuple[FloatArray, FloatArray]]]:
    """Rows of photos that follow each other, with rays ``(N, 3)`` of what both show."""
    centres = poses.world_from_camera[:, :3, 3]
    moved = np.flatnonzero(np.linalg.norm(np.diff(centres, axis=0), axis=1) > 0.0)
    spread = np.linspace(0, len(moved) - 1, PAIRS).astype(np.int64)
    chosen = moved[np.unique(spread)].tolist() if len(moved) else []
    detector = cv2.SIFT_create(FEATURES)  # type: ignore[attr-defined]
    for row in chosen:
        found = []
        for index in poses.image_index[[row, row + 1]].tolist():
            grey = cv2.cvtColor(data.read_image(index), cv2.COLOR_RGB2GRAY)
            found.append(detector.detectAndCompute(grey, None))
        (first, first_features), (second, second_features) = found
        if min(len(first), len(second)) < FEWEST_MATCHES:
            continue
        pairs = [
            (best.queryIdx, best.trainIdx)
            for best, other in cv2.BFMatcher().knnMatch(first_features, second_features, k=2)
            if best.distance < LOWE_RATIO * other.distance
        ]
        if len(pairs) < FEWEST_MATCHES or data.camera is None:
            continue
        rays = [
            data.camera.rays(np.array([points[pair[side]].pt for pair in pairs]))
            for side, points in enumerate((first, second))
        ]
        yield row, row + 1, (rays[0], rays[1])


def _explained(
    world_from_camera: FloatArray, rays: tuple[FloatArray, FloatArray], camera: Camera
) -> float:
    """Share of matched rays that two poses ``(2, 4, 4)`` put on each other's epipolar lines."""
    second_from_first = inverse(world_from_camera[1]) @ world_from_camera[0]
    x, y, z = second_from_first[:3, 3]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    essential = cross @ second_from_first[:3, :3]
    first, second = (of / of[:, 2:] for of in rays)
    lines, back = first @ essential.T, second @ essential
    product = np.sum(second * lines, axis=1)
    slopes = np.sum(lines[:, :2] ** 2, axis=1) + np.sum(back[:, :2] ** 2, axis=1)
    # Sampson's distance, to first order that from both lines.
    away = np.abs(product) / np.sqrt(np.maximum(slopes, 1e-300))
    return float(np.mean(away * camera.intrinsics.fx < EXPLAINED_PIXELS))
