"""The KITTI odometry benchmark (Geiger, Lenz, Urtasun 2012): rectified cameras on a car.

``calib.txt`` has a projection matrix ``P0`` ... ``P3`` for each camera, ``poses/NN.txt`` a line
an image with the first three rows of the pose of camera 0, relative to its first one. The world
here is REP-103's: x where the car looks at first, y left, z up, and the road below the first
camera is z = 0. The body is the point of the road below the imported camera.
"""

import re
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, OptionError
from pipelines.artifacts.file_content import read_text_file
from pipelines.dataset.dataset import images_in
from pipelines.dataset.images import read_image_header
from pipelines.dataset.importers.pose_matrix import read_number_rows, rigid_pose
from pipelines.dataset.importers.recording import IMAGE_FOLDER, Recording, SourceFrame
from pipelines.dataset.importers.settings import KITTI_CAMERAS, ImportSettings
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import base_from_camera_mount, inverse

MAX_TEXT_BYTES = 64 * 1024**2
# Metres; the sensor setup page of the benchmark says so.
CAMERA_HEIGHT = 1.65
# Which camera is taken where none is named: the left colour one, else the left grey one.
PREFERRED_CAMERAS = ("image_2", "image_0", "image_3", "image_1")


def read_kitti(source: Path, settings: ImportSettings) -> Recording:
    """Reads one camera of one sequence.

    Args:
        source: the folder of a sequence, or the one that holds ``sequences/`` and ``poses/``.
        settings: ``sequence``, ``camera`` and ``camera_height`` where the defaults do not do.

    Raises:
        InputError: a file is missing, damaged, or has fewer lines than there are images.
        OptionError: several sequences and none is named.
    """
    folder = _sequence_folder(source, settings.sequence)
    camera_folder = _camera_folder(folder, settings.camera)
    names = [name for name in images_in(camera_folder) if re.fullmatch(r"[0-9]{1,9}\.\w+", name)]
    if not names:
        raise InputError(camera_folder, "holds no images that are named by their number")
    indices = [int(name.split(".")[0]) for name in names]
    times = _times(folder / "times.txt", indices)
    projection = _projection(folder / "calib.txt", camera_folder.name[-1])
    header = read_image_header(camera_folder / names[0])
    focal_x, focal_y, centre_x, centre_y = projection[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
    params = (focal_x, focal_y, centre_x, centre_y)
    try:
        camera = Camera("PINHOLE", header.width, header.height, params)
    except OptionError as error:
        raise InputError(folder / "calib.txt", str(error)) from error
    height = CAMERA_HEIGHT if settings.camera_height is None else settings.camera_height
    mount = base_from_camera_mount((0.0, 0.0, height), (0.0, 0.0, 0.0))
    poses_file = _poses_file(folder)
    notes = [f"{camera_folder.name} of sequence {folder.name}, camera {height:g} m above the road"]
    poses: FloatArray | None = None
    if poses_file is None:
        notes.append("no poses: the benchmark gives them for sequences 00 to 10 only")
    else:
        camera_from_first_camera = np.eye(4)
        camera_from_first_camera[:3, 3] = np.linalg.solve(projection[:, :3], projection[:, 3])
        kitti_from_first_camera = _poses(poses_file, indices)
        poses = mount @ kitti_from_first_camera @ inverse(camera_from_first_camera)
    frames = tuple(
        SourceFrame(camera_folder / name, f"{IMAGE_FOLDER}/{name}", time)
        for name, time in zip(names, times, strict=True)
    )
    return Recording(frames, (camera,), poses, base_from_camera=mount, notes=tuple(notes))


def _sequence_folder(source: Path, sequence: str | None) -> Path:
    source = source.absolute()
    if (source / "calib.txt").is_file():
        if sequence not in (None, source.name):
            raise OptionError(f"--sequence {sequence}: {source} is the folder of a sequence")
        return source
    above = source / "sequences"
    if not above.is_dir():
        raise InputError(source, "holds neither calib.txt nor sequences/", "give a sequence")
    there = sorted(path.name for path in above.iterdir() if (path / "calib.txt").is_file())
    if not there:
        raise InputError(above, "holds no sequence with a calib.txt")
    if sequence is None:
        if len(there) > 1:
            raise OptionError(f"{above} holds {', '.join(there)}; name one with --sequence")
        return above / there[0]
    if sequence not in there:
        raise OptionError(f"--sequence {sequence}: {above} holds {', '.join(there)}")
    return above / sequence


def _camera_folder(folder: Path, camera: str | None) -> Path:
    if camera is not None:
        if not (folder / camera).is_dir():
            raise InputError(folder / camera, "is not there")
        return folder / camera
    for name in PREFERRED_CAMERAS:
        if (folder / name).is_dir():
            return folder / name
    raise InputError(folder, f"holds none of {', '.join(KITTI_CAMERAS)}")


def _poses_file(folder: Path) -> Path | None:
    for path in (folder.parent.parent / "poses" / f"{folder.name}.txt", folder / "poses.txt"):
        if path.is_file():
            return path
    return None


def _times(path: Path, indices: list[int]) -> list[float]:
    rows = read_number_rows(path, read_text_file(path, MAX_TEXT_BYTES), 1)
    _check_lines(path, len(rows), indices)
    times = rows[indices, 0]
    if np.any(np.diff(times) <= 0.0):
        raise InputError(path, "the times of the images do not increase")
    return [float(time) for time in times]


def _poses(path: Path, indices: list[int]) -> FloatArray:
    rows = read_number_rows(path, read_text_file(path, MAX_TEXT_BYTES), 12)
    _check_lines(path, len(rows), indices)
    return np.stack(
        [rigid_pose(path, rows[index].reshape(3, 4), f"line {index + 1}") for index in indices]
    )


def _check_lines(path: Path, count: int, indices: list[int]) -> None:
    if max(indices) >= count:
        raise InputError(path, f"has {count} lines, but there is an image number {max(indices)}")


def _projection(path: Path, number: str) -> FloatArray:
    """``(3, 4)``: the matrix of camera ``number``."""
    for line in read_text_file(path, MAX_TEXT_BYTES).splitlines():
        key, _, values = line.partition(":")
        if key.strip() != f"P{number}":
            continue
        matrix = read_number_rows(path, values, 12).reshape(-1, 4)
        if matrix.shape != (3, 4):
            raise InputError(path, f"P{number} is not a 3x4 matrix")
        if not np.allclose(matrix[[0, 1, 2, 2], [1, 0, 0, 1]], 0.0) or matrix[2, 2] != 1.0:
            raise InputError(path, f"P{number} is not the matrix of a rectified camera")
        if matrix[0, 0] <= 0.0 or matrix[1, 1] <= 0.0:
            raise InputError(path, f"P{number} has a focal length that is not positive")
        return matrix
    raise InputError(path, f"holds no P{number}")
