"""Drives on which something goes wrong, made of a recorded drive that went well.

- ``kidnapped``: after ten frames the robot is carried to the end of the drive, and from there comes
  back for five frames. Odometry knows nothing of the jump: no wheel turned meanwhile.
- ``dark``: five images in the middle are black.
- ``covered-middle``, ``covered-right``: a third of every image has one colour, as if tape stuck on
  the lens: a box in the middle, or everything on the right.

Each is a data set of its own, with the truth of its own frames and with every odometry file of the
recorded drive; the same settings can be tried on all of them with ``lfnav sweep``.
"""

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path, PurePosixPath

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.atomic import atomic_folder
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.stages import Progress
from pipelines.dataset.dataset import (
    CAMERA_FILE,
    GROUNDTRUTH_FILE,
    IMAGE_LIST,
    Dataset,
    load_dataset,
    poses_at_images,
)
from pipelines.dataset.images import encode_png
from pipelines.dataset.importers.placing import format_list
from pipelines.dataset.mask import MASK_FILE
from pipelines.geometry.pose import inverse
from pipelines.geometry.trajectory import Trajectory, format_tum, read_tum

RECORD = "disturbed.json"
ODOMETRY_FILES = "odometry*.txt"
FRAMES_BEFORE, FRAMES_AFTER = 10, 5
BLACK_FRAMES = 5
COVERED_SHARE = 1.0 / 3.0
# RGB of what covers the lens.
COVER = (90, 70, 50)

Alteration = Callable[[int, ImageArray], ImageArray | None]


@dataclass(frozen=True)
class Disturbance:
    """What is changed of a drive.

    Attributes:
        name: of the folder.
        meaning: in words.
        order: ``M`` frames of the recorded drive, in the order in which they come.
        jumps: numbers of the frames, in the new order, before which the robot was carried away.
        altered: the image in the place of a frame's, given its number in the new order and the
            recorded one; None: the recorded one stays.
        shown: frames of the recorded drive whose images are shown, where these are not ``order``.
        has_truth: whether the images show the place at all; else the data set gets no true poses.
    """

    name: str
    meaning: str
    order: tuple[int, ...]
    jumps: frozenset[int]
    altered: Alteration
    shown: tuple[int, ...] | None = None
    has_truth: bool = True


def disturbances(frames: int) -> tuple[Disturbance, ...]:
    """All of them for a drive of so many frames, at least ``FRAMES_BEFORE + FRAMES_AFTER``."""
    forwards = tuple(range(frames))
    backwards = tuple(range(frames - 1, frames - 1 - FRAMES_AFTER, -1))
    first_black = (frames - BLACK_FRAMES) // 2
    return (
        Disturbance(
            "kidnapped",
            f"frames 0 to {FRAMES_BEFORE - 1}, then {FRAMES_AFTER} backwards from {frames - 1}",
            forwards[:FRAMES_BEFORE] + backwards,
            frozenset({FRAMES_BEFORE}),
            lambda *_: None,
        ),
        Disturbance(
            "dark",
            f"frames {first_black} to {first_black + BLACK_FRAMES - 1} are black",
            forwards,
            frozenset(),
            lambda number, image: (
                np.zeros_like(image) if 0 <= number - first_black < BLACK_FRAMES else None
            ),
        ),
        Disturbance(
            "covered-middle",
            "a box in the middle, a third of each image, has one colour",
            forwards,
            frozenset(),
            lambda _, image: covered_middle(image),
        ),
        Disturbance(
            "covered-right",
            "the right third of each image has one colour",
            forwards,
            frozenset(),
            lambda _, image: covered_right(image),
        ),
    )


def covered_middle(image: ImageArray) -> ImageArray:
    """The image ``(H, W, 3)`` with a box of its own shape in the middle covered."""
    height, width = image.shape[:2]
    side = COVERED_SHARE**0.5
    top, left = round(0.5 * (1.0 - side) * height), round(0.5 * (1.0 - side) * width)
    covered = image.copy()
    covered[top : height - top, left : width - left] = COVER
    return covered


def covered_right(image: ImageArray) -> ImageArray:
    """The image ``(H, W, 3)`` with its right third covered."""
    covered = image.copy()
    covered[:, round((1.0 - COVERED_SHARE) * image.shape[1]) :] = COVER
    return covered


