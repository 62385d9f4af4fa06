"""Worlds that somebody else made, half made or spoilt: one line says what is wrong."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.json_fields import JsonFields
from pipelines.artifacts.safe_hdf5 import open_hdf5
from pipelines.lightfield.area_map import AreaMap
from pipelines.lightfield.stage import ModelSettings
from pipelines.lightfield.world_file import _world_of
from tests.chain_samples import succeed
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
