"""Bags: recordings of ROS 1 (``.bag``) and ROS 2 (sqlite3 and mcap), read without ROS.

``rosbags`` knows the files. The types of messages are those that lfnav knows, and not what a bag
says of them: a definition becomes code. Whatever is wrong with a bag is an ``InputError`` of one
line, and it is read as if a stranger had made it (``decompression_limit``).
"""

import struct
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipelines.artifacts.errors import InputError, LfnavError, StageError, quoted, reason_of
from pipelines.artifacts.kinds import ROSBAG2_METADATA
from pipelines.dataset.dataset import natural_key
from pipelines.ros.decompression_limit import MAX_CHUNK_BYTES, limited_decompression

IMAGE_TYPE, COMPRESSED_TYPE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
IMAGE_TYPES = (IMAGE_TYPE, COMPRESSED_TYPE)
INFO_TYPE, ODOMETRY_TYPE = "sensor_msgs/msg/CameraInfo", "nav_msgs/msg/Odometry"
TF_TYPE, OLD_TF_TYPE = "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"
TF_TYPES = (TF_TYPE, OLD_TF_TYPE)
POSE_TYPES = (
    ODOMETRY_TYPE,
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
)
_KNOWN_TYPES = (*IMAGE_TYPES, INFO_TYPE, *TF_TYPES, *POSE_TYPES)
# ROS 1 has it in a package that rosbags does not bring along.
_TF_DEFINITION = "geometry_msgs/TransformStamped[] transforms"
# Chunks that have to be decompressed at the same time because their times overlap.
MAX_OVERLAPPING_BYTES = 2 * MAX_CHUNK_BYTES
MAX_METADATA_BYTES = 4 * 1024**2
_REMEDIES = {
    ".bag": "rosbag reindex may mend it",
    ".mcap": "mcap recover may mend it",
    ".db3": "sqlite3's .recover may mend it",
}
_SUFFIXES = {".bag": "ROS 1", ".db3": "ROS 2, sqlite3", ".mcap": "ROS 2, mcap"}


@dataclass(frozen=True)
class Topic:
    """A topic of a bag: its name, the type of its messages (``package/msg/Name``), their number."""

    name: str
    type: str
    count: int


@dataclass(frozen=True)
class BagMessage:
    """A message as recorded: its topic and type, the time of its receipt (ns), its bytes."""

    topic: str
    type: str
    received: int
    data: bytes


