"""Images that do not show the map, and the map in another light: what a run states about them."""

from collections.abc import Callable

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.dataset.dataset import Dataset, load_dataset
from pipelines.geometry.pose import inverse, planar_state_of
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene
from pipelines.localize.localizer import Localizer
from pipelines.localize.run import FrameRecord
from pipelines.localize.settings import LocalizerSettings
from tests.chain_samples import ELEVATORS, map_elevators
from tests.report_samples import photo, smooth
from tests.sequence_samples import (
    TRUTH,
    localize_sequence,
    localizer,
    mixture_settings,
    position_error,
)

Change = Callable[[ImageArray, int], ImageArray]


def as_bytes(image: FloatArray) -> ImageArray:
    return np.clip(np.rint(image), 0.0, 255.0).astype(np.uint8)


def mirrored(image: ImageArray, number: int) -> ImageArray:
    return np.ascontiguousarray(image[:, ::-1])


def upside_down(image: ImageArray, number: int) -> ImageArray:
    return np.ascontiguousarray(image[::-1])


def negative(image: ImageArray, number: int) -> ImageArray:
    return np.asarray(255 - image, dtype=np.uint8)


def noise(image: ImageArray, number: int) -> ImageArray:
    generator = np.random.default_rng([3, number])
    return generator.integers(0, 256, image.shape).astype(np.uint8)


