"""``camera.toml``: camera model, mount on the robot, scale of the depth images."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, OptionError, quoted
from pipelines.artifacts.toml_file import read_toml
from pipelines.geometry.camera import CAMERA_MODELS, Camera
from pipelines.geometry.pose import base_from_camera_mount, mount_of

_REQUIRED_KEYS = ("model", "width", "height", "params")
_OPTIONAL_KEYS = ("depth_scale", "mount")
_MOUNT_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")


@dataclass(frozen=True)
class CameraFile:
    """The content of a ``camera.toml``.

    Attributes:
        camera: model and calibration.
        base_from_camera: ``(4, 4)``, the mount; None where the body is the camera.
        depth_scale: value in a depth image / depth_scale = metres; None where not given.
    """

    camera: Camera
    base_from_camera: FloatArray | None
    depth_scale: float | None


def read_camera_file(path: Path) -> CameraFile:
    """Reads and checks a ``camera.toml``.

    Raises:
        InputError: unreadable, not TOML, a key missing, unknown or of the wrong type, an unknown
            model, or numbers that no camera has.
    """
    return camera_file_of(read_toml(path), path)


def camera_file_of(table: Mapping[str, Any], path: Path) -> CameraFile:
    """The content of a ``camera.toml`` from its keys and values, wherever they were read.

    Args:
        table: keys and values as TOML or JSON has them.
        path: what an error names.

    Raises:
        InputError: a key missing, unknown or of the wrong type, an unknown model, or numbers that
            no camera has.
    """
    _check_keys(path, table, _REQUIRED_KEYS, _OPTIONAL_KEYS, "")
    depth_scale = _number(path, table, "depth_scale") if "depth_scale" in table else None
    if depth_scale is not None and depth_scale <= 0.0:
        raise InputError(path, f"depth_scale = {depth_scale:g} is not positive")
    return CameraFile(_camera(path, table), _mount(path, table), depth_scale)


def format_camera_file(content: CameraFile) -> str:
    """The text of a ``camera.toml``; ``read_camera_file`` reads it back."""
    camera = content.camera
    params = ", ".join(repr(float(value)) for value in camera.params)
    lines = [
        f'model = "{camera.model}"',
        f"width = {camera.width}",
        f"height = {camera.height}",
        f"params = [{params}]  # {' '.join(CAMERA_MODELS[camera.model])}",
    ]
    if content.depth_scale is not None:
        lines.append(f"depth_scale = {float(content.depth_scale)!r}")
    if content.base_from_camera is not None:
        position, angles_deg = mount_of(content.base_from_camera)
        lines += ["", "[mount]  # metres and degrees"]
        values = (*position.tolist(), *angles_deg.tolist())
        lines += [f"{key} = {value!r}" for key, value in zip(_MOUNT_KEYS, values, strict=True)]
    return "\n".join(lines) + "\n"


def _camera(path: Path, table: Mapping[str, Any]) -> Camera:
    model, params = table["model"], table["params"]
    if not isinstance(model, str):
        raise InputError(path, "model is not a text", 'write model = "OPENCV", for example')
    if not isinstance(params, list):
        raise InputError(path, "params is not a list of numbers")
    numbers = tuple(_number(path, {"params": value}, "params") for value in params)
    for key in ("width", "height"):
        # TOML's true is a bool, which Python takes for the integer 1.
        if type(table[key]) is not int:
            raise InputError(path, f"{key} is not a whole number")
    try:
        return Camera(model, table["width"], table["height"], numbers)
    except OptionError as error:
        raise InputError(path, str(error)) from error


def _mount(path: Path, table: Mapping[str, Any]) -> FloatArray | None:
    if "mount" not in table:
        return None
    mount = table["mount"]
    if not isinstance(mount, dict):
        raise InputError(path, "mount is not a table", "write [mount] and its keys below")
    _check_keys(path, mount, _MOUNT_KEYS, (), "mount.")
    x, y, z, roll, pitch, yaw = (_number(path, mount, key, "mount.") for key in _MOUNT_KEYS)
    return base_from_camera_mount((x, y, z), (roll, pitch, yaw))


def _check_keys(
    path: Path,
    table: Mapping[str, Any],
    required: tuple[str, ...],
    optional: tuple[str, ...],
    prefix: str,
) -> None:
    for key in required:
        if key not in table:
            raise InputError(path, f"{prefix}{key} is missing")
    for key in table:
        # A misspelt key would otherwise be ignored in silence.
        if key not in required + optional:
            known = ", ".join(required + optional)
            raise InputError(path, f"unknown key {prefix}{key}", f"known are {known}")


def _number(path: Path, table: Mapping[str, Any], key: str, prefix: str = "") -> float:
    value = table[key]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(path, f"{prefix}{key}: {quoted(value)} is not a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(path, f"{prefix}{key}: {value} is not finite")
    return number
