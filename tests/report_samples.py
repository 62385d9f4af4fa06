"""A painted wall, photos of it, and a run in front of it: small, and true by construction."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.dataset.images import encode_png
from pipelines.geometry.camera import Camera, Intrinsics
from pipelines.geometry.plane import Plane
from pipelines.geometry.pose import base_from_camera_mount, world_from_base_planar
from pipelines.lightfield.scene import PlaneEstimate, Scene
from pipelines.lightfield.scene_file import identifier_of, save_scene
from pipelines.localize.belief import normalise_log_weights
from pipelines.localize.run import FrameRecord, Run, save_run
from pipelines.localize.state_space import SPATIAL

# 90 degrees wide: from a distance d to the wall y = 0 a view shows 2 d of it.
CAMERA = Camera("SIMPLE_PINHOLE", 48, 36, (24.0, 23.5, 17.5))
MOUNT = base_from_camera_mount((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
WALL = Plane(np.array([0.0, -1.0, 0.0]), 0.0)


def facing_wall(x: float, distance: float, turn: float = 0.0) -> FloatArray:
    """A robot ``distance`` metres in front of the wall, turned left from it by ``turn``."""
    return np.array([x, -distance, np.pi / 2.0 + turn])


Paint = Callable[[FloatArray, FloatArray], FloatArray]


def smooth(x: FloatArray, z: FloatArray) -> FloatArray:
    """RGB ``(..., 3)`` of a wall without any edge, every 2 pi in x."""
    return 128.0 + 90.0 * _shades(x, z)


def painted(x: FloatArray, z: FloatArray) -> FloatArray:
    """RGB ``(..., 3)`` of a wall with broad shades under a pattern with edges, every 2 pi in x."""
    tiles = np.tanh(3.0 * np.sin(5.0 * x + np.sin(z))) * np.tanh(3.0 * np.cos(7.0 * z + np.sin(x)))
    stripes = np.tanh(3.0 * np.sin(3.0 * x + 4.0 * z))
    return 128.0 + 60.0 * _shades(x, z) + 40.0 * np.stack([tiles, stripes, -tiles], axis=-1)


def _shades(x: FloatArray, z: FloatArray) -> FloatArray:
    return np.stack([np.sin(2.0 * x), np.cos(x + 2.0 * z), np.sin(3.0 * z)], axis=-1)


def photo(
    state: FloatArray, camera: Intrinsics = CAMERA.intrinsics, paint: Paint = painted
) -> ImageArray:
    """What the robot's camera at ``state`` sees of the painted wall."""
    return photo_from(world_from_base_planar(state) @ MOUNT, camera, paint)


