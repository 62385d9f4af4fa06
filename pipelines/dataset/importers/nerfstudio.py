"""``transforms.json`` of nerfstudio and instant-ngp: images with cameras and poses.

Poses are camera-to-world in OpenGL's convention (camera x right, y up, z backwards), pixel
centres lie at .5 as in COLMAP. Values of a frame override those of the whole file.
"""

import math
import os
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from pipelines.artifacts.errors import InputError, OptionError, quoted
from pipelines.artifacts.json_fields import JsonFields, read_json_object
from pipelines.dataset.dataset import natural_key
from pipelines.dataset.images import IMAGE_SUFFIXES, read_image_header
from pipelines.dataset.importers.pose_matrix import rigid_pose
from pipelines.dataset.importers.recording import (
    IMAGE_FOLDER,
    Recording,
    SourceFrame,
    first_duplicate,
    name_below,
)
from pipelines.dataset.importers.source_files import all_inside, check_missing, files_below
from pipelines.geometry.camera import Camera
from pipelines.geometry.time_units import UNIT_NAMES, in_seconds, unit_of_times

FILE_NAMES = ("transforms.json", "transforms_train.json")
MAX_FILE_BYTES = 256 * 1024**2
PIXEL_CENTRE_SHIFT = 0.5
# x right, y down, z forward -> x right, y up, z backwards.
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
# Names of camera models that are pinholes with polynomial distortion.
PERSPECTIVE_MODELS = (
    "OPENCV",
    "PERSPECTIVE",
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "FULL_OPENCV",
)
# Names of a frame's time.
TIME_KEYS = ("timestamp", "time", "timestamps")
FISHEYE_MODEL = "OPENCV_FISHEYE"
# Which have fewer coefficients.
FISHEYE_MODELS = (
    FISHEYE_MODEL,
    "SIMPLE_FISHEYE",
    "FISHEYE",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
)


def find_transforms(source: Path) -> Path | None:
    """The JSON file that ``source`` is, or that lies in it; None where there is none."""
    if source.is_file():
        return source if source.suffix.lower() == ".json" else None
    return next((source / name for name in FILE_NAMES if (source / name).is_file()), None)


def read_nerfstudio(source: Path, allow_missing: float | None = None) -> Recording:
    """Reads the images that a ``transforms.json`` names.

    They are in the order of their times where all have one, else in natural order of their names.

    Args:
        source: the file, or the folder that holds it.
        allow_missing: share of the images that may be gone; None: ``MISSING_SHARE``.

    Raises:
        InputError: the file is malformed, names images that are gone or lie outside its folder, or
            has a matrix that is no pose or a camera that lfnav does not know.
    """
    path = find_transforms(source)
    if path is None:
        raise InputError(source, f"holds no {' or '.join(FILE_NAMES)}")
    fields = read_json_object(path, MAX_FILE_BYTES)
    rows = fields.get("frames", list)
    if not rows:
        raise InputError(path, "names no frames")
    entries = [JsonFields(path, row, f"frames[{index}].") for index, row in enumerate(rows)]
    texts = [entry.get("file_path", str) for entry in entries]
    found = files_below(path.parent, texts, ("", *IMAGE_SUFFIXES))
    files = all_inside(texts, found, path)
    notes = list(check_missing(path.parent, files, allow_missing))
    there = [index for index, file in enumerate(files) if file.is_there]
    # Of the images that are there alone.
    entries = [entries[index] for index in there]
    relative = [files[index].name for index in there]
    times, notes_on_times = _times(entries)
    notes += notes_on_times
    order = sorted(
        range(len(entries)),
        key=lambda index: natural_key(relative[index]) if times is None else times[index],
    )
    double = first_duplicate(relative)
    if double is not None:
        raise InputError(path, f"names {double} twice")
    stripped = _common_folder(relative)
    cameras: dict[Camera, int] = {}
    frames, poses = [], []
    for number, index in enumerate(order):
        entry, file = entries[index], path.parent / relative[index]
        camera = _camera_of(fields, entry, file)
        frames.append(
            SourceFrame(
                file,
                name_below(IMAGE_FOLDER, relative[index][stripped:], path),
                float(number) if times is None else times[index],
                camera=cameras.setdefault(camera, len(cameras)),
            )
        )
        matrix = entry.get("transform_matrix", list)
        pose = rigid_pose(path, matrix, f"{entry.prefix}transform_matrix")
        poses.append(pose @ OPENGL_FROM_OPENCV)
    if any("depth_file_path" in entry.values for entry in entries):
        notes.append("depth_file_path: depth of this source is not imported")
    return Recording(tuple(frames), tuple(cameras), np.stack(poses), notes=tuple(notes))


