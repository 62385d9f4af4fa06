"""The kind of thing that a path holds, by its content and not by its name."""

from pathlib import Path
from typing import Literal

from pipelines.artifacts.errors import InputError, quoted, reason_of
from pipelines.artifacts.safe_hdf5 import is_hdf5, open_hdf5

SCENE_FORMAT, RUN_FORMAT = "lfnav scene", "lfnav run"
RECONSTRUCTION_FILE = "reconstruction.json"

Kind = Literal["reconstruction", "scene", "run", "dataset"]


def kind_of(path: Path) -> Kind:
    """The kind of thing that a path holds.

    Returns:
        ``"reconstruction"`` for a folder with a ``reconstruction.json``, ``"scene"`` or ``"run"``
        for an HDF5 file of that format, ``"dataset"`` for anything else that exists.

    Raises:
        InputError: nothing is there, or an HDF5 file that lfnav did not make.
    """
    try:
        path.stat()
    except FileNotFoundError as error:
        raise InputError(path, "does not exist") from error
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be read ({reason_of(error)})") from error
    if path.is_dir():
        return "reconstruction" if (path / RECONSTRUCTION_FILE).is_file() else "dataset"
    if not is_hdf5(path):
        return "dataset"
    with open_hdf5(path) as file:
        found = file.attribute("format", str)
    if found == SCENE_FORMAT:
        return "scene"
    if found == RUN_FORMAT:
        return "run"
    raise InputError(path, f"is an HDF5 file of format {quoted(found)}, which lfnav does not know")
