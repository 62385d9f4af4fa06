"""The reconstruction: posed images of a place, and the folder in which it is kept.

The folder holds a COLMAP model in ``sparse/`` and ``reconstruction.json``: how it was made, the
images with their times and hashes, the images that were dropped and why, statistics.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from pipelines.artifacts.arguments import PathLike, checked_path
from pipelines.artifacts.arrays import FloatArray, ImageArray, IntArray, checked_array
from pipelines.artifacts.atomic import atomic_folder
from pipelines.artifacts.errors import InputError, OptionError, quoted
from pipelines.artifacts.file_content import read_file
from pipelines.artifacts.json_fields import JsonFields, read_json_object
from pipelines.artifacts.provenance import sha256_of_bytes
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import are_rigid, inverse
from pipelines.reconstruct.colmap_model import (
    MAX_MODEL_FILE_BYTES,
    ColmapModel,
    ModelImage,
    ModelPoints,
    read_model,
    write_model,
)

FORMAT = "lfnav reconstruction"
SCHEMA_VERSION = 1
DESCRIPTION_NAME = "reconstruction.json"
MODEL_FOLDER = "sparse"
MODEL_FILES = ("cameras.bin", "images.bin", "points3D.bin")
METHODS = ("sfm", "odometry", "poses")
SCALE_SOURCES = ("odometry", "given poses", "--scale", "arbitrary")
MAX_DESCRIPTION_BYTES = 64 * 1024 * 1024
UNKNOWN_COLOR = 128
UNKNOWN_ERROR = -1.0


def _no_pixels() -> FloatArray:
    return np.empty((0, 2))


def _no_colors() -> ImageArray:
    return np.empty((0, 3), dtype=np.uint8)


def _no_errors() -> FloatArray:
    return np.empty(0)


@dataclass(frozen=True)
class Reconstruction:
    """Posed images, and the points that they see where structure from motion found some.

    Attributes:
        method: one of ``METHODS``.
        image_root: absolute folder of the images.
        image_names: the registered images, POSIX, relative to ``image_root``, in time order.
        image_hashes: SHA-256 of the image files.
        timestamps: ``(N,)`` seconds.
        cameras: the cameras that took the images.
        camera_index: ``(N,)`` which of ``cameras`` took each image.
        world_from_camera: ``(N, 4, 4)``; metric and z up unless ``scale_source`` is "arbitrary".
        points: ``(P, 3)`` world coordinates; may be empty.
        observations: ``(M, 2)`` rows (index of a point, index of an image).
        base_from_camera: ``(4, 4)``; None: the body is the camera.
        scale_source: one of ``SCALE_SOURCES``.
        dropped: name of an image of the data set that has no pose -> the reason.
        statistics: plain JSON types.
        observed_pixels: ``(M, 2)`` where each observation lies in its image, pixel centres at
            integers. It is empty only where ``observations`` is.
        point_colors: ``(P, 3)`` RGB; empty where unknown.
        point_errors: ``(P,)`` mean reprojection error in pixels; empty where unknown.

    Raises:
        OptionError: no image, or arrays whose sizes contradict each other.
    """

    method: str
    image_root: Path
    image_names: tuple[str, ...]
    image_hashes: tuple[str, ...]
    timestamps: FloatArray
    cameras: tuple[Camera, ...]
    camera_index: IntArray
    world_from_camera: FloatArray
    points: FloatArray
    observations: IntArray
    base_from_camera: FloatArray | None
    scale_source: str
    dropped: dict[str, str]
    statistics: dict[str, Any]
    observed_pixels: FloatArray = field(default_factory=_no_pixels)
    point_colors: ImageArray = field(default_factory=_no_colors)
    point_errors: FloatArray = field(default_factory=_no_errors)

    def __post_init__(self) -> None:
        images, points, observations = map(len, (self.image_names, self.points, self.observations))
        if images == 0:
            raise OptionError("a reconstruction needs at least one image with a pose")
        if len(self.image_hashes) != images:
            raise OptionError(f"{images} images with {len(self.image_hashes)} hashes")
        expected: dict[str, tuple[int, ...]] = {
            "timestamps": (images,),
            "camera_index": (images,),
            "world_from_camera": (images, 4, 4),
            "points": (points, 3),
            "observations": (observations, 2),
            "observed_pixels": (observations, 2),
        }
        if len(self.point_colors):
            expected["point_colors"] = (points, 3)
        if len(self.point_errors):
            expected["point_errors"] = (points,)
        for name, shape in expected.items():
            checked_array(getattr(self, name), name, shape, finite=False)
        if self.method not in METHODS or self.scale_source not in SCALE_SOURCES:
            raise OptionError(
                f"unknown method {quoted(self.method)} or scale {quoted(self.scale_source)}"
            )


def with_images(reconstruction: Reconstruction, kept: IntArray) -> Reconstruction:
    """The part of a reconstruction that some of its images make; all points stay.

    Args:
        reconstruction: the whole.
        kept: ``(K,)`` indices of the images, ascending.
    """
    place = np.full(len(reconstruction.image_names), -1)
    place[kept] = np.arange(len(kept))
    image = place[reconstruction.observations[:, 1]]
    seen = image >= 0
    return replace(
        reconstruction,
        image_names=tuple(reconstruction.image_names[index] for index in kept),
        image_hashes=tuple(reconstruction.image_hashes[index] for index in kept),
        timestamps=reconstruction.timestamps[kept],
        camera_index=reconstruction.camera_index[kept],
        world_from_camera=reconstruction.world_from_camera[kept],
        observations=np.column_stack([reconstruction.observations[:, 0], image])[seen],
        observed_pixels=reconstruction.observed_pixels[seen],
    )


def save_reconstruction(
    path: Path, reconstruction: Reconstruction, provenance: Mapping[str, Any], overwrite: bool
) -> None:
    """Writes the folder, atomically.

    Raises:
        InputError: it exists already (without ``overwrite``), is no reconstruction that could be
            replaced, or cannot be written.
    """
    with atomic_folder(path, overwrite, marker=DESCRIPTION_NAME) as folder:
        write_reconstruction(folder, path, reconstruction, provenance)


def write_reconstruction(
    folder: Path, final_path: Path, reconstruction: Reconstruction, provenance: Mapping[str, Any]
) -> None:
    """Writes the files of a reconstruction into a folder; not atomic by itself.

    Args:
        folder: an empty folder.
        final_path: where ``folder`` will be once it is complete; paths are relative to it.
        reconstruction: the content.
        provenance: versions, settings and hashes of the inputs.

    Raises:
        InputError: a file cannot be written.
    """
    model_folder = folder / MODEL_FOLDER
    model_folder.mkdir()
    write_model(model_folder, _colmap_model_of(reconstruction))
    description = _description_of(final_path, reconstruction, provenance)
    description["files"] = {
        f"{MODEL_FOLDER}/{name}": sha256_of_bytes((model_folder / name).read_bytes())
        for name in MODEL_FILES
    }
    text = json.dumps(description, indent=2, allow_nan=False) + "\n"
    (folder / DESCRIPTION_NAME).write_text(text, encoding="utf-8")


def _description_of(
    path: Path, reconstruction: Reconstruction, provenance: Mapping[str, Any]
) -> dict[str, Any]:
    mount = reconstruction.base_from_camera
    root = reconstruction.image_root.resolve()
    # The relative path survives a move of reconstruction and images together, the absolute one
    # a move of the reconstruction alone.
    relative = Path(os.path.relpath(root, path.resolve())).as_posix()
    rows = zip(
        reconstruction.image_names,
        reconstruction.timestamps.tolist(),
        reconstruction.image_hashes,
        strict=True,
    )
    return {
        "format": FORMAT,
        "schema_version": SCHEMA_VERSION,
        "method": reconstruction.method,
        "scale_source": reconstruction.scale_source,
        "image_root": relative,
        "image_root_absolute": root.as_posix(),
        "images": [{"name": n, "timestamp": t, "sha256": h} for n, t, h in rows],
        "dropped": reconstruction.dropped,
        "base_from_camera": None if mount is None else mount.tolist(),
        "statistics": reconstruction.statistics,
        "provenance": dict(provenance),
    }


def _colmap_model_of(reconstruction: Reconstruction) -> ColmapModel:
    """The model as COLMAP numbers it: everything from 1, keypoints only where a point is seen."""
    camera_from_world = inverse(reconstruction.world_from_camera)
    images: list[ModelImage] = []
    keypoint_index = np.zeros(len(reconstruction.observations), dtype=np.int64)
    for index, name in enumerate(reconstruction.image_names):
        own = np.flatnonzero(reconstruction.observations[:, 1] == index)
        keypoint_index[own] = np.arange(len(own))
        images.append(
            ModelImage(
                index + 1,
                name,
                int(reconstruction.camera_index[index]) + 1,
                camera_from_world[index],
                reconstruction.observed_pixels[own],
                reconstruction.observations[own, 0] + 1,
            )
        )
    count = len(reconstruction.points)
    colors, errors = reconstruction.point_colors, reconstruction.point_errors
    points = ModelPoints(
        np.arange(1, count + 1),
        reconstruction.points,
        colors if len(colors) else np.full((count, 3), UNKNOWN_COLOR, dtype=np.uint8),
        errors if len(errors) else np.full(count, UNKNOWN_ERROR),
        np.column_stack(
            [
                reconstruction.observations[:, 0],
                reconstruction.observations[:, 1] + 1,
                keypoint_index,
            ]
        ),
    )
    cameras = {index + 1: camera for index, camera in enumerate(reconstruction.cameras)}
    return ColmapModel(cameras, tuple(images), points)


def load_reconstruction(path: PathLike) -> Reconstruction:
    """Reads a reconstruction; nothing in it is believed before it is checked.

    Args:
        path: folder made by ``reconstruct``.

    Raises:
        OptionError: ``path`` is no path.
        InputError: the folder is missing or is no reconstruction, a file is truncated, damaged or
            of the wrong types, or no image has a pose; the file is named.
    """
    path = checked_path(path, "the reconstruction's path")
    if not path.is_dir():
        reason = "is not a folder" if path.exists() else "does not exist"
        raise InputError(path, reason, "make a reconstruction with lfnav reconstruct")
    source = path / DESCRIPTION_NAME
    if not source.exists():
        raise InputError(path, f"is not a reconstruction (holds no {DESCRIPTION_NAME})")
    description = _read_description(source)
    _check_hashes(path, description.get("files", dict))
    model = read_model(path / MODEL_FOLDER)
    try:
        return _assemble(path, description, model)
    except OptionError as error:
        raise InputError(source, str(error)) from error


def _assemble(path: Path, fields: JsonFields, model: ColmapModel) -> Reconstruction:
    rows = fields.get("images", list)
    if not rows:
        raise InputError(fields.path, "the reconstruction holds no image with a pose")
    entries = [JsonFields(fields.path, row, f"images[{k}].") for k, row in enumerate(rows)]
    names = tuple(_checked_name(entry) for entry in entries)
    by_name = {image.name: image for image in model.images}
    if len(by_name) != len(model.images) or set(by_name) != set(names) or len(rows) != len(names):
        raise InputError(fields.path, f"its images are not those of {MODEL_FOLDER}/images.bin")
    images = [by_name[name] for name in names]
    if len(images) != len(model.images):
        raise InputError(fields.path, "names an image twice")
    timestamps = np.array([entry.number("timestamp") for entry in entries])
    if np.any(np.diff(timestamps) <= 0.0):
        raise InputError(fields.path, "the timestamps of the images do not increase")
    camera_numbers = list(model.cameras)
    observations, pixels = observations_of(model, images)
    return Reconstruction(
        method=fields.choice("method", METHODS),
        image_root=_image_root(path, fields, names[0]),
        image_names=names,
        image_hashes=tuple(entry.get("sha256", str) for entry in entries),
        timestamps=timestamps,
        cameras=tuple(model.cameras.values()),
        camera_index=np.array([camera_numbers.index(image.camera) for image in images]),
        world_from_camera=inverse(np.array([image.camera_from_world for image in images])),
        points=model.points.positions,
        observations=observations,
        base_from_camera=_mount(fields),
        scale_source=fields.choice("scale_source", SCALE_SOURCES),
        dropped=_texts(fields, "dropped"),
        statistics=fields.get("statistics", dict),
        observed_pixels=pixels,
        point_colors=model.points.colors,
        point_errors=model.points.errors,
    )


def observations_of(
    model: ColmapModel, images: Sequence[ModelImage]
) -> tuple[IntArray, FloatArray]:
    """The tracks of a model by the indices of points and images.

    Args:
        model: whose tracks.
        images: all images of the model, in the order that the indices shall follow.

    Returns:
        Rows (index of a point, index of an image), ``(M, 2)``, and where each observation lies in
        its image, ``(M, 2)`` pixels.
    """
    row_of_image = {image.identifier: row for row, image in enumerate(images)}
    tracks = model.points.tracks
    rows = np.array([row_of_image[number] for number in tracks[:, 1].tolist()], dtype=np.int64)
    pixels = np.empty((len(tracks), 2))
    for row, image in enumerate(images):
        own = rows == row
        pixels[own] = image.keypoints[tracks[own, 2]]
    return np.column_stack([tracks[:, 0], rows]), pixels


def _read_description(path: Path) -> JsonFields:
    fields = read_json_object(path, MAX_DESCRIPTION_BYTES)
    if fields.values.get("format") != FORMAT:
        raise InputError(path, "is not the description of a reconstruction made by lfnav")
    version = fields.get("schema_version", int)
    if version > SCHEMA_VERSION:
        raise InputError(
            path,
            f"was written by a newer lfnav (schema {version}, this one reads up to "
            f"{SCHEMA_VERSION})",
            "update lfnav",
        )
    if version < 1:
        raise InputError(path, f"schema_version {version} does not exist")
    return fields


def _check_hashes(path: Path, hashes: dict[str, Any]) -> None:
    for name in MODEL_FILES:
        key = f"{MODEL_FOLDER}/{name}"
        content = read_file(path / MODEL_FOLDER / name, MAX_MODEL_FILE_BYTES)
        if hashes.get(key) != sha256_of_bytes(content):
            raise InputError(
                path / MODEL_FOLDER / name,
                f"is damaged, or was changed after {DESCRIPTION_NAME} was written",
                "run lfnav reconstruct again",
            )


def _checked_name(entry: JsonFields) -> str:
    name = entry.get("name", str)
    parts = PurePosixPath(name).parts
    if not parts or PurePosixPath(name).is_absolute() or ".." in parts or "\0" in name:
        raise InputError(entry.path, f"{entry.prefix}name {quoted(name)} leads out of the folder")
    return name


def _image_root(path: Path, fields: JsonFields, first_name: str) -> Path:
    relative, absolute = fields.get("image_root", str), fields.get("image_root_absolute", str)
    if "\0" in relative + absolute:
        raise InputError(fields.path, "image_root holds a null character")
    together = Path(os.path.normpath(path.resolve() / relative))
    alone = Path(absolute)
    if not (together / first_name).is_file() and (alone / first_name).is_file():
        return alone
    return together


def _mount(fields: JsonFields) -> FloatArray | None:
    value = fields.values.get("base_from_camera")
    if value is None:
        return None
    try:
        mount = np.array(value, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        mount = np.empty(0)
    if mount.shape != (4, 4) or not np.all(are_rigid(mount, tolerance=1e-6)):
        raise InputError(fields.path, "base_from_camera is not a rigid 4x4 transform")
    return mount


def _texts(fields: JsonFields, key: str) -> dict[str, str]:
    values = fields.get(key, dict)
    if not all(isinstance(text, str) for text in values.values()):
        raise InputError(fields.path, f"{key} does not map names to reasons")
    return dict(values)
