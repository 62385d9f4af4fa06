"""Image retrieval: what finds the photos and the areas that show what an image shows."""

from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.safe_hdf5 import open_hdf5
from pipelines.dataset.images import encode_png
from pipelines.geometry.camera import Camera
from pipelines.geometry.trajectory import Trajectory, format_tum
from pipelines.lightfield.area_recognition import (
    AreaRecognition,
    Calibration,
    area_fits,
    learn_recognition,
)
from pipelines.lightfield.retrieval_file import (
    load_features,
    read_index,
    save_features,
    write_index,
)
from pipelines.lightfield.retrieval_index import (
    MATCHED_ANYWAY,
    MAX_BITS,
    RARITY,
    SIGMA_BITS,
    WORDS_LOOKED_UP,
    build_retrieval_index,
    describe,
    unit_vectors,
)
from pipelines.lightfield.visual_words import learn_vocabulary
from pipelines.lightfield.world_file import load_recognition, load_world
from tests.chain_samples import succeed
from tests.lightfield_samples import looking
from tests.reconstruct_samples import texture

CAMERA = Camera("SIMPLE_PINHOLE", 240, 180, (220.0, 119.5, 89.5))
# A robot's: wider, smaller, distorted.
OTHER_CAMERA = Camera("SIMPLE_RADIAL", 200, 150, (140.0, 99.5, 74.5, -0.1))
PHOTOS = 8


def descriptors(count: int, seed: int) -> ImageArray:
    """``(count, 128)`` of features that nothing showed."""
    values = np.random.default_rng(seed).exponential(16.0, (count, 128))
    return values.clip(0, 255).astype(np.uint8)


def wall(seed: int) -> ImageArray:
    """A painted wall, 480x720; one seed, one paint."""
    return texture(480, 720, seed)


def photo(paint: ImageArray, x: float, y: float, scale: float, turn: float = 0.0) -> ImageArray:
    """``(180, 240, 3)`` of a wall around a point, from nearer or farther, seen from aside."""
    corners = np.array([[-120, -90], [120, -90], [120, 90], [-120, 90]], dtype=np.float32)
    slanted = corners * scale * (1.0 + turn * corners[:, :1] / 240.0) + np.array([x, y])
    image_from_wall = cv2.getPerspectiveTransform(
        slanted.astype(np.float32), corners + np.array([120, 90], dtype=np.float32)
    )
    return np.asarray(cv2.warpPerspective(paint, image_from_wall, (240, 180)), dtype=np.uint8)


def area_photos(paint: ImageArray, area: int = 0) -> list[ImageArray]:
    """Photos along a wall, each sharing half of what it shows with the next."""
    # Of no two walls they are taken from the same places.
    first = 120.0 + 15.0 * (area % 3)
    return [photo(paint, first + 60.0 * step, 240.0, 0.9) for step in range(PHOTOS)]


def recognition_of(walls: list[ImageArray]) -> AreaRecognition:
    """Of areas in a row, each before a wall of its own."""
    features = [
        describe(image, CAMERA)
        for area, paint in enumerate(walls)
        for image in area_photos(paint, area)
    ]
    home = np.repeat(np.arange(len(walls)), PHOTOS)
    positions = np.array([[0.6 * number, 0.0, 1.0] for number in range(len(features))])
    alone = [np.array([area]) for area in range(len(walls))]
    parts = [
        lambda area=area: {
            number: features[number] for number in np.flatnonzero(home == area).tolist()
        }
        for area in range(len(walls))
    ]
    return learn_recognition(parts, positions, home, alone)


@pytest.fixture(scope="module")
def walls() -> list[ImageArray]:
    return [wall(seed) for seed in range(5)]


@pytest.fixture(scope="module")
def recognition(walls: list[ImageArray]) -> AreaRecognition:
    return recognition_of(walls)


# --- words and lists -----------------------------------------------------------------------------