def photo_from(
    pose: FloatArray, camera: Intrinsics = CAMERA.intrinsics, paint: Paint = painted
) -> ImageArray:
    """What a camera at ``world_from_camera`` sees of the painted wall, computed ray by ray."""
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    rays = np.stack(
        [(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones(rows.shape)],
        axis=-1,
    )
    rays = rays @ pose[:3, :3].T
    reach = -pose[1, 3] / rays[..., 1]
    x, z = pose[0, 3] + reach * rays[..., 0], pose[2, 3] + reach * rays[..., 2]
    return paint(x, z).astype(np.uint8)


def wall_scene(paint: Paint = painted) -> Scene:
    """Three views from two metres away: they show the wall from x = -3 to 3."""
    states = [facing_wall(x, 2.0) for x in (-1.0, 0.0, 1.0)]
    images = tuple(encode_png(photo(state, paint=paint)) for state in states)
    poses = world_from_base_planar(np.array(states)) @ MOUNT
    index = np.zeros(3, dtype=np.int64)
    surface = PlaneEstimate(WALL, 0.01, 0.002, "given", 1.0)
    return Scene(
        image_names=("a.png", "b.png", "c.png"),
        encoded_images=images,
        timestamps=np.arange(3.0),
        cameras=(CAMERA,),
        camera_index=index,
        world_from_camera=poses,
        surface=surface,
        base_from_camera=MOUNT,
        bounds=np.array([-3.0, 3.0, -3.0, 0.0]),
        scale_source="given poses",
        identifier=identifier_of(images, (CAMERA,), index, poses, surface, MOUNT),
    )


# Where the robot really was: it drives along the wall and looks at it.
TRUTH = np.array([facing_wall(-0.6 + 0.2 * i, 1.8) for i in range(6)])
# Perfect, but in a frame of its own.
ODOMETRY = TRUTH + np.array([7.0, 0.0, 0.0])


def wall_run(
    *,
    offset: float = 0.05,
    statuses: str = "gttttt",
    groundtruth: FloatArray | None = TRUTH,
    odometry: FloatArray | None = ODOMETRY,
    dataset_name: str = "corridor",
    image_name: str = "rgb/{}.png",
) -> Run:
    """Six frames; estimates lie ``offset`` metres to the right of the truth.

    Args:
        offset: metres.
        statuses: a letter a frame: g(lobal), t(racking), b(lind), l(ost); lost frames have no
            estimate.
        groundtruth: as in ``Run``.
        odometry: as in ``Run``.
        dataset_name: as in ``Run``.
        image_name: with a place for the frame's number.
    """
    words = {"g": "global", "t": "tracking", "b": "blind", "l": "lost"}
    random = np.random.default_rng(5)
    frames = []
    for index, letter in enumerate(statuses):
        centre = TRUTH[index] + [offset, 0.0, 0.0]
        particles = centre + random.normal(0.0, 1.0, (60, 3)) * [0.1, 0.05, 0.02]
        log_weights, _ = normalise_log_weights(random.normal(0.0, 1.0, 60))
        frames.append(
            FrameRecord(
                timestamp=10.0 + 0.5 * index,
                image_name=image_name.replace("{}", str(index)),
                particles=particles,
                log_weights=log_weights,
                estimates={} if letter == "l" else {"mode": centre, "mean": centre + 0.01},
                modes=np.array([[*centre, 0.8], [centre[0] + 1.0, *centre[1:], 0.2]]),
                covariance=np.diag([0.01, 0.0025, 0.0004]),
                effective_sample_size=35.0,
                confidence=0.1 if letter == "l" else 0.9,
                status=words[letter],
                seconds={"likelihood": 0.02, "motion": 0.001},
            )
        )
    return Run(
        scene_identifier=wall_scene().identifier,
        scene_path="scene.h5",
        dataset_name=dataset_name,
        camera=CAMERA,
        base_from_camera=MOUNT,
        settings={"particles": 60, "area": None, "noise": {"turn": 0.1}},
        seed=42,
        frames=tuple(frames),
        encoded_images=tuple(encode_png(photo(state)) for state in TRUTH[: len(frames)]),
        odometry=odometry,
        groundtruth=groundtruth,
        provenance={"versions": {"lfnav": "0.1"}},
    )


def spatial_wall_run() -> Run:
    """``wall_run`` as that of a camera in the hand, where the robot's camera was."""
    run = wall_run(odometry=None)

    def spatial(states: FloatArray) -> FloatArray:
        return SPATIAL.states(world_from_base_planar(states) @ MOUNT)

    frames = tuple(
        replace(
            frame,
            particles=spatial(frame.particles),
            estimates={name: spatial(state) for name, state in frame.estimates.items()},
            modes=np.column_stack([spatial(frame.modes[:, :3]), frame.modes[:, 3]]),
            covariance=np.diag([0.01, 0.0025, 0.001, 0.0001, 0.0001, 0.0004]),
        )
        for frame in run.frames
    )
    return replace(run, frames=frames, base_from_camera=np.eye(4), groundtruth=spatial(TRUTH))


@dataclass(frozen=True)
class Files:
    """A run beside its scene, on disk."""

    run: Path
    scene: Path


def written(folder: Path, run: Run) -> Files:
    """Saves the run and the scene of the wall into ``folder``."""
    files = Files(folder / "run.h5", folder / "scene.h5")
    save_scene(files.scene, wall_scene(), overwrite=False)
    save_run(files.run, run, overwrite=False)
    return files
