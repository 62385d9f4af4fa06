"""Writing a recording as the files of a data set, into a folder that is not published yet."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.provenance import sha256_of_bytes
from pipelines.artifacts.stages import Progress
from pipelines.dataset.camera_file import CameraFile, format_camera_file
from pipelines.dataset.dataset import CAMERA_FILE, DEPTH_LIST, GROUNDTRUTH_FILE, IMAGE_LIST
from pipelines.dataset.images import (
    decode_depth,
    decode_image,
    encode_depth,
    image_header,
    read_image_bytes,
)
from pipelines.dataset.importers.recording import (
    DEPTH_FOLDER,
    Recording,
    first_duplicate,
)
from pipelines.geometry.pose import inverse
from pipelines.geometry.trajectory import Trajectory, format_tum


def place_images(
    folder: Path, recording: Recording, *, link: bool, decode: bool, progress: Progress
) -> tuple[str, ...]:
    """Copies the images as they are, and compares their sizes with the cameras'.

    Args:
        folder: the future data set.
        recording: the images; those that lie in ``folder`` already stay there.
        link: make hard links where the file system allows it.
        decode: decode each image, so that damage is found now.
        progress: told how far the work is.

    Returns:
        SHA-256 of each image.

    Raises:
        InputError: an image is damaged, of another size than its camera, or named like another.
    """
    double = first_duplicate([frame.name for frame in recording.frames])
    if double is not None:
        raise InputError(folder, f"two images of the source would both be {double}")
    hashes: list[str] = []
    size: tuple[int, int] | None = None
    for frame in progress(recording.frames, "images", len(recording.frames)):
        data = read_image_bytes(frame.file)
        header = image_header(data, frame.file)
        if recording.cameras:
            camera = recording.cameras[frame.camera]
            size = (camera.width, camera.height)
        elif size is None:
            size = (header.width, header.height)
        if (header.width, header.height) != size:
            raise InputError(
                frame.file,
                f"is {header.width}x{header.height} pixels, its camera {size[0]}x{size[1]}",
            )
        if decode:
            decode_image(data, frame.file)
        _place(folder / frame.name, frame.file, data, link)
        hashes.append(sha256_of_bytes(data))
    return tuple(hashes)


def _place(target: Path, source: Path, data: bytes, link: bool) -> None:
    if target == source:
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    if link:
        try:
            # A link to a symbolic link would end with the folder that it points into.
            os.link(source.resolve(), target)
        except OSError:
            link = False  # another file system, or one without links
    if not link:
        target.write_bytes(data)


def place_depth(folder: Path, recording: Recording, progress: Progress) -> None:
    """Copies the depth images, unknown depth becoming 0, and writes ``depth.txt``.

    Raises:
        InputError: one is damaged, not of 16 bits, or of another size than its camera.
    """
    with_depth = [(frame, frame.depth) for frame in recording.frames if frame.depth is not None]
    if not with_depth:
        return
    names = [f"{DEPTH_FOLDER}/{file.name}" for _, file in with_depth]
    double = first_duplicate(names)
    if double is not None:
        raise InputError(folder, f"two depth images of the source would both be {double}")
    (folder / DEPTH_FOLDER).mkdir()
    for frame, file in progress(with_depth, "depth images", len(with_depth)):
        data = read_image_bytes(file)
        depth = decode_depth(data, file)
        camera = recording.cameras[frame.camera]
        if depth.shape != (camera.height, camera.width):
            height, width = depth.shape
            raise InputError(
                file,
                f"is {width}x{height} pixels, its camera {camera.width}x{camera.height}",
            )
        if recording.depth_invalid is not None and (depth == recording.depth_invalid).any():
            depth[depth == recording.depth_invalid] = 0
            data = encode_depth(depth)
        (folder / DEPTH_FOLDER / file.name).write_bytes(data)
    times = [frame.timestamp for frame, _ in with_depth]
    (folder / DEPTH_LIST).write_text(format_list(times, names), encoding="utf-8")


def write_lists(folder: Path, recording: Recording, world_from_camera: FloatArray | None) -> None:
    """Writes ``rgb.txt``, ``camera.toml`` where there is one camera, ``groundtruth.txt``.

    Args:
        folder: the future data set.
        recording: images, cameras and mount.
        world_from_camera: ``(N, 4, 4)``, or None without poses.
    """
    times = [frame.timestamp for frame in recording.frames]
    names = [frame.name for frame in recording.frames]
    (folder / IMAGE_LIST).write_text(format_list(times, names), encoding="utf-8")
    if len(recording.cameras) == 1:
        content = CameraFile(
            recording.cameras[0], recording.base_from_camera, recording.depth_scale
        )
        (folder / CAMERA_FILE).write_text(format_camera_file(content), encoding="utf-8")
    if world_from_camera is None:
        return
    world_from_body = world_from_camera
    if recording.base_from_camera is not None:
        world_from_body = world_from_camera @ inverse(recording.base_from_camera)
    trajectory = Trajectory(np.array(times), world_from_body)
    (folder / GROUNDTRUTH_FILE).write_text(format_tum(trajectory), encoding="utf-8")


def format_list(timestamps: Sequence[float], names: Sequence[str]) -> str:
    """The text of ``rgb.txt`` or ``depth.txt``."""
    lines = [f"{time:.9f} {name}" for time, name in zip(timestamps, names, strict=True)]
    return "\n".join(["# timestamp filename", *lines]) + "\n"