def odometry_with_jumps(
    world_from_body: FloatArray, order: Sequence[int], jumps: frozenset[int]
) -> FloatArray:
    """What odometry says when a drive's frames come in another order, ``(M, 4, 4)``.

    Args:
        world_from_body: ``(N, 4, 4)`` what it said of the recorded frames.
        order: ``M`` of these frames.
        jumps: numbers in the new order before which it measured no motion.
    """
    poses = [world_from_body[order[0]]]
    for number, (before, after) in enumerate(pairwise(order), start=1):
        motion = inverse(world_from_body[before]) @ world_from_body[after]
        poses.append(poses[-1] if number in jumps else poses[-1] @ motion)
    return np.stack(poses)


def write_disturbed_drives(
    drive: Path, output: Path, *, overwrite: bool, progress: Progress
) -> tuple[Path, ...]:
    """Writes a data set for each of ``disturbances`` below a folder.

    Args:
        drive: the recorded drive, with ground truth, camera and odometry.
        output: the folder; appears whole or not at all.
        overwrite: whether one of an earlier time may be replaced.
        progress: told how far the work is.

    Returns:
        The data sets' folders.

    Raises:
        InputError: the drive cannot be used, lacks something or is too short, or the output cannot
            be written.
    """
    return write_drives(
        drive,
        output,
        disturbances,
        RECORD,
        fewest_frames=FRAMES_BEFORE + FRAMES_AFTER,
        overwrite=overwrite,
        progress=progress,
    )


def write_drives(
    drive: Path,
    output: Path,
    kinds_of: Callable[[int], Sequence[Disturbance]],
    record_name: str,
    *,
    fewest_frames: int,
    overwrite: bool,
    progress: Progress,
) -> tuple[Path, ...]:
    """Writes a data set for each of some disturbances below a folder.

    Args:
        drive: the recorded drive, with ground truth, camera and odometry.
        output: the folder; appears whole or not at all.
        kinds_of: the disturbances of a drive of so many frames.
        record_name: file in the folder that says what they are; also tells that it is such a one.
        fewest_frames: that a drive has to have.
        overwrite: whether one of an earlier time may be replaced.
        progress: told how far the work is.

    Returns:
        The data sets' folders.

    Raises:
        InputError: the drive cannot be used, lacks something or is too short, or the output cannot
            be written.
    """
    dataset = load_dataset(drive)
    if dataset.groundtruth is None:
        raise InputError(drive / GROUNDTRUTH_FILE, "is missing: nothing could be judged without it")
    if len(dataset) < fewest_frames:
        reason = f"has {len(dataset)} frames, fewer than {fewest_frames}"
        raise InputError(drive, reason, "give a longer drive")
    truth = poses_at_images(dataset, dataset.groundtruth, drive / GROUNDTRUTH_FILE)
    odometry = {
        path.name: poses_at_images(dataset, read_tum(path), path)
        for path in sorted(drive.glob(ODOMETRY_FILES))
    }
    kinds = kinds_of(len(dataset))
    with atomic_folder(output, overwrite, record_name) as folder:
        for kind in progress(kinds, "drives", len(kinds)):
            _write(folder / kind.name, dataset, kind, truth, odometry)
        record = {"source": drive.name, "drives": {kind.name: kind.meaning for kind in kinds}}
        (folder / record_name).write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    return tuple(output / kind.name for kind in kinds)


def _write(
    folder: Path,
    dataset: Dataset,
    kind: Disturbance,
    truth: FloatArray,
    odometry: dict[str, FloatArray],
) -> None:
    """Writes one data set; its frames come at the times of the recorded drive's first ones."""
    (folder / "rgb").mkdir(parents=True)
    times = dataset.timestamps[: len(kind.order)]
    names = []
    for number, source in enumerate(kind.order if kind.shown is None else kind.shown):
        altered = kind.altered(number, dataset.read_image(source))
        suffix = PurePosixPath(dataset.image_names[source]).suffix if altered is None else ".png"
        names.append(f"rgb/{number:04d}{suffix}")
        # Altered images are kept without loss: a black frame stays black.
        data = dataset.read_image_bytes(source) if altered is None else encode_png(altered)
        (folder / names[-1]).write_bytes(data)
    (folder / IMAGE_LIST).write_text(format_list(times.tolist(), names), encoding="utf-8")
    for name in (CAMERA_FILE, MASK_FILE):
        if (dataset.root / name).is_file():
            shutil.copyfile(dataset.root / name, folder / name)
    paths = {GROUNDTRUTH_FILE: truth[list(kind.order)]} if kind.has_truth else {}
    for name, poses in odometry.items():
        paths[name] = odometry_with_jumps(poses, kind.order, kind.jumps)
    for name, poses in paths.items():
        (folder / name).write_text(format_tum(Trajectory(times, poses)), encoding="utf-8")
