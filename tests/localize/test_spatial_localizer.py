"""Six degrees of freedom: a camera held in the hand before the painted wall."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.pose import inverse, world_from_base_planar
from pipelines.lightfield.scene import Scene
from pipelines.localize.localizer import Localizer
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import Observer
from pipelines.localize.run import FrameRecord
from pipelines.localize.state_space import SPATIAL
from tests.lightfield_samples import looking
from tests.report_samples import CAMERA, MOUNT, photo_from
from tests.sequence_samples import BLACK, SCENE, TRUTH, content, mixture_settings, scene_of


def held_in_a_hand() -> FloatArray:
    """``(8, 4, 4)`` world_from_camera along the robot's way, but with all the wobble of a hand."""
    level = SPATIAL.states(world_from_base_planar(TRUTH) @ MOUNT)
    t = np.arange(len(TRUTH))
    wobble = np.stack(
        [
            0.03 * np.sin(2.0 * t),
            0.02 * np.sin(t),
            0.05 * np.cos(1.3 * t),
            0.06 * np.sin(1.1 * t),
            0.05 * np.cos(0.7 * t),
            0.04 * np.sin(2.0 * t),
        ],
        axis=1,
    )
    return SPATIAL.poses(SPATIAL.moved(level, wobble))


POSES = held_in_a_hand()
STATES = SPATIAL.states(POSES)
IMAGES = [photo_from(pose) for pose in POSES]
NEAR = {
    "start": tuple(float(value) for value in STATES[0] + [0.05, -0.05, 0.05, 0.03, 0.0, -0.03]),
    "start_position_sigma": 0.1,
    "start_heading_sigma": 0.07,
}


def follow(seed: int, *, has_odometry: bool, **changes: Any) -> list[FrameRecord]:
    chosen = mixture_settings(degrees_of_freedom=6, **changes)
    camera = Localizer(SCENE, CAMERA, np.eye(4), chosen, np.random.default_rng(seed))
    records = []
    for number, image in enumerate(IMAGES):
        motion = None
        if has_odometry and number > 0:
            motion = SPATIAL.states(inverse(POSES[number - 1]) @ POSES[number])
        records.append(camera.step(image, motion, float(number)))
    return records


def errors(record: FrameRecord, number: int, estimate: str) -> tuple[float, float]:
    """Metres and radians from the true pose."""
    difference = inverse(POSES[number]) @ SPATIAL.poses(record.estimates[estimate])
    cosine = (np.trace(difference[:3, :3]) - 1.0) / 2.0
    return float(np.linalg.norm(difference[:3, 3])), float(np.arccos(np.clip(cosine, -1.0, 1.0)))


@pytest.mark.parametrize("has_odometry", [True, False], ids=["visual odometry", "random walk"])
@pytest.mark.parametrize("seed", range(2))
def test_a_camera_in_the_hand_is_followed(seed: int, has_odometry: bool) -> None:
    records = follow(seed, has_odometry=has_odometry, **NEAR)
    assert {record.status for record in records} == {"tracking"}
    for number, record in enumerate(records):
        metres, radians = errors(record, number, "refined")
        # A hundredth of the distance to the wall.
        assert metres < 0.02
        assert radians < np.radians(0.5)
        metres, radians = errors(record, number, "mode")
        assert metres < 0.35
        assert radians < np.radians(12.0)
        assert record.particles.shape[1] == 6
        assert record.modes.shape[1] == 7
        assert record.covariance.shape == (6, 6)


def test_a_camera_is_found_around_the_recorded_views() -> None:
    records = follow(1, has_odometry=True)
    assert records[-1].status == "tracking"
    metres, radians = errors(records[-1], len(POSES) - 1, "refined")
    assert metres < 0.02
    assert radians < np.radians(0.5)


def test_a_camera_that_is_swept_about_is_found_in_every_image() -> None:
    # Five times as far from image to image as the random walk says.
    chosen = mixture_settings(degrees_of_freedom=6, particles=100, **NEAR)
    camera = Localizer(SCENE, CAMERA, np.eye(4), chosen, np.random.default_rng(1))
    for number in (0, 4, 0, 5, 1, 6, 2, 7, 3):
        record = camera.step(IMAGES[number])
        metres, radians = errors(record, number, "refined")
        assert metres < 0.03
        assert radians < np.radians(1.0)


@pytest.mark.parametrize("strategy", ["condensation", "coarse_to_fine"])
def test_the_other_strategies_do_six_degrees_of_freedom_too(strategy: str) -> None:
    records = follow(
        0, has_odometry=True, strategy=strategy, particles=250, estimate="mean", **NEAR
    )
    assert {record.status for record in records} == {"tracking"}
    for number, record in enumerate(records):
        metres, radians = errors(record, number, "mean")
        assert metres < 0.25
        assert radians < np.radians(9.0)


def test_a_covered_lens_is_blind_with_six_degrees_of_freedom_too() -> None:
    chosen = mixture_settings(degrees_of_freedom=6, **NEAR)
    camera = Localizer(SCENE, CAMERA, np.eye(4), chosen, np.random.default_rng(0))
    camera.step(IMAGES[0])
    spreads = []
    for _ in range(3):
        record = camera.step(BLACK)
        assert (record.status, record.confidence) == ("blind", 0.0)
        spreads.append(float(np.trace(record.covariance)))
    # A random walk spreads and spreads.
    assert spreads == sorted(spreads)


