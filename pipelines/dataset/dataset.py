"""Data sets: images in time order, their camera, odometry and ground truth.

The layout is that of the TUM RGB-D benchmark: ``rgb.txt`` (timestamp and file name a line) and the
images it names, and optionally ``camera.toml``, ``odometry.txt``, ``groundtruth.txt``,
``depth.txt`` and ``mask.png``. A plain folder of images is a data set too; its timestamps are 0, 1,
2, ...
"""

import logging
import math
import os
import re
import stat
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from pipelines.artifacts.arguments import PathLike, checked_index, checked_path
from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import InputError, quoted, reason_of
from pipelines.artifacts.file_content import is_file, read_text_file
from pipelines.artifacts.kinds import is_bag
from pipelines.dataset.camera_file import CameraFile, read_camera_file
from pipelines.dataset.images import (
    IMAGE_SUFFIXES,
    decode_image,
    read_image_bytes,
    read_image_header,
)
from pipelines.dataset.mask import MASK_FILE, Mask, read_mask
from pipelines.geometry.camera import Camera
from pipelines.geometry.trajectory import Trajectory, read_tum

IMAGE_LIST, DEPTH_LIST, CAMERA_FILE = "rgb.txt", "depth.txt", "camera.toml"
ODOMETRY_FILE, GROUNDTRUTH_FILE = "odometry.txt", "groundtruth.txt"
MAX_LIST_BYTES = 64 * 1024**2
# Half a frame at 25 Hz: what images and poses of the same moment may differ by, in seconds.
PAIRING_TOLERANCE = 0.02
VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv")

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Dataset:
    """What a robot or a person recorded.

    Attributes:
        root: the folder.
        image_names: ``N`` paths relative to ``root``, in time order; they never leave ``root``.
        timestamps: ``(N,)`` seconds, strictly increasing.
        camera: the camera that took all images; None where no ``camera.toml`` tells.
        base_from_camera: ``(4, 4)``, the camera's mount, metres; None where the body is the camera.
        odometry: world_from_body in a frame of its own, integrated and drifting; None where there
            is none.
        groundtruth: world_from_body in the world of the map; for evaluation, never for estimation;
            None where there is none.
        depth_names: for each image its depth image relative to ``root``, or None; None where the
            data set has no depth images at all.
        depth_scale: value in a depth image / depth_scale = metres; None where nothing says.
        mask: of what the camera always sees; None where there is none.
    """

    root: Path
    image_names: tuple[str, ...]
    timestamps: FloatArray
    camera: Camera | None
    base_from_camera: FloatArray | None
    odometry: Trajectory | None
    groundtruth: Trajectory | None
    depth_names: tuple[str | None, ...] | None
    depth_scale: float | None
    mask: Mask | None = None

    def __len__(self) -> int:
        return len(self.image_names)

    @property
    def body_from_camera(self) -> FloatArray:
        """``(4, 4)``: the mount; the identity where the body is the camera."""
        return np.eye(4) if self.base_from_camera is None else self.base_from_camera

    def image_path(self, index: int) -> Path:
        """The file of an image.

        Args:
            index: of the image, from 0.

        Raises:
            OptionError: no such image.
        """
        index = checked_index(index, "images", len(self))
        return self.root / self.image_names[index]

    def read_image_bytes(self, index: int) -> bytes:
        """The content of an image's file, as recorded.

        Args:
            index: of the image, from 0.

        Raises:
            InputError: it is missing, too large or unreadable.
            OptionError: no such image.
        """
        return read_image_bytes(self.image_path(index))

    def read_image(self, index: int) -> ImageArray:
        """An image, decoded.

        Args:
            index: of the image, from 0.

        Returns:
            ``(height, width, 3)`` RGB, 8 bits, as recorded (not undistorted).

        Raises:
            InputError: unreadable, damaged, or of another size than the camera's.
            OptionError: no such image.
        """
        path = self.image_path(index)
        image = decode_image(read_image_bytes(path), path)
        height, width = image.shape[:2]
        if self.camera is not None and (width, height) != (self.camera.width, self.camera.height):
            raise _wrong_size(path, (width, height), (self.camera.width, self.camera.height))
        return image


