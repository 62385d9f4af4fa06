"""HDF5 files: written with checksums, and read as if a stranger had made them to do harm.

A file of six kilobytes can declare an array of eight terabytes, link to any other file of the
machine, or unfold a gigabyte from a megabyte; and without checksums a flipped bit is read back
in silence. So the reader follows hard links only, one path component at a time, knows few storage
layouts and filters, and compares shape, type and size with what the caller expects before it
reads anything. The writer makes only files that this reader accepts, the same bytes for the same
content.
"""

import json
import math
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipelines.artifacts.atomic import atomic_file
from pipelines.artifacts.errors import InputError, quoted, reason_of
from pipelines.artifacts.hdf5_chunks import read_chunks

SIGNATURE = b"\x89HDF\r\n\x1a\n"
MAX_ARRAY_BYTES = 1024**3
MAX_TOTAL_BYTES = 16 * 1024**3
MAX_JSON_BYTES = 16 * 1024**2
MAX_ATTRIBUTE_BYTES = 64 * 1024
MAX_NAMES = 1_000_000
MAX_DIMENSIONS = 8
_WRITTEN_CHUNK_BYTES = 1024**2
_MAX_CHUNK_BYTES = 16 * 1024**2
_MAX_CHUNKS = 100_000
_MAX_PATH_COMPONENTS = 16
# In files of this version every block of metadata has a checksum too.
_LIBRARY_VERSION = ("v110", "v110")
_FILTER_NAMES = {
    h5py.h5z.FILTER_DEFLATE: "deflate",
    h5py.h5z.FILTER_SHUFFLE: "shuffle",
    h5py.h5z.FILTER_FLETCHER32: "fletcher32",
}
# What h5py and zlib raise over files that break the rules of the format.
_FORMAT_ERRORS = (
    OSError,
    KeyError,
    ValueError,
    TypeError,
    RuntimeError,
    OverflowError,
    zlib.error,
)

Value = TypeVar("Value", str, int, float, bool)


