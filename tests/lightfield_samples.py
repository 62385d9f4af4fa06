"""Photos of an analytic surface, and random light fields, for the tests of ``lightfield``."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray
from pipelines.geometry.camera import Camera, Intrinsics
from pipelines.geometry.plane import Plane, plane_from_coefficients
from pipelines.geometry.pose import pose_from_rotation
from pipelines.lightfield.views import Views, build_views

# The plane y = 0, seen from negative y, as in the sample data.
WALL = Plane(np.array([0.0, -1.0, 0.0]), 0.0)

Texture = Callable[[FloatArray], FloatArray]


def looking(centre: ArrayLike, target: ArrayLike, roll: float = 0.0) -> FloatArray:
    """world_from_camera ``(4, 4)`` of a camera that looks at a point; level without ``roll``."""
    place = np.asarray(centre, dtype=np.float64)
    forward = np.asarray(target, dtype=np.float64) - place
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right)
    level = np.stack([right, np.cross(forward, right), forward], axis=1)
    turn = np.array(
        [[np.cos(roll), -np.sin(roll), 0.0], [np.sin(roll), np.cos(roll), 0.0], [0.0, 0.0, 1.0]]
    )
    return pose_from_rotation(level @ turn, place)


def pinhole(width: int, height: int, focal: float) -> Intrinsics:
    """Square pixels, the principal point in the middle of the image."""
    return Intrinsics(width, height, focal, focal, (width - 1) / 2.0, (height - 1) / 2.0)


def pixels_of(intrinsics: Intrinsics) -> FloatArray:
    """``(H, W, 2)`` pixel centres."""
    columns, rows = np.meshgrid(np.arange(intrinsics.width), np.arange(intrinsics.height))
    return np.stack([columns, rows], axis=-1).astype(np.float64)


def surface_points(
    pose: FloatArray, rays: FloatArray, plane: Plane
) -> tuple[FloatArray, BoolArray]:
    """Where rays ``(..., 3)`` of camera coordinates meet a plane, and whether in front of it."""
    directions = rays @ pose[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = -plane.signed_distance(pose[:3, 3]) / (directions @ plane.normal)
        hit = np.isfinite(reach) & (reach > 0.0)
    reach = np.where(hit, reach, 0.0)
    return pose[:3, 3] + reach[..., None] * directions, np.asarray(hit)


def pinhole_rays(intrinsics: Intrinsics, pixels: FloatArray) -> FloatArray:
    """``(..., 3)`` viewing rays of pixels ``(..., 2)``."""
    x = (pixels[..., 0] - intrinsics.cx) / intrinsics.fx
    y = (pixels[..., 1] - intrinsics.cy) / intrinsics.fy
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def recorded_rays(camera: Camera) -> FloatArray:
    """``(H, W, 3)`` viewing rays of an OPENCV camera's pixels, lens distortion included."""
    _, _, _, _, k1, k2, p1, p2 = camera.params
    distorted = pinhole_rays(camera.intrinsics, pixels_of(camera.intrinsics))[..., :2]
    plain = distorted
    # The model gives the distorted point; its inverse is found by iteration.
    for _ in range(60):
        x, y = plain[..., 0], plain[..., 1]
        square = x * x + y * y
        radial = 1.0 + k1 * square + k2 * square * square
        shift_x = 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)
        shift_y = p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y
        plain = (distorted - np.stack([shift_x, shift_y], axis=-1)) / radial[..., None]
    return np.concatenate([plain, np.ones((*plain.shape[:2], 1))], axis=-1)


def waves(points: FloatArray) -> FloatArray:
    """A smooth solid texture: RGB (0 to 255) at world points ``(..., 3)``."""
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack(
        [
            128.0 + 90.0 * np.sin(2.1 * x + 0.7 * z + 0.4 * y),
            128.0 + 90.0 * np.cos(1.3 * x - 2.3 * z + 1.0),
            128.0 + 90.0 * np.sin(2.9 * z + 0.3 * x) * np.cos(1.1 * x + 0.8 * y),
        ],
        axis=-1,
    )


def true_image(
    pose: FloatArray, rays: FloatArray, plane: Plane, texture: Texture = waves
) -> FloatArray:
    """``(H, W, 3)`` what a camera sees of the surface, ray by ray; zero beside it."""
    points, hit = surface_points(pose, rays, plane)
    return np.asarray(np.where(hit[..., None], texture(points), 0.0))


def photo(
    pose: FloatArray, intrinsics: Intrinsics, plane: Plane = WALL, texture: Texture = waves
) -> ImageArray:
    """``true_image`` of a pinhole camera as a photo: rounded to grey levels."""
    rays = pinhole_rays(intrinsics, pixels_of(intrinsics))
    return np.rint(true_image(pose, rays, plane, texture)).astype(np.uint8)


def photographed(
    poses: Sequence[FloatArray], intrinsics: Intrinsics, plane: Plane, texture: Texture = waves
) -> Views:
    """The light field of pinhole photos of the surface."""
    images = [photo(pose, intrinsics, plane, texture) for pose in poses]
    return build_views(images, [intrinsics] * len(poses), np.array(poses))


def noise_views(poses: Sequence[FloatArray], generator: np.random.Generator) -> Views:
    """Photos of white noise and various sizes: whoever reads a wrong texel is found out."""
    images, intrinsics = [], []
    for _ in poses:
        width, height = (int(side) for side in generator.integers(20, 45, 2))
        focal = float(generator.uniform(15.0, 40.0))
        centre = generator.uniform(-3.0, 3.0, 2) + np.array([width / 2, height / 2])
        images.append(generator.integers(0, 256, (height, width, 3)).astype(np.uint8))
        intrinsics.append(Intrinsics(width, height, focal, 1.1 * focal, *centre.tolist()))
    return build_views(images, intrinsics, np.array(poses))


def tilted_wall(generator: np.random.Generator) -> Plane:
    """A plane near y = 0 that faces negative y, turned by up to 20 degrees either way."""
    tilt = generator.uniform(-0.35, 0.35, 2)
    return plane_from_coefficients([tilt[0], -1.0, tilt[1], generator.uniform(-0.2, 0.2)])
