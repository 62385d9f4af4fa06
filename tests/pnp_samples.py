"""A map of a few photos of the workshop at their true poses, for tests of poses by features."""

from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import BoolArray
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.dataset import Dataset, load_dataset
from pipelines.geometry.interpolation import PAIRING_TOLERANCE
from pipelines.geometry.plane import Plane
from pipelines.lightfield.scene import PlaneEstimate, Scene
from pipelines.lightfield.scene_file import identifier_of
from pipelines.localize.landmarks import LandmarkSource
from pipelines.localize.pnp import MountedCamera, PnpLocalizer
from pipelines.localize.state_space import PLANAR, StateSpace

WORKSHOP = Path(__file__).parents[1] / "sample_data" / "workshop"
SEQUENCE: Dataset = load_dataset(WORKSHOP / "test")
# Photos of the map, and frames of the sequence that they show.
MAP_PHOTOS, FRAMES = (20, 24, 28), (6, 10)
# The wall with the tools; the shelves before it are wrong landmarks.
WALL = PlaneEstimate(Plane(np.array([0.0, -1.0, 0.0]), 0.0), 0.01, 0.002, "given", 1.0)


def workshop_scene() -> Scene:
    """A light field of three photos over the wall."""
    source = load_dataset(WORKSHOP / "map")
    assert source.camera is not None
    assert source.groundtruth is not None
    chosen = np.array(MAP_PHOTOS)
    nearest = source.groundtruth.nearest(source.timestamps[chosen], PAIRING_TOLERANCE)
    poses = source.groundtruth.poses[nearest]
    images = tuple(source.read_image_bytes(index) for index in MAP_PHOTOS)
    index = np.zeros(len(chosen), dtype=np.int64)
    return Scene(
        image_names=tuple(source.image_names[number] for number in MAP_PHOTOS),
        encoded_images=images,
        timestamps=source.timestamps[chosen],
        cameras=(source.camera,),
        camera_index=index,
        world_from_camera=poses,
        surface=WALL,
        base_from_camera=None,
        bounds=np.array([-4.0, 4.0, -5.0, 0.0]),
        scale_source="given poses",
        identifier=identifier_of(images, (source.camera,), index, poses, WALL, None),
    )


def workshop_finder(
    scene: Scene,
    space: StateSpace = PLANAR,
    threads: int = 2,
    height: float = 0.0,
    mask: BoolArray | None = None,
) -> PnpLocalizer:
    """Finds poses in the workshop; the camera's mount stands too low by ``height`` metres."""
    assert SEQUENCE.camera is not None
    assert SEQUENCE.base_from_camera is not None
    mount = SEQUENCE.base_from_camera.copy()
    mount[2, 3] -= height
    return PnpLocalizer(
        scene,
        LandmarkSource(scene, None),
        MountedCamera(SEQUENCE.camera, mount, mask),
        space,
        seed=3,
        threads=threads,
        progress=no_progress,
    )
