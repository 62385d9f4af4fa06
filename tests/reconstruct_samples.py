"""Small models and data sets for the tests of ``pipelines.reconstruct``."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import pose_from_rotation
from pipelines.reconstruct.reconstruction import Reconstruction

ROOT = Path(__file__).parents[1]
SAMPLES = ROOT / "sample_data"
SHARED = ROOT.parent / "shared" / "data"
FOCAL = 300.0
SIZE = (320, 240)


def random_poses(count: int, seed: int = 0) -> FloatArray:
    """``(count, 4, 4)``."""
    generator = np.random.default_rng(seed)
    rotations = Rotation.random(count, random_state=seed).as_matrix()
    return pose_from_rotation(rotations, generator.normal(size=(count, 3)))


def small_reconstruction(root: Path, images: int = 4, points: int = 30) -> Reconstruction:
    """Every point is seen by three images; nothing else about it is true."""
    generator = np.random.default_rng(1)
    rows = [
        (point, image)
        for point in range(points)
        for image in sorted(generator.choice(images, 3, replace=False).tolist())
    ]
    return Reconstruction(
        method="sfm",
        image_root=root.resolve(),
        image_names=tuple(f"rgb/{index} ä.jpg" for index in range(images)),
        image_hashes=tuple(f"{index:064x}" for index in range(images)),
        timestamps=1305031102.175304 + 0.1 * np.arange(images, dtype=np.float64),
        cameras=(
            Camera("SIMPLE_RADIAL", 640, 480, (500.0, 319.5, 239.5, 0.01)),
            Camera("PINHOLE", 320, 240, (250.0, 251.0, 160.25, 119.0)),
        ),
        camera_index=np.arange(images) % 2,
        world_from_camera=random_poses(images),
        points=generator.normal(size=(points, 3)),
        observations=np.array(rows, dtype=np.int64),
        base_from_camera=random_poses(1, seed=5)[0],
        scale_source="odometry",
        dropped={"rgb/9.jpg": "no pose"},
        statistics={"mean_reprojection_error_px": 0.5},
        observed_pixels=generator.uniform(0.0, 200.0, (len(rows), 2)),
        point_colors=generator.integers(0, 256, (points, 3)).astype(np.uint8),
        point_errors=generator.uniform(0.0, 1.0, points),
    )


def texture(height: int, width: int, seed: int = 0) -> ImageArray:
    """Colour noise of several octaves: features everywhere, at all scales."""
    generator = np.random.default_rng(seed)
    total = np.zeros((height, width, 3))
    for cell in (4, 8, 16, 32, 64):
        noise = generator.normal(size=(height // cell + 1, width // cell + 1, 3))
        total += cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC) * cell**0.3
    total = (total - total.mean()) / total.std()
    return np.asarray(np.clip(total * 50.0 + 128.0, 0.0, 255.0), dtype=np.uint8)


def turning_camera(folder: Path, count: int, *, with_camera: bool) -> None:
    """Writes images of a textured backdrop from a camera that only turns about its centre."""
    folder.mkdir(parents=True)
    width, height = SIZE
    matrix = np.array([[FOCAL, 0, width / 2 - 0.5], [0, FOCAL, height / 2 - 0.5], [0, 0, 1.0]])
    backdrop = texture(1200, 1600)
    backdrop_matrix = np.array([[450.0, 0, 799.5], [0, 450.0, 599.5], [0, 0, 1.0]])
    for index in range(count):
        angles = (-14.0 + 28.0 * index / (count - 1), 2.0 * np.sin(index), np.cos(index))
        turn = Rotation.from_euler("yxz", angles, degrees=True).as_matrix()
        homography = backdrop_matrix @ turn @ np.linalg.inv(matrix)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        image = cv2.warpPerspective(backdrop, homography, SIZE, flags=flags)
        cv2.imwrite(str(folder / f"{index}.png"), image)
    if with_camera:
        params = f"[{FOCAL}, {FOCAL}, {width / 2 - 0.5}, {height / 2 - 0.5}]"
        (folder / "camera.toml").write_text(
            f'model = "PINHOLE"\nwidth = {width}\nheight = {height}\nparams = {params}\n',
            encoding="utf-8",
        )


def part_of(source: Path, target: Path, rows: Sequence[int], files: Sequence[str]) -> None:
    """A data set with some of the images of another one, and with the named files."""
    lines = (source / "rgb.txt").read_text(encoding="utf-8").splitlines()
    lines = [line for line in lines if not line.startswith("#")]
    chosen = [lines[row] for row in rows]
    (target / "rgb").mkdir(parents=True)
    for line in chosen:
        name = line.split()[1]
        (target / name).symlink_to((source / name).resolve())
    (target / "rgb.txt").write_text("\n".join(chosen) + "\n", encoding="utf-8")
    for name in files:
        (target / name).symlink_to((source / name).resolve())