def test_a_feature_belongs_to_the_nearest_centre_of_its_cell() -> None:
    sample = unit_vectors(descriptors(2000, 1))
    vocabulary = learn_vocabulary(sample, 5000, np.random.default_rng(0))
    words, signatures = vocabulary.quantise(sample[:200], 3)
    size = len(vocabulary.coarse)
    assert vocabulary.words == size**2
    for point, found, signs in zip(
        (sample[:200] - vocabulary.mean) @ vocabulary.projection, words, signatures, strict=True
    ):
        near = np.argsort(np.linalg.norm(vocabulary.coarse - point, axis=1))[:2]
        numbers = (size * near[:, None] + np.arange(size)).reshape(-1)
        centres = vocabulary.fine[near].reshape(-1, 64)
        order = np.argsort(np.linalg.norm(centres - point, axis=1))[:3]
        assert found.tolist() == numbers[order].tolist()
        for centre, sign in zip(centres[order], signs, strict=True):
            expected = "".join("1" if above else "0" for above in point > centre)
            assert sorted(expected) == sorted(f"{int(sign):064b}")


def test_scores_are_those_of_comparing_every_feature_with_every_other() -> None:
    features = {number: descriptors(40 + number, number) for number in range(12)}
    # Some photos show the same.
    features[7][:30] = features[3][:30]
    index = build_retrieval_index([lambda: features], 12, np.random.default_rng(0))
    query = np.concatenate([features[3][:20], descriptors(15, 99)])
    vocabulary = index.vocabulary
    words, signatures = vocabulary.quantise(unit_vectors(query), WORDS_LOOKED_UP)
    stored = {
        number: vocabulary.quantise(unit_vectors(found)) for number, found in features.items()
    }
    home = np.array([0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, -1])
    expected = np.zeros(12)
    for own_words, own_signatures in zip(words, signatures, strict=True):
        votes = np.zeros(12)
        for word, signature in zip(own_words, own_signatures, strict=True):
            for number, (other_words, other_signatures) in stored.items():
                for row in np.flatnonzero(other_words[:, 0] == word):
                    bits = bin(int(signature) ^ int(other_signatures[row, 0])).count("1")
                    if bits <= MAX_BITS and home[number] >= 0:
                        votes[number] = max(votes[number], np.exp(-((bits / SIGMA_BITS) ** 2)))
        areas = sum(votes[home == area].max() for area in range(4))
        expected += votes / (MATCHED_ANYWAY + areas) ** RARITY / len(query)
    scores = index.scores(unit_vectors(query), home)
    np.testing.assert_allclose(scores, expected, rtol=1e-4, atol=1e-9)
    kept = np.arange(12) != 3
    without = index.scores(unit_vectors(query), home, kept)
    np.testing.assert_allclose(without, index.scores(unit_vectors(query), np.where(kept, home, -1)))
    assert without[3] == 0.0
    assert int(np.argmax(scores)) in (3, 7)


def test_parts_are_taken_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    features = {number: descriptors(30, number) for number in range(6)}
    early, late = [{number: features[number] for number in part} for part in ((0, 2, 5), (1, 3))]
    together = build_retrieval_index([lambda: early | late], 6, np.random.default_rng(0))
    # And in steps of a few features.
    monkeypatch.setattr("pipelines.reconstruct.clustering.MAX_DISTANCES", 40)
    apart = build_retrieval_index([lambda: early, lambda: late], 6, np.random.default_rng(0))
    assert apart.count == 6
    for name in ("starts", "photos", "signatures"):
        np.testing.assert_array_equal(getattr(apart, name), getattr(together, name))
    assert 4 not in apart.photos


def test_a_map_without_features_finds_nothing() -> None:
    none = np.zeros((0, 128), dtype=np.uint8)
    recognition = learn_recognition(
        [lambda: {0: none, 1: none}],
        np.zeros((2, 3)),
        np.array([0, 1]),
        [np.array([0]), np.array([1])],
    )
    for query in (none, descriptors(20, 1)):
        found = recognition.recognise_features(query)
        assert found.areas.sum() + found.nothing == pytest.approx(1.0)
        assert found.areas[0] == found.areas[1]