class Bag:
    """An open bag.

    Attributes:
        path: the file or folder.
        format: for people, like ``"ROS 2, mcap"``.
        topics: by name.
        start, end: of the times of receipt, ns; both 0 where the bag is empty.
    """

    def __init__(self, path: Path, readers: list[Any], *, is_ros1: bool, bag_format: str) -> None:
        self.path = path
        self.format = bag_format
        self.is_ros1 = is_ros1
        self._readers = readers
        self._store = _typestore(is_ros1=is_ros1)
        self._connections: dict[str, list[tuple[Any, Any]]] = {}
        for reader in readers:
            for connection in reader.connections:
                self._connections.setdefault(str(connection.topic), []).append((reader, connection))
        self.topics = {
            name: Topic(name, str(found[0][1].msgtype), sum(c.msgcount for _, c in found))
            for name, found in sorted(self._connections.items())
        }
        spans = [(r.start_time, r.end_time) for r in readers if r.end_time > r.start_time]
        self.start = min((start for start, _ in spans), default=0)
        self.end = max((end for _, end in spans), default=0)

    def of_type(self, types: Collection[str]) -> tuple[Topic, ...]:
        """The topics whose messages are of one of these types, and of which there are some."""
        return tuple(t for t in self.topics.values() if t.type in types and t.count)

    def count(self, topics: Collection[str]) -> int:
        """Number of the messages of topics."""
        return sum(self.topics[name].count for name in topics)

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """The messages of topics in the order of their receipt, one after the other.

        Raises:
            InputError: the bag is damaged.
        """
        for name in topics:
            self._check_type(name)
        with _errors_of(self.path):
            for reader in self._readers:
                chosen = [c for name in topics for r, c in self._connections[name] if r is reader]
                if not chosen:
                    continue
                for connection, received, data in reader.messages(chosen):
                    if len(data) > MAX_CHUNK_BYTES:
                        raise InputError(self.path, f"has a message of {len(data)} bytes")
                    # What goes wrong with the consumer is not the bag's.
                    yield BagMessage(
                        str(connection.topic), str(connection.msgtype), int(received), bytes(data)
                    )

    def decoded(self, message: BagMessage) -> Any:
        """The message's fields.

        Raises:
            InputError: its bytes are no message of its type.
        """
        try:
            if self.is_ros1:
                return self._store.deserialize_ros1(message.data, message.type)
            return self._store.deserialize_cdr(message.data, message.type)
        except Exception as error:
            raise InputError(
                self.path,
                f"topic {quoted(message.topic)} has a damaged message ({reason_of(error)})",
            ) from error

    def stamp(self, message: BagMessage) -> int:
        """The time (ns) in the header with which a message begins; nothing else is decoded.

        Raises:
            InputError: the message is too short for a header.
        """
        # ROS 1: sequence number, seconds, nanoseconds. CDR: byte order in four bytes, and these.
        order = ">" if not self.is_ros1 and message.data[1:2] == b"\0" else "<"
        try:
            seconds, nanoseconds = struct.unpack_from(f"{order}iI", message.data, 4)
        except struct.error as error:
            raise InputError(
                self.path, f"topic {quoted(message.topic)} has a damaged message (too short)"
            ) from error
        return int(seconds) * 1_000_000_000 + int(nanoseconds)

    def _check_type(self, name: str) -> None:
        """Refuses a topic of two types, or of another version of a type than lfnav's."""
        connections = [connection for _, connection in self._connections[name]]
        types = sorted({str(connection.msgtype) for connection in connections})
        if len(types) > 1:
            texts = " and ".join(quoted(text) for text in types)
            raise InputError(self.path, f"topic {quoted(name)} has messages of {texts}")
        if types[0] not in _KNOWN_TYPES:
            raise InputError(
                self.path,
                f"topic {quoted(name)} is of type {quoted(types[0])}, which lfnav does not read",
            )
        known = (
            self._store.generate_msgdef(types[0])[1]
            if self.is_ros1
            else self._store.hash_rihs01(types[0])
        )
        for digest in {str(connection.digest) for connection in connections if connection.digest}:
            if digest not in {known, "*"}:
                raise InputError(
                    self.path,
                    f"topic {quoted(name)} has another version of the type {types[0]} than "
                    "lfnav knows",
                )


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Opens a bag for reading.

    Args:
        path: a ``.bag``, ``.db3`` or ``.mcap`` file; the folder of a bag of ROS 2, with its
            ``metadata.yaml``; or a folder with the parts of one bag of ROS 1.

    Raises:
        InputError: no bag, or one that is cut off, without index or otherwise damaged.
        StageError: ``rosbags`` is not installed.
    """
    files, bag_format = _files_of(path)
    try:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
    except ImportError as error:
        raise StageError(
            f"reading bags needs the package rosbags ({reason_of(error)}); "
            "install it: pip install 'lfnav[ros]'"
        ) from error
    is_ros1 = bag_format == _SUFFIXES[".bag"]
    with ExitStack() as stack:
        with _errors_of(path):
            stack.enter_context(limited_decompression())
            readers: list[Any] = []
            for file in files:
                _check_length(file)
                reader = Reader1(file) if is_ros1 else Reader2(file)
                with _damage_of(file):
                    stack.enter_context(reader)
                readers.append(reader)
                if not is_ros1:
                    _limit_storages(path, reader)
            bag = Bag(path, readers, is_ros1=is_ros1, bag_format=bag_format)
        yield bag


def _files_of(path: Path) -> tuple[list[Path], str]:
    """What a reader is opened for each of, and the bag's format."""
    try:
        if not path.exists():
            raise InputError(path, "does not exist")
        if path.is_dir():
            if (path / ROSBAG2_METADATA).is_file():
                if (path / ROSBAG2_METADATA).stat().st_size > MAX_METADATA_BYTES:
                    raise InputError(path / ROSBAG2_METADATA, "is too large for an index")
                return [path], "ROS 2"
            parts = sorted(path.glob("*.bag"), key=lambda part: natural_key(part.name))
            if parts:
                return parts, _SUFFIXES[".bag"]
            others = sorted([*path.glob("*.mcap"), *path.glob("*.db3")])
            if others:
                raise InputError(
                    path,
                    f"holds no {ROSBAG2_METADATA}: the recording was not ended",
                    f"make it with ros2 bag reindex, or name the file {others[0].name}",
                )
            raise InputError(path, "is no bag: it holds no metadata.yaml and no .bag file")
        if not path.is_file():
            raise InputError(path, "is not a file")
        if path.stat().st_size == 0:
            raise InputError(path, "is empty")
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be read ({reason_of(error)})") from error
    if path.suffix not in _SUFFIXES:
        raise InputError(path, "is no bag: its name ends in none of .bag, .db3, .mcap")
    return [path], _SUFFIXES[path.suffix]


