"""The EuRoC MAV benchmark (Burri et al. 2016), and what is laid out like it: TUM-VI, ASL datasets.

Images of one camera are in ``mav0/cam0/data``; ``data.csv`` beside it has their times in
nanoseconds and their names, which are these times too. ``sensor.yaml`` has the camera and its place
on the body; ``state_groundtruth_estimate0``, ``mocap0`` or ``vicon0`` has poses of the body.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, OptionError, quoted
from pipelines.artifacts.file_content import read_text_file
from pipelines.dataset.dataset import images_in
from pipelines.dataset.image_list import MAX_LIST_BYTES, read_image_list
from pipelines.dataset.importers.pose_matrix import rigid_pose
from pipelines.dataset.importers.recording import IMAGE_FOLDER, Recording, SourceFrame, name_below
from pipelines.geometry.camera import Camera
from pipelines.geometry.interpolation import poses_at_times
from pipelines.geometry.time_units import hint_on_times, in_seconds, unit_of_times
from pipelines.geometry.trajectory import read_tum

CAMERA, LIST, SENSOR = "cam0", "data.csv", "sensor.yaml"
TRUTHS = ("state_groundtruth_estimate0", "groundtruth", "mocap0", "vicon0", "leica0")
MAX_SENSOR_BYTES = 1024**2
# Distortion of sensor.yaml -> COLMAP's name of the camera model.
DISTORTIONS = {
    "radial-tangential": "OPENCV",
    "radtan": "OPENCV",
    "plumb_bob": "OPENCV",
    "equidistant": "OPENCV_FISHEYE",
    "equi": "OPENCV_FISHEYE",
    "none": "PINHOLE",
}


@dataclass(frozen=True)
class _Sensor:
    """What ``sensor.yaml`` says: the camera, and body_from_camera ``(4, 4)``."""

    camera: Camera
    body_from_camera: FloatArray


def find_recording(source: Path) -> Path | None:
    """The folder that holds ``cam0``: ``source`` or its ``mav0``; None where there is none."""
    for folder in (source, source / "mav0"):
        if (folder / CAMERA / "data").is_dir() or (folder / CAMERA / LIST).is_file():
            return folder
    return None


def read_euroc(source: Path) -> Recording:
    """Reads the images of ``cam0``, the camera, and poses of the camera where the truth has them.

    Raises:
        InputError: no images, or a list, sensor or ground truth that is malformed.
    """
    folder = find_recording(source)
    if folder is None:
        raise InputError(source, f"holds no mav0/{CAMERA}/data")
    times, names, notes = _images(folder / CAMERA)
    sensor = _sensor(folder / CAMERA / SENSOR)
    if sensor is None:
        notes.append(f"no {CAMERA}/{SENSOR}: say in camera.toml what the camera is")
    truth = next(
        (folder / name / LIST for name in TRUTHS if (folder / name / LIST).is_file()), None
    )
    poses: FloatArray | None = None
    if truth is not None and sensor is not None:
        trajectory = read_tum(truth)
        found = poses_at_times(trajectory, times)
        if not np.any(found.is_known):
            hint = hint_on_times(times, trajectory.timestamps)
            raise InputError(truth, "has no pose at any image", hint)
        poses = found.poses[found.is_known] @ sensor.body_from_camera
        left_out = int(np.count_nonzero(~found.is_known))
        if left_out:
            notes.append(f"{left_out} images before, after or in gaps of the truth are left out")
        times, names = (
            times[found.is_known],
            [name for name, known in zip(names, found.is_known, strict=True) if known],
        )
        notes.append(f"poses of the camera: those of {truth.parent.name}, interpolated")
    elif truth is not None:
        notes.append(f"the poses of {truth.parent.name} are not taken: where is the camera?")
    data = folder / CAMERA / "data"
    frames = tuple(
        SourceFrame(data / name, name_below(IMAGE_FOLDER, name, data), float(time))
        for time, name in zip(times, names, strict=True)
    )
    cameras = () if sensor is None else (sensor.camera,)
    return Recording(frames, cameras, poses, notes=tuple(notes))


def _images(folder: Path) -> tuple[FloatArray, list[str], list[str]]:
    """Times ``(N,)`` in seconds, names in ``data/``, and notes."""
    data = folder / "data"
    if (folder / LIST).is_file() and _has_entries(folder / LIST):
        times, names = read_image_list(data, f"../{LIST}")
        return times, list(names), []
    named = [name for name in images_in(data) if Path(name).stem.isdecimal()]
    if not named:
        raise InputError(data, f"holds no images, and {LIST} names none")
    named.sort(key=lambda name: int(Path(name).stem))
    recorded = np.array([float(Path(name).stem) for name in named])
    times = in_seconds(recorded, unit_of_times(recorded))
    if np.any(np.diff(times) <= 0.0):
        # Too fine for numbers of 64 bits: counted from the first image.
        first = int(Path(named[0]).stem)
        recorded = np.array([float(int(Path(name).stem) - first) for name in named])
        times = in_seconds(recorded, 1e-9)
    return times, named, [f"{LIST} names no images: times are those in the names of the images"]


def _has_entries(path: Path) -> bool:
    lines = read_text_file(path, MAX_LIST_BYTES).splitlines()
    return any(line.strip() and not line.lstrip().startswith("#") for line in lines)


def _sensor(path: Path) -> _Sensor | None:
    """Reads the few values of a sensor file that matter; None where there is no file."""
    if not path.is_file():
        return None
    text = read_text_file(path, MAX_SENSOR_BYTES)
    size, focal = _list(path, text, "resolution", 2), _list(path, text, "intrinsics", 4)
    match = re.search(r"(?m)^\s*distortion_model\s*:\s*[\"']?([\w-]+)", text)
    model = "none" if match is None else match[1]
    if model not in DISTORTIONS:
        known = ", ".join(DISTORTIONS)
        raise InputError(path, f"distortion_model {quoted(model)} is unknown", f"known: {known}")
    distortion = () if model == "none" else _list(path, text, "distortion_coefficients", 4)
    try:
        camera = Camera(DISTORTIONS[model], int(size[0]), int(size[1]), (*focal, *distortion))
    except OptionError as error:
        raise InputError(path, str(error)) from error
    placed = text[text.find("T_BS") :] if "T_BS" in text else ""
    pose = np.eye(4) if not placed else np.array(_list(path, placed, "data", 16)).reshape(4, 4)
    return _Sensor(camera, rigid_pose(path, pose, "T_BS"))


def _list(path: Path, text: str, key: str, count: int) -> tuple[float, ...]:
    """The numbers of ``key: [1, 2, 3]``, which may go over several lines."""
    match = re.search(rf"(?m)^\s*{key}\s*:\s*\[([^\]]*)\]", text)
    if match is None:
        raise InputError(path, f"has no {key}: [...]")
    try:
        values = tuple(float(value) for value in match[1].split(","))
    except ValueError:
        values = ()
    if len(values) != count or not np.all(np.isfinite(values)):
        raise InputError(path, f"{key} is not made of {count} numbers")
    return values