class SafeFile:
    """An HDF5 file open for reading; made by ``open_hdf5``.

    Names are paths from the root, components separated by ``/``. All methods raise ``InputError``
    that names the file and the object when something is missing, damaged, or not as expected.
    """

    def __init__(self, path: Path, file: h5py.File, total_bytes: int) -> None:
        self.path = path
        self._file = file
        self._bytes_left = total_bytes

    def has(self, name: str) -> bool:
        """Whether a hard link of this name exists."""
        try:
            self._object(name)
        except _MissingError:
            return False
        return True

    def names(self, group: str = "/") -> list[str]:
        """The names in a group, sorted."""
        found = self._object(group)
        if not isinstance(found, h5py.Group):
            raise InputError(self.path, f"{group} is not a group")
        try:
            if len(found) > MAX_NAMES:
                raise InputError(self.path, f"{group} holds more than {MAX_NAMES} names")
            return sorted(found)
        except _FORMAT_ERRORS as error:
            raise self._damaged(group, error) from error

    def attribute(self, name: str, kind: type[Value], group: str = "/") -> Value:
        """A scalar attribute of a group or dataset.

        Args:
            name: the attribute's name.
            kind: ``str``, ``int``, ``float`` or ``bool``; others than this are refused.
            group: the object that carries it.
        """
        found = self._object(group)
        label = f"attribute {name} of {group}"
        try:
            if not h5py.h5a.exists(found.id, name.encode()):
                raise InputError(self.path, f"{label} is missing")
            attribute = h5py.h5a.open(found.id, name.encode())
            expected = {str: "S", int: "iu", float: "f", bool: "b"}[kind]
            fits = attribute.dtype.kind in expected and attribute.shape == ()
            # A string of variable length has kind O: its size is not known before it is read.
            if not fits or attribute.dtype.itemsize > MAX_ATTRIBUTE_BYTES:
                raise InputError(self.path, f"{label} is not of type {kind.__name__}")
            buffer = np.empty((), dtype=attribute.dtype)
            attribute.read(buffer)
            value: Any = buffer[()]
            return kind(value.decode("utf-8") if isinstance(value, bytes) else value)
        except _FORMAT_ERRORS as error:
            raise self._damaged(label, error) from error

    def read_array(
        self,
        name: str,
        *,
        dtype_kind: str,
        shape: tuple[int | None, ...],
        max_bytes: int = MAX_ARRAY_BYTES,
    ) -> NDArray[Any]:
        """Reads a whole array.

        Args:
            name: path of the dataset.
            dtype_kind: NumPy's letters of the kinds that are accepted, such as ``"f"`` or ``"iu"``.
            shape: the expected shape; None where a length is free.
            max_bytes: what the array may take in memory.

        Returns:
            The array in native byte order, C-contiguous.
        """
        dataset = self._object(name)
        if not isinstance(dataset, h5py.Dataset):
            raise InputError(self.path, f"{name} is not an array")
        try:
            # A scalar is stored as one element, since HDF5 cannot add a checksum to it.
            self._check_declaration(name, dataset, dtype_kind, shape or (1,), max_bytes)
            filters = self._check_storage(name, dataset)
            array = np.empty(dataset.shape, dtype=dataset.dtype)
            if array.size > 0:
                array = read_chunks(dataset, filters)
        except _FORMAT_ERRORS as error:
            raise self._damaged(name, error) from error
        self._bytes_left -= array.nbytes
        native = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("="))
        return native if shape else native.reshape(())

    def stored_bytes(self, name: str) -> int:
        """What an array takes in the file: compressed, where it is, and with its checksums."""
        dataset = self._object(name)
        if not isinstance(dataset, h5py.Dataset):
            raise InputError(self.path, f"{name} is not an array")
        try:
            return int(dataset.id.get_storage_size())
        except _FORMAT_ERRORS as error:
            raise self._damaged(name, error) from error

    def read_json(self, name: str, max_bytes: int = MAX_JSON_BYTES) -> Any:
        """Reads a JSON value that ``write_json`` stored; NaN and infinity are refused."""
        data = self.read_array(name, dtype_kind="u", shape=(None,), max_bytes=max_bytes)
        try:
            return json.loads(data.tobytes(), parse_constant=_refuse_constant)
        except (ValueError, RecursionError) as error:
            raise self._damaged(name, error) from error

    def _object(self, name: str) -> Any:
        """The group or dataset of this name, reached over hard links alone."""
        components = [component for component in name.split("/") if component]
        if len(components) > _MAX_PATH_COMPONENTS or {".", ".."} & set(components):
            raise InputError(self.path, f"{quoted(name)} is not the name of an array")
        found: Any = self._file
        for component in components:
            try:
                if not isinstance(found, h5py.Group):
                    raise _MissingError(self.path, f"{name} is missing")
                link = found.get(component, getlink=True)
                if link is None:
                    raise _MissingError(self.path, f"{name} is missing")
                # Others lead out of the file or to places that were not checked.
                if type(link) is not h5py.HardLink:
                    raise InputError(
                        self.path, f"{name} is a soft or external link, which lfnav never follows"
                    )
                found = found[component]
            except _FORMAT_ERRORS as error:
                raise self._damaged(name, error) from error
        return found

    def _check_declaration(
        self,
        name: str,
        dataset: h5py.Dataset,
        dtype_kind: str,
        shape: tuple[int | None, ...],
        max_bytes: int,
    ) -> None:
        """Compares what the file declares with what is expected, before anything is allocated."""
        dtype, declared = dataset.dtype, dataset.shape
        if dtype.kind not in dtype_kind or dtype.kind not in "fiub" or dtype.itemsize > 8:
            raise InputError(self.path, f"{name} has type {dtype}, not of kind {dtype_kind!r}")
        fits = declared is not None and len(declared) == len(shape) <= MAX_DIMENSIONS
        if not fits or any(e not in (None, d) for d, e in zip(declared, shape, strict=True)):
            wanted = ", ".join("any" if length is None else str(length) for length in shape)
            raise InputError(self.path, f"{name} has shape {declared} instead of ({wanted})")
        # Python's integers do not overflow.
        size = dtype.itemsize * math.prod(int(length) for length in declared)
        if size > min(max_bytes, self._bytes_left):
            raise InputError(
                self.path,
                f"{name} declares {size} bytes, more than the "
                f"{min(max_bytes, self._bytes_left)} that are allowed",
            )

    def _check_storage(self, name: str, dataset: h5py.Dataset) -> list[str]:
        """The filters; refuses storage outside the file, unknown filters, many or large chunks."""
        properties = dataset.id.get_create_plist()
        layout = properties.get_layout()
        if properties.get_external_count() > 0 or layout == h5py.h5d.VIRTUAL:
            raise InputError(self.path, f"{name} lies in another file, which lfnav never reads")
        filters = []
        for index in range(properties.get_nfilters()):
            code = properties.get_filter(index)[0]
            if code not in _FILTER_NAMES:
                raise InputError(self.path, f"{name} uses the unknown filter {code}")
            filters.append(_FILTER_NAMES[code])
        if dataset.size == 0:
            return filters
        in_order = [f for f in ("shuffle", "deflate", "fletcher32") if f in filters]
        if layout != h5py.h5d.CHUNKED or filters != in_order or "fletcher32" not in filters:
            raise InputError(self.path, f"{name} is not stored as lfnav does, with a checksum")
        chunk_bytes = dataset.dtype.itemsize * math.prod(map(int, properties.get_chunk()))
        if chunk_bytes > _MAX_CHUNK_BYTES:
            raise InputError(self.path, f"{name} has chunks of {chunk_bytes} bytes, too large")
        count = math.prod(
            -(-length // step) for length, step in zip(dataset.shape, dataset.chunks, strict=True)
        )
        if count > _MAX_CHUNKS:
            raise InputError(self.path, f"{name} has {count} chunks, too many")
        # Others HDF5 would convert; there is no reason why any should be there.
        if not dataset.id.get_type().equal(h5py.h5t.py_create(dataset.dtype, logical=True)):
            raise InputError(self.path, f"{name} is not stored as lfnav does, by its type")
        return filters

    def _damaged(self, name: str, error: Exception | str) -> InputError:
        return InputError(self.path, f"is damaged at {name} ({reason_of(error)})")


class _MissingError(InputError):
    """An object is not in the file."""


@contextmanager
def open_hdf5(path: Path, total_bytes: int = MAX_TOTAL_BYTES) -> Iterator[SafeFile]:
    """Opens a file for reading.

    Args:
        path: the file.
        total_bytes: what all arrays read from it may take in memory together.

    Raises:
        InputError: missing, not HDF5, truncated.
    """
    if not is_hdf5(path):
        raise InputError(path, "is not an HDF5 file")
    try:
        # No lock: files are replaced whole, never changed, and may lie on a read-only medium.
        file = h5py.File(path, "r", locking=False)
    except _FORMAT_ERRORS as error:
        raise InputError(path, f"is damaged or truncated ({reason_of(error)})") from error
    try:
        yield SafeFile(path, file, total_bytes)
    finally:
        file.close()


def is_hdf5(path: Path) -> bool:
    """Whether a file begins as HDF5 files do.

    Raises:
        InputError: it does not exist or cannot be read.
    """
    try:
        if path.exists() and not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(SIGNATURE)) == SIGNATURE
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(path, f"cannot be read ({reason})") from error


