"""Data sets: images in time order, their camera, odometry and ground truth.

The layout is that of the TUM RGB-D benchmark: ``rgb.txt`` (timestamp and file name a line) and the
images it names, and optionally ``camera.toml``, ``odometry.txt``, ``groundtruth.txt``,
``depth.txt`` and ``mask.png``. A plain folder of images is a data set too; its timestamps are 0, 1,
2, ...
"""

import logging
import os
import re
import stat
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pipelines.artifacts.arguments import PathLike, checked_index, checked_path
from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import InputError, reason_of
from pipelines.dataset.camera_file import CameraFile, read_camera_file
from pipelines.dataset.image_list import read_image_list
from pipelines.dataset.images import (
    IMAGE_SUFFIXES,
    decode_image,
    read_image_bytes,
    read_image_header,
)
from pipelines.dataset.left_out import BELOW, OTHER, VIDEO_SUFFIXES, files_left_out, left_out_text
from pipelines.dataset.mask import MASK_FILE, Mask, read_mask
from pipelines.geometry.camera import Camera
from pipelines.geometry.interpolation import PAIRING_TOLERANCE
from pipelines.geometry.trajectory import Trajectory, read_tum

IMAGE_LIST, DEPTH_LIST, CAMERA_FILE = "rgb.txt", "depth.txt", "camera.toml"
ODOMETRY_FILE, GROUNDTRUTH_FILE = "odometry.txt", "groundtruth.txt"
# What is read from a plain folder besides its images.
_KNOWN_FILES = (CAMERA_FILE, MASK_FILE)

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
            None where there is none, or none that can be read.
        depth_names: for each image its depth image relative to ``root``, or None; None where the
            data set has no depth images at all.
        depth_scale: value in a depth image / depth_scale = metres; None where nothing says.
        mask: of what the camera always sees; None where there is none.
        left_out: what else lies in a plain folder of images: reason -> number of files.
        groundtruth_problem: why the ground truth that is there is not read: only what needs it
            fails.
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
    left_out: Mapping[str, int] = field(default_factory=dict)
    groundtruth_problem: InputError | None = None

    def __len__(self) -> int:
        return len(self.image_names)

    @property
    def body_from_camera(self) -> FloatArray:
        """``(4, 4)``: the mount; the identity where the body is the camera."""
        return np.eye(4) if self.base_from_camera is None else self.base_from_camera

    def part(self, indices: Iterable[int]) -> "Dataset":
        """The data set with some of its images.

        Args:
            indices: of the images, from 0, increasing.
        """
        chosen = list(indices)
        depth = self.depth_names
        return replace(
            self,
            image_names=tuple(self.image_names[index] for index in chosen),
            timestamps=self.timestamps[chosen],
            depth_names=None if depth is None else tuple(depth[index] for index in chosen),
        )

    def true_poses(self, reason: str = "is missing", remedy: str = "") -> Trajectory:
        """The ground truth, for whatever cannot do without.

        Args:
            reason: what is said where there is none.
            remedy: what to do about it.

        Raises:
            InputError: there is none, or it cannot be read.
        """
        if self.groundtruth_problem is not None:
            raise self.groundtruth_problem
        if self.groundtruth is None:
            raise InputError(self.root / GROUNDTRUTH_FILE, reason, remedy)
        return self.groundtruth

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
    reads_odometry: bool = True,
) -> Dataset:
    """Reads and checks a data set in the layout of the TUM RGB-D benchmark (Sturm et al. 2012).

    Of the images the headers only are read.

    Args:
        root: a folder with ``rgb.txt``, or with images in it or in one of its sub-folders.
        odometry: a TUM file to use instead of the folder's ``odometry.txt``.
        groundtruth: a TUM file to use instead of the folder's ``groundtruth.txt``.
        mask: a mask to use instead of the folder's ``mask.png``.
        reads_odometry: whether there is a use for odometry; False: it is not looked at.

    Raises:
        InputError: something is missing, damaged or contradictory; names the file and the reason.
            Damaged ground truth in the folder is ``Dataset.groundtruth_problem`` instead.
        OptionError: a path is none.
    """
    root = checked_path(root, "the data set's path")
    odometry, groundtruth, mask = (
        None if path is None else checked_path(path, f"the {name}'s path")
        for name, path in (("odometry", odometry), ("ground truth", groundtruth), ("mask", mask))
    )
    _check_folder(root)
    left_out: dict[str, int] = {}
    if (root / IMAGE_LIST).is_file():
        timestamps, names = read_image_list(root, IMAGE_LIST)
    else:
        _check_plain(root)
        names = _plain_images(root)
        timestamps = np.arange(len(names), dtype=np.float64)
        left_out = _left_out(root, names)
    camera_path = root / CAMERA_FILE
    camera_file = read_camera_file(camera_path) if camera_path.is_file() else None
    size = _checked_size(root, names, camera_file)
    truth, problem = _read_truth(groundtruth, root / GROUNDTRUTH_FILE)
    dataset = Dataset(
        root=root,
        image_names=names,
        timestamps=timestamps,
        camera=camera_file.camera if camera_file else None,
        base_from_camera=camera_file.base_from_camera if camera_file else None,
        odometry=_read_trajectory(odometry, root / ODOMETRY_FILE) if reads_odometry else None,
        groundtruth=truth,
        depth_names=_depth_names(root, timestamps),
        depth_scale=camera_file.depth_scale if camera_file else None,
        mask=_read_mask(
            root, mask, size, f"{CAMERA_FILE} says" if camera_file else f"{names[0]} is"
        ),
        left_out=left_out,
        groundtruth_problem=problem,
    )
    _log.info("%s: %d images", root, len(dataset))
    return dataset


