"""Worlds that somebody else made, half made or spoilt: one line says what is wrong."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from pipelines.artifacts.errors import InputError, LfnavError, OptionError
from pipelines.artifacts.json_fields import JsonFields
from pipelines.artifacts.safe_hdf5 import open_hdf5
from pipelines.lightfield.area_map import AreaMap
from pipelines.lightfield.open_world import open_world
from pipelines.lightfield.stage import ModelSettings
from pipelines.lightfield.world import AreaSettings, model_world
from pipelines.lightfield.world_file import _world_of
from pipelines.render import area_renderers
from tests.chain_samples import lfnav, succeed
from tests.world_samples import FLOOR, TWO_ROOMS, rooms_reconstruction

EAST = "areas/east.h5"
PLACES = [(x, 0.0) for x in (-1.0, -0.6, -0.2, 0.2, 0.6, 1.0)]
FLAT = ModelSettings(plane=(0.0, 0.0, 1.0, 0.0))
Spoil = Callable[[Path], Path]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small world, ``world``, and what it was made from."""
    folder = tmp_path_factory.mktemp("made")
    rooms_reconstruction(folder, PLACES)
    (folder / "areas.toml").write_text(TWO_ROOMS, encoding="utf-8")
    options = ("--areas", folder / "areas.toml", "--plane", FLOOR)
    succeed("model", folder / "map", "-o", folder / "world", *options)
    return folder


@pytest.fixture
def world(made: Path, tmp_path: Path) -> Path:
    """A copy that a test may spoil."""
    shutil.copytree(made / "world", tmp_path / "world")
    return tmp_path / "world"


def described(file: Path, name: str, change: Callable[[dict[str, Any]], object]) -> None:
    """Changes the JSON in a file, checksum and all."""
    with h5py.File(file, "r+") as opened:
        description = json.loads(opened[name][()].tobytes())
        change(description)
        del opened[name]
        data = np.frombuffer(json.dumps(description).encode(), dtype=np.uint8)
        opened.create_dataset(name, data=data, chunks=data.shape, fletcher32=True)


def changed(file: Path, name: str, change: Callable[[NDArray[Any]], NDArray[Any]]) -> None:
    """Changes an array in a file, checksum and all."""
    with h5py.File(file, "r+") as opened:
        data = change(opened[name][()])
        del opened[name]
        opened.create_dataset(name, data=data, chunks=data.shape, fletcher32=True)


def with_true_identifier(world: Path) -> None:
    """Writes the identifier that the index now has, as who makes one to do harm does."""
    path = world / "world.h5"
    with open_hdf5(path) as file:
        found = _world_of(file, JsonFields(path, file.read_json("world")))
    described(path, "world", lambda d: d.update(identifier=found.identifier))


def refused(told: str, named: Path, reason: str) -> None:
    assert told.startswith(f"lfnav: {named}: ")
    assert reason in told
    assert told.count("\n") == 1


# --- folders that are no whole world -------------------------------------------------------------


def without_index(world: Path) -> Path:
    (world / "world.h5").unlink()
    return world


def being_built(world: Path) -> Path:
    return Path(shutil.move(world / "areas", world.parent / "other.areas-in-progress"))


def index_alone(world: Path) -> Path:
    return world / "world.h5"


def some_folder(world: Path) -> Path:
    return world / "areas"


@pytest.mark.parametrize("command", ["render", "localize", "dock", "robot"])
@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (without_index, "the world is not whole; make it again with lfnav model --areas"),
        (being_built, "is a world that is being built; call the same lfnav model again to go on"),
        (index_alone, "is the index of a world; name its folder"),
        (some_folder, "is a folder without world.h5"),
    ],
)
def test_what_is_no_whole_world_is_named(
    made: Path, world: Path, spoil: Spoil, reason: str, command: str
) -> None:
    given, output = spoil(world), world.parent / "output"
    robot = f"model:{given if command == 'robot' else made / 'world'}"
    docked = ("dock", made / "world" if command == "robot" else given, "--dry-run")
    told = lfnav(
        *{
            "render": ("render", given, "--pose", "0.5,0,0", "-o", output),
            "localize": ("localize", given, made / "data", "-o", output),
            "dock": (*docked, "--robot", robot, "--goal", "0,0,0"),
            "robot": (*docked, "--robot", robot, "--goal", "0,0,0", "--true-start", "0,0,0"),
        }[command]
    )
    assert told.code == 1
    refused(told.err, given, reason)
    assert not output.exists()


