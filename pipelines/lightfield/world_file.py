"""A world on disk: a folder with ``world.h5``, its index, and a scene for each area.

Layout of ``world.h5``: ``world`` (JSON: names of the photos, areas, how they were divided,
provenance), ``timestamps``, ``world_from_camera`` and ``home`` of all N recorded photos, ``links``
and ``link_lengths`` between their positions, and for each area, in the order of the list,
``areas/0000/views``: which photos ``areas/NAME.h5`` holds. Since schema 2 also what finds the areas
of an image (``retrieval_file``). Readers pass over what they do not know, so that later versions
may add arrays under other names.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import InputError, OptionError, quoted
from pipelines.artifacts.json_fields import JsonFields
from pipelines.artifacts.kinds import AREA_FOLDER, WORLD_FILE, WORLD_FORMAT
from pipelines.artifacts.safe_hdf5 import (
    MAX_JSON_BYTES,
    SafeFile,
    check_schema,
    create_hdf5,
    open_hdf5,
    write_array,
    write_json,
    write_schema,
)
from pipelines.geometry.pose import are_rigid
from pipelines.lightfield.area_file import is_area_name
from pipelines.lightfield.area_map import FARTHEST
from pipelines.lightfield.area_recognition import AreaRecognition
from pipelines.lightfield.retrieval_file import has_index, index_bytes, read_index, write_index
from pipelines.lightfield.scene_file import scene_identifier

SCHEMA_VERSION = 2
# Names of 100,000 photos take about this.
MAX_INDEX_BYTES = 4 * MAX_JSON_BYTES
# No file is larger, bytes.
LARGEST_FILE = 2**60
REBUILD = "make the world again with lfnav model --areas"


@dataclass(frozen=True)
class WorldArea:
    """An area as the index knows it.

    Attributes:
        name: ``areas/NAME.h5`` is its scene.
        views: indices, ascending, of the photos that the scene holds, in the scene's order.
        rectangle: ``(4,)`` x_min, x_max, y_min, y_max, metres: where its own photos were taken.
        bounds: ``(4,)`` likewise: the scene's, where a robot can stand and see what it shows.
        neighbours: names of the areas to which a recorded path leads.
        identifier: the scene's.
        sha256: of the file.
        file_bytes: size of the file.
        memory_bytes: what ``lfnav localize`` holds of it in memory, by default.
    """

    name: str
    views: IntArray
    rectangle: FloatArray
    bounds: FloatArray
    neighbours: tuple[str, ...]
    identifier: str
    sha256: str
    file_bytes: int
    memory_bytes: int


@dataclass(frozen=True)
class World:
    """The index of a world.

    Attributes:
        image_names: N names of all photos that were recorded, also of those that no area holds.
        timestamps: ``(N,)`` seconds.
        world_from_camera: ``(N, 4, 4)``.
        home: ``(N,)`` number of the area in which each photo is at home; -1: none.
        links: ``(E, 2)`` photos between whose positions a recorded path leads.
        link_lengths: ``(E,)`` metres.
        areas: at least one.
        division: how it was divided: method and what it depended on; plain JSON types.
        provenance: versions, settings and hashes of the inputs; plain JSON types.
    """

    image_names: tuple[str, ...]
    timestamps: FloatArray
    world_from_camera: FloatArray
    home: IntArray
    links: IntArray
    link_lengths: FloatArray
    areas: tuple[WorldArea, ...]
    division: Mapping[str, Any]
    provenance: Mapping[str, Any]

    @property
    def identifier(self) -> str:
        """Hash of all that decides what the world looks like; names this build of it."""
        digest = hashlib.sha256()
        areas = [[a.name, a.identifier, a.views.tolist(), a.neighbours] for a in self.areas]
        digest.update(json.dumps([list(self.image_names), areas]).encode())
        for numbers in (self.timestamps, self.world_from_camera, self.link_lengths):
            digest.update(np.ascontiguousarray(numbers, dtype="<f8").tobytes())
        for indices in (self.home, self.links):
            digest.update(np.ascontiguousarray(indices, dtype="<i8").tobytes())
        return digest.hexdigest()


def area_path(world: Path, name: str) -> Path:
    """The scene of an area."""
    return world / AREA_FOLDER / f"{name}.h5"


def save_index(path: Path, world: World, recognition: AreaRecognition) -> None:
    """Writes ``world.h5``.

    Args:
        path: the file.
        world: what it holds.
        recognition: of its areas.

    Raises:
        InputError: the file exists or cannot be written.
    """
    rows = [
        {
            "name": area.name,
            "rectangle": area.rectangle.tolist(),
            "bounds": area.bounds.tolist(),
            "neighbours": list(area.neighbours),
            "identifier": area.identifier,
            "sha256": area.sha256,
            "file_bytes": area.file_bytes,
            "memory_bytes": area.memory_bytes,
        }
        for area in world.areas
    ]
    description = {
        "image_names": list(world.image_names),
        "areas": rows,
        "division": dict(world.division),
        "identifier": world.identifier,
        "provenance": dict(world.provenance),
    }
    with create_hdf5(path, overwrite=False) as file:
        write_schema(file, WORLD_FORMAT, SCHEMA_VERSION)
        write_json(file, "world", description)
        write_array(file, "timestamps", world.timestamps)
        write_array(file, "world_from_camera", world.world_from_camera)
        write_array(file, "home", world.home)
        write_array(file, "links", world.links)
        write_array(file, "link_lengths", world.link_lengths)
        for number, area in enumerate(world.areas):
            write_array(file, f"areas/{number:04d}/views", area.views)
        write_index(file, recognition.index, recognition.calibration)


def load_world(path: Path) -> World:
    """Reads the index of a world and makes sure that its areas are there.

    Of the areas' files it is checked that they are of this build; what they hold is checked when
    they are opened as scenes.

    Args:
        path: the folder.

    Raises:
        InputError: missing, half built, damaged, of a newer schema, with contents that contradict
            each other, or with an area whose file is missing or of another build.
    """
    index = path / WORLD_FILE
    with open_hdf5(index) as file:
        check_schema(file, WORLD_FORMAT, SCHEMA_VERSION)
        fields = JsonFields(index, file.read_json("world", MAX_INDEX_BYTES))
        try:
            world = _world_of(file, fields)
        except OptionError as error:
            raise InputError(index, str(error)) from error
    if world.identifier != fields.get("identifier", str):
        raise InputError(index, "was changed after it was written", REBUILD)
    for area in world.areas:
        _check_area(area_path(path, area.name), area)
    return world


def load_recognition(path: Path, world: World) -> AreaRecognition:
    """Reads what finds the areas of an image; it takes some kilobytes a photo in memory.

    Args:
        path: the world's folder.
        world: its index.

    Raises:
        InputError: damaged, or made by a version that did not keep it.
    """
    index = path / WORLD_FILE
    with open_hdf5(index) as file:
        check_schema(file, WORLD_FORMAT, SCHEMA_VERSION)
        if not has_index(file):
            raise InputError(index, "does not hold what finds the area of an image", REBUILD)
        found, calibration = read_index(file, len(world.image_names))
    return AreaRecognition(found, world.home, len(world.areas), calibration)


def recognition_bytes(path: Path) -> int:
    """What it takes in the world's file; 0: there is none."""
    with open_hdf5(path / WORLD_FILE) as file:
        return index_bytes(file) if has_index(file) else 0


