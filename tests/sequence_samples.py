"""A robot that drives along the painted wall, for the tests of the particle filter."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.dataset.images import encode_png
from pipelines.geometry.pose import inverse, planar_state_of, world_from_base_planar, wrap_angle
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import identifier_of
from pipelines.localize.likelihood import likelihood_named
from pipelines.localize.localizer import Localizer
from pipelines.localize.run import FrameRecord
from pipelines.localize.settings import LocalizerSettings
from tests.report_samples import CAMERA, MOUNT, facing_wall, photo, wall_scene

SCENE = wall_scene()
# The robot drives along the wall, comes nearer, and turns to the right.
TRUTH = np.array([facing_wall(-1.0 + 0.2 * i, 1.8 - 0.05 * i, 0.3 - 0.06 * i) for i in range(8)])
START = (float(TRUTH[0, 0]), float(TRUTH[0, 1]), float(TRUTH[0, 2]))
BLACK = np.zeros((CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
SQUARED = likelihood_named("squared")
# The painting repeats itself along the wall after so many metres.
PERIOD = 2.0 * np.pi


def mixture_settings(**changes: Any) -> LocalizerSettings:
    """A search that is small enough for a test."""
    small: dict[str, Any] = {
        "particles": 60,
        "start_particles": 2000,
        "coarse_width": 12,
        "fine_width": 24,
        "refine_width": 48,
        "threads": 1,
    }
    return LocalizerSettings(**{**small, **changes})


def search_settings(**changes: Any) -> LocalizerSettings:
    """The same by numbers alone, with the paper's comparison."""
    plain = {"strategy": "coarse_to_fine", "estimate": "mode", "likelihood": SQUARED}
    return mixture_settings(**{**plain, **changes})


def paper_settings(**changes: Any) -> LocalizerSettings:
    """The paper's filter."""
    paper = {
        "strategy": "condensation",
        "resampling": "multinomial",
        "estimate": "max_weight",
        "likelihood": SQUARED,
    }
    return mixture_settings(**{**paper, **changes})


def localizer(chosen: LocalizerSettings, seed: int = 0, scene: Scene = SCENE) -> Localizer:
    """A localizer in front of the wall."""
    return Localizer(scene, CAMERA, MOUNT, chosen, np.random.default_rng(seed))


def increments(truth: FloatArray) -> list[FloatArray]:
    """The motion before each image; that before the first one is not used."""
    poses = world_from_base_planar(truth)
    return [np.zeros(3), *(planar_state_of(inverse(a) @ b) for a, b in pairwise(poses))]


def localize_sequence(
    robot: Localizer, truth: FloatArray = TRUTH, images: Sequence[ImageArray] | None = None
) -> list[FrameRecord]:
    """The records of a sequence with exact odometry; images other than the true ones on request."""
    taken = [photo(state) for state in truth] if images is None else images
    return [
        robot.step(image, motion, float(number), f"{number}.png")
        for number, (image, motion) in enumerate(zip(taken, increments(truth), strict=True))
    ]


def content(record: FrameRecord) -> list[object]:
    """Everything in a record but the time that it took, as bytes where it is an array."""
    arrays = (record.particles, record.log_weights, record.modes, record.covariance)
    numbers = (record.timestamp, record.effective_sample_size, record.confidence)
    estimates = {name: state.tobytes() for name, state in record.estimates.items()}
    refined = None if record.refined_covariance is None else record.refined_covariance.tobytes()
    names = (record.image_name, record.status)
    return [*(array.tobytes() for array in arrays), numbers, names, estimates, refined]


def position_error(record: FrameRecord, truth: FloatArray, estimate: str = "mode") -> float:
    """Metres between an estimate and the truth."""
    return float(np.hypot(*(record.estimates[estimate] - truth)[:2]))


def heading_error(record: FrameRecord, truth: FloatArray, estimate: str = "mode") -> float:
    """Radians between an estimate and the truth."""
    return abs(float(wrap_angle(record.estimates[estimate][2] - truth[2])))


def scene_of(
    images: Sequence[ImageArray],
    poses: FloatArray,
    bounds: Sequence[float],
    mount: FloatArray | None = MOUNT,
) -> Scene:
    """The wall's plane and camera with other photos, taken at ``world_from_camera`` (N, 4, 4)."""
    encoded = tuple(encode_png(image) for image in images)
    index = np.zeros(len(encoded), dtype=np.int64)
    return replace(
        SCENE,
        image_names=tuple(f"{number}.png" for number in range(len(encoded))),
        encoded_images=encoded,
        timestamps=np.arange(float(len(encoded))),
        camera_index=index,
        world_from_camera=poses,
        base_from_camera=mount,
        bounds=np.array(bounds),
        identifier=identifier_of(encoded, SCENE.cameras, index, poses, SCENE.surface, mount),
    )


def periodic_scene() -> Scene:
    """The map now shows two periods of the painting, so that each view is there twice.

    Photos are taken a sixth of a period apart: what the map knows is there twice as well.
    """
    states = np.array([facing_wall(x, 2.0) for x in np.arange(-5.0, 8.0, PERIOD / 6.0)])
    images = [photo(state) for state in states]
    return scene_of(images, world_from_base_planar(states) @ MOUNT, [-5.0, 7.0, -3.0, 0.0])
