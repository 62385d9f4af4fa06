"""The record of a docking in a run: goal, commands and outcome.

In the file it is the group ``docking``: ``header`` (JSON: robot, drive, outcome, reason, the name
of the state at each frame), ``goal``, ``staging``, ``commands`` and ``measured``.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.safe_hdf5 import SafeFile, write_array, write_json

GROUP = "docking"


@dataclass(frozen=True)
class DockingRecord:
    """How a docking went.

    Attributes:
        robot: its name on the command line.
        drive: kinematics of the robot, ``omni`` or ``diff``.
        outcome: name of the outcome.
        exit_code: exit code of the command.
        reason: one line that says why it ended so.
        attempts: times that the robot left the staging pose.
        settings: settings of the docking, plain JSON types.
        goal: ``(3,)`` x, y in metres and heading in radians.
        staging: ``(3,)`` where the last approach begins.
        states: name of the state after each of the N frames.
        commands: ``(N, 3)`` the movement commanded after each frame, in the robot's frame: metres
            forward and left, radians; zeros after the last.
        measured: ``(N, 3)`` the movement after each frame by odometry, in the robot's frame.

    Raises:
        OptionError: parts that do not fit together.
    """

    robot: str
    drive: str
    outcome: str
    exit_code: int
    reason: str
    attempts: int
    settings: dict[str, Any]
    goal: FloatArray
    staging: FloatArray
    states: tuple[str, ...]
    commands: FloatArray
    measured: FloatArray

    def __post_init__(self) -> None:
        count = len(self.states)
        shapes = {"goal": (3,), "staging": (3,), "commands": (count, 3), "measured": (count, 3)}
        for name, shape in shapes.items():
            values = getattr(self, name)
            if values.shape != shape or not np.all(np.isfinite(values)):
                raise OptionError(f"docking: {name} is not {shape} finite numbers")


def write_docking(file: Any, record: DockingRecord) -> None:
    """Adds the group to an HDF5 file that is being written."""
    group = file.create_group(GROUP)
    header = {
        "robot": record.robot,
        "drive": record.drive,
        "outcome": record.outcome,
        "exit_code": record.exit_code,
        "reason": record.reason,
        "attempts": record.attempts,
        "settings": record.settings,
        "states": list(record.states),
    }
    write_json(group, "header", header)
    for name in ("goal", "staging", "commands", "measured"):
        write_array(group, name, getattr(record, name))


def read_docking(file: SafeFile, frames: int) -> DockingRecord | None:
    """The group of a file with so many frames; None where the run is no docking.

    Raises:
        InputError, OptionError, KeyError, TypeError, ValueError: a group that is damaged.
    """
    if not file.has(f"{GROUP}/header"):
        return None
    header = file.read_json(f"{GROUP}/header")
    shapes = {"goal": (3,), "staging": (3,), "commands": (frames, 3), "measured": (frames, 3)}
    arrays = {
        name: np.asarray(
            file.read_array(f"{GROUP}/{name}", dtype_kind="f", shape=shape), dtype=np.float64
        )
        for name, shape in shapes.items()
    }
    states = tuple(str(state) for state in header["states"])
    if len(states) != frames:
        raise OptionError(f"docking: {len(states)} states for {frames} frames")
    return DockingRecord(
        robot=str(header["robot"]),
        drive=str(header["drive"]),
        outcome=str(header["outcome"]),
        exit_code=int(header["exit_code"]),
        reason=str(header["reason"]),
        attempts=int(header["attempts"]),
        settings=dict(header["settings"]),
        states=states,
        **arrays,
    )
