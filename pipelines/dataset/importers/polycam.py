"""Polycam's raw data: ``keyframes/images``, and a camera file for each in ``keyframes/cameras``.

A camera file has the first three rows of world_from_camera as ``t_00`` to ``t_23`` in ARKit's axes,
and the photo's own intrinsics. Where Polycam has adjusted the poses, ``corrected_images`` and
``corrected_cameras`` hold those.
"""

from pathlib import Path

import numpy as np

from pipelines.artifacts.errors import InputError
from pipelines.artifacts.json_fields import JsonFields, read_json_object
from pipelines.dataset.dataset import images_in
from pipelines.dataset.importers.arkit import pinhole_of_photo, poses_with_z_up
from pipelines.dataset.importers.pose_matrix import rigid_pose
from pipelines.dataset.importers.recording import IMAGE_FOLDER, Recording, SourceFrame, name_below
from pipelines.geometry.camera import Camera

# The adjusted ones first.
FOLDERS = (("corrected_images", "corrected_cameras"), ("images", "cameras"))
MAX_CAMERA_BYTES = 1024**2


def find_keyframes(source: Path) -> tuple[Path, Path] | None:
    """The folders of photos and cameras below ``source``; None where there are none."""
    for folder in (source / "keyframes", source):
        for images, cameras in FOLDERS:
            if (folder / images).is_dir() and any((folder / cameras).glob("*.json")):
                return folder / images, folder / cameras
    return None


def read_polycam(source: Path) -> Recording:
    """Reads the photos that have a camera file, in the order of their names.

    Raises:
        InputError: no such photos, or a camera file that is malformed.
    """
    found = find_keyframes(source)
    if found is None:
        raise InputError(source, "holds no keyframes/images with keyframes/cameras")
    photos, camera_folder = found
    names = images_in(photos)
    used = [name for name in names if (camera_folder / f"{Path(name).stem}.json").is_file()]
    if not used:
        raise InputError(photos, f"holds no photo that has a file in {camera_folder.name}")
    cameras: dict[Camera, int] = {}
    frames, poses = [], []
    for number, name in enumerate(used):
        fields = read_json_object(camera_folder / f"{Path(name).stem}.json", MAX_CAMERA_BYTES)
        rows = [[fields.number(f"t_{row}{column}") for column in range(4)] for row in range(3)]
        poses.append(rigid_pose(fields.path, rows, "t_00 to t_23"))
        camera = cameras.setdefault(_camera(fields, photos / name), len(cameras))
        frames.append(
            SourceFrame(
                photos / name,
                name_below(IMAGE_FOLDER, name, photos),
                float(number),
                camera=camera,
            )
        )
    placed, note = poses_with_z_up(np.stack(poses))
    notes = [f"photos of {photos.name}", note]
    if len(used) < len(names):
        without = len(names) - len(used)
        notes.append(f"{without} of {len(names)} photos have no camera file and are left out")
    return Recording(tuple(frames), tuple(cameras), placed, notes=tuple(notes))


def _camera(fields: JsonFields, photo: Path) -> Camera:
    fx, fy, cx, cy = (fields.number(key) for key in ("fx", "fy", "cx", "cy"))
    size = (fields.number("width"), fields.number("height"))
    return pinhole_of_photo(fields.path, photo, size, (fx, fy, cx, cy))
