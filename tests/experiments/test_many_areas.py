"""A floor repeated: copies differ, each alike from wherever it is seen."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.geometry.camera import Intrinsics
from pipelines.lightfield.area_file import AreaFile, read_area_file
from tests.experiments.test_doorway import experiment
from tests.lightfield_samples import looking
from tests.world_samples import TWO_ROOMS, rooms_dataset

PINHOLE = Intrinsics(160, 120, 100.0, 100.0, 79.5, 59.5)
GREY = np.full((120, 160, 3), 150, dtype=np.uint8)


@pytest.fixture(scope="module")
def many_areas() -> Any:
    return experiment("many_areas")


@pytest.fixture
def drawn(tmp_path: Path) -> AreaFile:
    (tmp_path / "areas.toml").write_text(TWO_ROOMS, encoding="utf-8")
    return read_area_file(tmp_path / "areas.toml")


def red_poster(many_areas: Any, drawn: AreaFile) -> Any:
    """A copy with one red poster, at the west end of the western room."""
    picture = np.zeros((90, 100, 3), dtype=np.uint8)
    picture[..., 0] = 200
    # Seen from within, the west wall goes from south to north.
    poster = many_areas.Poster(
        0, np.array([-4.0, -0.5, 1.0]), np.array([0.0, 1.0, 0.0]), 0.9, picture
    )
    return many_areas.Copy((poster,), (np.eye(3), np.eye(3)), (1.0, 1.0))


def is_red(image: ImageArray) -> FloatArray:
    """``(K, 2)`` columns and rows of red pixels."""
    rows, columns = np.nonzero((image[..., 0] > 150) & (image[..., 1] < 50))
    return np.column_stack([columns, rows]).astype(np.float64)


def test_a_poster_is_where_it_hangs(many_areas: Any, drawn: AreaFile) -> None:
    copy = red_poster(many_areas, drawn)
    for place, towards in (([-2.0, 0.3, 1.0], [-4.0, 0.0, 1.2]), ([-3.0, -1.0, 1.3], [-4.0, 0, 1])):
        pose = looking(place, towards)
        image, share = many_areas.altered(GREY, PINHOLE, pose, drawn, copy)
        red = is_red(image)
        assert share == pytest.approx(len(red) / GREY[..., 0].size)
        middle = np.linalg.inv(pose) @ [-4.0, 0.0, 1.45, 1.0]
        corner = np.linalg.inv(pose) @ [-4.0, 0.5, 1.0, 1.0]
        for point in (middle, corner):
            pixel = PINHOLE.matrix() @ point[:3]
            assert np.linalg.norm(red - pixel[:2] / pixel[2], axis=1).min() < 2.0
        # No farther than its corners.
        ends = np.linalg.inv(pose) @ np.vstack([copy.posters[0].corners.T, np.ones(4)])
        ends = (PINHOLE.matrix() @ ends[:3])[:2] / (PINHOLE.matrix() @ ends[:3])[2]
        assert np.all(red >= ends.min(axis=1) - 1.0)
        assert np.all(red <= ends.max(axis=1) + 1.0)


def test_posters_are_seen_through_open_doors_only(many_areas: Any, drawn: AreaFile) -> None:
    copy = red_poster(many_areas, drawn)
    seen = {}
    for y in (0.0, 1.5):
        pose = looking([2.0, y, 1.4], [-4.0, 0.0, 1.4])
        image, _ = many_areas.altered(GREY, PINHOLE, pose, drawn, copy)
        seen[y] = len(is_red(image))
    # From aside the line to the poster meets the wall beside the door.
    assert seen[0.0] > 50
    assert seen[1.5] == 0


def test_copies_differ_and_are_made_alike_again(many_areas: Any, drawn: AreaFile) -> None:
    pose = looking([-2.0, 0.0, 1.0], [-4.0, 0.0, 1.2])
    images = [
        many_areas.altered(GREY, PINHOLE, pose, drawn, many_areas.make_copy(drawn, number))[0]
        for number in (0, 1, 1)
    ]
    assert not np.array_equal(images[0], images[1])
    np.testing.assert_array_equal(images[1], images[2])


def test_areas_of_copies_are_told_apart(many_areas: Any, tmp_path: Path) -> None:
    floor = tmp_path / "floor"
    rooms_dataset(floor / "map")
    places = [(-2.2, 0.3), (2.1, -0.4)]
    for name in many_areas.SEQUENCES:
        rooms_dataset(floor / name, places)
    (floor / "areas.toml").write_text(TWO_ROOMS, encoding="utf-8")
    arguments = [str(floor), "-o", str(tmp_path / "out"), "--floors", "2", "--photos", "80"]
    assert many_areas.main(arguments) == 0
    results = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    assert [row["areas"] for row in results] == [2, 4]
    assert [row["views"] for row in results] == [80, 160]
    assert (tmp_path / "out" / "table.md").read_text(encoding="utf-8").startswith("| areas |")
    assert (tmp_path / "out" / "cost.png").read_bytes().startswith(b"\x89PNG")
    # What was found is not looked for again.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(many_areas, "altered", None)
        assert many_areas.main(arguments) == 0