def blotches(image: ImageArray, number: int) -> ImageArray:
    """Noise in large squares: as much structure as a place has, but none of it known."""
    generator = np.random.default_rng([4, number // 4])
    height, width = image.shape[:2]
    squares = generator.integers(0, 256, (height // 6 + 1, width // 6 + 2, 3))
    fine = np.repeat(np.repeat(squares, 6, axis=0), 6, axis=1)
    return fine[:height, number % 4 : number % 4 + width].astype(np.uint8)


def ramp(image: ImageArray, number: int) -> ImageArray:
    rows, columns = np.indices(image.shape[:2])
    slope = 90.0 * columns / image.shape[1] + (60.0 + 5.0 * number) * rows / image.shape[0]
    return as_bytes(np.repeat(slope[..., None] + 40.0, 3, axis=2))


STRANGE = (mirrored, upside_down, negative, noise, blotches, ramp)


def stated(records: list[FrameRecord]) -> str:
    """Status by frame, for whoever reads the log."""
    return " ".join(f"{record.status}:{record.confidence:.2f}" for record in records)


@pytest.mark.parametrize("change", STRANGE)
def test_the_wall_is_not_found_in_images_of_something_else(change: Change) -> None:
    images = [change(photo(state), number) for number, state in enumerate(TRUTH)]
    confidences = []
    for seed in range(2):
        records = localize_sequence(localizer(mixture_settings(), seed), images=images)
        assert "tracking" not in {record.status for record in records}, stated(records)
        confidences += [record.confidence for record in records]
        # It says that it is lost, or still searching where one image fits some place.
        assert {record.status for record in records} <= {"lost", "global", "blind"}, stated(records)
        assert sum(record.status == "lost" for record in records) >= len(records) // 2
    # They are probabilities, of something that is never true.
    assert np.mean(confidences) < 0.1
    assert max(confidences) < 0.5


def test_another_painting_is_not_taken_for_this_one() -> None:
    def other(x: FloatArray, z: FloatArray) -> FloatArray:
        tiles = np.sign(np.sin(4.0 * x + 1.0) * np.cos(5.0 * z + 2.0 * np.sin(x)))
        return np.stack([128.0 + 80.0 * tiles, 128.0 - 50.0 * tiles, 90.0 + 40.0 * tiles], axis=-1)

    for paint in (other, smooth):
        images = [photo(state, paint=paint) for state in TRUTH]
        for seed in range(2):
            records = localize_sequence(localizer(mixture_settings(), seed), images=images)
            assert "tracking" not in {record.status for record in records}, stated(records)


@pytest.mark.parametrize("change", STRANGE)
def test_a_robot_that_was_followed_is_lost_when_images_show_something_else(
    change: Change,
) -> None:
    images = [photo(state) for state in TRUTH[:4]]
    images += [change(photo(state), number) for number, state in enumerate(TRUTH[4:])]
    for seed in range(2):
        records = localize_sequence(localizer(mixture_settings(), seed), images=images)
        assert records[3].status == "tracking", stated(records)
        # Odometry may carry it for an image or two, no longer.
        assert "tracking" not in {record.status for record in records[6:]}, stated(records)
        assert records[-1].confidence < 0.3, stated(records)


# --- the same place in another light -----------------------------------------------------------


def lit(image: ImageArray, number: int) -> ImageArray:
    """A lamp at the left, moving on a little from image to image, and a longer exposure."""
    rows, columns = np.indices(image.shape[:2])
    x, y = columns / image.shape[1] - 0.2, rows / image.shape[0] - 0.3 - 0.02 * number
    gain = 0.55 + 0.6 * np.exp(-2.0 * (x**2 + y**2))
    return as_bytes(image * gain[..., None] + 8.0)


def test_the_wall_is_found_in_another_light_as_in_its_own() -> None:
    images = [photo(state) for state in TRUTH]
    changed = [lit(image, number) for number, image in enumerate(images)]
    assert np.abs(np.array(changed).astype(float) - np.array(images)).mean() > 15.0
    for seed in range(2):
        plain = localize_sequence(localizer(mixture_settings(), seed), images=images)
        records = localize_sequence(localizer(mixture_settings(), seed), images=changed)
        found = [record.status for record in records].index("tracking")
        assert found <= 2, stated(records)
        assert {record.status for record in records[found:]} == {"tracking"}, stated(records)
        for record, own, truth in zip(records[found:], plain[found:], TRUTH[found:], strict=True):
            assert position_error(record, truth, "refined") < 0.04
            assert record.confidence > 0.8 * own.confidence


# --- the elevator lobby ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lobby(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return load_scene(map_elevators(tmp_path_factory.mktemp("lobby"), "--plane", "0,1,0,0"))


def lobby_drive(scene: Scene, change: Change | None, seed: int, count: int) -> list[FrameRecord]:
    """The first images of the test sequence, each of them changed."""
    source = ELEVATORS / "test" / "odometry.txt"
    dataset: Dataset = load_dataset(ELEVATORS / "test", odometry=source)
    assert dataset.camera is not None
    assert dataset.odometry is not None
    poses = dataset.odometry.poses[dataset.odometry.nearest(dataset.timestamps, 0.1)]
    robot = Localizer(
        scene,
        dataset.camera,
        dataset.body_from_camera,
        LocalizerSettings(threads=2),
        np.random.default_rng(seed),
    )
    records = []
    for number in range(count):
        image = dataset.read_image(number)
        motion = None
        if number > 0:
            motion = planar_state_of(inverse(poses[number - 1]) @ poses[number])
        records.append(robot.step(image if change is None else change(image, number), motion))
    return records


@pytest.mark.parametrize("change", STRANGE)
def test_the_lobby_is_not_found_in_images_of_something_else(change: Change, lobby: Scene) -> None:
    for seed in range(2):
        records = lobby_drive(lobby, change, seed, 8)
        assert "tracking" not in {record.status for record in records}, stated(records)
        assert max(record.confidence for record in records) < 0.5, stated(records)


def test_the_lobby_is_found_in_another_light_as_in_its_own(lobby: Scene) -> None:
    dataset = load_dataset(ELEVATORS / "test")
    assert dataset.groundtruth is not None
    truth = dataset.groundtruth.poses[dataset.groundtruth.nearest(dataset.timestamps, 0.1)]
    for seed in range(2):
        for change in (None, lit):
            records = lobby_drive(lobby, change, seed, 8)
            assert {record.status for record in records[2:]} == {"tracking"}, stated(records)
            for record, pose in zip(records[2:], truth[2:8], strict=True):
                error = record.estimates["refined"][:2] - pose[:2, 3]
                assert np.hypot(*error) < 0.08, stated(records)