def test_half_a_world_is_no_scene(world: Path) -> None:
    told = lfnav("evaluate", without_index(world), "--leave-one-out")
    assert told.code == 1
    refused(told.err, world, "the world is not whole")


def test_a_scene_may_be_called_as_an_index_is(world: Path, tmp_path: Path) -> None:
    scene = Path(shutil.copy(world / EAST, tmp_path / "world.h5"))
    assert json.loads(succeed("info", scene, "--json"))["views"] > 0


@pytest.mark.parametrize("target", ["/dev/zero", "east.h5", "/", "fifo", "/etc/hostname"])
def test_links_out_of_the_folder_are_read_as_scenes_alone(world: Path, target: str) -> None:
    path = world / EAST
    path.unlink()
    if target == "fifo":
        os.mkfifo(path)
    else:
        path.symlink_to(target)
    told = lfnav("info", world)
    assert told.code == 1
    refused(told.err, path, "is ")


# --- an index that was made to do harm -----------------------------------------------------------


def of_area(**fields: object) -> Callable[[Path], None]:
    return lambda world: described(
        world / "world.h5", "world", lambda d: d["areas"][0].update(fields)
    )


def of_index(name: str, change: Callable[[NDArray[Any]], NDArray[Any]]) -> Callable[[Path], None]:
    return lambda world: changed(world / "world.h5", name, change)


def far_away(poses: NDArray[Any]) -> NDArray[Any]:
    poses[0, 0, 3] = 1e300
    return poses


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (of_area(file_bytes=10**400), "areas[0].file_bytes is out of range"),
        (of_area(memory_bytes=-1), "areas[0].memory_bytes is out of range"),
        (of_area(name="x" * 10_000), "cannot be that of a file"),
        (of_area(name="a\nb"), "cannot be that of a file"),
        (of_area(neighbours=["y" * 10_000]), "names a neighbour that there is not"),
        (of_area(identifier="\n\x1b" * 5_000), "was changed after it was written"),
        (of_index("world_from_camera", far_away), "holds a pose more than 1e+08 m away"),
        (of_index("home", lambda home: 0 * home - 1), "holds no photo that is at home in an area"),
        (
            of_index("areas/0000/views", lambda v: v + 10**6),
            "names something that it does not hold",
        ),
    ],
)
def test_an_index_of_nonsense_is_refused(
    world: Path, spoil: Callable[[Path], None], reason: str
) -> None:
    spoil(world)
    told = lfnav("info", world)
    assert told.code == 1
    refused(told.err, world / "world.h5", reason)


@pytest.mark.parametrize("name", ["areas/0000/views", "links", "retrieval/photos"])
def test_an_index_that_declares_terabytes_is_refused(world: Path, name: str) -> None:
    path = world / "world.h5"
    with h5py.File(path, "r+") as file:
        shape, kind = (10**13, *file[name].shape[1:]), file[name].dtype
        del file[name]
        file.create_dataset(name, shape=shape, dtype=kind, chunks=True, fletcher32=True)
    with pytest.raises(InputError, match="more than the 1073741824 that are allowed"):
        open_world(world)


@pytest.mark.parametrize(
    ("name", "change", "reason"),
    [
        ("coarse", lambda a: a * np.nan, "a vocabulary that is not finite"),
        ("fine", lambda a: a + np.inf, "a vocabulary that is not finite"),
        ("coarse", lambda a: a[:1], "a vocabulary of 1 centres"),
        ("starts", lambda a: a[::-1].copy(), "that begin before they end"),
        ("photos", lambda a: a.astype(np.uint64), "an index of other types"),
        ("photos", lambda a: a + 99, "lists a photo that it does not hold"),
        ("calibration", lambda a: a * np.nan, "weighed by no numbers"),
    ],
)
def test_what_finds_areas_is_read_with_suspicion(
    world: Path, name: str, change: Callable[[NDArray[Any]], NDArray[Any]], reason: str
) -> None:
    changed(world / "world.h5", f"retrieval/{name}", change)
    with pytest.raises(InputError, match=reason):
        open_world(world)


def test_numbers_of_fewer_bits_are_the_same_world(made: Path, world: Path) -> None:
    for name in ("home", "links", "areas/0000/views", "areas/0001/views"):
        changed(world / "world.h5", name, lambda numbers: numbers.astype(np.int16))
    given, small = open_world(made / "world"), open_world(world)
    assert small.identifier == given.identifier
    np.testing.assert_array_equal(small.area_map.home, given.area_map.home)


# --- areas that are not what the index says ------------------------------------------------------