def _check_folder(root: Path) -> None:
    try:
        is_folder = stat.S_ISDIR(root.stat().st_mode)
    except FileNotFoundError as error:
        raise InputError(root, "does not exist") from error
    except (OSError, ValueError) as error:
        raise InputError(root, f"cannot be read ({reason_of(error)})") from error
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
        others = _total(files_left_out(folder, _KNOWN_FILES) for folder in (root, *folders))
        others = {why: count for why, count in others.items() if why not in (BELOW, OTHER)}
        raise InputError(
            root,
            f"holds no {IMAGE_LIST} and no images ({', '.join(IMAGE_SUFFIXES)})",
            f"not read: {left_out_text(others)}" if others else "give the folder that holds them",
        )
    if len(found) > 1:
        raise InputError(
            root, f"holds images in several folders ({', '.join(found)})", "give one of them"
        )
    ((folder, images),) = found.items()
    return tuple(f"{folder}/{image}" for image in images)


def _left_out(root: Path, names: tuple[str, ...]) -> dict[str, int]:
    """What a plain folder holds besides its images; a warning says it where it may be photos."""
    folder = (root / names[0]).parent
    counts = files_left_out(root, {*names, *_KNOWN_FILES, folder.name})
    if folder != root:
        counts = _total([counts, files_left_out(folder, {Path(name).name for name in names})])
    if counts.keys() - {OTHER}:
        _log.warning("%s: %d images are taken, not %s", root, len(names), left_out_text(counts))
    return counts


def _total(counts: Iterable[Mapping[str, int]]) -> dict[str, int]:
    total: dict[str, int] = {}
    for count in counts:
        for reason, number in count.items():
            total[reason] = total.get(reason, 0) + number
    return total


def images_in(folder: Path) -> tuple[str, ...]:
    """Names of the photos in a folder that are of a kind that is read, in natural order.

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
    """Width and height of all images: the camera's, or the first image's.

    Without a camera some may be turned against the others: portrait and landscape.
    """
    expected: tuple[int, int] | None = None
    if camera_file is not None:
        expected = (camera_file.camera.width, camera_file.camera.height)
    for name in names:
        header = read_image_header(root / name)
        size = (header.width, header.height)
        if expected is None:
            expected = size
        if size != expected and (camera_file is not None or size[::-1] != expected):
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
        "a data set has one camera and one size"
        if other is not None or size[::-1] != expected
        else f"without {CAMERA_FILE} structure from motion takes portrait and landscape alike",
    )


def _read_trajectory(given: Path | None, default: Path) -> Trajectory | None:
    if given is not None:
        return read_tum(given)
    return read_tum(default) if default.is_file() else None


def _read_truth(given: Path | None, default: Path) -> tuple[Trajectory | None, InputError | None]:
    """The ground truth, or why there is none; whoever names a file wants to know at once."""
    if given is not None:
        return read_tum(given), None
    try:
        return _read_trajectory(None, default), None
    except InputError as error:
        _log.warning("%s; there is no ground truth", error)
        return None, error


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
    times, names = read_image_list(root, DEPTH_LIST)
    timed = Trajectory(times, np.broadcast_to(np.eye(4), (len(times), 4, 4)))
    nearest = timed.nearest(timestamps, PAIRING_TOLERANCE)
    return tuple(names[index] if index >= 0 else None for index in nearest)
