"""Two rooms with painted walls and a doorway between them, photographed, for tests of worlds.

The rooms lie side by side, the wall between them at x = 0, 4 m by 4 m each; the doorway is at its
middle, 1 m wide. A third room, of the same size, lies beyond x = 4 and has no door.
"""

from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dataset.images import encode_png
from pipelines.geometry.camera import Camera
from pipelines.geometry.trajectory import Trajectory, format_tum
from tests.chain_samples import succeed
from tests.lightfield_samples import looking, pinhole_rays, pixels_of, waves

CAMERA = Camera("SIMPLE_PINHOLE", 48, 36, (30.0, 23.5, 17.5))
# Any plane does where depth is not asked for: here the floor.
FLOOR = "0,0,1,0"
HALF_DOOR = 0.5
DIRECTIONS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))

TWO_ROOMS = """
[[area]]
name = "west"
xmin = -4
xmax = 0
ymin = -2
ymax = 2

[[area]]
name = "east"
xmin = 0
xmax = 4
ymin = -2
ymax = 2

[[doorway]]
areas = ["west", "east"]
x = 0
y = 0
width = 1
"""


def room_places(middle: float) -> list[tuple[float, float]]:
    """A grid of places half a metre apart, a metre from the walls of the room around x."""
    steps = np.linspace(-1.0, 1.0, 5)
    return [(middle + x, y) for y in steps for x in steps]


# Through the doorway, then the other room.
PLACES = [
    *room_places(-2.0),
    *((x, 0.0) for x in (-0.75, -0.5, -0.2, 0.2, 0.5, 0.75)),
    *room_places(2.0),
]


def surfaces_met(centre: FloatArray, rays: FloatArray) -> FloatArray:
    """How far along rays ``(..., 3)`` from a place walls, floor or ceiling are met, in rays."""
    reach = np.full(rays.shape[:-1], np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis, offsets in ((0, (-4.0, 0.0, 4.0)), (1, (-2.0, 2.0)), (2, (0.0, 3.0))):
            for offset in offsets:
                distance = (offset - centre[axis]) / rays[..., axis]
                y = centre[1] + distance * rays[..., 1]
                open_door = (axis == 0) & (offset == 0.0) & (np.abs(y) < HALF_DOOR)
                met = (distance > 1e-9) & (distance < reach) & ~open_door
                reach = np.where(met, distance, reach)
    return reach


def seen(pose: FloatArray) -> FloatArray:
    """``(H, W, 3)`` what a camera sees of the walls, ray by ray; the rooms are painted unlike."""
    rays = pinhole_rays(CAMERA.intrinsics, pixels_of(CAMERA.intrinsics)) @ pose[:3, :3].T
    centre = pose[:3, 3]
    reach = surfaces_met(centre, rays)
    points = centre + reach[..., None] * rays
    return np.asarray(waves(points + np.where(points[..., :1] > 0.0, 7.0, 0.0)))


def rooms_dataset(folder: Path, places: list[tuple[float, float]] | None = None) -> Path:
    """A data set with four photos from each place, a metre high."""
    poses = [
        looking([x, y, 1.0], [x + right, y + ahead, 1.0])
        for x, y in (PLACES if places is None else places)
        for right, ahead in DIRECTIONS
    ]
    (folder / "rgb").mkdir(parents=True)
    for index, pose in enumerate(poses):
        image = np.rint(seen(pose)).clip(0, 255).astype(np.uint8)
        (folder / f"rgb/{index:04d}.png").write_bytes(encode_png(image))
    lines = [f"{index}.0 rgb/{index:04d}.png" for index in range(len(poses))]
    (folder / "rgb.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    times = np.arange(len(poses), dtype=np.float64)
    text = format_tum(Trajectory(times, np.array(poses)))
    (folder / "groundtruth.txt").write_text(text, encoding="utf-8")
    (folder / "camera.toml").write_text(
        f'model = "{CAMERA.model}"\nwidth = {CAMERA.width}\nheight = {CAMERA.height}\n'
        f"params = {list(CAMERA.params)}\n",
        encoding="utf-8",
    )
    return folder


def rooms_reconstruction(folder: Path, places: list[tuple[float, float]] | None = None) -> Path:
    """``folder/map``: the rooms with their true poses."""
    data = rooms_dataset(folder / "data", places)
    poses = data / "groundtruth.txt"
    succeed("reconstruct", data, "-o", folder / "map", "--method", "poses", "--poses", poses)
    return folder / "map"
