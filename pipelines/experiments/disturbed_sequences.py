"""Disturbed sequences, made from a recorded one.

- ``kidnapped``: after ten frames the robot is carried to the end of the sequence and drives back
  from there for five frames. Odometry does not measure the jump.
- ``dark``: five images in the middle are black.
- ``covered-middle``, ``covered-right``: a third of every image has one colour, as if tape stuck to
  the lens: a box in the middle, or the right side.

Each is a data set of its own, with the true poses of its frames and with every odometry file of the
recorded sequence; ``lfnav sweep`` runs the same settings on all of them.
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
)
from pipelines.dataset.images import encode_png
from pipelines.dataset.importers.placing import format_list
from pipelines.dataset.mask import MASK_FILE
from pipelines.dataset.pairing import poses_at_images
from pipelines.geometry.pose import inverse
from pipelines.geometry.trajectory import Trajectory, format_tum, read_tum

ODOMETRY_FILES = "odometry*.txt"
FRAMES_BEFORE, FRAMES_AFTER = 10, 5
BLACK_FRAMES = 5
COVERED_SHARE = 1.0 / 3.0
# RGB colour of the covered part of the image.
COVER = (90, 70, 50)

Alteration = Callable[[int, ImageArray], ImageArray | None]


@dataclass(frozen=True)
class Disturbance:
    """How a disturbed sequence differs from the recorded one.

    Attributes:
        name: name of its folder.
        meaning: what is disturbed, for people.
        order: numbers of the recorded frames, ``M`` of them, in their new order.
        jumps: numbers of the frames, in the new order, before which the robot is carried away.
        altered: from a frame's number in the new order and its recorded image to the image that
            replaces it; None: the recorded image stays.
        shown: numbers of the recorded frames whose images are used; None: those of ``order``.
        has_truth: whether the images show the place; if not, the data set gets no true poses.
    """

    name: str
    meaning: str
    order: tuple[int, ...]
    jumps: frozenset[int]
    altered: Alteration
    shown: tuple[int, ...] | None = None
    has_truth: bool = True


@dataclass(frozen=True)
class DisturbanceSet:
    """Disturbances whose sequences are written into one folder.

    Attributes:
        record: file in the folder that describes the sequences, and by which it is recognized.
        fewest_frames: number of frames that a recorded sequence needs.
        of: from a sequence's number of frames to the disturbances.
    """

    record: str
    fewest_frames: int
    of: Callable[[int], Sequence[Disturbance]]


def disturbances(frames: int) -> tuple[Disturbance, ...]:
    """The disturbances of a sequence.

    Args:
        frames: number of its frames, at least ``FRAMES_BEFORE + FRAMES_AFTER``.
    """
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


DISTURBED = DisturbanceSet("disturbed.json", FRAMES_BEFORE + FRAMES_AFTER, disturbances)


def covered_middle(image: ImageArray) -> ImageArray:
    """The image ``(H, W, 3)`` with a box of the same aspect ratio covered in the middle."""
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
    """Odometry of a sequence whose frames come in another order, ``(M, 4, 4)``.

    Args:
        world_from_body: ``(N, 4, 4)`` odometry of the recorded frames.
        order: numbers of the recorded frames, ``M`` of them, in their new order.
        jumps: numbers of the frames, in the new order, before which it measures no motion.
    """
    poses = [world_from_body[order[0]]]
    for number, (before, after) in enumerate(pairwise(order), start=1):
        motion = inverse(world_from_body[before]) @ world_from_body[after]
        poses.append(poses[-1] if number in jumps else poses[-1] @ motion)
    return np.stack(poses)


def write_sequences(
    sequence: Path, output: Path, disturbed: DisturbanceSet, *, overwrite: bool, progress: Progress
) -> tuple[Path, ...]:
    """Writes a data set for each disturbance of a set into a folder.

    Args:
        sequence: folder of the recorded sequence, with ground truth, camera and odometry.
        output: folder to write; it appears whole or not at all.
        disturbed: the disturbances.
        overwrite: whether a folder with the set's record may be replaced.
        progress: wraps the loop to report progress.

    Returns:
        The data sets' folders.

    Raises:
        InputError: the sequence cannot be used, lacks something or is too short, or the output
            cannot be written.
    """
    dataset = load_dataset(sequence)
    truth = dataset.true_poses("is missing: errors cannot be measured without it")
    if len(dataset) < disturbed.fewest_frames:
        reason = f"has {len(dataset)} frames, fewer than {disturbed.fewest_frames}"
        raise InputError(sequence, reason, "give a longer sequence")
    true_poses = poses_at_images(dataset, truth, sequence / GROUNDTRUTH_FILE)
    odometry = {
        path.name: poses_at_images(dataset, read_tum(path), path)
        for path in sorted(sequence.glob(ODOMETRY_FILES))
    }
    kinds = disturbed.of(len(dataset))
    with atomic_folder(output, overwrite, disturbed.record) as folder:
        for kind in progress(kinds, "sequences", len(kinds)):
            _write(folder / kind.name, dataset, kind, true_poses, odometry)
        # The key is that of files which older versions wrote.
        record = {"source": sequence.name, "drives": {kind.name: kind.meaning for kind in kinds}}
        (folder / disturbed.record).write_text(
            json.dumps(record, indent=2) + "\n", encoding="utf-8"
        )
    return tuple(output / kind.name for kind in kinds)


def _write(
    folder: Path,
    dataset: Dataset,
    kind: Disturbance,
    truth: FloatArray,
    odometry: dict[str, FloatArray],
) -> None:
    """Writes one data set; its frames have the timestamps of the first recorded ones."""
    (folder / "rgb").mkdir(parents=True)
    times = dataset.timestamps[: len(kind.order)]
    names = []
    for number, source in enumerate(kind.order if kind.shown is None else kind.shown):
        altered = kind.altered(number, dataset.read_image(source))
        suffix = PurePosixPath(dataset.image_names[source]).suffix if altered is None else ".png"
        names.append(f"rgb/{number:04d}{suffix}")
        # Altered images are stored losslessly: a black frame stays black.
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
