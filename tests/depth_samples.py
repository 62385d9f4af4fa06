"""Photos and exact depth of a board before a wall, as data sets, for tests of scenes with depth."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.dataset.images import encode_png
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.trajectory import Trajectory, format_tum
from tests.lightfield_samples import looking, pinhole, pinhole_rays, pixels_of, waves

CAMERA = pinhole(96, 72, 84.0)
# A board stands 1.2 m before the wall y = 0 and hides a part of it, another one from every place.
BOARD_Y, BOARD_LEFT, BOARD_RIGHT = -1.2, -0.5, 0.4
MAP_PLACES = [[x, -4.0 + 0.3 * (i % 2), 1.0] for i, x in enumerate(np.linspace(-1.0, 1.0, 7))]
TEST_PLACES = [[-0.45, -3.7, 1.05], [0.2, -3.9, 0.95]]


def seen(pose: FloatArray) -> tuple[ImageArray, FloatArray]:
    """Photo and depth (metres along z) of the wall and the board, ray by ray."""
    rays = pinhole_rays(CAMERA, pixels_of(CAMERA)) @ pose[:3, :3].T
    to_board = (BOARD_Y - pose[1, 3]) / rays[..., 1]
    x = pose[0, 3] + to_board * rays[..., 0]
    on_board = (x > BOARD_LEFT) & (x < BOARD_RIGHT)
    depth = np.where(on_board, to_board, -pose[1, 3] / rays[..., 1])
    points = pose[:3, 3] + depth[..., None] * rays
    # The board has a finer texture of its own.
    colours = np.where(on_board[..., None], waves(3.0 * points + 5.0), waves(2.0 * points))
    return np.rint(colours).astype(np.uint8), depth


def write_dataset(root: Path, places: list[list[float]]) -> Path:
    """A data set of body = camera with exact poses and depth images."""
    poses = np.array([looking(place, [place[0] * 0.3, 0.0, 1.0]) for place in places])
    return write_rgbd(root, poses, seen, CAMERA)


def write_rgbd(
    root: Path,
    poses: FloatArray,
    view: Callable[[FloatArray], tuple[ImageArray, FloatArray]],
    camera: Intrinsics,
) -> Path:
    """A data set of what is seen, colours and depth, from poses of body = camera ``(N, 4, 4)``."""
    (root / "rgb").mkdir(parents=True)
    (root / "depth").mkdir()
    for index, pose in enumerate(poses):
        image, depth = view(pose)
        (root / f"rgb/{index}.png").write_bytes(encode_png(image))
        levels = np.rint(depth * 5000.0).astype(np.uint16)
        (root / f"depth/{index}.png").write_bytes(cv2.imencode(".png", levels)[1].tobytes())
    for kind in ("rgb", "depth"):
        lines = [f"{index}.0 {kind}/{index}.png" for index in range(len(poses))]
        (root / f"{kind}.txt").write_text("\n".join(lines) + "\n")
    times = np.arange(len(poses), dtype=np.float64)
    (root / "groundtruth.txt").write_text(format_tum(Trajectory(times, poses)))
    (root / "camera.toml").write_text(
        f'model = "PINHOLE"\nwidth = {camera.width}\nheight = {camera.height}\n'
        f"params = {camera.vector().tolist()}\ndepth_scale = 5000\n"
    )
    return root