def _world_of(file: SafeFile, fields: JsonFields) -> World:
    names = tuple(_text(fields, name) for name in fields.get("image_names", list))
    count = len(names)
    rows = [
        JsonFields(fields.path, row, f"areas[{number}].")
        for number, row in enumerate(fields.get("areas", list))
    ]
    if count == 0 or not rows:
        raise InputError(fields.path, "holds no areas or no photos")
    areas = tuple(_area_of(file, row, number, count) for number, row in enumerate(rows))
    area_names = [area.name for area in areas]
    if len({name.casefold() for name in area_names}) != len(area_names):
        raise InputError(fields.path, "names an area twice")
    if any(not set(area.neighbours) <= set(area_names) - {area.name} for area in areas):
        raise InputError(fields.path, "names a neighbour that there is not")
    poses = file.read_array("world_from_camera", dtype_kind="f", shape=(count, 4, 4))
    if not np.all(are_rigid(poses)):
        raise InputError(fields.path, "holds a pose that is no rigid transform")
    if np.abs(poses[:, :3, 3]).max() > FARTHEST:
        raise InputError(fields.path, f"holds a pose more than {FARTHEST:g} m away")
    home = file.read_array("home", dtype_kind="i", shape=(count,)).astype(np.int64)
    links = file.read_array("links", dtype_kind="i", shape=(None, 2)).astype(np.int64)
    lengths = file.read_array("link_lengths", dtype_kind="f", shape=(len(links),))
    _check_range(fields.path, "home", home, -1, len(areas))
    if np.all(home < 0):
        raise InputError(fields.path, "holds no photo that is at home in an area")
    _check_range(fields.path, "links", links, 0, count)
    if not np.all(np.isfinite(lengths) & (lengths >= 0.0)):
        raise InputError(fields.path, "holds a path of a length that is none")
    return World(
        image_names=names,
        timestamps=file.read_array("timestamps", dtype_kind="f", shape=(count,)),
        world_from_camera=poses,
        home=home,
        links=links,
        link_lengths=lengths,
        areas=areas,
        division=fields.get("division", dict),
        provenance=fields.get("provenance", dict),
    )


