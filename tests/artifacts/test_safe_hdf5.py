"""HDF5 files of strangers: refused before they do harm; own files: read back as written."""

import json
import re
import time
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from pipelines.artifacts.errors import InputError
from pipelines.artifacts.kinds import kind_of
from pipelines.artifacts.safe_hdf5 import (
    check_schema,
    create_hdf5,
    open_hdf5,
    write_array,
    write_attribute,
    write_json,
    write_schema,
)

DECLARED_8_TB = (1_000_000, 1_000_000)


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    return tmp_path / "hostile.h5"


def sample_file(path: Path) -> Path:
    generator = np.random.default_rng(0)
    with create_hdf5(path, overwrite=False) as file:
        write_schema(file, "lfnav run", 1)
        write_attribute(file, "seed", 7)
        write_array(file, "particles", generator.normal(size=(100, 3)), compress=True)
        write_array(file, "frames/0000/image", generator.integers(0, 256, 500).astype(np.uint8))
        write_array(file, "frames/0000/nothing", np.empty((0, 4)))
        write_json(file, "settings", {"particles": 195, "names": ["a", None, "ü"]})
    return path


def read_everything(path: Path) -> list[Any]:
    with open_hdf5(path) as file:
        return [
            check_schema(file, "lfnav run", 1),
            file.attribute("seed", int),
            file.names(),
            file.names("frames/0000"),
            file.read_array("particles", dtype_kind="f", shape=(None, 3)).tobytes(),
            file.read_array("frames/0000/image", dtype_kind="u", shape=(None,)).tobytes(),
            file.read_array("frames/0000/nothing", dtype_kind="f", shape=(None, 4)).shape,
            file.read_json("settings"),
        ]


def read_values(path: Path, shape: tuple[int | None, ...] = (None,)) -> Any:
    with open_hdf5(path) as file:
        return file.read_array("values", dtype_kind="fiu", shape=shape)


def refused(path: Path, reason: str, read: Callable[[Path], Any] = read_values) -> None:
    """Reading fails with one line that names the file and the reason."""
    with pytest.raises(InputError, match=reason) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")


# --- round trips -------------------------------------------------------------------------------


@settings(deadline=None, max_examples=60)
@given(
    array=st.sampled_from(
        [np.float64, np.float32, np.int64, np.uint8, np.uint16, np.bool_]
    ).flatmap(
        lambda dtype: arrays(dtype, array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=5))
    ),
    compress=st.booleans(),
)
def test_arrays_come_back_as_they_were(
    tmp_path_factory: pytest.TempPathFactory, array: Any, compress: bool
) -> None:
    path = tmp_path_factory.mktemp("arrays") / "a.h5"
    values = np.asarray(array)
    with create_hdf5(path, overwrite=False) as file:
        write_array(file, "group/values", values, compress=compress)
    with open_hdf5(path) as opened:
        read = opened.read_array("group/values", dtype_kind=values.dtype.kind, shape=values.shape)
    assert read.dtype == values.dtype
    assert read.shape == values.shape
    assert read.tobytes() == values.tobytes()


@pytest.mark.parametrize("compress", [True, False])
@pytest.mark.parametrize("shape", [(700_001,), (5, 300_007), (200_003, 3), (3, 2, 150_001)])
def test_arrays_of_several_chunks_come_back(
    tmp_path: Path, shape: tuple[int, ...], compress: bool
) -> None:
    values = np.arange(np.prod(shape), dtype=np.int64).reshape(shape)
    with create_hdf5(tmp_path / "a.h5", overwrite=False) as file:
        write_array(file, "values", values, compress=compress)
        assert file["values"].id.get_num_chunks() > 1
    np.testing.assert_array_equal(read_values(tmp_path / "a.h5", (None,) * len(shape)), values)
    if not compress:
        assert (tmp_path / "a.h5").stat().st_size < 1.05 * values.nbytes


