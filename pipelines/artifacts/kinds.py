"""The kind of thing that a path holds, by its content and not by its name."""

from pathlib import Path
from typing import Literal

from pipelines.artifacts.errors import InputError, quoted, reason_of
from pipelines.artifacts.safe_hdf5 import is_hdf5, open_hdf5

SCENE_FORMAT, RUN_FORMAT, WORLD_FORMAT = "lfnav scene", "lfnav run", "lfnav world"
RECONSTRUCTION_FILE = "reconstruction.json"
# A world is a folder with an index and, in this folder, a scene for each area.
WORLD_FILE, AREA_FOLDER = "world.h5", "areas"
# Of the folder beside a world in which finished areas are kept while it is built.
BUILDING_SUFFIX = ".areas-in-progress"
# Recordings of ROS: files, and folders with an index of this name and content.
BAG_SUFFIXES = (".bag", ".db3", ".mcap")
_DATA_SET_SUFFIXES = (".jpg", ".jpeg", ".png", ".txt")
ROSBAG2_METADATA, _ROSBAG2_KEY = "metadata.yaml", b"rosbag2_bagfile_information"

Kind = Literal["reconstruction", "world", "scene", "run", "bag", "dataset"]


def kind_of(path: Path) -> Kind:
    """The kind of thing that a path holds.

    Returns:
        ``"reconstruction"`` for a folder with a ``reconstruction.json``, ``"world"`` for one with a
        ``world.h5``, ``"scene"`` or ``"run"`` for an HDF5 file of that format, ``"bag"`` for a
        recording of ROS, ``"dataset"`` for anything else that exists.

    Raises:
        InputError: nothing is there, an HDF5 file that lfnav did not make, or a folder with the
            scenes of areas and no index.
    """
    try:
        path.stat()
    except FileNotFoundError as error:
        raise InputError(path, "does not exist") from error
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be read ({reason_of(error)})") from error
    if is_bag(path):
        return "bag"
    if path.is_dir():
        return _kind_of_folder(path)
    if not is_hdf5(path):
        return "dataset"
    with open_hdf5(path) as file:
        found = file.attribute("format", str)
    if found == SCENE_FORMAT:
        return "scene"
    if found == RUN_FORMAT:
        return "run"
    if found == WORLD_FORMAT:
        raise InputError(path, "is the index of a world", f"name its folder, {path.parent}")
    raise InputError(path, f"is an HDF5 file of format {quoted(found)}, which lfnav does not know")


def is_world(path: Path) -> bool:
    """Whether a path is the folder of a world; half a world is none."""
    return (path / WORLD_FILE).is_file()


def is_bag(path: Path) -> bool:
    """Whether a path is a recording of ROS: a file by its suffix, a folder by what it holds."""
    try:
        if not path.is_dir():
            return path.suffix in BAG_SUFFIXES and path.is_file()
        index = path / ROSBAG2_METADATA
        if index.is_file():
            with index.open("rb") as file:
                return _ROSBAG2_KEY in file.read(4096)
        # Nothing but parts of one: a data set with a bag beside its images stays a data set.
        children = list(path.iterdir())
        return any(child.suffix in BAG_SUFFIXES for child in children) and not any(
            child.is_dir() or child.suffix.lower() in _DATA_SET_SUFFIXES for child in children
        )
    except (OSError, ValueError):
        return False


def refuse_world(path: Path) -> None:
    """Says what to do with a world where one scene is needed.

    Raises:
        InputError: ``path`` is the folder of a world, or its index.
    """
    folder = path.parent if path.name == WORLD_FILE else path
    if (folder / WORLD_FILE).is_file():
        raise InputError(
            path,
            "is a world of areas, which this command does not take yet",
            f"name the scene of one area, {folder / AREA_FOLDER}/NAME.h5",
        )


def _kind_of_folder(path: Path) -> Kind:
    if (path / RECONSTRUCTION_FILE).is_file():
        return "reconstruction"
    if (path / WORLD_FILE).is_file():
        return "world"
    if any((path / AREA_FOLDER).glob("*.h5")):
        raise InputError(
            path,
            f"holds {AREA_FOLDER}/ and no {WORLD_FILE}: the world is not whole",
            "make it again with lfnav model --areas",
        )
    if path.name.endswith(BUILDING_SUFFIX):
        raise InputError(
            path, "is a world that is being built", "call the same lfnav model again to go on"
        )
    return "dataset"