def load_dataset(
    root: PathLike,
    *,
    odometry: PathLike | None = None,
    groundtruth: PathLike | None = None,
    mask: PathLike | None = None,
) -> Dataset:
    """Reads and checks a data set in the layout of the TUM RGB-D benchmark (Sturm et al. 2012).

    Of the images the headers only are read.

    Args:
        root: a folder with ``rgb.txt``, or with images in it or in one of its sub-folders.
        odometry: a TUM file to use instead of the folder's ``odometry.txt``.
        groundtruth: a TUM file to use instead of the folder's ``groundtruth.txt``.
        mask: a mask to use instead of the folder's ``mask.png``.

    Raises:
        InputError: something is missing, damaged or contradictory; names the file and the reason.
        OptionError: a path is none.
    """
    root = checked_path(root, "the data set's path")
    odometry, groundtruth, mask = (
        None if path is None else checked_path(path, f"the {name}'s path")
        for name, path in (("odometry", odometry), ("ground truth", groundtruth), ("mask", mask))
    )
    _check_folder(root)
    if (root / IMAGE_LIST).is_file():
        timestamps, names = _read_list(root, IMAGE_LIST)
    else:
        _check_plain(root)
        names = _plain_images(root)
        timestamps = np.arange(len(names), dtype=np.float64)
    camera_path = root / CAMERA_FILE
    camera_file = read_camera_file(camera_path) if camera_path.is_file() else None
    size = _checked_size(root, names, camera_file)
    dataset = Dataset(
        root=root,
        image_names=names,
        timestamps=timestamps,
        camera=camera_file.camera if camera_file else None,
        base_from_camera=camera_file.base_from_camera if camera_file else None,
        odometry=_read_trajectory(odometry, root / ODOMETRY_FILE),
        groundtruth=_read_trajectory(groundtruth, root / GROUNDTRUTH_FILE),
        depth_names=_depth_names(root, timestamps),
        depth_scale=camera_file.depth_scale if camera_file else None,
        mask=_read_mask(
            root, mask, size, f"{CAMERA_FILE} says" if camera_file else f"{names[0]} is"
        ),
    )
    _log.info("%s: %d images", root, len(dataset))
    return dataset


def poses_at_images(
    dataset: Dataset,
    trajectory: Trajectory,
    source: Path | str,
    tolerance: float = PAIRING_TOLERANCE,
) -> FloatArray:
    """The pose of a trajectory that is nearest in time to each image.

    Args:
        dataset: the images.
        trajectory: the poses, at any rate.
        source: the trajectory's file, for the error.
        tolerance: seconds between an image and its pose at most.

    Returns:
        ``(N, 4, 4)``, one pose an image.

    Raises:
        InputError: an image has no pose; the first such time is named.
    """
    indices = trajectory.nearest(dataset.timestamps, tolerance)
    if np.any(indices < 0):
        first = dataset.timestamps[int(np.argmax(indices < 0))]
        missing = int(np.count_nonzero(indices < 0))
        raise InputError(
            source,
            f"has no pose within {tolerance:g} s of the image at time {first:.6f} "
            f"({missing} of {len(dataset)} images are without)",
            f"its times run from {trajectory.timestamps[0]:.6f} to {trajectory.timestamps[-1]:.6f}",
        )
    return np.asarray(trajectory.poses[indices], dtype=np.float64)


def _check_folder(root: Path) -> None:
    try:
        is_folder = stat.S_ISDIR(root.stat().st_mode)
    except FileNotFoundError as error:
        raise InputError(root, "does not exist") from error
    except (OSError, ValueError) as error:
        raise InputError(root, f"cannot be read ({reason_of(error)})") from error
    if is_bag(root):
        raise InputError(
            root,
            "is a ROS bag, not a folder of images",
            f"make a data set of it first: lfnav import {root.name} -o drive",
        )
    if is_folder:
        if not os.access(root, os.R_OK | os.X_OK):
            raise InputError(root, "cannot be read (no permission)")
        return
    if root.suffix.lower() in VIDEO_SUFFIXES:
        raise InputError(
            root,
            "is a video, not a folder of images",
            f"extract its frames first: lfnav import {root.name} -o frames",
        )
    raise InputError(root, "is a file, not a folder", "a data set is a folder of images")


def _read_list(root: Path, list_name: str) -> tuple[FloatArray, tuple[str, ...]]:
    """Reads ``rgb.txt`` or ``depth.txt``: timestamps ``(N,)`` and names of files that exist."""
    path = root / list_name
    lines = read_text_file(path, MAX_LIST_BYTES).splitlines()
    entries: dict[str, float] = {}
    last = -math.inf
    for number, line in enumerate(lines, start=1):
        content = line.strip()
        if not content or content.startswith("#"):
            continue
        try:
            time, name = _parse_entry(content)
        except ValueError as error:
            raise InputError(path, f"line {number}: {error}") from error
        if time <= last:
            raise InputError(
                path,
                f"line {number}: time {time:.6f} does not come after {last:.6f}",
                "sort the images by time and keep one for each",
            )
        if name in entries:
            raise InputError(path, f"line {number}: {quoted(name)} is named a second time")
        if not is_file(root / name):
            raise InputError(path, f"line {number}: {quoted(name)} is not there")
        entries[name] = last = time
    if not entries:
        raise InputError(path, "names no image")
    return np.array(list(entries.values()), dtype=np.float64), tuple(entries)