def test_the_seed_determines_everything_in_six_dimensions() -> None:
    runs = [
        [content(record) for record in follow(5, has_odometry=True, threads=threads, **NEAR)]
        for threads in (1, 2)
    ]
    assert runs[0] == runs[1]


def test_the_mount_stands_between_body_and_camera() -> None:
    # A drone: its camera sits on a mount, and the state is the drone's.
    chosen = mixture_settings(
        degrees_of_freedom=6,
        start=tuple(map(float, SPATIAL.states(POSES[0] @ inverse(MOUNT)))),
        start_position_sigma=0.05,
        start_heading_sigma=0.05,
    )
    drone = Localizer(SCENE, CAMERA, MOUNT, chosen, np.random.default_rng(0))
    record = drone.step(IMAGES[0])
    camera = SPATIAL.poses(record.estimates["refined"]) @ MOUNT
    assert np.linalg.norm(camera[:3, 3] - POSES[0][:3, 3]) < 0.02


# --- a car: 1.1 m from image to image, and no odometry -------------------------------------------


def facade(x: FloatArray, z: FloatArray) -> FloatArray:
    """RGB ``(..., 3)`` of a wall that nowhere repeats itself."""
    shades = [
        np.sin(1.3 * x + 0.7 * z) + np.sin(0.44 * x) + np.sin(2.9 * z + 0.011 * x**2),
        np.cos(0.9 * x - 1.7 * z) + np.sin(0.017 * x**2) + np.sin(0.43 * x + 2.3 * z),
        np.sin(2.1 * z - 1.9 * x) + np.cos(0.023 * x**2 + z) + np.sin(0.71 * x),
    ]
    return 128.0 + 40.0 * np.stack(shades, axis=-1)


def on_the_street(x: float, sway: float) -> FloatArray:
    """``(4, 4)`` of a camera at the windscreen that looks half forward, half at the houses."""
    return looking([x, -4.0 + 0.3 * sway, 1.0 + 0.05 * sway], [x + 4.0, 0.0, 1.0 + 0.1 * sway])


def street(spacing: float = 2.0) -> Scene:
    """A photo every few metres, over sixty metres."""
    poses = np.array([on_the_street(x, 0.0) for x in np.arange(0.0, 61.0, spacing)])
    images = [photo_from(pose, paint=facade) for pose in poses]
    return scene_of(images, poses, [-1.0, 65.0, -6.0, 0.0], mount=None)


def alone(seed: int, spacing: float, steps: Sequence[float]) -> tuple[int, int]:
    """How many images of a sequence with these steps (m) are tracked, and how many wrongly."""
    truth = [on_the_street(x, np.sin(x / 4.0)) for x in 3.3 + np.cumsum(steps)]
    chosen = mixture_settings(degrees_of_freedom=6, particles=100)
    car = Localizer(street(spacing), CAMERA, np.eye(4), chosen, np.random.default_rng(seed))
    followed, wrong = 0, 0
    for pose in truth:
        record = car.step(photo_from(pose, paint=facade))
        if record.status == "tracking":
            best = record.estimates.get("refined", record.estimates["mode"])
            followed += 1
            wrong += bool(np.linalg.norm(best[:3] - pose[:3, 3]) > 0.2)
    return followed, wrong


@pytest.mark.parametrize("seed", range(2))
def test_a_car_is_followed_by_its_images_alone(seed: int) -> None:
    # It drives, stands in front of a light for three images, and drives on at once.
    steps = [0.0] + [1.1] * 9 + [0.0] * 3 + [1.1] * 8
    followed, wrong = alone(seed, 2.0, steps)
    assert wrong == 0
    assert followed >= 0.9 * len(steps)


@pytest.mark.parametrize("seed", range(3))
def test_a_car_that_brakes_hard_is_found_again_or_not_at_all(seed: int) -> None:
    # Photos are farther apart than it drives, and from full speed it stands: another house,
    # metres away, fits more than half as well as this one does.
    steps = [0.0] + [1.1] * 6 + [2.6] * 2 + [0.0] * 3 + [2.5] * 3
    followed, wrong = alone(seed, 6.0, steps)
    assert wrong == 0
    assert followed >= 0.8 * len(steps)


def test_a_speed_that_goes_on_is_no_measurement() -> None:
    """The estimate is that of the image, wherever the speed so far would have led."""
    chosen = mixture_settings(degrees_of_freedom=6, **NEAR)
    model = MeasurementModel.of_scene(SCENE, np.eye(4), chosen)
    camera = Localizer(SCENE, CAMERA, np.eye(4), chosen, np.random.default_rng(0), model)
    observer = Observer(CAMERA, chosen.widths, None)
    for image in IMAGES[:4]:
        record = camera.step(image)
        observations = observer(image)
        widths = [width for width in chosen.widths if width >= chosen.fine_width]
        by_image = model.aligned(record.estimates["mode"], observations, widths)
        np.testing.assert_array_equal(record.estimates["refined"], by_image.state)
