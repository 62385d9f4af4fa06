"""The light fields that are measured, all from the sample data."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipelines.artifacts.stages import no_progress
from pipelines.geometry.plane import plane_inverse_depth
from pipelines.lightfield.depth_storage import as_stored
from pipelines.lightfield.scene import Scene, SceneDepth
from pipelines.lightfield.scene_file import identified
from pipelines.lightfield.stage import ModelSettings, build_scene
from pipelines.reconstruct.reconstruction import Reconstruction, load_reconstruction
from pipelines.reconstruct.stage import ReconstructSettings, reconstruct

ROOT = Path(__file__).resolve().parents[1]
WORKSHOP = ROOT / "sample_data" / "workshop" / "map"
ELEVATORS = ROOT / "sample_data" / "elevators"
WALL = (0.0, -1.0, 0.0, 0.0)
DEPTH_WIDTH = 480


def workshop_reconstruction(folder: Path) -> Reconstruction:
    """The workshop's photos with their true poses; written into a folder."""
    settings = ReconstructSettings("poses", poses=WORKSHOP / "groundtruth.txt")
    reconstruct(WORKSHOP, folder, settings, overwrite=False, progress=no_progress)
    return load_reconstruction(folder)


def workshop_scene() -> Scene:
    """The same as a light field, with the wall as the surface."""
    with tempfile.TemporaryDirectory() as folder:
        source = workshop_reconstruction(Path(folder) / "reconstruction")
        return build_scene(source, ModelSettings(plane=WALL), no_progress)


def elevators_scene() -> Scene:
    """The lobby as ``make demo`` maps it: poses from the wheels, the plane found in the photos."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "reconstruction"
        settings = ReconstructSettings("odometry")
        reconstruct(ELEVATORS / "map", folder, settings, overwrite=False, progress=no_progress)
        return build_scene(load_reconstruction(folder), ModelSettings(), no_progress)


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


def repeated(scene: Scene, count: int) -> Scene:
    """A scene of ``count`` views: the photos again and again, each time a little elsewhere."""
    copies = part_of(scene, tuple(index % len(scene) for index in range(count)))
    poses = copies.world_from_camera.copy()
    poses[:, :3, 3] += np.random.default_rng(0).normal(0.0, 0.1, (count, 3))
    whole = replace(
        copies,
        image_names=tuple(f"{index:06d}.jpg" for index in range(count)),
        timestamps=np.arange(float(count)),
        world_from_camera=poses,
    )
    return identified(whole)


def with_wall_as_depth(scene: Scene) -> Scene:
    """The scene with depth maps: rendering them takes as long as if they had been computed."""
    maps: list[SceneDepth] = []
    for index, pose in enumerate(scene.world_from_camera):
        pinhole = scene.camera_of(index).intrinsics
        size = DEPTH_WIDTH, round(pinhole.height * DEPTH_WIDTH / pinhole.width)
        inverse = plane_inverse_depth(scene.plane, pose, pinhole.resized(*size))
        maps.append(as_stored(inverse.astype(np.float32), inverse > 0.0))
    return identified(replace(scene, depth=tuple(maps)))
