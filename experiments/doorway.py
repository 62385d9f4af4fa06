"""A place with a narrow passage, made and photographed by a program.

    python experiments/doorway.py scene sample_data/doorway/scene     # how that folder was made
    python experiments/doorway.py photos sample_data/doorway/scene/scene.xml -o out/doorway/map

Two pillars stand 0.9 m apart in a room; behind them is the wall that a robot is to dock at. The
scene is one for Mitsuba (walls, boxes, a lamp, textures drawn from random numbers), the photos are
a data set with simulated odometry, taken by a robot that looks round before and behind the pillars.
"""

import argparse
import math
import sys
from pathlib import Path

import cv2
import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.dataset.images import encode_png
from pipelines.dock.planar_motion import moved, movement_between
from pipelines.dock.robot import Movement
from pipelines.dock.robots.noise import MotionNoise, SensorNoise, SimulatedMotion
from pipelines.dock.robots.simulator import PathTracing, SimulatorRobot
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import base_from_camera_mount, world_from_base_planar
from pipelines.geometry.trajectory import Trajectory, format_tum

# The pillars: centres at x = -+PILLAR_X, y = PILLAR_Y; half their width, their height. Metres.
PASSAGE, HALF_WIDTH, HEIGHT = 0.9, 0.2, 2.2
PILLAR_X, PILLAR_Y = PASSAGE / 2.0 + HALF_WIDTH, -2.0
# The room: x from -ROOM_X to ROOM_X, y from ROOM_Y to 0, ROOM_Z high.
ROOM_X, ROOM_Y, ROOM_Z = 2.5, -6.0, 2.6
TEXTURE_SIDE, JPEG_QUALITY = 768, 70
SEED = 4
CAMERA_HEIGHT = 1.0
ODOMETRY = MotionNoise(actuation=0.0, odometry=0.01, odometry_turn=math.radians(0.05))
SENSOR = SensorNoise(noise=1.0, gain=0.0)
CAMERA = Camera("PINHOLE", 480, 360, (432.97, 432.97, 239.5, 179.5))


