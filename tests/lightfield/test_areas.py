"""Dividing: two made rooms, and the floor of eight rooms where its data is there."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import InputError, OptionError, StageError
from pipelines.dataset.dataset import load_dataset
from pipelines.geometry.camera import Camera
from pipelines.geometry.trajectory import read_tum
from pipelines.lightfield.area_file import AreaFile, Doorway, Rectangle, read_area_file
from pipelines.lightfield.areas import (
    OVERLAP_SHARE,
    divide_by_covisibility,
    divide_by_rectangles,
)
from pipelines.lightfield.covisibility import covisibility
from pipelines.lightfield.recorded_paths import recorded_paths
from pipelines.reconstruct.reconstruction import Reconstruction
from tests.lightfield_samples import looking
from tests.reconstruct_samples import SHARED
from tests.world_samples import CAMERA, DIRECTIONS, PLACES, room_places

FLOOR = SHARED / "floor"
floor_only = pytest.mark.skipif(not FLOOR.is_dir(), reason=f"needs the data in {FLOOR}")

WEST, EAST = (Rectangle("west", (-4.0, 0.0, -2.0, 2.0)), Rectangle("east", (0.0, 4.0, -2.0, 2.0)))
DOOR = Doorway(("west", "east"), 0.0, 0.0, 1.0)


def posed(poses: FloatArray, camera: Camera = CAMERA) -> Reconstruction:
    """A reconstruction of photos that nobody looks at."""
    count = len(poses)
    return Reconstruction(
        method="poses",
        image_root=Path("/nowhere"),
        image_names=tuple(f"{index:04d}.png" for index in range(count)),
        image_hashes=("0" * 64,) * count,
        timestamps=np.arange(count, dtype=np.float64),
        cameras=(camera,),
        camera_index=np.zeros(count, dtype=np.int64),
        world_from_camera=poses,
        points=np.empty((0, 3)),
        observations=np.empty((0, 2), dtype=np.int64),
        base_from_camera=None,
        scale_source="given poses",
        dropped={},
        statistics={},
    )


def standing(places: list[tuple[float, float]]) -> Reconstruction:
    """Four photos from each place."""
    return posed(
        np.array(
            [
                looking([x, y, 1.0], [x + dx, y + dy, 1.0])
                for x, y in places
                for dx, dy in DIRECTIONS
            ]
        )
    )


def x_of(source: Reconstruction, views: IntArray) -> FloatArray:
    return np.asarray(source.world_from_camera[views, 0, 3])


def test_rooms_are_found_as_areas() -> None:
    source = standing(PLACES)
    division = divide_by_covisibility(source, 160)
    assert len(division.areas) == 2
    west, east = division.areas
    assert np.all(x_of(source, west.own) < 1.0)
    assert np.all(x_of(source, east.own) > -1.0)
    assert division.neighbours == ((0, 1),)


def test_every_photo_is_at_home_once_and_areas_overlap_at_the_doorway() -> None:
    source = standing(PLACES)
    division = divide_by_covisibility(source, 90)
    own = np.concatenate([area.own for area in division.areas])
    assert sorted(own.tolist()) == list(range(len(source.image_names)))
    assert all(len(area.views) <= 90 for area in division.areas)
    both = divide_by_rectangles(source, AreaFile(Path("a"), (WEST, EAST), (DOOR,)))
    for area, other in zip(both.areas, reversed(both.areas), strict=True):
        assert len(area.overlap) > 0
        assert set(area.overlap) <= set(other.own)
        near = np.abs(x_of(source, area.overlap)).mean()
        assert near < np.abs(x_of(source, other.own)).mean() - 0.3


def test_overlap_is_what_shares_the_named_part_with_the_area() -> None:
    source = standing(PLACES)
    division = divide_by_rectangles(source, AreaFile(Path("a"), (WEST, EAST), (DOOR,)))
    weights = covisibility(
        source.world_from_camera,
        [CAMERA.intrinsics] * len(source.image_names),
        source.points,
        source.observations,
        division.paths,
    ).toarray()
    west = division.home == 0
    expected = [
        view
        for view in np.flatnonzero(~west)
        if weights[view, west].sum() / weights[view].sum() >= OVERLAP_SHARE
    ]
    assert division.areas[0].overlap.tolist() == expected
    np.testing.assert_allclose(weights, weights.T)


def test_paths_pass_doorways_and_no_walls() -> None:
    # Half a metre from the wall on both sides: near enough to be taken for a path through it.
    beside = [(x, y) for y in np.linspace(-1.0, 1.0, 5) for x in (-0.2, 0.2)]
    source = standing([*room_places(-2.0), *room_places(2.0), *PLACES[25:31], *beside])
    free = divide_by_rectangles(source, AreaFile(Path("a"), (WEST, EAST), ()))
    kept = divide_by_rectangles(source, AreaFile(Path("a"), (WEST, EAST), (DOOR,)))

    def crossings(links: IntArray) -> FloatArray:
        ends = source.world_from_camera[links, :2, 3]
        return np.asarray(ends[np.prod(ends[..., 0], axis=1) < 0.0].mean(axis=1)[:, 1])

    assert np.abs(crossings(free.paths.links)).max() > 0.9
    assert np.abs(crossings(kept.paths.links)).max() <= 0.5
    assert len(crossings(kept.paths.links)) > 0


def test_tracks_decide_where_there_are_some() -> None:
    # All stand in one row and look the same way; two groups see different points.
    poses = np.array([looking([0.1 * k, 0.0, 1.0], [0.1 * k, 1.0, 1.0]) for k in range(40)])
    group = np.arange(40) % 2
    observed = [
        (point, view) for view in range(40) for point in range(50) if point % 2 == group[view]
    ]
    source = replace(
        posed(poses),
        points=np.zeros((50, 3)),
        observations=np.array(observed),
        observed_pixels=np.zeros((len(observed), 2)),
    )
    weights = covisibility(
        poses, [CAMERA.intrinsics] * 40, source.points, source.observations, recorded_paths(poses)
    ).toarray()
    assert weights[0, 20] == pytest.approx(1.0)
    assert weights[0, 21] == 0.0
    division = divide_by_covisibility(source, 30)
    assert {tuple(np.unique(group[area.own])) for area in division.areas} == {(0,), (1,)}


def test_rectangles_that_overlap_share_the_photos_in_both() -> None:
    source = standing(PLACES)
    wide = (Rectangle("west", (-4.0, 0.6, -2.0, 2.0)), EAST)
    division = divide_by_rectangles(source, AreaFile(Path("a"), wide, ()))
    x, y = source.world_from_camera[:, 0, 3], source.world_from_camera[:, 1, 3]
    inside = np.flatnonzero((x <= 0.6) & (np.abs(y) <= 2.0))
    assert set(inside) <= set(division.areas[0].views)
    # 0.2 m into the east room, and 0.4 m from the wide rectangle's end.
    assert np.all(division.home[np.isclose(x, 0.2)] == 0)


def test_photos_far_from_all_rectangles_are_left_out() -> None:
    source = standing([*PLACES, (30.0, 0.0), (30.2, 0.0)])
    division = divide_by_rectangles(source, AreaFile(Path("a"), (WEST, EAST), (DOOR,)))
    assert np.count_nonzero(division.home < 0) == 8
    assert max(area.views.max() for area in division.areas) < len(source.image_names) - 8


@pytest.mark.parametrize(
    ("rectangles", "reason"),
    [
        ((WEST, EAST, Rectangle("north", (-4.0, 4.0, 5.0, 9.0))), "'north' holds no photo"),
        ((WEST, EAST, Rectangle("far", (29.0, 31.0, -1.0, 1.0))), "'far' overlaps no other"),
    ],
)
def test_areas_of_no_use_are_refused(rectangles: tuple[Rectangle, ...], reason: str) -> None:
    source = standing([*PLACES, (30.0, 0.0), (30.2, 0.0)])
    with pytest.raises(InputError, match=reason):
        divide_by_rectangles(source, AreaFile(Path("a"), rectangles, (DOOR,)))


def test_one_photo_is_no_area() -> None:
    source = posed(standing(PLACES).world_from_camera[:1])
    with pytest.raises(StageError, match="near each other"):
        divide_by_covisibility(source, 100)
    with pytest.raises(InputError, match="'west' holds 1 photo"):
        divide_by_rectangles(source, AreaFile(Path("a"), (WEST,), ()))
    with pytest.raises(OptionError, match="7 photos are no area"):
        divide_by_covisibility(source, 7)


def test_parts_of_a_map_that_no_path_joins_are_areas_of_their_own() -> None:
    source = standing([*room_places(-2.0), *room_places(12.0)])
    division = divide_by_covisibility(source, 1000)
    assert division.neighbours == ()
    assert [len(area.own) for area in division.areas] == [100, 100]


@pytest.fixture(scope="module")
def floor() -> Reconstruction:
    dataset = load_dataset(FLOOR / "map")
    assert dataset.camera is not None
    return posed(read_tum(FLOOR / "map/groundtruth.txt").poses, dataset.camera)


@floor_only
def test_the_floor_by_its_rectangles(floor: Reconstruction) -> None:
    drawn = read_area_file(FLOOR / "areas.toml")
    division = divide_by_rectangles(floor, drawn)
    stored = json.loads((FLOOR / "poses.json").read_text(encoding="utf-8"))["map"]
    for area, rectangle in zip(division.areas, drawn.rectangles, strict=True):
        x_min, x_max, y_min, y_max = rectangle.bounds
        inside = [x_min <= x <= x_max and y_min <= y <= y_max for x, y, *_ in stored]
        # Those in the doorways lie in no rectangle, if there are any.
        assert len(area.own) == pytest.approx(sum(inside), abs=2)
        assert len(area.overlap) > 0
    names = [area.name for area in division.areas]
    assert {frozenset((names[a], names[b])) for a, b in division.neighbours} == {
        frozenset(doorway.areas) for doorway in drawn.doorways
    }


@floor_only
def test_the_floor_by_covisibility(floor: Reconstruction) -> None:
    division = divide_by_covisibility(floor, 150)
    again = divide_by_covisibility(floor, 150)
    assert all(
        np.array_equal(a.views, b.views) for a, b in zip(division.areas, again.areas, strict=True)
    )
    assert all(len(area.views) <= 150 for area in division.areas)
    drawn = divide_by_rectangles(floor, read_area_file(FLOOR / "areas.toml"))
    agreeing = sum(int(np.bincount(drawn.home[area.own]).max()) for area in division.areas)
    # Rooms are what is found: nine of ten photos lie in the room that most of their area are in.
    assert agreeing / len(floor.image_names) > 0.9
    pairs = {
        frozenset((int(drawn.home[a]), int(drawn.home[b])))
        for a, b in division.paths.links.tolist()
        if drawn.home[a] != drawn.home[b]
    }
    assert pairs == {frozenset(pair) for pair in drawn.neighbours}
