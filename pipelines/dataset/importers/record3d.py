"""Record3D's export: ``metadata.json`` and numbered photos in ``rgb/``.

``poses`` are ARKit's, a frame each as ``qx qy qz qw x y z``; ``K`` is the matrix of the camera,
column by column.
"""

from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.json_fields import JsonFields, read_json_object
from pipelines.dataset.dataset import images_in
from pipelines.dataset.images import read_image_header
from pipelines.dataset.importers.arkit import pinhole_of_photo, poses_with_z_up
from pipelines.dataset.importers.recording import IMAGE_FOLDER, Recording, SourceFrame, name_below
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import pose_from_quaternion
from pipelines.geometry.trajectory import QUATERNION_TOLERANCE

METADATA, PHOTOS = "metadata.json", "rgb"
MAX_METADATA_BYTES = 256 * 1024**2
FRAMES_A_SECOND = 60.0


def is_record3d(source: Path) -> bool:
    """Whether a folder holds an export of Record3D."""
    return (source / METADATA).is_file() and (source / PHOTOS).is_dir()


def read_record3d(source: Path) -> Recording:
    """Reads an export.

    Raises:
        InputError: no photos, none with a pose, or metadata that are malformed.
    """
    path = source / METADATA
    fields = read_json_object(path, MAX_METADATA_BYTES)
    poses = _poses(fields)
    numbered = {
        int(Path(name).stem): name
        for name in images_in(source / PHOTOS)
        if Path(name).stem.isdecimal()
    }
    numbers = sorted(number for number in numbered if number < len(poses))
    if not numbers:
        raise InputError(source / PHOTOS, "holds no photo 0.jpg, 1.jpg, ... that has a pose")
    times, how = _times(fields, len(poses))
    camera = _camera(fields, source / PHOTOS / numbered[numbers[0]])
    frames = tuple(
        SourceFrame(
            source / PHOTOS / numbered[number],
            name_below(IMAGE_FOLDER, numbered[number], path),
            float(times[number]),
        )
        for number in numbers
    )
    placed, note = poses_with_z_up(poses[numbers])
    notes = [how, note]
    without = len(numbered) - len(numbers)
    if without:
        notes.append(f"{without} of {len(numbered)} photos have no pose and are left out")
    if (source / "depth").is_dir():
        notes.append("depth of this source is not imported")
    return Recording(frames, (camera,), placed, notes=tuple(notes))


def _numbers(fields: JsonFields, key: str, columns: int) -> FloatArray:
    try:
        values = np.array(fields.get(key, list), dtype=np.float64).reshape(-1, columns)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(fields.path, f"{key} is not made of {columns} numbers each") from error
    if not np.all(np.isfinite(values)):
        raise InputError(fields.path, f"{key} holds a number that is not finite")
    return values


def _poses(fields: JsonFields) -> FloatArray:
    """``(N, 4, 4)`` world_from_camera in the axes of OpenGL."""
    rows = _numbers(fields, "poses", 7)
    lengths = np.linalg.norm(rows[:, :4], axis=1)
    off = np.abs(lengths - 1.0) > QUATERNION_TOLERANCE
    if np.any(off):
        first = int(np.argmax(off))
        raise InputError(
            fields.path,
            f"poses[{first}]: the quaternion has length {lengths[first]:.4f} instead of 1",
        )
    return pose_from_quaternion(rows[:, 4:], rows[:, :4])


def _times(fields: JsonFields, count: int) -> tuple[FloatArray, str]:
    """Seconds of the frames, and where they come from."""
    if fields.values.get("frameTimestamps") is not None:
        times = _numbers(fields, "frameTimestamps", 1)[:, 0]
        if len(times) == count and np.all(np.diff(times) > 0.0):
            return times, "times from frameTimestamps"
    rate = fields.number("fps") if fields.values.get("fps") is not None else FRAMES_A_SECOND
    if rate <= 0.0:
        raise InputError(fields.path, f"fps {rate:g} is not positive")
    return np.arange(count) / rate, f"times from the frame numbers at {rate:g} images a second"


def _camera(fields: JsonFields, photo: Path) -> Camera:
    matrix = _numbers(fields, "K", 9).reshape(3, 3)
    # Column by column; where somebody wrote rows, the last one is 0 0 1.
    if matrix[2, 0] != 0.0 or matrix[2, 1] != 0.0:
        matrix = matrix.T
    header = read_image_header(photo)
    width = fields.number("w") if "w" in fields.values else float(header.width)
    height = fields.number("h") if "h" in fields.values else float(header.height)
    params = (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])
    return pinhole_of_photo(fields.path, photo, (width, height), params)
