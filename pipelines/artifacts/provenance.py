"""Provenance of a result: versions, settings, hashes of the inputs.

No clock and no host name: the same input gives the same bytes.
"""

import hashlib
import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from pipelines.artifacts.errors import InputError

# Distributions whose version can change a result.
LIBRARIES = (
    "numpy",
    "scipy",
    "h5py",
    "pillow",
    "pycolmap",
    "opencv-python-headless",
    "opencv-python",
)


def sha256_of_bytes(data: bytes) -> str:
    """The SHA-256 of ``data``, 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def sha256_of_file(path: Path) -> str:
    """The SHA-256 of a file's content, 64 hexadecimal digits.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror or error})") from error


def version_of(distribution: str) -> str | None:
    """The version of an installed distribution; None where it is not installed."""
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def provenance(
    stage: str, settings: Mapping[str, Any], inputs: Mapping[str, str]
) -> dict[str, Any]:
    """The record that a result carries.

    Args:
        stage: the command that made it.
        settings: its options, plain JSON types.
        inputs: name of an input -> its hash.

    Returns:
        Plain JSON types: lfnav, python, libraries (installed ones only), stage, settings, inputs.
    """
    versions = {name: version_of(name) for name in LIBRARIES}
    return {
        "stage": stage,
        "lfnav": version_of("lfnav") or "not installed",
        "python": platform.python_version(),
        "libraries": {name: version for name, version in versions.items() if version is not None},
        "settings": dict(settings),
        "inputs": dict(inputs),
    }