# --- areas ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [0.7, 1.2])
@pytest.mark.parametrize("camera", [CAMERA, OTHER_CAMERA])
def test_the_area_is_found_from_between_photos(
    walls: list[ImageArray], recognition: AreaRecognition, scale: float, camera: Camera
) -> None:
    for area, paint in enumerate(walls):
        image = photo(paint, 210.0, 250.0, scale, 0.2)
        image = np.asarray(cv2.resize(image, (camera.width, camera.height)), dtype=np.uint8)
        found = recognition.recognise(image, camera)
        assert int(found.areas.argmax()) == area
        assert found.areas[area] > 0.8
        assert found.likely_areas().tolist() == [area]
        # At 210 of the wall, between the second photo and the third.
        assert int(found.photos[0]) - PHOTOS * area in (1, 2)
        assert np.all(np.diff(found.scores) <= 0.0)


def test_other_light_changes_little(walls: list[ImageArray], recognition: AreaRecognition) -> None:
    image = photo(walls[2], 330.0, 240.0, 0.9).astype(np.float64)
    ramp = np.linspace(0.25, 0.9, 240)[None, :, None]
    warm = image * ramp * np.array([1.0, 0.8, 0.5]) + 10.0
    found = recognition.recognise(np.rint(warm).clip(0, 255).astype(np.uint8), CAMERA)
    assert found.areas[2] > 0.8


def test_twins_share_the_probability_until_something_tells_them_apart(
    walls: list[ImageArray],
) -> None:
    twin = walls[1].copy()
    # A poster of their own at one end of the wall.
    twin[180:300, 400:520] = wall(77)[:120, :120]
    recognition = recognition_of([walls[0], walls[1], twin, walls[3]])
    alike = recognition.recognise(photo(walls[1], 150.0, 240.0, 0.8), CAMERA)
    assert set(alike.likely_areas().tolist()) == {1, 2}
    assert abs(alike.areas[1] - alike.areas[2]) < 0.2
    assert alike.areas[1] + alike.areas[2] > 0.6
    for area, paint in ((1, walls[1]), (2, twin)):
        told = recognition.recognise(photo(paint, 450.0, 240.0, 0.8), CAMERA)
        assert told.areas[area] > told.areas[3 - area] + 0.3


def test_what_no_area_shows_is_nothing(recognition: AreaRecognition) -> None:
    found = recognition.recognise(photo(wall(123), 300.0, 240.0, 0.9), CAMERA)
    assert found.nothing > 0.8


def test_an_image_that_shows_nothing_decides_nothing(recognition: AreaRecognition) -> None:
    grey = np.full((180, 240, 3), 128, dtype=np.uint8)
    found = recognition.recognise(grey, CAMERA)
    np.testing.assert_allclose(found.areas, found.nothing)


def test_what_is_masked_is_not_looked_at(
    walls: list[ImageArray], recognition: AreaRecognition
) -> None:
    image = photo(walls[0], 240.0, 240.0, 0.9)
    image[:, 120:] = photo(walls[1], 240.0, 240.0, 0.9)[:, 120:]
    for area, columns in ((0, slice(120, 240)), (1, slice(0, 120))):
        used = np.full((180, 240), 255, dtype=np.uint8)
        used[:, columns] = 0
        assert recognition.recognise(image, CAMERA, used).areas[area] > 0.8


def test_probabilities_follow_the_power_law() -> None:
    calibration = Calibration(exponent=2.0, nothing=0.1)
    areas, nothing = calibration.probabilities(np.array([0.1, 0.3, 0.0]))
    assert areas.sum() + nothing == pytest.approx(1.0)
    assert areas[0] == pytest.approx(nothing)
    assert areas[1] == pytest.approx(9.0 * nothing)


def test_an_area_fits_as_its_best_photo_does() -> None:
    scores = np.array([0.1, 0.5, 0.2, 0.9, 0.3])
    home = np.array([0, 0, 2, -1, 2])
    assert area_fits(scores, home, 3).tolist() == [0.5, 0.0, 0.3]


# --- worlds --------------------------------------------------------------------------------------


