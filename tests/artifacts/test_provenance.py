"""Provenance: what a result was made from, without a clock."""

import hashlib
import json
import platform
from pathlib import Path

import numpy as np
import pytest

from pipelines.artifacts.errors import InputError
from pipelines.artifacts.provenance import (
    provenance,
    sha256_of_bytes,
    sha256_of_file,
    version_of,
)


def test_hashes_are_sha256(tmp_path: Path) -> None:
    # The test vector of FIPS 180-4 for "abc".
    known = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert sha256_of_bytes(b"abc") == known
    (tmp_path / "abc").write_bytes(b"abc")
    assert sha256_of_file(tmp_path / "abc") == known
    large = bytes(range(256)) * 10_000
    (tmp_path / "large").write_bytes(large)
    assert sha256_of_file(tmp_path / "large") == hashlib.sha256(large).hexdigest()


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="missing: cannot be read"):
        sha256_of_file(tmp_path / "missing")


def test_the_record_is_json_and_the_same_every_time() -> None:
    record = provenance("model", {"scale": 0.5}, {"a.png": "00"})
    assert json.loads(json.dumps(record)) == record
    assert record == provenance("model", {"scale": 0.5}, {"a.png": "00"})
    assert record["stage"] == "model"
    assert record["settings"] == {"scale": 0.5}
    assert record["inputs"] == {"a.png": "00"}
    assert record["python"] == platform.python_version()
    assert record["libraries"]["numpy"] == np.__version__
    assert all(version is not None for version in record["libraries"].values())


def test_a_distribution_that_is_not_installed_has_no_version() -> None:
    assert version_of("lfnav-does-not-exist") is None
