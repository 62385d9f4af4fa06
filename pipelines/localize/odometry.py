"""Odometry of the images that are localized: which have none, and whether a robot moves like it."""

from pathlib import Path

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError
from pipelines.dataset.dataset import Dataset
from pipelines.dataset.pairing import pair_images
from pipelines.geometry.interpolation import MAX_GAP
from pipelines.geometry.planarity import check_planar, note_on_speed
from pipelines.localize.settings import LocalizerSettings


def images_with_odometry(
    dataset: Dataset, settings: LocalizerSettings, source: Path, max_gap: float = MAX_GAP
) -> tuple[Dataset, FloatArray | None, list[str]]:
    """The images that are localized, their poses by odometry ``(N, 4, 4)``, and notes on both.

    Args:
        dataset: the images, and odometry where there is some.
        settings: of the localizer.
        source: the odometry's file, for errors and notes.
        max_gap: seconds between the two poses around an image at most.

    Raises:
        InputError: the filter of a robot on a floor has no odometry, or none of its images, or no
            robot on a floor moves like this; ``source`` is named.
    """
    needs = settings.method == "filter"
    if dataset.odometry is None:
        if needs and settings.state_space.angles == 1:
            raise InputError(
                source,
                "is missing: a planar robot is localized with odometry",
                "give the file with --odometry",
            )
        return dataset, None, []
    try:
        found = pair_images(dataset, dataset.odometry, source, max_gap)
    except InputError as error:
        if needs:
            raise
        # Poses by features do without; odometry is only shown beside them.
        return dataset, None, [str(error)]
    if not needs and found.left_out:
        count = f"{len(found.left_out)} of {len(dataset)} images have none"
        return dataset, None, [f"{source}: is not shown beside the poses: {count}"]
    notes = [*found.notes, *_check(found.world_from_body, settings, source)]
    times = dataset.timestamps[found.image_index]
    speed = note_on_speed(times, found.world_from_body[:, :3, 3])
    if speed is not None:
        notes.append(f"{source}: {speed}")
    return dataset.part(found.image_index.tolist()), found.world_from_body, notes


def _check(body_poses: FloatArray, settings: LocalizerSettings, source: Path) -> tuple[str, ...]:
    """Refuses to filter a planar robot's drive with odometry of something else.

    Args:
        body_poses: ``(N, 4, 4)`` world_from_body at the images, by odometry.
        settings: of the localizer.
        source: the odometry's file.

    Returns:
        Lines on what is suspicious about the odometry.

    Raises:
        InputError: no robot on a floor moves like this; ``source`` is named.
    """
    if settings.state_space.angles != 1:
        return ()
    try:
        note = check_planar(body_poses, source)
    except InputError as error:
        if settings.method == "filter":
            raise
        # Poses by features do without; the odometry is only shown beside them.
        note = str(error)
    return () if note is None else (note,)