def _parse_entry(content: str) -> tuple[float, str]:
    """Timestamp and normalised file name; ValueError says what is wrong with them."""
    parts = content.split(maxsplit=1)
    if len(parts) != 2:
        raise ValueError("not of the form: timestamp filename")
    try:
        time = float(parts[0])
    except ValueError:
        raise ValueError(f"{quoted(parts[0])} is not a timestamp") from None
    if not math.isfinite(time):
        raise ValueError(f"the timestamp {time} is not finite")
    name = PurePosixPath(parts[1])
    if not parts[1].isprintable():
        raise ValueError(f"{quoted(parts[1])} is not a file name")
    if name.is_absolute() or ".." in name.parts:
        raise ValueError(f"{quoted(parts[1])} leads out of the data set's folder")
    return time, str(name)


def _check_plain(root: Path) -> None:
    """Made-up times must not be paired with recorded ones."""
    for name in (ODOMETRY_FILE, GROUNDTRUTH_FILE, DEPTH_LIST):
        if (root / name).is_file():
            raise InputError(
                root,
                f"holds {name} but no {IMAGE_LIST}",
                f"write {IMAGE_LIST} with a line 'timestamp filename' for each image",
            )


def _plain_images(root: Path) -> tuple[str, ...]:
    """The images of a plain folder in natural order, or else those of its one sub-folder."""
    names = tuple(name for name in images_in(root) if name != MASK_FILE)
    if names:
        return names
    try:
        folders = sorted(p for p in root.iterdir() if p.is_dir() and not p.name.startswith("."))
    except OSError as error:
        raise InputError(root, f"cannot be read ({error.strerror or error})") from error
    found = {folder.name: images_in(folder) for folder in folders}
    found = {folder: images for folder, images in found.items() if images}
    if not found:
        raise InputError(
            root,
            f"holds no {IMAGE_LIST} and no images ({', '.join(IMAGE_SUFFIXES)})",
            "give the folder that holds them",
        )
    if len(found) > 1:
        raise InputError(
            root, f"holds images in several folders ({', '.join(found)})", "give one of them"
        )
    ((folder, images),) = found.items()
    return tuple(f"{folder}/{image}" for image in images)


def images_in(folder: Path) -> tuple[str, ...]:
    """Names of the JPEG and PNG files in a folder, in natural order.

    Raises:
        InputError: the folder cannot be read.
    """
    try:
        names = [
            entry.name
            for entry in folder.iterdir()
            if entry.suffix.lower() in IMAGE_SUFFIXES
            and not entry.name.startswith(".")
            and entry.is_file()
        ]
    except OSError as error:
        raise InputError(folder, f"cannot be read ({error.strerror or error})") from error
    return tuple(sorted(names, key=natural_key))


def natural_key(name: str) -> tuple[list[tuple[int, str]], str]:
    """Orders ``img2`` before ``img10``; the name itself decides between ``img1`` and ``img01``."""
    parts = re.split(r"([0-9]+)", name.lower())
    # Odd parts are the numbers; compared by length first, digits need no conversion.
    key = [
        (len(part.lstrip("0")), part.lstrip("0")) if index % 2 else (0, part)
        for index, part in enumerate(parts)
    ]
    return key, name


def _checked_size(
    root: Path, names: tuple[str, ...], camera_file: CameraFile | None
) -> tuple[int, int]:
    """Width and height of all images: the camera's, or the first image's."""
    expected: tuple[int, int] | None = None
    if camera_file is not None:
        expected = (camera_file.camera.width, camera_file.camera.height)
    for name in names:
        header = read_image_header(root / name)
        size = (header.width, header.height)
        if expected is None:
            expected = size
        if size != expected:
            others = None if camera_file is not None else names[0]
            raise _wrong_size(root / name, size, expected, others)
    if expected is None:
        raise InputError(root, "holds no image")
    return expected


def _wrong_size(
    path: Path, size: tuple[int, int], expected: tuple[int, int], other: str | None = None
) -> InputError:
    whose = f"{CAMERA_FILE} says" if other is None else f"{other} is"
    return InputError(
        path,
        f"is {size[0]}x{size[1]} pixels, {whose} {expected[0]}x{expected[1]}",
        "a data set has one camera and one size",
    )


def _read_trajectory(given: Path | None, default: Path) -> Trajectory | None:
    if given is not None:
        return read_tum(given)
    return read_tum(default) if default.is_file() else None


def _read_mask(root: Path, given: Path | None, size: tuple[int, int], whose: str) -> Mask | None:
    path = root / MASK_FILE if given is None else given
    # A link that leads nowhere is not the same as no mask.
    if given is None and not os.path.lexists(path):
        return None
    return read_mask(path, size, whose)


def _depth_names(root: Path, timestamps: FloatArray) -> tuple[str | None, ...] | None:
    """The depth image nearest in time to each image, where one is near enough."""
    if not (root / DEPTH_LIST).is_file():
        return None
    times, names = _read_list(root, DEPTH_LIST)
    timed = Trajectory(times, np.broadcast_to(np.eye(4), (len(times), 4, 4)))
    nearest = timed.nearest(timestamps, PAIRING_TOLERANCE)
    return tuple(names[index] if index >= 0 else None for index in nearest)