def test_big_endian_arrays_come_back_native(tmp_path: Path) -> None:
    with create_hdf5(tmp_path / "a.h5", overwrite=False) as file:
        write_array(file, "values", np.arange(5, dtype=">f8"))
    read = read_values(tmp_path / "a.h5")
    assert read.dtype == np.dtype("=f8")
    np.testing.assert_array_equal(read, np.arange(5.0))


@settings(deadline=None, max_examples=25)
@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers(-(2**53), 2**53)
        | st.text(st.characters(codec="utf-8")),
        lambda inner: (
            st.lists(inner) | st.dictionaries(st.text(st.characters(codec="utf-8")), inner)
        ),
        max_leaves=20,
    )
)
def test_json_comes_back(tmp_path_factory: pytest.TempPathFactory, value: Any) -> None:
    path = tmp_path_factory.mktemp("json") / "a.h5"
    with create_hdf5(path, overwrite=False) as file:
        write_json(file, "value", value)
    with open_hdf5(path) as opened:
        assert opened.read_json("value") == value


@pytest.mark.parametrize("value", ["", "lfnav run", "Küche", 0, -5, 2.5, True, False])
def test_attributes_come_back(tmp_path: Path, value: str | int | float | bool) -> None:
    with create_hdf5(tmp_path / "a.h5", overwrite=False) as file:
        write_attribute(file.create_group("group"), "name", value)
    kind: Any = type(value)
    with open_hdf5(tmp_path / "a.h5") as opened:
        read = opened.attribute("name", kind, "group")
    assert read == value
    assert type(read) is type(value)


def test_the_same_content_gives_the_same_bytes(tmp_path: Path) -> None:
    first = sample_file(tmp_path / "first.h5").read_bytes()
    # HDF5's clock counts seconds.
    time.sleep(1.1)
    assert sample_file(tmp_path / "second.h5").read_bytes() == first


def test_names_and_has(tmp_path: Path) -> None:
    with open_hdf5(sample_file(tmp_path / "a.h5")) as file:
        assert file.names() == ["frames", "particles", "settings"]
        assert file.has("frames/0000/image")
        assert not file.has("frames/0001/image")
        assert not file.has("particles/below an array")
        with pytest.raises(InputError, match="particles is not a group"):
            file.names("particles")


def test_what_cannot_be_stored_is_refused_by_the_writer(tmp_path: Path) -> None:
    with create_hdf5(tmp_path / "a.h5", overwrite=False) as file:
        for value in (np.array(["text"]), np.array([1j]), np.array([None])):
            with pytest.raises(ValueError, match="not stored"):
                write_array(file, "values", value)
        with pytest.raises(ValueError, match="JSON"):
            write_json(file, "value", float("nan"))


def test_a_file_is_not_half_there_when_writing_fails(tmp_path: Path) -> None:
    def write() -> None:
        with create_hdf5(tmp_path / "a.h5", overwrite=False) as file:
            write_array(file, "values", np.zeros(5))
            raise RuntimeError

    with pytest.raises(RuntimeError):
        write()
    assert list(tmp_path.iterdir()) == []


# --- damaged -----------------------------------------------------------------------------------


def test_a_flipped_bit_anywhere_is_detected_or_without_effect(tmp_path: Path) -> None:
    path = sample_file(tmp_path / "a.h5")
    truth = read_everything(path)
    data = bytearray(path.read_bytes())
    damaged = tmp_path / "damaged.h5"
    detected = 0
    positions = range(0, len(data), 11)
    for position in positions:
        data[position] ^= 1 << (position % 8)
        damaged.write_bytes(data)
        try:
            # Unused bytes of the file may change without effect; wrong values must never appear.
            assert read_everything(damaged) == truth, position
        except InputError:
            detected += 1
        data[position] ^= 1 << (position % 8)
    assert detected > 0.5 * len(positions)