def texture(rng: np.random.Generator, tone: tuple[int, int, int], spread: int) -> ImageArray:
    """An image ``(S, S, 3)`` of patches of all sizes on a ground of one tone."""
    side = TEXTURE_SIDE
    image = np.full((side, side, 3), tone, dtype=np.uint8)
    for size in (160, 80, 40, 20):
        for _ in range(int(2.2 * (side / size) ** 1.6)):
            corner = rng.integers(-size // 2, side, 2)
            extent = rng.integers(size // 3, size, 2)
            color = np.clip(np.array(tone) + rng.integers(-spread, spread + 1, 3), 8, 247)
            last = (int(corner[0] + extent[0]), int(corner[1] + extent[1]))
            first = (int(corner[0]), int(corner[1]))
            cv2.rectangle(image, first, last, tuple(map(int, color)), -1)
    grain = rng.normal(0.0, 4.0, image.shape)
    return np.clip(image + grain, 0.0, 255.0).astype(np.uint8)


def _shape(kind: str, name: str, transforms: str) -> str:
    # A pillar's face shows as much of its texture as its width is of its height.
    across = 2.0 * HALF_WIDTH / HEIGHT if kind == "cube" else 1.0
    return f"""    <shape type="{kind}" id="{name}">
        <transform name="to_world">{transforms}</transform>
        <bsdf type="twosided"><bsdf type="diffuse">
            <texture type="bitmap" name="reflectance">
                <string name="filename" value="textures/{name.rstrip("12")}.jpg"/>
                <transform name="to_uv"><scale x="{across:.3f}" y="1"/></transform>
            </texture>
        </bsdf></bsdf>
    </shape>
"""


def _scaled(x: float, y: float, z: float) -> str:
    return f'<scale x="{x:g}" y="{y:g}" z="{z:g}"/>'


def _turned(axis: str, degrees: float) -> str:
    return f'<rotate {axis}="1" angle="{degrees:g}"/>'


def _moved(x: float, y: float, z: float) -> str:
    return f'<translate x="{x:g}" y="{y:g}" z="{z:g}"/>'


def scene_xml() -> str:
    """The scene: z up, metres. Mitsuba's rectangle and cube reach from -1 to 1."""
    middle_y, middle_z = ROOM_Y / 2.0, ROOM_Z / 2.0
    upright = _turned("x", 90.0)
    wall, side = _scaled(ROOM_X, middle_z, 1.0), _scaled(-middle_y, middle_z, 1.0)
    pillar = _scaled(HALF_WIDTH, HALF_WIDTH, HEIGHT / 2.0)
    ground = _scaled(ROOM_X, -middle_y, 1.0)
    shapes = [
        _shape("rectangle", "front", wall + upright + _moved(0.0, 0.0, middle_z)),
        _shape("rectangle", "back", wall + upright + _moved(0.0, ROOM_Y, middle_z)),
        *(
            _shape(
                "rectangle",
                f"side{number}",
                side + upright + _turned("z", 90.0) + _moved(sign * ROOM_X, middle_y, middle_z),
            )
            for number, sign in ((1, -1.0), (2, 1.0))
        ),
        _shape("rectangle", "floor", ground + _moved(0.0, middle_y, 0.0)),
        *(
            _shape(
                "cube",
                f"pillar{number}",
                pillar + _moved(sign * PILLAR_X, PILLAR_Y, HEIGHT / 2.0),
            )
            for number, sign in ((1, -1.0), (2, 1.0))
        ),
    ]
    lamp = ground + _turned("x", 180.0) + _moved(0.0, middle_y, ROOM_Z)
    return f"""<?xml version="1.0" encoding="utf-8"?>
<!-- A passage between two pillars: z up, metres; made by experiments/doorway.py, CC0. The sensor
     comes from the program that renders it. The whole ceiling is the lamp. -->
<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="3"/></integrator>
{"".join(shapes)}    <shape type="rectangle" id="ceiling">
        <transform name="to_world">{lamp}</transform>
        <emitter type="area"><rgb name="radiance" value="0.9 0.9 0.88"/></emitter>
    </shape>
</scene>
"""


def make_scene(folder: Path) -> None:
    """Writes ``scene.xml`` and its textures."""
    rng = np.random.default_rng(SEED)
    tones = {
        "front": ((176, 160, 138), 80),
        "back": ((120, 132, 140), 60),
        "side": ((150, 150, 140), 70),
        "floor": ((110, 104, 98), 30),
        "pillar": ((140, 110, 96), 90),
    }
    (folder / "textures").mkdir(parents=True, exist_ok=True)
    for name, (tone, spread) in tones.items():
        image = cv2.cvtColor(texture(rng, tone, spread), cv2.COLOR_RGB2BGR)
        path = folder / "textures" / f"{name}.jpg"
        cv2.imwrite(str(path), image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    (folder / "scene.xml").write_text(scene_xml(), encoding="utf-8")


def places() -> list[FloatArray]:
    """States ``(3,)`` of the robot at the photos: to and fro before, through, to and fro behind."""
    rows = [
        (-5.0, np.linspace(-1.5, 1.5, 7)),
        (-4.3, np.linspace(1.5, -1.5, 7)),
        (-3.6, np.linspace(-1.3, 1.3, 7)),
        (-3.0, np.linspace(0.9, -0.9, 5)),
        (-2.5, np.linspace(-0.3, 0.3, 3)),
        (-2.0, np.array([0.1, -0.1])),
        (-1.6, np.linspace(-0.8, 0.8, 5)),
        (-1.1, np.linspace(0.8, -0.8, 5)),
    ]
    # It looks towards the middle of the wall, a little to and fro.
    return [
        np.array([x, y, math.atan2(1.0 - y, -0.5 * x) + math.radians(8.0) * (-1) ** number])
        for y, xs in rows
        for number, x in enumerate(xs.tolist())
    ]


def photograph(scene: Path, folder: Path, samples: int) -> None:
    """Renders the map data set: photos, camera, odometry and ground truth."""
    motion = SimulatedMotion(places()[0], ODOMETRY, np.random.default_rng(SEED))
    mount = base_from_camera_mount((0.0, 0.0, CAMERA_HEIGHT), (0.0, 0.0, 0.0))
    tracing = PathTracing(samples, denoise=False)
    rng = np.random.default_rng(SEED + 1)
    robot = SimulatorRobot(scene, CAMERA, mount, motion, SENSOR, tracing, rng)
    (folder / "rgb").mkdir(parents=True, exist_ok=True)
    truth, odometry, names = [], [motion.state], []
    for number, place in enumerate(places()):
        if number:
            command = movement_between(motion.state, place)
            measured = robot.move(command.forward, command.left, command.turn)
            odometry.append(moved(odometry[-1], Movement(*measured)))
        truth.append(motion.state)
        names.append(f"{0.5 * number:.6f} rgb/{number:04d}.png")
        (folder / "rgb" / f"{number:04d}.png").write_bytes(encode_png(robot.take_image()))
        print(f"photo {number + 1} of {len(places())}", file=sys.stderr, flush=True)
    (folder / "rgb.txt").write_text("# timestamp filename\n" + "\n".join(names) + "\n")
    times = 0.5 * np.arange(len(truth), dtype=np.float64)
    for name, states in (("groundtruth.txt", truth), ("odometry.txt", odometry)):
        poses = world_from_base_planar(np.stack(states))
        (folder / name).write_text(format_tum(Trajectory(times, poses)), encoding="utf-8")
    params = ", ".join(f"{value:g}" for value in CAMERA.params)
    (folder / "camera.toml").write_text(
        f'model = "{CAMERA.model}"\nwidth = {CAMERA.width}\nheight = {CAMERA.height}\n'
        f"params = [{params}]\n\n[mount]\nx = 0.0\ny = 0.0\nz = {CAMERA_HEIGHT}\n"
        "roll = 0.0\npitch = 0.0\nyaw = 0.0\n",
        encoding="utf-8",
    )


def main() -> int:
    """Makes the scene, or the photos."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parts = parser.add_subparsers(dest="part", required=True)
    scene = parts.add_parser("scene")
    scene.add_argument("folder", type=Path)
    photos = parts.add_parser("photos")
    photos.add_argument("scene", type=Path)
    photos.add_argument("-o", "--output", type=Path, required=True)
    photos.add_argument("--samples", type=int, default=32)
    options = parser.parse_args()
    if options.part == "scene":
        make_scene(options.folder)
    else:
        photograph(options.scene, options.output, options.samples)
    return 0


if __name__ == "__main__":
    sys.exit(main())
