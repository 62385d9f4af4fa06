"""Images and poses that were recorded side by side: which image has which pose, and which none."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import InputError
from pipelines.dataset.dataset import Dataset
from pipelines.geometry.interpolation import MAX_GAP, PAIRING_TOLERANCE, poses_at_times
from pipelines.geometry.time_units import hint_on_times
from pipelines.geometry.trajectory import Trajectory

# Seconds by which an image may lie outside of the poses' times before that is worth a word: half of
# what a millisecond is rounded by.
SAME_TIME = 0.0005


@dataclass(frozen=True)
class PosedImages:
    """The images of a data set that have a pose.

    Attributes:
        image_index: ``(N,)`` indices into the data set's images.
        world_from_body: ``(N, 4, 4)``.
        left_out: index of an image without a pose -> the reason.
        notes: lines on what was left out, and on poses that are not of the image's very time.
    """

    image_index: IntArray
    world_from_body: FloatArray
    left_out: dict[int, str]
    notes: tuple[str, ...]


def pair_images(
    dataset: Dataset, trajectory: Trajectory, source: Path | str, max_gap: float = MAX_GAP
) -> PosedImages:
    """Gives every image the pose at its time, interpolated.

    Args:
        dataset: the images.
        trajectory: the poses, at any rate.
        source: the trajectory's file, for errors and reasons.
        max_gap: seconds between the two poses around an image at most.

    Raises:
        InputError: no image has a pose.
    """
    times, known = dataset.timestamps, trajectory.timestamps
    found = poses_at_times(trajectory, times, max_gap)
    if not np.any(found.is_known):
        raise InputError(
            source,
            f"none of its poses lies within {PAIRING_TOLERANCE:g} s of an image, and no two that "
            f"are at most {max_gap:g} s apart lie around one",
            hint_on_times(times, known),
        )
    name = Path(source).name
    left_out = {
        index: _reason(float(times[index]), known, name, max_gap)
        for index in np.flatnonzero(~found.is_known).tolist()
    }
    outside = (times < known[0]) | (times > known[-1])
    notes = []
    if left_out:
        beyond = int(np.count_nonzero(outside & ~found.is_known))
        parts = [
            f"{count} {where}"
            for count, where in (
                (beyond, f"before the first or after the last pose of {name}"),
                (len(left_out) - beyond, f"in gaps of {name} longer than {max_gap:g} s"),
            )
            if count
        ]
        notes.append(f"{len(left_out)} of {len(dataset)} images are left out: {', '.join(parts)}")
    late = float(np.max(found.offsets[outside & found.is_known], initial=0.0))
    if late > SAME_TIME:
        notes.append(
            f"{name} begins or ends {late:.3f} s from an image, which takes the pose there"
        )
    return PosedImages(
        np.flatnonzero(found.is_known), found.poses[found.is_known], left_out, tuple(notes)
    )


def _reason(time: float, known: FloatArray, name: str, max_gap: float) -> str:
    if not known[0] <= time <= known[-1]:
        where = "before the first" if time < known[0] else "after the last"
        end = known[0] if time < known[0] else known[-1]
        return f"time {time:.6f} lies {where} pose of {name} ({end:.6f})"
    after = int(np.searchsorted(known, time))
    gap = float(known[after] - known[after - 1])
    return f"time {time:.6f} lies in a gap of {name} of {gap:.3f} s, and --max-gap is {max_gap:g} s"


def poses_at_images(
    dataset: Dataset, trajectory: Trajectory, source: Path | str, max_gap: float = MAX_GAP
) -> FloatArray:
    """The pose of a trajectory at the time of each image.

    Args:
        dataset: the images.
        trajectory: the poses, at any rate.
        source: the trajectory's file, for the error.
        max_gap: seconds between the two poses around an image at most.

    Returns:
        ``(N, 4, 4)``, one pose an image.

    Raises:
        InputError: an image has no pose; the first such image is named.
    """
    found = pair_images(dataset, trajectory, source, max_gap)
    if found.left_out:
        first = min(found.left_out)
        raise InputError(
            source,
            f"has no pose for {len(found.left_out)} of {len(dataset)} images: of "
            f"{dataset.image_names[first]} the {found.left_out[first]}",
        )
    return found.world_from_body