@pytest.mark.parametrize("compress", [True, False])
def test_a_flipped_bit_in_the_values_is_detected(tmp_path: Path, compress: bool) -> None:
    path = tmp_path / "a.h5"
    with create_hdf5(path, overwrite=False) as file:
        write_array(file, "values", np.random.default_rng(1).normal(size=1000), compress=compress)
        chunk = file["values"].id.get_chunk_info(0)
        place = chunk.byte_offset + chunk.size // 2
    data = bytearray(path.read_bytes())
    data[place] ^= 4
    path.write_bytes(data)
    refused(path, "is damaged at values")


@pytest.mark.parametrize("share", [0.999, 0.9, 0.5, 0.1, 0.02])
def test_a_truncated_file_is_refused(tmp_path: Path, share: float) -> None:
    path = sample_file(tmp_path / "a.h5")
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    refused(path, "damaged or truncated", read_everything)


@pytest.mark.parametrize("content", [b"", b"# a text\n", b"\x89PNG\r\n\x1a\n" + bytes(100)])
def test_what_is_not_hdf5_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.h5"
    path.write_bytes(content)
    refused(path, "is not an HDF5 file")


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    refused(tmp_path, "is not an HDF5 file")
    refused(tmp_path / "missing.h5", "no such file")


def test_json_that_is_none_is_refused(hostile: Path) -> None:
    for text in (b"{", b"NaN", b"\xff", b"[" * 100_000):
        with create_hdf5(hostile, overwrite=True) as file:
            write_array(file, "values", np.frombuffer(text, dtype=np.uint8))
        with open_hdf5(hostile) as opened, pytest.raises(InputError, match="is damaged at values"):
            opened.read_json("values")


# --- hostile -----------------------------------------------------------------------------------


def test_external_and_soft_links_are_not_followed(hostile: Path, tmp_path: Path) -> None:
    secret = sample_file(tmp_path / "secret.h5")
    with h5py.File(hostile, "w") as file:
        file["external"] = h5py.ExternalLink(str(secret), "/")
        file["soft"] = h5py.SoftLink("/external")
        file["values"] = h5py.SoftLink("/external/particles")
        file["dangling"] = h5py.SoftLink("/nowhere")
    refused(hostile, "values is a soft or external link", lambda p: read_values(p, (None, 3)))
    with open_hdf5(hostile) as opened:
        for name in ("external/particles", "soft/particles", "external", "soft", "dangling"):
            with pytest.raises(InputError, match="soft or external link"):
                opened.read_array(name, dtype_kind="f", shape=(None, 3))
            with pytest.raises(InputError, match="soft or external link"):
                opened.names(name)
            with pytest.raises(InputError, match="soft or external link"):
                opened.attribute("seed", int, name)


@pytest.mark.parametrize("name", ["../a", "a/../b", "./a", "a/" * 100])
def test_names_that_wander_are_refused(tmp_path: Path, name: str) -> None:
    with open_hdf5(sample_file(tmp_path / "a.h5")) as file, pytest.raises(InputError):
        file.read_array(name, dtype_kind="f", shape=(None,))


def test_external_storage_is_not_read(hostile: Path, tmp_path: Path) -> None:
    (tmp_path / "secret").write_bytes(b"password")
    with h5py.File(hostile, "w") as file:
        file.create_dataset("values", (8,), "u1", external=[(str(tmp_path / "secret"), 0, 8)])
    refused(hostile, "lies in another file")


