"""COLMAP's binary model: ``cameras.bin``, ``images.bin`` and ``points3D.bin``.

Read and written here and not by pycolmap, since these files may come from strangers. Every count
in a file is checked against the bytes that are there before it is believed.

This is also the one place where pixel conventions meet. COLMAP puts the centre of the top-left
pixel at (0.5, 0.5), this project at (0, 0); everything that comes out of this module follows the
project's convention and everything in the files COLMAP's.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray, IntArray
from pipelines.artifacts.errors import InputError, OptionError, quoted
from pipelines.artifacts.file_content import read_file
from pipelines.geometry.camera import CAMERA_MODELS, Camera
from pipelines.geometry.pose import pose_from_quaternion, quaternion_of
from pipelines.reconstruct.colmap_cameras import (
    COLMAP_MODELS,
    MODEL_NAMES,
    MODEL_NUMBERS,
    exact_camera,
    remedy_for,
)

PIXEL_CENTRE_SHIFT = 0.5
MAX_MODEL_FILE_BYTES = 2 * 1024**3
MAX_NAME_BYTES = 4096
MAX_IMAGE_SIDE = 1_000_000
NO_POINT = -1

CAMERA_HEADER = struct.Struct("<IiQQ")  # identifier, model, width, height
IMAGE_HEADER = struct.Struct("<I7dI")  # identifier, quaternion w x y z, translation, camera
POINT_HEADER = struct.Struct("<Q3d3BdQ")  # identifier, position, colour, error, track length
COUNT = struct.Struct("<Q")
KEYPOINT_TYPE = np.dtype([("pixel", "<f8", 2), ("point", "<i8")])
TRACK_TYPE = np.dtype([("image", "<u4"), ("keypoint", "<u4")])


@dataclass(frozen=True)
class ModelImage:
    """One registered image of a model.

    Attributes:
        identifier: COLMAP's number of the image.
        name: relative to the image folder.
        camera: COLMAP's number of its camera.
        camera_from_world: ``(4, 4)``.
        keypoints: ``(K, 2)`` pixels, centres at integers.
        points: ``(K,)`` COLMAP's numbers of the points seen there, ``NO_POINT`` where none.
    """

    identifier: int
    name: str
    camera: int
    camera_from_world: FloatArray
    keypoints: FloatArray
    points: IntArray


@dataclass(frozen=True)
class ModelPoints:
    """The points of a model.

    Attributes:
        identifiers: ``(P,)`` COLMAP's numbers of the points.
        positions: ``(P, 3)`` world coordinates.
        colors: ``(P, 3)`` RGB.
        errors: ``(P,)`` mean reprojection error in pixels, -1 where it is not known.
        tracks: ``(M, 3)`` rows (row of the point, number of the image, index of the keypoint).
    """

    identifiers: IntArray
    positions: FloatArray
    colors: ImageArray
    errors: FloatArray
    tracks: IntArray


@dataclass(frozen=True)
class ColmapModel:
    """A COLMAP model: cameras by their number, registered images, points."""

    cameras: dict[int, Camera]
    images: tuple[ModelImage, ...]
    points: ModelPoints


def colmap_params(camera: Camera) -> tuple[float, ...]:
    """The camera's parameters as COLMAP wants them: the principal point half a pixel further."""
    return _shift_principal_point(camera.model, camera.params, PIXEL_CENTRE_SHIFT)


def _shift_principal_point(model: str, params: Sequence[float], shift: float) -> tuple[float, ...]:
    names = CAMERA_MODELS[model]
    return tuple(
        value + shift if name in ("cx", "cy") else value
        for name, value in zip(names, params, strict=True)
    )


