"""Hashes of a run's inputs: a stored result belongs to their content, not to their paths."""

import hashlib
from pathlib import Path

from pipelines.artifacts.errors import InputError
from pipelines.artifacts.provenance import sha256_of_file
from pipelines.dataset.dataset import (
    CAMERA_FILE,
    GROUNDTRUTH_FILE,
    IMAGE_LIST,
    ODOMETRY_FILE,
    Dataset,
)
from pipelines.dataset.mask import MASK_FILE

# Packages whose code a run's result depends on.
PROGRAM = ("artifacts", "geometry", "dataset", "lightfield", "render", "localize")


def program_hash() -> str:
    """SHA-256 of the source code that a run's result depends on, comments included."""
    digest = hashlib.sha256()
    root = Path(__file__).parents[1]
    for path in sorted(path for name in PROGRAM for path in (root / name).rglob("*.py")):
        digest.update(f"{path.relative_to(root)} {sha256_of_file(path)}\n".encode())
    return digest.hexdigest()


def scene_hash(path: Path) -> str:
    """SHA-256 of a scene model."""
    return sha256_of_file(path)


def dataset_hash(dataset: Dataset) -> str:
    """SHA-256 of a data set without odometry: image list, camera, mask, ground truth, images."""
    digest = hashlib.sha256()
    for name in (IMAGE_LIST, CAMERA_FILE, MASK_FILE, GROUNDTRUTH_FILE, *dataset.image_names):
        if (dataset.root / name).is_file():
            digest.update(f"{name} {sha256_of_file(dataset.root / name)}\n".encode())
    return digest.hexdigest()


def odometry_hash(dataset: Path, odometry: Path | None) -> str:
    """SHA-256 of an odometry file.

    Args:
        dataset: folder of the data set.
        odometry: the file; None: the data set's own.
    """
    return sha256_of_file(odometry if odometry is not None else dataset / ODOMETRY_FILE)


def check_unchanged(path: Path, found: str, planned: str | None) -> None:
    """Refuses an input that is not the one that the sweep was planned with.

    Args:
        path: of the input.
        found: its hash now.
        planned: its hash when the sweep was planned.

    Raises:
        InputError: the hashes differ: the input has changed, or this machine has another one.
    """
    if found != planned:
        raise InputError(path, "is not what it was when the sweep began", "start the sweep again")