def _area_of(file: SafeFile, row: JsonFields, number: int, photos: int) -> WorldArea:
    name = row.get("name", str)
    # The name becomes a path: here nothing may lead out of the folder.
    if not is_area_name(name):
        raise InputError(row.path, f"{row.prefix}name {quoted(name)} cannot be that of a file")
    stored = file.read_array(f"areas/{number:04d}/views", dtype_kind="i", shape=(None,))
    views = stored.astype(np.int64)
    _check_range(row.path, f"{row.prefix}views", views, 0, photos)
    if len(views) == 0 or np.any(np.diff(views) <= 0):
        raise InputError(row.path, f"{row.prefix}views are none, or not in order")
    return WorldArea(
        name=name,
        views=views,
        rectangle=_rectangle(row, "rectangle"),
        bounds=_rectangle(row, "bounds"),
        neighbours=tuple(_text(row, neighbour) for neighbour in row.get("neighbours", list)),
        identifier=row.get("identifier", str),
        sha256=row.get("sha256", str),
        file_bytes=_size(row, "file_bytes"),
        memory_bytes=_size(row, "memory_bytes"),
    )


def _size(row: JsonFields, key: str) -> int:
    value = row.get(key, int)
    if not 0 <= value <= LARGEST_FILE:
        raise InputError(row.path, f"{row.prefix}{key} is out of range")
    return value


def _rectangle(row: JsonFields, key: str) -> FloatArray:
    values = row.get(key, list)
    numbers = [JsonFields(row.path, {key: value}, row.prefix).number(key) for value in values]
    if len(numbers) != 4 or numbers[0] >= numbers[1] or numbers[2] >= numbers[3]:
        raise InputError(row.path, f"{row.prefix}{key} encloses no area")
    return np.array(numbers)


def _text(fields: JsonFields, value: object) -> str:
    if not isinstance(value, str):
        raise InputError(fields.path, f"{quoted(value)} is no name")
    return value


def _check_range(path: Path, name: str, numbers: IntArray, low: int, end: int) -> None:
    if np.any((numbers < low) | (numbers >= end)):
        raise InputError(path, f"{name} names something that it does not hold")


def _check_area(path: Path, area: WorldArea) -> None:
    """Whether the file is that of the area: there, and of this build."""
    if not path.is_file():
        raise InputError(path, "is missing: the world is not whole", REBUILD)
    if scene_identifier(path) != area.identifier:
        raise InputError(path, "belongs to another build of the world", REBUILD)