def test_a_world_knows_its_photos_again(walls: list[ImageArray], tmp_path: Path) -> None:
    data = tmp_path / "data"
    (data / "rgb").mkdir(parents=True)
    poses: list[FloatArray] = []
    for area in range(2):
        for step, image in enumerate(area_photos(walls[area], area)):
            name = f"rgb/{len(poses):02d}.png"
            (data / name).write_bytes(encode_png(image))
            place = [4.0 * area - 4.0 + 0.4 * step, 0.0, 1.0]
            poses.append(looking(place, [place[0], 2.0, 1.0]))
    names = [f"{number}.0 rgb/{number:02d}.png" for number in range(len(poses))]
    (data / "rgb.txt").write_text("\n".join(names), encoding="utf-8")
    times = np.arange(len(poses), dtype=np.float64)
    truth = format_tum(Trajectory(times, np.array(poses)))
    (data / "groundtruth.txt").write_text(truth, encoding="utf-8")
    camera = f'model = "{CAMERA.model}"\nwidth = {CAMERA.width}\nheight = {CAMERA.height}\n'
    camera += f"params = {list(CAMERA.params)}\n"
    (data / "camera.toml").write_text(camera, encoding="utf-8")
    given = ("--method", "poses", "--poses", data / "groundtruth.txt")
    succeed("reconstruct", data, "-o", tmp_path / "map", *given)
    (tmp_path / "areas.toml").write_text(
        "\n".join(
            f'[[area]]\nname = "{name}"\nxmin = {x}\nxmax = {x + 3.5}\nymin = -1\nymax = 1'
            for name, x in (("west", -4.2), ("east", -0.4))
        ),
        encoding="utf-8",
    )
    drawn = ("--areas", tmp_path / "areas.toml", "--plane", "0,1,0,-2")
    succeed("model", tmp_path / "map", "-o", tmp_path / "world", *drawn)
    world = load_world(tmp_path / "world")
    recognition = load_recognition(tmp_path / "world", world)
    for area in range(2):
        found = recognition.recognise(photo(walls[area], 240.0, 240.0, 0.8), CAMERA)
        assert int(found.areas.argmax()) == area
        assert found.areas[area] > 0.8
        assert world.home[found.photos[0]] == area


# --- files ---------------------------------------------------------------------------------------


def test_what_is_written_is_read_back(recognition: AreaRecognition, tmp_path: Path) -> None:
    path = tmp_path / "index.h5"
    with h5py.File(path, "w") as file:
        write_index(file, recognition.index, recognition.calibration)
    with open_hdf5(path) as stored:
        index, calibration = read_index(stored, len(recognition.home))
    assert calibration == recognition.calibration
    query = unit_vectors(descriptors(50, 5))
    home = recognition.home
    expected = recognition.index.scores(query, home)
    np.testing.assert_array_equal(index.scores(query, home), expected)


@pytest.mark.parametrize(
    ("name", "value"),
    [("starts", 10**6), ("photos", 10**3), ("calibration", np.nan)],
)
def test_an_index_that_contradicts_itself_is_refused(
    recognition: AreaRecognition, tmp_path: Path, name: str, value: float
) -> None:
    path = tmp_path / "index.h5"
    with h5py.File(path, "w") as file:
        write_index(file, recognition.index, recognition.calibration)
        stored = file[f"retrieval/{name}"][...]
        stored = stored.astype(np.uint32) if name == "photos" else stored
        stored[1] = value
        del file[f"retrieval/{name}"]
        file.create_dataset(f"retrieval/{name}", data=stored, chunks=True, fletcher32=True)
    with open_hdf5(path) as spoilt, pytest.raises(InputError, match=r"holds|lists"):
        read_index(spoilt, len(recognition.home))


def test_features_of_other_photos_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "features.h5"
    save_features(path, [descriptors(5, 1), descriptors(0, 1), descriptors(7, 2)])
    found = load_features(path, 3)
    assert [len(of_photo) for of_photo in found] == [5, 0, 7]
    np.testing.assert_array_equal(found[2], descriptors(7, 2))
    with pytest.raises(InputError):
        load_features(path, 2)
