"""What finds areas, on disk: features of one area's photos, and the index of a world.

The features lie beside an area while a world is built. The index lies in ``world.h5``, under
``retrieval``: ``mean``, ``projection``, ``coarse`` and ``fine`` of the vocabulary, ``starts``,
``photos`` and ``signatures`` of the lists, and ``calibration``, exponent and fit of nothing.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from pipelines.artifacts.arrays import ImageArray
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.safe_hdf5 import (
    SafeFile,
    check_schema,
    create_hdf5,
    open_hdf5,
    write_array,
    write_schema,
)
from pipelines.lightfield.area_recognition import Calibration
from pipelines.lightfield.retrieval_index import RetrievalIndex
from pipelines.lightfield.visual_words import DIMENSIONS, MAX_CENTRES, MIN_CENTRES, Vocabulary

FEATURES_FORMAT = "lfnav features"
FEATURES_VERSION = 1
GROUP = "retrieval"
ARRAYS = (
    *("mean", "projection", "coarse", "fine"),
    *("starts", "photos", "signatures", "calibration"),
)


def save_features(path: Path, features: Sequence[ImageArray]) -> None:
    """Writes the descriptors ``(F, 128)`` of photos, in their order."""
    with create_hdf5(path, overwrite=True) as file:
        write_schema(file, FEATURES_FORMAT, FEATURES_VERSION)
        write_array(file, "counts", np.array([len(of_photo) for of_photo in features], np.int64))
        write_array(file, "descriptors", np.concatenate(features))


def load_features(path: Path, photos: int) -> list[ImageArray]:
    """Reads what ``save_features`` wrote, of so many photos.

    Raises:
        InputError: missing, damaged, or of other photos.
    """
    with open_hdf5(path) as file:
        check_schema(file, FEATURES_FORMAT, FEATURES_VERSION)
        counts = file.read_array("counts", dtype_kind="i", shape=(photos,))
        descriptors = file.read_array("descriptors", dtype_kind="u", shape=(None, 128))
    if np.any(counts < 0) or counts.sum() != len(descriptors):
        raise InputError(path, "holds features of no photo")
    return np.split(descriptors, np.cumsum(counts)[:-1])


def write_index(file: h5py.Group, index: RetrievalIndex, calibration: Calibration) -> None:
    """Writes the index into a world's file."""
    vocabulary = index.vocabulary
    numbers = np.array([calibration.exponent, calibration.nothing])
    arrays: tuple[NDArray[Any], ...] = (
        *(vocabulary.mean, vocabulary.projection, vocabulary.coarse, vocabulary.fine),
        *(index.starts, index.photos, index.signatures, numbers),
    )
    for name, array in zip(ARRAYS, arrays, strict=True):
        write_array(file, f"{GROUP}/{name}", array)


def has_index(file: SafeFile) -> bool:
    """Whether a world's file holds one; those of schema 1 do not."""
    return file.has(GROUP)


def index_bytes(file: SafeFile) -> int:
    """What the index takes in the file."""
    return sum(file.stored_bytes(f"{GROUP}/{name}") for name in ARRAYS)


def read_index(file: SafeFile, photos: int) -> tuple[RetrievalIndex, Calibration]:
    """Reads the index of so many photos from a world's file.

    Raises:
        InputError: damaged, or with contents that contradict each other.
    """

    def read(name: str, kind: str, *shape: int | None) -> NDArray[Any]:
        return file.read_array(f"{GROUP}/{name}", dtype_kind=kind, shape=shape)

    coarse = read("coarse", "f", None, DIMENSIONS)
    size = len(coarse)
    if not MIN_CENTRES <= size <= MAX_CENTRES:
        raise InputError(file.path, f"holds a vocabulary of {size} centres a level")
    vocabulary = Vocabulary(
        read("mean", "f", 128),
        read("projection", "f", 128, DIMENSIONS),
        coarse,
        read("fine", "f", size, size, DIMENSIONS),
    )
    centres = (vocabulary.mean, vocabulary.projection, vocabulary.coarse, vocabulary.fine)
    if not all(np.all(np.isfinite(numbers)) for numbers in centres):
        raise InputError(file.path, "holds a vocabulary that is not finite")
    starts = read("starts", "i", size * size + 1).astype(np.int64)
    owners = read("photos", "u", None)
    signatures = read("signatures", "u", len(owners))
    exponent, nothing = read("calibration", "f", 2).tolist()
    if starts[0] != 0 or starts[-1] != len(owners) or np.any(np.diff(starts) < 0):
        raise InputError(file.path, "holds lists of photos that begin before they end")
    if np.any(owners >= photos):
        raise InputError(file.path, "lists a photo that it does not hold")
    # Numbers of 64 bits without a sign and such with one have no integer type in common.
    if owners.dtype == np.uint64 or signatures.dtype != np.uint64:
        raise InputError(file.path, "holds an index of other types")
    if not (0.0 < exponent < 1e3 and 0.0 < nothing < 1e3):
        raise InputError(file.path, "holds an index that is weighed by no numbers")
    index = RetrievalIndex(vocabulary, starts, owners, signatures, photos)
    return index, Calibration(exponent, nothing)
