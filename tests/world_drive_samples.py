"""The two rooms of ``world_samples`` as a world with depth, and a drive from one to the other."""

from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.dataset.images import encode_png
from pipelines.geometry.pose import base_from_camera_mount, inverse, world_from_base_planar
from pipelines.geometry.trajectory import Trajectory, format_tum
from tests.chain_samples import lfnav, succeed
from tests.depth_samples import write_rgbd
from tests.lightfield_samples import looking, pinhole, pinhole_rays, pixels_of, waves
from tests.world_samples import PLACES, TWO_ROOMS, surfaces_met

CAMERA = pinhole(96, 72, 60.0)
MOUNT = base_from_camera_mount((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))


def seen(pose: FloatArray) -> tuple[ImageArray, FloatArray]:
    """Photo and depth (metres along z) of the rooms, ray by ray."""
    rays = pinhole_rays(CAMERA, pixels_of(CAMERA)) @ pose[:3, :3].T
    depth = surfaces_met(pose[:3, 3], rays)
    points = pose[:3, 3] + depth[..., None] * rays
    turned = points + 0.7 * np.roll(points, 1, axis=-1)
    # The rooms are painted unlike, and so are both sides of the wall between them.
    turned = turned + np.where((points - 1e-6 * rays)[..., :1] > 0.0, 7.0, 0.0)
    colours = 0.6 * waves(1.7 * turned) + 0.4 * waves(6.1 * turned + 2.0)
    return np.rint(colours).astype(np.uint8), depth


def map_poses() -> FloatArray:
    """``(N, 4, 4)`` four photos from each place, all around."""
    return np.array(
        [
            looking([x, y, 1.0], [x + np.cos(angle), y + np.sin(angle), 1.0])
            for number, (x, y) in enumerate(PLACES)
            for angle in 0.5 * np.pi * np.arange(4) + 0.8 * (number % 2)
        ]
    )


def world_of_rooms(folder: Path, areas: str = TWO_ROOMS, name: str = "world") -> Path:
    """A world with given depth: ``folder/map`` is made once, ``folder/name`` by these areas."""
    if not (folder / "map").exists():
        data = write_rgbd(folder / "data", map_poses(), seen, CAMERA)
        given = ("--method", "poses", "--poses", data / "groundtruth.txt")
        succeed("reconstruct", data, "-o", folder / "map", *given)
    (folder / f"{name}.toml").write_text(areas, encoding="utf-8")
    options = ("--areas", folder / f"{name}.toml", "--geometry", "depth", "--depth", "given")
    # Not succeed: of areas that leave out photos it is said which.
    outcome = lfnav("model", folder / "map", "-o", folder / name, *options)
    assert outcome.code == 0, outcome.err
    return folder / name


def drive(folder: Path, states: FloatArray) -> Path:
    """A data set of a robot that was at these states ``(N, 3)``, with exact odometry."""
    (folder / "rgb").mkdir(parents=True)
    poses = np.array([world_from_base_planar(state) for state in states])
    for index, pose in enumerate(poses):
        image, _ = seen(pose @ MOUNT)
        (folder / f"rgb/{index:03d}.png").write_bytes(encode_png(image))
    lines = [f"{index}.0 rgb/{index:03d}.png" for index in range(len(poses))]
    (folder / "rgb.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    times = np.arange(len(poses), dtype=np.float64)
    (folder / "groundtruth.txt").write_text(format_tum(Trajectory(times, poses)))
    relative = inverse(poses[0]) @ poses
    (folder / "odometry.txt").write_text(format_tum(Trajectory(times, relative)))
    (folder / "camera.toml").write_text(
        f'model = "PINHOLE"\nwidth = {CAMERA.width}\nheight = {CAMERA.height}\n'
        f"params = {CAMERA.vector().tolist()}\n"
        "[mount]\nx = 0.0\ny = 0.0\nz = 1.0\nroll = 0.0\npitch = 0.0\nyaw = 0.0\n",
        encoding="utf-8",
    )
    return folder


def through_the_door() -> FloatArray:
    """``(N, 3)`` from the middle of the western room to that of the eastern one."""
    x = np.arange(-2.4, 2.0, 0.2)
    y = 0.3 * np.sin(1.3 * x) * np.minimum(np.abs(x), 1.0)
    heading = np.arctan2(np.gradient(y), np.gradient(x))
    return np.column_stack([x, y, heading])