def _check_length(bag: Path) -> None:
    """Refuses a database of SQLite that lacks its end, where only the last messages may lie."""
    for file in [bag] if bag.is_file() else sorted(bag.glob("*.db3")):
        with file.open("rb") as content:
            header = content.read(100)
        if file.suffix != ".db3" or len(header) < 100 or header[24:28] != header[92:96]:
            continue  # the header's number of pages counts only where it was written last
        (page_size,) = struct.unpack_from(">H", header, 16)
        (pages,) = struct.unpack_from(">I", header, 28)
        # 64 KiB has no place in the two bytes.
        if file.stat().st_size < pages * (65536 if page_size == 1 else page_size):
            raise InputError(file, "is cut off", _REMEDIES[".db3"])


def _typestore(*, is_ros1: bool) -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if not is_ros1:
        return get_typestore(Stores.ROS2_JAZZY)
    store = get_typestore(Stores.ROS1_NOETIC)
    for name in TF_TYPES:
        store.register(get_types_from_msg(_TF_DEFINITION, name))
    return store


def _limit_storages(path: Path, reader: Any) -> None:
    """Limits what the reader of a bag of ROS 2 holds in memory at a time."""
    for storage in getattr(reader.storage, "storages", [reader.storage]):
        if hasattr(storage, "dbconn"):
            import apsw

            storage.dbconn.limit(apsw.SQLITE_LIMIT_LENGTH, MAX_CHUNK_BYTES)
            continue
        changes = [(chunk.message_start_time, chunk.uncompressed_size) for chunk in storage.chunks]
        changes += [(chunk.message_end_time, -chunk.uncompressed_size) for chunk in storage.chunks]
        together = largest = 0
        # At the same time chunks are opened before others are done with.
        for _, size in sorted(changes, key=lambda change: (change[0], -change[1])):
            together += size
            largest = max(largest, together)
        if largest > MAX_OVERLAPPING_BYTES:
            raise InputError(
                path,
                f"has chunks that overlap in time: {largest} bytes would be open at once, "
                f"{MAX_OVERLAPPING_BYTES} are allowed",
            )


@contextmanager
def _damage_of(file: Path) -> Iterator[None]:
    """Says of what cannot be opened what may mend it."""
    try:
        yield
    except LfnavError:
        raise
    except Exception as error:
        raise InputError(
            file,
            f"is cut off, without index or damaged ({_reason(error)})",
            _REMEDIES.get(file.suffix, ""),
        ) from error


@contextmanager
def _errors_of(path: Path) -> Iterator[None]:
    """Whatever reading a bag raises becomes an error of the file.

    rosbags has exceptions of its own, and lets those of its parts through: of struct, zstd, lz4,
    bz2, YAML, SQLite, failed assertions, and of whatever wrong numbers lead to.
    """
    try:
        yield
    except (LfnavError, GeneratorExit):
        raise
    except Exception as error:
        raise InputError(path, f"is a damaged bag ({_reason(error)})") from error


def _reason(error: Exception) -> str:
    """What an exception says, on one line; some say nothing."""
    if isinstance(error, MemoryError):
        return "a record of it is too large"
    return " ".join(reason_of(str(error) or type(error).__name__).split())
