"""COLMAP's model as text: ``cameras.txt``, ``images.txt`` and ``points3D.txt``.

What comes out is what ``colmap_model`` reads from the binary form: pixel centres at integers.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import InputError, quoted, reason_of
from pipelines.artifacts.file_content import is_file, read_text_file
from pipelines.reconstruct.colmap_cameras import COLMAP_MODELS
from pipelines.reconstruct.colmap_model import (
    NO_POINT,
    PIXEL_CENTRE_SHIFT,
    ColmapModel,
    ModelCameras,
    ModelImage,
    ModelPoints,
    check_tracks,
    image_pose,
    read_model,
)

MAX_TEXT_BYTES = 512 * 1024**2
MAX_NUMBER = 2**62


def read_any_model(folder: Path) -> ColmapModel:
    """Reads a COLMAP model, binary where it is there in binary form, else text.

    Raises:
        InputError: a file is missing, truncated, damaged, or contradicts another one.
    """
    if is_file(folder / "cameras.bin") or not is_file(folder / "cameras.txt"):
        return read_model(folder)
    cameras = _read_cameras(folder / "cameras.txt")
    images = _read_images(folder / "images.txt", cameras)
    points = _read_points(folder / "points3D.txt", images)
    return ColmapModel(cameras.known, images, points)


def image_count(folder: Path) -> int:
    """How many images a model has, from no more than its list of them; 0 where that is damaged."""
    path = folder / "images.bin"
    try:
        if is_file(path):
            with path.open("rb") as file:
                return int.from_bytes(file.read(8), "little")
        lines = "\n".join(text for _, text in _lines(folder / "images.txt")).strip("\n")
        return (1 + len(lines.split("\n"))) // 2 if lines else 0
    except (OSError, InputError):
        return 0


class _Line:
    """The blank-separated values of one line; what cannot be read is an error with its number."""

    def __init__(self, path: Path, number: int, text: str, parts: int = -1) -> None:
        self.path, self.number = path, number
        self.values = text.split(maxsplit=parts)

    def error(self, reason: str) -> InputError:
        return InputError(self.path, f"line {self.number}: {reason}")

    def at_least(self, count: int) -> None:
        if len(self.values) < count:
            raise self.error(f"{len(self.values)} values where {count} are needed")

    def whole(self, index: int) -> int:
        try:
            value = int(self.values[index])
        except ValueError:
            raise self.error(f"{quoted(self.values[index])} is not a whole number") from None
        if not 0 <= value < MAX_NUMBER:
            raise self.error(f"{value} is out of range")
        return value

    def numbers(self, chosen: slice) -> FloatArray:
        try:
            values = np.array(self.values[chosen], dtype=np.float64)
        except ValueError as error:
            raise self.error(f"not a number ({reason_of(error)})") from None
        if not np.all(np.isfinite(values)):
            raise self.error("a value is not finite")
        return values

    def whole_numbers(self, chosen: slice) -> IntArray:
        try:
            return np.array(self.values[chosen], dtype=np.int64)
        except (ValueError, OverflowError) as error:
            raise self.error(f"not a whole number ({reason_of(error)})") from None


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Number and text of each line, comments left out."""
    for number, line in enumerate(read_text_file(path, MAX_TEXT_BYTES).split("\n"), start=1):
        if not line.lstrip().startswith("#"):
            yield number, line.strip()


def _read_cameras(path: Path) -> ModelCameras:
    cameras = ModelCameras({}, {})
    for number, text in _lines(path):
        if not text:
            continue
        line = _Line(path, number, text)
        line.at_least(5)
        identifier, model = line.whole(0), line.values[1]
        if model not in COLMAP_MODELS:
            known = ", ".join(COLMAP_MODELS)
            raise InputError(
                path,
                f"camera {identifier} has model {quoted(model)}, which is not supported",
                f"known: {known}",
            )
        size = (line.whole(2), line.whole(3))
        cameras.add(path, identifier, model, size, line.numbers(slice(4, None)).tolist())
    return cameras


def _read_images(path: Path, cameras: ModelCameras) -> tuple[ModelImage, ...]:
    """Two lines an image; the second holds its keypoints and is empty where there are none."""
    images: dict[int, ModelImage] = {}
    header: _Line | None = None
    for number, text in _lines(path):
        if header is None:
            if text:
                header = _Line(path, number, text, parts=9)
            continue
        image = _image(path, header, _Line(path, number, text), cameras)
        if image.identifier in images:
            raise InputError(path, f"image {image.identifier} is there twice")
        images[image.identifier] = image
        header = None
    if header is not None:
        raise header.error("the line with the keypoints of the last image is missing")
    return tuple(images.values())


def _image(path: Path, header: _Line, points: _Line, cameras: ModelCameras) -> ModelImage:
    header.at_least(10)
    identifier, camera, name = header.whole(0), header.whole(8), header.values[9]
    cameras.check(path, name, camera)
    if len(points.values) % 3:
        raise points.error(f"{len(points.values)} values are not x, y, point for each keypoint")
    columns = points.numbers(slice(0, None, 3)), points.numbers(slice(1, None, 3))
    return ModelImage(
        identifier,
        name,
        camera,
        image_pose(path, name, header.numbers(slice(1, 8)).tolist()),
        np.column_stack(columns) - PIXEL_CENTRE_SHIFT,
        np.maximum(points.whole_numbers(slice(2, None, 3)), NO_POINT),
    )


def _read_points(path: Path, images: tuple[ModelImage, ...]) -> ModelPoints:
    identifiers: list[int] = []
    rows: list[FloatArray] = []
    tracks: list[IntArray] = []
    for number, text in _lines(path):
        if not text:
            continue
        line = _Line(path, number, text)
        line.at_least(8)
        identifiers.append(line.whole(0))
        rows.append(line.numbers(slice(1, 8)))
        track = line.whole_numbers(slice(8, None))
        if len(track) % 2:
            raise line.error("the track is not pairs of image and keypoint")
        if np.any((rows[-1][3:6] < 0) | (rows[-1][3:6] > 255)) or np.any(track < 0):
            raise line.error("a value is out of range")
        pairs = track.reshape(-1, 2)
        own = np.full((len(pairs), 1), len(rows) - 1, dtype=np.int64)
        tracks.append(np.hstack([own, pairs]))
    values = np.array(rows, dtype=np.float64).reshape(-1, 7)
    numbers = np.array(identifiers, dtype=np.int64)
    if len(np.unique(numbers)) != len(numbers):
        raise InputError(path, "holds the same point twice")
    all_tracks = np.concatenate(tracks) if tracks else np.empty((0, 3), dtype=np.int64)
    check_tracks(path, numbers, all_tracks, images)
    return ModelPoints(
        numbers, values[:, :3].copy(), values[:, 3:6].astype(np.uint8), values[:, 6], all_tracks
    )
