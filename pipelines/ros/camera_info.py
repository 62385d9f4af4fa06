"""sensor_msgs/CameraInfo: the camera that took the images beside it.

A CameraInfo describes the whole sensor. Its images may show a part of it (``roi``), and less finely
(``binning_x``, ``binning_y``); what is returned is the camera of the images. Pixel centres lie at
integers in ROS as in lfnav.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.errors import InputError, OptionError, quoted, reason_of
from pipelines.geometry.camera import Camera

# ROS's name of a distortion model -> how many coefficients it may have.
DISTORTION_MODELS: dict[str, tuple[int, ...]] = {
    "plumb_bob": (0, 4, 5),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
    # What some drivers call the same.
    "fisheye": (4,),
    "": (0,),
}
_NO_DISTORTION: tuple[str, tuple[float, ...]] = ("PINHOLE", ())
# What cameras are wider than: a step of binning that is larger is no such number.
LARGEST_BINNING = 64


def camera_of_info(
    info: Any, image_size: tuple[int, int], name: Path | str, *, rectified: bool = False
) -> Camera:
    """The camera of images whose CameraInfo is given.

    Args:
        info: a sensor_msgs/CameraInfo of ROS 1 or 2.
        image_size: width and height of the images, pixels.
        name: the source of the message, for the error.
        rectified: whether the images were rectified, as those of topics like ``image_rect``: then
            the projection matrix describes them, and they have no distortion.

    Returns:
        OPENCV (``plumb_bob``, or FULL_OPENCV where it has a k3), FULL_OPENCV
        (``rational_polynomial``), OPENCV_FISHEYE (``equidistant``), or PINHOLE (rectified images,
        and those of a camera that states no distortion model).

    Raises:
        InputError: an uncalibrated camera, a distortion model that lfnav does not know, or images
            of another size than the message says.
    """
    try:
        fx, skew, cx, _, fy, cy = _numbers(info, "p" if rectified else "k")
        if rectified:
            model, distortion = _NO_DISTORTION
        else:
            model, distortion = _distortion(info, name)
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise InputError(name, f"is no usable CameraInfo ({reason_of(error)})") from error
    if fx == 0.0 and fy == 0.0:
        raise InputError(
            name,
            "the CameraInfo has no focal length: the camera was not calibrated",
            "calibrate it, or give --focal or --fov",
        )
    if abs(skew) > 1e-9 * abs(fx):
        raise InputError(name, f"the CameraInfo has skewed pixels (skew {skew:g})")
    (left, binning_x), (top, binning_y) = _placement(info, image_size, name)
    # A binned pixel is the mean of several, and its centre lies between theirs.
    pinhole = (
        fx / binning_x,
        fy / binning_y,
        (cx - left + 0.5) / binning_x - 0.5,
        (cy - top + 0.5) / binning_y - 0.5,
    )
    try:
        return Camera(model, *image_size, (*pinhole, *distortion))
    except OptionError as error:
        raise InputError(name, f"the CameraInfo is of no camera: {error}") from error


def info_key(info: Any) -> tuple[Any, ...]:
    """What of a CameraInfo is the camera: equal for two messages of the same one."""
    roi = info.roi
    return (
        int(info.width),
        int(info.height),
        str(info.distortion_model),
        *(tuple(float(value) for value in _field(info, key)) for key in ("d", "k", "r", "p")),
        int(info.binning_x),
        int(info.binning_y),
        *(int(value) for value in (roi.x_offset, roi.y_offset, roi.width, roi.height)),
    )


def is_rectified(topic: str) -> bool:
    """Whether the images of a topic were rectified, by the names that image_proc gives them.

    Args:
        topic: like ``/camera/image_rect_color`` or ``/camera/image_rect/compressed``.
    """
    parts = [part for part in topic.split("/") if part]
    names = parts[-2:] if parts and parts[-1] == "compressed" else parts[-1:]
    # RealSense calls images as they come from the sensor image_rect_raw: they are rectified, too.
    return any("rect" in name.split("_") for name in names)


def _field(info: Any, key: str) -> Sequence[float]:
    """ROS 1 writes the matrices in capitals."""
    value: Sequence[float] = (
        getattr(info, key) if hasattr(info, key) else getattr(info, key.upper())
    )
    return value


def _numbers(info: Any, key: str) -> list[float]:
    """The first two rows and three columns of K ``(3, 3)`` or P ``(3, 4)``."""
    matrix = np.asarray(_field(info, key), dtype=np.float64).reshape(3, -1)
    return [float(value) for value in matrix[:2, :3].reshape(6)]


def _distortion(info: Any, name: Path | str) -> tuple[str, tuple[float, ...]]:
    """COLMAP's name of the model, and its parameters after fx fy cx cy."""
    model = str(info.distortion_model)
    values = tuple(float(value) for value in _field(info, "d"))
    if model not in DISTORTION_MODELS:
        known = ", ".join(key for key in DISTORTION_MODELS if key)
        raise InputError(
            name, f"distortion model {quoted(model)} is not known", f"known are {known}"
        )
    if len(values) not in DISTORTION_MODELS[model]:
        raise InputError(name, f"distortion model {quoted(model)} has {len(values)} coefficients")
    if model in {"equidistant", "fisheye"}:
        return "OPENCV_FISHEYE", values
    if model == "rational_polynomial":
        if any(values[8:]):
            raise InputError(
                name, "the CameraInfo has coefficients of a thin prism, which lfnav does not know"
            )
        k1, k2, p1, p2, k3, k4, k5, k6 = values[:8]
        return "FULL_OPENCV", (k1, k2, p1, p2, k3, k4, k5, k6)
    if not model:
        return _NO_DISTORTION
    k1, k2, p1, p2, k3 = (*values, *[0.0] * (5 - len(values)))
    if k3 == 0.0:
        return "OPENCV", (k1, k2, p1, p2)
    return "FULL_OPENCV", (k1, k2, p1, p2, k3, 0.0, 0.0, 0.0)


def _placement(
    info: Any, image_size: tuple[int, int], name: Path | str
) -> tuple[tuple[int, int], tuple[int, int]]:
    """For columns and rows: the first pixel of the sensor that is shown, and the binning."""
    roi = info.roi
    sensor = (int(info.width), int(info.height))
    # All zeros mean the whole sensor, and no binning.
    shown = (int(roi.width) or sensor[0], int(roi.height) or sensor[1])
    offset = (int(roi.x_offset), int(roi.y_offset))
    binning = (int(info.binning_x) or 1, int(info.binning_y) or 1)
    if not all(1 <= step <= LARGEST_BINNING for step in binning):
        raise InputError(name, f"the CameraInfo has a binning of {binning[0]}x{binning[1]}")
    if any(
        start + length > full for start, length, full in zip(offset, shown, sensor, strict=True)
    ):
        raise InputError(
            name,
            f"the CameraInfo has a region of interest of {shown[0]}x{shown[1]} at "
            f"{offset[0]}, {offset[1]} in an image of {sensor[0]}x{sensor[1]}",
        )
    expected = (shown[0] // binning[0], shown[1] // binning[1])
    if expected != image_size:
        raise InputError(
            name,
            f"the images have {image_size[0]}x{image_size[1]} pixels, by their CameraInfo they "
            f"have {expected[0]}x{expected[1]}",
        )
    return (offset[0], binning[0]), (offset[1], binning[1])