def check_schema(file: SafeFile, expected_format: str, newest_version: int) -> int:
    """Checks what kind of file this is and whether this program can read its version.

    Returns:
        The file's schema version, from 1 to ``newest_version``.

    Raises:
        InputError: another kind of file, or a version that this program does not know.
    """
    found = file.attribute("format", str)
    if found != expected_format:
        raise InputError(file.path, f"is a file of format {quoted(found)}, not {expected_format!r}")
    version = file.attribute("schema_version", int)
    if version > newest_version:
        raise InputError(
            file.path,
            f"was written by a newer lfnav (schema {version}, this one reads up to "
            f"{newest_version})",
            "update lfnav",
        )
    if version < 1:
        raise InputError(file.path, f"has schema version {version}, which never existed")
    return version


@contextmanager
def create_hdf5(path: Path, overwrite: bool) -> Iterator[h5py.File]:
    """Yields an ``h5py.File`` to write to; ``path`` appears, whole, when the block ends well.

    Write to it (or to its groups) with ``write_schema``, ``write_array``, ``write_json`` and
    ``write_attribute``.

    Raises:
        InputError: ``path`` exists (without ``overwrite``) or cannot be written.
    """
    with (
        atomic_file(path, overwrite) as temporary,
        h5py.File(temporary, "w", libver=_LIBRARY_VERSION, locking=False) as file,
    ):
        yield file