def test_virtual_storage_is_not_read(hostile: Path, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["values"] = np.arange(8)
    layout = h5py.VirtualLayout((8,), "i8")
    layout[:] = h5py.VirtualSource(str(tmp_path / "secret.h5"), "values", (8,))
    with h5py.File(hostile, "w", libver="latest") as file:
        file.create_virtual_dataset("values", layout)
    refused(hostile, "lies in another file")


@pytest.mark.parametrize("options", [{"compression": "lzf"}, {"scaleoffset": 3}])
def test_unknown_filters_are_refused(hostile: Path, options: dict[str, Any]) -> None:
    with h5py.File(hostile, "w") as file:
        file.create_dataset("values", data=np.arange(100), **options)
    refused(hostile, "unknown filter")


@pytest.mark.parametrize("options", [{}, {"chunks": (10,)}, {"compression": "gzip"}])
def test_arrays_without_checksum_are_refused(hostile: Path, options: dict[str, Any]) -> None:
    with h5py.File(hostile, "w") as file:
        file.create_dataset("values", data=np.arange(100), **options)
    refused(hostile, "with a checksum")


def test_a_declared_array_of_8_terabytes_is_refused(hostile: Path) -> None:
    with h5py.File(hostile, "w") as file:
        file.create_dataset(
            "values", DECLARED_8_TB, "f8", chunks=(128, 1024), compression="gzip", fletcher32=True
        )
    assert hostile.stat().st_size < 10_000
    tracemalloc.start()
    refused(hostile, "declares 8000000000000 bytes", lambda p: read_values(p, (None, None)))
    assert tracemalloc.get_traced_memory()[1] < 10_000_000
    tracemalloc.stop()


def test_the_budget_holds_for_all_arrays_together(hostile: Path) -> None:
    with create_hdf5(hostile, overwrite=False) as file:
        for name in "abc":
            write_array(file, name, np.zeros(100))
    with open_hdf5(hostile, total_bytes=2000) as opened:
        for name in "ab":
            opened.read_array(name, dtype_kind="f", shape=(None,))
        with pytest.raises(InputError, match="c declares 800 bytes, more than the 400"):
            opened.read_array("c", dtype_kind="f", shape=(None,))
        with pytest.raises(InputError, match="more than the 100 "):
            opened.read_array("a", dtype_kind="f", shape=(None,), max_bytes=100)


def test_values_that_were_never_stored_are_not_read_as_zeros(hostile: Path) -> None:
    with h5py.File(hostile, "w") as file:
        file.create_dataset("values", (100,), "f8", chunks=(10,), fletcher32=True)
        file["values"][:50] = 1.0
    refused(hostile, "parts of it are missing")


def test_a_chunk_that_unfolds_to_more_than_it_may_is_refused(hostile: Path) -> None:
    bomb = zlib.compress(bytes(50_000_000), 9)
    with h5py.File(hostile, "w") as file:
        dataset = file.create_dataset(
            "values", (100_000,), "u1", chunks=(100_000,), compression="gzip", fletcher32=True
        )
        dataset.id.write_direct_chunk((0,), bomb + bytes(4))
    tracemalloc.start()
    refused(hostile, "a chunk has the wrong size")
    assert tracemalloc.get_traced_memory()[1] < 5_000_000
    tracemalloc.stop()


def test_a_chunk_that_skips_its_checksum_is_refused(hostile: Path) -> None:
    with h5py.File(hostile, "w") as file:
        dataset = file.create_dataset("values", (8,), "u1", chunks=(8,), fletcher32=True)
        dataset.id.write_direct_chunk((0,), bytes(8), filter_mask=1)
    refused(hostile, "a chunk has the wrong size")


def test_large_chunks_are_refused(hostile: Path) -> None:
    with h5py.File(hostile, "w") as file:
        file.create_dataset(
            "values", (10,), "f8", maxshape=(None,), chunks=(100_000_000,), fletcher32=True
        )
    refused(hostile, "chunks of 800000000 bytes")


def test_very_many_chunks_are_refused(hostile: Path) -> None:
    with h5py.File(hostile, "w") as file:
        file.create_dataset("values", (10_000_000,), "u1", chunks=(1,), fletcher32=True)
    refused(hostile, "10000000 chunks")


@pytest.mark.parametrize(
    ("shape", "dtype_kind", "reason"),
    [
        ((None, 4), "f", "has shape (100, 3) instead of (any, 4)"),
        ((None,), "f", "has shape (100, 3) instead of (any)"),
        ((), "f", "has shape (100, 3) instead of (1)"),
        ((100, 3), "iu", "has type float64, not of kind 'iu'"),
    ],
)
def test_another_shape_or_type_is_refused(
    tmp_path: Path, shape: tuple[int | None, ...], dtype_kind: str, reason: str
) -> None:
    with (
        open_hdf5(sample_file(tmp_path / "a.h5")) as file,
        pytest.raises(InputError, match=re.escape(reason)),
    ):
        file.read_array("particles", dtype_kind=dtype_kind, shape=shape)


def test_objects_strings_and_compounds_are_not_read(hostile: Path) -> None:
    with h5py.File(hostile, "w") as file:
        file["text"] = "text"
        file["strings"] = np.array([b"a", b"b"])
        file["compound"] = np.zeros(3, dtype=[("a", "f8"), ("b", "i4")])
        file["empty"] = h5py.Empty("f8")
        file["type"] = np.dtype("f8")
        file.create_dataset("variable", (2,), dtype=h5py.vlen_dtype("f8"))
    with open_hdf5(hostile) as opened:
        for name in ("text", "strings", "compound", "empty", "type", "variable"):
            with pytest.raises(InputError, match=name):
                opened.read_array(name, dtype_kind="fiubSOV", shape=(None,))


# --- attributes and schema ---------------------------------------------------------------------


def test_attributes_of_another_kind_are_refused(hostile: Path) -> None:
    with h5py.File(hostile, "w") as file:
        file.attrs["array"] = np.zeros(3)
        file.attrs["variable"] = "a string of variable length"
        file.attrs["number"] = 5
        file.attrs["invalid"] = np.bytes_(b"\xff\xfe")
    cases: list[tuple[str, Any]] = [
        ("array", float),
        ("variable", str),
        ("number", str),
        ("number", bool),
    ]
    with open_hdf5(hostile) as opened:
        for name, kind in cases:
            with pytest.raises(InputError, match=f"attribute {name} of / is not of type"):
                opened.attribute(name, kind)
        with pytest.raises(InputError, match="attribute missing of / is missing"):
            opened.attribute("missing", int)
        with pytest.raises(InputError, match="is damaged at attribute invalid"):
            opened.attribute("invalid", str)


@pytest.mark.parametrize(
    ("format_name", "version", "reason"),
    [
        ("lfnav run", 3, "was written by a newer lfnav (schema 3, this one reads up to 2); update"),
        ("lfnav run", 0, "schema version 0"),
        ("lfnav scene", 1, "is a file of format 'lfnav scene', not 'lfnav run'"),
    ],
)
def test_files_of_another_schema_are_refused(
    hostile: Path, format_name: str, version: int, reason: str
) -> None:
    with create_hdf5(hostile, overwrite=False) as file:
        write_schema(file, format_name, version)
    with open_hdf5(hostile) as opened, pytest.raises(InputError, match=re.escape(reason)):
        check_schema(opened, "lfnav run", 2)


def test_the_kind_of_a_path_is_found_from_its_content(tmp_path: Path) -> None:
    for format_name in ("lfnav scene", "lfnav run", "something else"):
        with create_hdf5(tmp_path / format_name, overwrite=False) as file:
            write_schema(file, format_name, 1)
    assert kind_of(tmp_path / "lfnav scene") == "scene"
    assert kind_of(tmp_path / "lfnav run") == "run"
    refused(tmp_path / "something else", "which lfnav does not know", kind_of)
    refused(tmp_path / "missing", "does not exist", kind_of)
    refused(tmp_path / ("x" * 300), "cannot be read", kind_of)
    assert kind_of(tmp_path) == "dataset"
    (tmp_path / "reconstruction.json").write_text(json.dumps({}))
    assert kind_of(tmp_path) == "reconstruction"
    assert kind_of(tmp_path / "reconstruction.json") == "dataset"
