"""LLFF's ``poses_bounds.npy`` (Mildenhall et al. 2019) with the photos beside it.

A row an image: a 3x5 matrix, whose first four columns are world_from_camera with the camera's axes
down, right, backwards, and whose fifth is height, width and focal length in pixels; then the
nearest and the farthest depth. The world is that of structure from motion: nothing in it is up, and
its unit is none. Programs that read it make the nearest depth ``1 / bd_factor`` of a unit.
"""

from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, OptionError, reason_of
from pipelines.dataset.dataset import images_in
from pipelines.dataset.images import read_image_header
from pipelines.dataset.importers.nerfstudio import PIXEL_CENTRE_SHIFT
from pipelines.dataset.importers.pose_matrix import rigid_pose
from pipelines.dataset.importers.recording import IMAGE_FOLDER, Recording, SourceFrame, name_below
from pipelines.geometry.camera import Camera

POSES = "poses_bounds.npy"
MAX_POSES_BYTES = 64 * 1024**2
COLUMNS = 17
# Folders of the photos, the largest ones first.
PHOTO_FOLDERS = ("images", "images_2", "images_4", "images_8", "")
# LLFF's default: its programs make the nearest depth 1 / 0.75 of a unit.
BD_FACTOR = 0.75
# Share by which the two sides may be reduced differently, by rounding to pixels.
SAME_REDUCTION = 0.01


def read_llff(source: Path) -> Recording:
    """Reads the photos in the order of their names, which is that of the poses.

    Raises:
        InputError: no photos, not as many as poses, or poses that are malformed.
    """
    path = source / POSES
    rows = _rows(path)
    folder, names = _photos(source, len(rows))
    header = read_image_header(folder / names[0])
    cameras: dict[Camera, int] = {}
    frames, poses = [], []
    for number, (name, row) in enumerate(zip(names, rows, strict=True)):
        matrix = row[:15].reshape(3, 5)
        # Right, down, forward of down, right, backwards.
        turned = np.stack([matrix[:, 1], matrix[:, 0], -matrix[:, 2], matrix[:, 3]], axis=1)
        poses.append(rigid_pose(path, turned, f"the pose of row {number}"))
        camera = _camera(path, number, matrix[:, 4], (header.width, header.height))
        frames.append(
            SourceFrame(
                folder / name,
                name_below(IMAGE_FOLDER, name, path),
                float(number),
                camera=cameras.setdefault(camera, len(cameras)),
            )
        )
    nearest = float(rows[:, 15].min())
    notes = [f"photos of {folder.name}/; the nearest depth of the source is {nearest:.3g} units"]
    if nearest > 0.0:
        scale = 1.0 / (nearest * BD_FACTOR)
        notes.append(f"--scale {scale:.6g} gives the units of LLFF's own programs")
    return Recording(tuple(frames), tuple(cameras), np.stack(poses), notes=tuple(notes))


def _rows(path: Path) -> FloatArray:
    """``(N, 17)`` finite numbers."""
    try:
        if path.stat().st_size > MAX_POSES_BYTES:
            raise InputError(path, f"is larger than {MAX_POSES_BYTES} bytes")
        # Mapped: a header that promises more than the file holds allocates nothing.
        rows = np.array(np.load(path, mmap_mode="r", allow_pickle=False), dtype=np.float64)
    except (OSError, ValueError, TypeError, EOFError, SyntaxError) as error:
        raise InputError(path, f"is no array of NumPy ({reason_of(error)})") from error
    if rows.ndim != 2 or rows.shape[1] != COLUMNS or len(rows) == 0:
        raise InputError(path, f"has shape {rows.shape} instead of (images, {COLUMNS})")
    if not np.all(np.isfinite(rows)):
        raise InputError(path, "holds a number that is not finite")
    return rows


def _photos(source: Path, count: int) -> tuple[Path, tuple[str, ...]]:
    """The folder with as many photos as there are poses; the largest photos first."""
    found = {}
    for name in PHOTO_FOLDERS:
        folder = source / name
        if folder.is_dir() and (names := tuple(sorted(images_in(folder)))):
            if len(names) == count:
                return folder, names
            found[name or "the folder"] = len(names)
    if not found:
        raise InputError(source, "holds no photos in images/")
    counts = ", ".join(f"{number} in {name}" for name, number in found.items())
    raise InputError(source / POSES, f"has {count} poses, but there are photos: {counts}")


def _camera(path: Path, number: int, size_and_focal: FloatArray, size: tuple[int, int]) -> Camera:
    height, width, focal = size_and_focal.tolist()
    if min(height, width, focal) <= 0.0:
        raise InputError(path, f"row {number}: height, width or focal length is not positive")
    across, down = size[0] / width, size[1] / height
    if abs(across / down - 1.0) > SAME_REDUCTION:
        raise InputError(
            path,
            f"row {number} is of {width:g}x{height:g} pixels, the photos are {size[0]}x{size[1]}",
        )
    centre = (size[0] / 2.0 - PIXEL_CENTRE_SHIFT, size[1] / 2.0 - PIXEL_CENTRE_SHIFT)
    try:
        return Camera("SIMPLE_PINHOLE", *size, (focal * across, *centre))
    except OptionError as error:
        raise InputError(path, f"row {number}: {error}") from error