def write_schema(file: h5py.Group, format_name: str, version: int) -> None:
    """Stores the format and the schema version, which ``check_schema`` checks."""
    write_attribute(file, "format", format_name)
    write_attribute(file, "schema_version", version)


def write_attribute(group: h5py.Group, name: str, value: str | int | float | bool) -> None:
    """Stores a scalar attribute. Strings get a fixed length, so that readers know their size."""
    if isinstance(value, str):
        data = value.encode("utf-8")
        if len(data) > MAX_ATTRIBUTE_BYTES or data.endswith(b"\0"):
            raise ValueError(f"attribute {name} is too long or ends with a zero byte")
        # HDF5 has no strings of length zero.
        stored: Any = np.array(data, dtype=f"S{max(1, len(data))}")
    elif isinstance(value, bool):
        stored = np.bool_(value)
    elif isinstance(value, int):
        stored = np.int64(value)
    else:
        stored = np.float64(value)
    group.attrs.create(name, stored)


def write_array(group: h5py.Group, name: str, array: ArrayLike, compress: bool = False) -> None:
    """Stores a numeric or boolean array, with checksums; groups in ``name`` are made.

    Args:
        group: the file or a group in it.
        name: path of the new dataset from there.
        array: any shape, zero-size and scalar ones too.
        compress: shuffle and gzip it; not for what is compressed already.
    """
    values = np.asarray(array)
    if values.dtype.kind not in "fiub" or values.dtype.itemsize > 8:
        raise ValueError(f"{name}: arrays of type {values.dtype} are not stored")
    values = np.atleast_1d(values)
    if values.size == 0:
        # No chunks: there is nothing to store or to check.
        group.create_dataset(name, shape=values.shape, dtype=values.dtype, track_times=False)
        return
    options = {"compression": "gzip", "compression_opts": 4, "shuffle": True} if compress else {}
    group.create_dataset(
        name,
        data=values,
        chunks=_chunk_shape(values.shape, values.dtype.itemsize),
        fletcher32=True,
        track_times=False,
        **options,
    )


def write_json(group: h5py.Group, name: str, value: Any) -> None:
    """Stores plain JSON types as UTF-8 bytes, with a checksum; NaN and infinity are refused."""
    text = json.dumps(value, allow_nan=False, sort_keys=True, separators=(",", ":"))
    write_array(group, name, np.frombuffer(text.encode("utf-8"), dtype=np.uint8))


def _chunk_shape(shape: tuple[int, ...], item_bytes: int) -> tuple[int, ...]:
    """Chunks of whole rows, up to about a megabyte."""
    left = _WRITTEN_CHUNK_BYTES // item_bytes
    chunk = []
    for length in reversed(shape):
        parts = -(-length // max(1, min(length, left)))
        # Equal parts: a chunk takes its whole size in the file even where it sticks out.
        chunk.append(-(-length // parts))
        left //= chunk[-1]
    return tuple(reversed(chunk))


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not JSON")
