"""What happened in a docking so far, step by step, and the run that is made of it."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.dataset.images import encode_png
from pipelines.dock.outcomes import Outcome
from pipelines.dock.planar_motion import moved
from pipelines.dock.robot import STANDSTILL, CheckedRobot, Movement
from pipelines.dock.settings import DockSettings
from pipelines.localize.docking_record import DockingRecord
from pipelines.localize.run import FrameRecord, Run
from pipelines.localize.settings import LocalizerSettings


@dataclass(frozen=True)
class Entry:
    """One image and what followed.

    Attributes:
        frame: the belief after the image.
        image: ``(H, W, 3)``.
        state: name of the state of the docking.
        command: the movement commanded then.
        measured: the movement as odometry measured it.
        true_state: ``(3,)`` where the robot really was when it took the image, or None.
    """

    frame: FrameRecord
    image: ImageArray
    state: str
    command: Movement
    measured: Movement
    true_state: FloatArray | None


@dataclass(frozen=True)
class Origin:
    """What the run says about where it comes from.

    Attributes:
        scene_identifier, scene_path: of the scene model.
        robot: as it was named.
        seed: of the random numbers.
        provenance: plain JSON types.
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
        entries: what happened, in order of time.
        outcome: how it ended.
        attempts: times that the robot left the staging pose.
        goal, staging: ``(3,)``.
        seconds: wall time altogether, and of it in the robot and in the filter.
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
) -> Run | None:
    """The run of a docking; None where not a single image was taken."""
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
            outcome=docking.outcome.ending.word,
            exit_code=docking.outcome.ending.value,
            reason=docking.outcome.reason,
            attempts=docking.attempts,
            settings=settings.to_dict(),
            goal=docking.goal,
            staging=docking.staging,
            states=tuple(entry.state for entry in entries),
            commands=_stacked([entry.command for entry in entries]),
            measured=_stacked([entry.measured for entry in entries]),
        ),
    )


def _stacked(movements: list[Movement]) -> FloatArray:
    return np.stack([movement.vector() for movement in [*movements, STANDSTILL]])[:-1]