@pytest.mark.parametrize("most", [1e300, 1e7, 1e4])
def test_areas_as_large_as_countries_take_no_memory(world: Path, most: float) -> None:
    bounds = np.array([-most, most, -most, most])
    changed(world / EAST, "bounds", lambda _: bounds)
    with pytest.raises(InputError, match="too far apart, or too large, for one floor"):
        open_world(world)


def test_an_area_that_is_thin_and_endless_takes_no_memory(world: Path) -> None:
    changed(world / EAST, "bounds", lambda _: np.array([0.0, 0.5, 0.0, 1e9]))
    with pytest.raises(InputError, match="too large, for one floor"):
        open_world(world)


@pytest.mark.parametrize("name", ["image_names", "world_from_camera"])
def test_an_area_with_other_photos_is_refused(world: Path, tmp_path: Path, name: str) -> None:
    if name == "image_names":
        described(world / EAST, "scene", lambda d: d[name].append(d[name].pop(1)))
    else:
        changed(world / EAST, name, lambda poses: poses[[0, *range(2, len(poses)), 1]])
    told = lfnav("render", world, "--pose", "0.5,0,0", "-o", tmp_path / "view.png")
    assert told.code == 1
    refused(told.err, world / EAST, "holds other photos than the world's index says")
    assert list(tmp_path.iterdir()) == [world]


def test_areas_of_photos_that_are_at_home_elsewhere_are_a_world(world: Path) -> None:
    changed(world / "world.h5", "home", lambda home: 1 - home)
    with_true_identifier(world)
    opened = open_world(world)
    for area, held in enumerate(opened.index.areas):
        at_home = np.flatnonzero(opened.held & (opened.index.home == area))
        assert set(at_home.tolist()) <= set(held.views.tolist())


def test_a_light_field_is_of_the_photos_that_areas_hold(made: Path, tmp_path: Path) -> None:
    settings = ModelSettings(plane=FLAT.plane, max_views=6)
    areas = AreaSettings(file=made / "areas.toml")
    model_world(made / "map", tmp_path / "few", areas, settings)
    few = open_world(tmp_path / "few")
    assert 0 < np.count_nonzero(few.held) < np.count_nonzero(few.index.home >= 0)
    photos = np.flatnonzero(few.held).tolist()
    names = few.light_field(photos).image_names
    assert sorted(names) == sorted(few.index.image_names[photo] for photo in photos)
    left_out = np.flatnonzero(~few.held)
    with pytest.raises(LfnavError, match=r"holds other photos|holds fewer views"):
        few.light_field(left_out.tolist())


def test_pictures_of_an_area_that_is_too_large_say_what_to_do(
    world: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(area_renderers, "AT_ONCE_MEGABYTES", 150.0)
    told = lfnav("render", world, "--pose", "0.5,0,0", "-o", tmp_path / "view.png")
    assert told.code == 1
    assert "and pictures of a world at most 150; make the world with a smaller" in told.err
    assert told.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == [world]


@pytest.mark.parametrize("memory", [0.0, -1.0, float("nan"), float("inf")])
def test_memory_is_a_number_of_megabytes(world: Path, memory: float) -> None:
    with pytest.raises(OptionError, match=r"--memory .* is not between 1 and"):
        open_world(world, memory)


# --- which place belongs to which area -----------------------------------------------------------


def test_places_beside_an_area_are_those_whose_nearest_photo_is_hardly_nearer() -> None:
    rng = np.random.default_rng(0)
    taken, home = rng.uniform(-5.0, 5.0, (60, 2)), rng.integers(0, 3, 60)
    areas = AreaMap(("a", "b", "none", "c"), taken, home + (home == 2))
    places = rng.normal(size=(40, 2))
    apart = np.linalg.norm(places[:, None] - taken, axis=2)
    borders = areas.borders(places, 0.5)
    for area in range(4):
        nearest = np.where(areas.home == area, apart, np.inf).min(axis=1)
        expected = nearest <= apart.min(axis=1) + 0.5
        np.testing.assert_array_equal(areas.beside(places, area, 0.5), expected)
        np.testing.assert_array_equal(borders[:, area], expected)


def test_a_place_is_in_an_area_however_far_away_it_is() -> None:
    areas = AreaMap(("west", "east"), np.array([[-1.0, 0.0], [1.0, 0.0]]), np.array([0, 1]))
    far = np.array([[-1e300, 0.0], [1e300, 0.0]])
    assert areas.areas_of(far).tolist() == [0, 1]
    assert areas.borders(far, 0.1).tolist() == [[True, False], [False, True]]
    with pytest.raises(OptionError, match=r"more than 1e.08 m away"):
        AreaMap(("west",), far, np.array([0, 0]))