def _times(entries: list[JsonFields]) -> tuple[list[float] | None, list[str]]:
    """Seconds of the frames, or None, and notes on times that are not taken."""
    for key in TIME_KEYS:
        with_time = [entry for entry in entries if entry.values.get(key) is not None]
        if not with_time:
            continue
        if len(with_time) < len(entries):
            missing = len(entries) - len(with_time)
            return None, [f"{key} is missing for {missing} frames: times are not taken"]
        recorded = np.array([entry.number(key) for entry in entries])
        if len(np.unique(recorded)) < len(entries):
            return None, [f"frames have the same {key}: times are not taken"]
        unit = unit_of_times(np.sort(recorded))
        said = "" if unit == 1.0 else f", which are {UNIT_NAMES[unit]}"
        return in_seconds(recorded, unit).tolist(), [f"times from {key}{said}"]
    return None, []


def _common_folder(names: list[str]) -> int:
    """Length of the folder that all names begin with, its slash included."""
    common = os.path.commonpath([PurePosixPath(name).parent for name in names])
    return len(common) + 1 if common not in ("", ".") else 0


class _Numbers:
    """Numbers of a frame, or else of the file."""

    def __init__(self, fields: JsonFields, entry: JsonFields) -> None:
        self.levels = (entry, fields)

    def find(self, key: str) -> float | None:
        for level in self.levels:
            if level.values.get(key) is not None:
                return level.number(key)
        return None

    def get(self, key: str, default: float) -> float:
        value = self.find(key)
        return default if value is None else value

    def text(self, key: str) -> str | None:
        for level in self.levels:
            if level.values.get(key) is not None:
                return level.get(key, str)
        return None

    def flag(self, key: str) -> bool:
        values: list[Any] = [level.values.get(key) for level in self.levels]
        return next((bool(value) for value in values if value is not None), False)


def _camera_of(fields: JsonFields, entry: JsonFields, image: Path) -> Camera:
    numbers = _Numbers(fields, entry)
    header = read_image_header(image)
    for key, actual in (("w", header.width), ("h", header.height)):
        stated = numbers.find(key)
        if stated is not None and stated != actual:
            raise InputError(
                image,
                f"is {header.width}x{header.height} pixels, {fields.path.name} says "
                f"{key} = {stated:g}",
            )
    focal_x = _focal(numbers, "fl_x", "camera_angle_x", header.width)
    focal_y = _focal(numbers, "fl_y", "camera_angle_y", header.height)
    focal_x, focal_y = focal_x or focal_y, focal_y or focal_x
    if focal_x is None or focal_y is None:
        raise InputError(fields.path, f"{entry.prefix}fl_x is missing, and camera_angle_x as well")
    pinhole = (
        focal_x,
        focal_y,
        numbers.get("cx", header.width / 2.0) - PIXEL_CENTRE_SHIFT,
        numbers.get("cy", header.height / 2.0) - PIXEL_CENTRE_SHIFT,
    )
    model, distortion = _distortion(fields.path, numbers)
    try:
        return Camera(model, header.width, header.height, (*pinhole, *distortion))
    except OptionError as error:
        raise InputError(fields.path, f"{entry.prefix}{error}") from error


def _focal(numbers: _Numbers, length: str, angle: str, size: int) -> float | None:
    focal, opening = numbers.find(length), numbers.find(angle)
    if focal is not None or opening is None:
        return focal
    if not 0.0 < opening < math.pi:
        raise InputError(numbers.levels[1].path, f"{angle} = {opening:g} is no angle of view")
    return size / 2.0 / math.tan(opening / 2.0)


def _distortion(path: Path, numbers: _Numbers) -> tuple[str, tuple[float, ...]]:
    """COLMAP's name of the camera model, and what its parameters have after fx fy cx cy."""
    model = numbers.text("camera_model") or "OPENCV"
    k1, k2, k3, k4, p1, p2 = (numbers.get(key, 0.0) for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
    if model in FISHEYE_MODELS or numbers.flag("is_fisheye"):
        return FISHEYE_MODEL, (k1, k2, k3, k4)
    if model not in PERSPECTIVE_MODELS:
        known = ", ".join((*PERSPECTIVE_MODELS, *FISHEYE_MODELS))
        raise InputError(path, f"camera_model {quoted(model)} is not supported", f"known: {known}")
    if k4 != 0.0:
        raise InputError(path, f"k4 = {k4:g} of a camera that is no fisheye is not supported")
    if k3 != 0.0:
        return "FULL_OPENCV", (k1, k2, p1, p2, k3, 0.0, 0.0, 0.0)
    if (k1, k2, p1, p2) != (0.0, 0.0, 0.0, 0.0):
        return "OPENCV", (k1, k2, p1, p2)
    return "PINHOLE", ()
