"""Chunks as they are unpacked here: what HDF5 itself reads, and nothing that it would refuse."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from pipelines.artifacts.errors import InputError
from pipelines.artifacts.hdf5_chunks import CHECKSUM_BYTES, fletcher32, read_chunks
from pipelines.artifacts.safe_hdf5 import open_hdf5, write_array


@pytest.mark.parametrize(
    "data",
    [
        bytes(8),
        b"\xff" * 8,
        b"\0\1\xff",
        b"\xff\xff",
        b"\7",
        np.random.default_rng(0).bytes(70_001),
        b"\xff" * 200_000,
    ],
)
def test_checksums_are_those_of_hdf5(tmp_path: Path, data: bytes) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        values = np.frombuffer(data, dtype=np.uint8)
        dataset = file.create_dataset("values", data=values, chunks=(len(data),), fletcher32=True)
        _, stored = dataset.id.read_direct_chunk((0,))
    assert stored[:-CHECKSUM_BYTES] == data
    assert fletcher32(data) == int.from_bytes(stored[-CHECKSUM_BYTES:], "little")


@pytest.mark.parametrize("dtype", ["u1", "<u2", ">u2", "<f4", ">f8", "bool"])
@pytest.mark.parametrize("filters", [("fletcher32",), ("shuffle", "deflate", "fletcher32")])
def test_arrays_are_those_that_hdf5_reads(
    tmp_path: Path, dtype: str, filters: tuple[str, ...]
) -> None:
    values: NDArray[np.uint8] = np.random.default_rng(0).integers(0, 2, (23, 31), np.uint8)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        dataset = file.create_dataset(
            "values",
            data=(values * 200).astype(dtype),
            chunks=(10, 7),
            shuffle="shuffle" in filters,
            compression="gzip" if "deflate" in filters else None,
            fletcher32=True,
        )
        found, expected = read_chunks(dataset, filters), dataset[()]
    assert found.dtype == expected.dtype
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("compress", [False, True])
def test_a_flipped_bit_is_found(tmp_path: Path, compress: bool) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        write_array(file, "values", np.arange(1000), compress=compress)
        dataset = file["values"]
        _, stored = dataset.id.read_direct_chunk((0,))
        place = dataset.id.get_chunk_info(0).byte_offset + len(stored) // 2
    content = bytearray(path.read_bytes())
    content[place] ^= 4
    path.write_bytes(content)
    with open_hdf5(path) as opened, pytest.raises(InputError, match="is damaged at values"):
        opened.read_array("values", dtype_kind="i", shape=(None,))


def test_numbers_that_numpy_has_not_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    twelve_bits = h5py.h5t.STD_U16LE.copy()
    twelve_bits.set_precision(12)
    with h5py.File(path, "w") as file:
        properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        properties.set_chunk((10,))
        properties.set_fletcher32()
        space = h5py.h5s.create_simple((10,))
        own = h5py.h5d.create(file.id, b"values", twelve_bits, space, properties)
        own.write(h5py.h5s.ALL, h5py.h5s.ALL, np.arange(10, dtype=np.uint16))
    with open_hdf5(path) as opened, pytest.raises(InputError, match="by its type"):
        opened.read_array("values", dtype_kind="u", shape=(None,))