class _Cursor:
    """Walks through the bytes of one file and refuses to step over their end."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path = path
        self.data = data
        self.position = 0

    def take(self, size: int) -> int:
        """The position of the next ``size`` bytes, which are then passed."""
        start = self.position
        if size > len(self.data) - start:
            raise InputError(
                self.path,
                f"is truncated or damaged: {size} bytes declared at byte {start}, "
                f"{len(self.data) - start} there",
            )
        self.position = start + size
        return start

    def unpack(self, layout: struct.Struct) -> tuple[float, ...]:
        return layout.unpack_from(self.data, self.take(layout.size))

    def count(self, smallest_item: int) -> int:
        """A number of items, each of at least ``smallest_item`` bytes, that can still follow."""
        number = int(self.unpack(COUNT)[0])
        if number * smallest_item > len(self.data) - self.position:
            raise InputError(
                self.path,
                f"is truncated or damaged: {number} entries declared at byte "
                f"{self.position - COUNT.size}, {len(self.data) - self.position} bytes follow",
            )
        return number

    def name(self) -> str:
        end = self.data.find(b"\0", self.position, self.position + MAX_NAME_BYTES + 1)
        if end < 0:
            raise InputError(self.path, f"holds a name that does not end (byte {self.position})")
        raw = self.data[self.position : end]
        self.position = end + 1
        try:
            return raw.decode("utf-8")
        except UnicodeDecodeError as error:
            shown = quoted(raw.decode("latin-1"))
            raise InputError(self.path, f"holds a name that is not UTF-8: {shown}") from error

    def finish(self) -> None:
        if self.position != len(self.data):
            raise InputError(
                self.path,
                f"is damaged: {len(self.data) - self.position} bytes after the last entry",
            )


def read_model(folder: Path) -> ColmapModel:
    """Reads a COLMAP model in binary form.

    Raises:
        InputError: a file is missing, truncated, damaged, or contradicts another one; the file is
            named.
    """
    cameras = _read_cameras(folder / "cameras.bin")
    images = _read_images(folder / "images.bin", cameras)
    points = _read_points(folder / "points3D.bin", images)
    return ColmapModel(cameras.known, images, points)


@dataclass(frozen=True)
class ModelCameras:
    """The cameras of a model that is being read.

    Attributes:
        known: by COLMAP's number.
        others: those that no model of this project describes, by number: what to say of them. No
            harm where no image was taken with them.
    """

    known: dict[int, Camera]
    others: dict[int, InputError]

    def add(
        self, path: Path, identifier: int, model: str, size: tuple[int, int], params: list[float]
    ) -> None:
        """Adds what a file says of a camera.

        Raises:
            InputError: it is there already, or is no camera.
        """
        if identifier in self.known or identifier in self.others:
            raise InputError(path, f"camera {identifier} is there twice")
        count = COLMAP_MODELS[model][1]
        if len(params) != count:
            reason = f"camera model {model} takes {count} params, got {len(params)}"
            raise InputError(path, f"camera {identifier}: {reason}")
        exact = exact_camera(model, params)
        if exact is None:
            reason = f"camera {identifier} has model {model}, which lfnav does not describe exactly"
            self.others[identifier] = InputError(path, reason, remedy_for(model))
        else:
            self.known[identifier] = camera_from_colmap(path, identifier, exact[0], size, exact[1])

    def check(self, path: Path, image: str, camera: int) -> None:
        """Makes sure that an image's camera is known.

        Raises:
            InputError: it is not.
        """
        if camera in self.others:
            raise self.others[camera]
        if camera not in self.known:
            raise InputError(path, f"image {quoted(image)} was taken with camera {camera}, unknown")


def _read_cameras(path: Path) -> ModelCameras:
    cursor = _Cursor(path, read_file(path, MAX_MODEL_FILE_BYTES))
    cameras = ModelCameras({}, {})
    for _ in range(cursor.count(CAMERA_HEADER.size)):
        header = [int(value) for value in cursor.unpack(CAMERA_HEADER)]
        identifier, number, width, height = header
        if number not in MODEL_NAMES:
            known = ", ".join(MODEL_NAMES.values())
            raise InputError(
                path, f"camera {identifier} has model number {number}", f"known: {known}"
            )
        model = MODEL_NAMES[number]
        params = cursor.unpack(struct.Struct(f"<{COLMAP_MODELS[model][1]}d"))
        cameras.add(path, identifier, model, (width, height), list(params))
    cursor.finish()
    return cameras


def camera_from_colmap(
    path: Path, identifier: int, model: str, size: tuple[int, int], params: Sequence[float]
) -> Camera:
    """The camera that COLMAP describes so, its principal point half a pixel nearer.

    Raises:
        InputError: an impossible size, or numbers that no camera has.
    """
    if max(size) > MAX_IMAGE_SIDE:
        raise InputError(path, f"camera {identifier} has {size[0]}x{size[1]} pixels")
    try:
        # Which first of all compares the number of the parameters with the model's.
        Camera(model, *size, tuple(params))
        return Camera(model, *size, _shift_principal_point(model, params, -PIXEL_CENTRE_SHIFT))
    except OptionError as error:
        raise InputError(path, f"camera {identifier}: {error}") from error


def _read_images(path: Path, cameras: ModelCameras) -> tuple[ModelImage, ...]:
    cursor = _Cursor(path, read_file(path, MAX_MODEL_FILE_BYTES))
    images: dict[int, ModelImage] = {}
    for _ in range(cursor.count(IMAGE_HEADER.size + 1 + COUNT.size)):
        header = cursor.unpack(IMAGE_HEADER)
        identifier, camera = int(header[0]), int(header[8])
        name = cursor.name()
        keypoint_count = cursor.count(KEYPOINT_TYPE.itemsize)
        start = cursor.take(keypoint_count * KEYPOINT_TYPE.itemsize)
        keypoints = np.frombuffer(cursor.data, KEYPOINT_TYPE, keypoint_count, start)
        if identifier in images:
            raise InputError(path, f"image {identifier} is there twice")
        cameras.check(path, name, camera)
        if not np.all(np.isfinite(keypoints["pixel"])):
            raise InputError(path, f"image {quoted(name)} has keypoints that are not finite")
        images[identifier] = ModelImage(
            identifier,
            name,
            camera,
            image_pose(path, name, header[1:8]),
            keypoints["pixel"].astype(np.float64) - PIXEL_CENTRE_SHIFT,
            keypoints["point"].astype(np.int64),
        )
    cursor.finish()
    return tuple(images.values())


def image_pose(path: Path, name: str, values: Sequence[float]) -> FloatArray:
    """camera_from_world ``(4, 4)`` of a quaternion w x y z and a translation, seven numbers.

    Raises:
        InputError: not finite, or the quaternion is no unit quaternion.
    """
    quaternion_wxyz, translation = np.array(values[:4]), np.array(values[4:])
    if not (np.all(np.isfinite(quaternion_wxyz)) and np.all(np.isfinite(translation))):
        raise InputError(path, f"image {quoted(name)} has a pose that is not finite")
    length = float(np.linalg.norm(quaternion_wxyz))
    if abs(length - 1.0) > 1e-3:
        raise InputError(path, f"image {quoted(name)} has a quaternion of length {length:.4g}")
    return pose_from_quaternion(translation, np.roll(quaternion_wxyz / length, -1))


def _read_points(path: Path, images: tuple[ModelImage, ...]) -> ModelPoints:
    cursor = _Cursor(path, read_file(path, MAX_MODEL_FILE_BYTES))
    count = cursor.count(POINT_HEADER.size)
    identifiers = np.empty(count, dtype=np.int64)
    values = np.empty((count, 4))
    colors = np.empty((count, 3), dtype=np.uint8)
    tracks: list[IntArray] = []
    for row in range(count):
        identifier, x, y, z, red, green, blue, error, length = cursor.unpack(POINT_HEADER)
        if identifier >= 2**63:
            raise InputError(path, f"point number {identifier} is too large")
        identifiers[row], values[row], colors[row] = (
            identifier,
            (x, y, z, error),
            (red, green, blue),
        )
        start = cursor.take(int(length) * TRACK_TYPE.itemsize)
        track = np.frombuffer(cursor.data, TRACK_TYPE, int(length), start)
        rows = np.full(len(track), row, dtype=np.int64)
        tracks.append(np.column_stack([rows, track["image"], track["keypoint"]]).astype(np.int64))
    cursor.finish()
    if not np.all(np.isfinite(values)):
        raise InputError(path, "holds a point that is not finite")
    if len(np.unique(identifiers)) != count:
        raise InputError(path, "holds the same point twice")
    all_tracks = np.concatenate(tracks) if tracks else np.empty((0, 3), dtype=np.int64)
    check_tracks(path, identifiers, all_tracks, images)
    return ModelPoints(identifiers, values[:, :3].copy(), colors, values[:, 3].copy(), all_tracks)


def check_tracks(
    path: Path, identifiers: IntArray, tracks: IntArray, images: tuple[ModelImage, ...]
) -> None:
    """Makes sure that every track names keypoints that exist and that name the point in turn.

    Raises:
        InputError: a track or a keypoint contradicts the other.
    """
    known = np.array([image.identifier for image in images], dtype=np.int64)
    strangers = np.setdiff1d(tracks[:, 1], known)
    if len(strangers):
        raise InputError(
            path, f"a track names image {strangers[0]}, which images.bin does not hold"
        )
    for image in images:
        own = tracks[tracks[:, 1] == image.identifier]
        if len(own) and int(own[:, 2].max()) >= len(image.keypoints):
            raise InputError(
                path, f"a track names a keypoint that image {quoted(image.name)} lacks"
            )
        if not np.array_equal(image.points[own[:, 2]], identifiers[own[:, 0]]):
            raise InputError(
                path, f"its tracks contradict the keypoints of image {quoted(image.name)}"
            )


def write_model(folder: Path, model: ColmapModel) -> None:
    """Writes the three files into ``folder``, which exists; not atomic by itself.

    Raises:
        InputError: a file cannot be written.
    """
    contents = {
        "cameras.bin": _encode_cameras(model.cameras),
        "images.bin": _encode_images(model.images),
        "points3D.bin": _encode_points(model.points),
    }
    for name, content in contents.items():
        try:
            (folder / name).write_bytes(content)
        except OSError as error:
            reason = f"cannot be written ({error.strerror or error})"
            raise InputError(folder / name, reason) from error


def _encode_cameras(cameras: dict[int, Camera]) -> bytes:
    parts = [COUNT.pack(len(cameras))]
    for identifier, camera in cameras.items():
        number = MODEL_NUMBERS[camera.model]
        parts.append(CAMERA_HEADER.pack(identifier, number, camera.width, camera.height))
        parts.append(np.array(colmap_params(camera), dtype="<f8").tobytes())
    return b"".join(parts)


def _encode_images(images: tuple[ModelImage, ...]) -> bytes:
    parts = [COUNT.pack(len(images))]
    for image in images:
        x, y, z, w = quaternion_of(image.camera_from_world)
        translation = image.camera_from_world[:3, 3]
        parts.append(IMAGE_HEADER.pack(image.identifier, w, x, y, z, *translation, image.camera))
        parts.append(image.name.encode("utf-8") + b"\0")
        keypoints = np.empty(len(image.keypoints), dtype=KEYPOINT_TYPE)
        keypoints["pixel"] = image.keypoints + PIXEL_CENTRE_SHIFT
        keypoints["point"] = image.points
        parts.append(COUNT.pack(len(keypoints)) + keypoints.tobytes())
    return b"".join(parts)


def _encode_points(points: ModelPoints) -> bytes:
    order = np.argsort(points.tracks[:, 0], kind="stable")
    tracks = points.tracks[order]
    ends = np.searchsorted(tracks[:, 0], np.arange(len(points.positions)), side="right")
    packed = np.empty(len(tracks), dtype=TRACK_TYPE)
    packed["image"], packed["keypoint"] = tracks[:, 1], tracks[:, 2]
    parts = [COUNT.pack(len(points.positions))]
    start = 0
    for row, end in enumerate(ends.tolist()):
        header = (int(points.identifiers[row]), *points.positions[row].tolist())
        color, error = points.colors[row].tolist(), float(points.errors[row])
        parts.append(POINT_HEADER.pack(*header, *color, error, end - start))
        parts.append(packed[start:end].tobytes())
        start = end
    return b"".join(parts)
