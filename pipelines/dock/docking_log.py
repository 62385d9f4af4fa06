"""The log of docking, step by step, and the run file's content made of it."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.dataset.images import encode_png
from pipelines.dock.planar_motion import moved
from pipelines.dock.robot import STANDSTILL, CheckedRobot, Movement
from pipelines.dock.settings import DockSettings
from pipelines.dock.states import Outcome
from pipelines.lightfield.area_map import AreaMap
from pipelines.localize.docking_record import DockingRecord
from pipelines.localize.run import FrameRecord, Run
from pipelines.localize.settings import LocalizerSettings


@dataclass(frozen=True)
class Entry:
    """One image and the movement after it.

    Attributes:
        frame: the filter's belief after the image.
        image: ``(H, W, 3)`` RGB.
        state: name of the phase or, in the last entry, of the outcome.
        command: the movement commanded after the image.
        measured: that movement by odometry.
        true_state: ``(3,)`` true pose of a simulated robot at the image; None for a real robot.
    """

    frame: FrameRecord
    image: ImageArray
    state: str
    command: Movement
    measured: Movement
    true_state: FloatArray | None


@dataclass(frozen=True)
class Origin:
    """Where a run comes from.

    Attributes:
        scene_identifier: identifier of the scene model.
        scene_path: path of the scene model, relative to the run file.
        robot: name of the robot as the user gave it.
        seed: seed of all random numbers.
        provenance: versions, options and hashes of the inputs, plain JSON types.
    """

    scene_identifier: str
    scene_path: str
    robot: str
    seed: int
    provenance: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Docking:
    """A docking that has ended.

    Attributes:
        entries: one for each image, in order of time.
        outcome: how docking ended.
        attempts: times that the robot left the staging pose.
        goal: ``(3,)`` x and y in metres, heading in radians.
        staging: ``(3,)`` pose from which the approach begins.
        seconds: wall time: ``total``, and of it ``robot`` and ``filter``.
    """

    entries: tuple[Entry, ...]
    outcome: Outcome
    attempts: int
    goal: FloatArray
    staging: FloatArray
    seconds: dict[str, float]


def run_of(
    docking: Docking,
    robot: CheckedRobot,
    filter_settings: LocalizerSettings,
    settings: DockSettings,
    origin: Origin,
    areas: AreaMap | None = None,
) -> Run | None:
    """The run file's content of a docking; None where not a single image was taken.

    Args:
        docking: the docking.
        robot: the robot that was docked.
        filter_settings: the filter's settings.
        settings: the docking's settings.
        origin: where the run comes from.
        areas: of the world that the robot was localized in; None: it was one scene.
    """
    entries = docking.entries
    if not entries:
        return None
    odometry = [np.zeros(3)]
    for entry in entries[:-1]:
        odometry.append(moved(odometry[-1], entry.measured))
    truth = [entry.true_state for entry in entries if entry.true_state is not None]
    return Run(
        scene_identifier=origin.scene_identifier,
        scene_path=origin.scene_path,
        dataset_name=f"docking of {origin.robot}",
        camera=robot.camera,
        base_from_camera=robot.base_from_camera,
        settings=filter_settings.to_dict(),
        seed=origin.seed,
        frames=tuple(entry.frame for entry in entries),
        encoded_images=tuple(encode_png(entry.image) for entry in entries),
        odometry=np.stack(odometry),
        groundtruth=np.stack(truth) if len(truth) == len(entries) else None,
        provenance=origin.provenance,
        docking=DockingRecord(
            robot=origin.robot,
            drive=settings.drive,
            outcome=docking.outcome.kind.word,
            exit_code=docking.outcome.kind.value,
            reason=docking.outcome.reason,
            attempts=docking.attempts,
            settings=settings.to_dict(),
            goal=docking.goal,
            staging=docking.staging,
            states=tuple(entry.state for entry in entries),
            commands=_stacked([entry.command for entry in entries]),
            measured=_stacked([entry.measured for entry in entries]),
        ),
        areas=areas,
    )


def _stacked(movements: list[Movement]) -> FloatArray:
    """Movements as an array ``(N, 3)``; N may be 0."""
    return np.stack([movement.vector() for movement in [*movements, STANDSTILL]])[:-1]
