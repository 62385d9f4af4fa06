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
# Fields of the header and their types; ``states`` is the one besides.
HEADER = {
    "robot": str,
    "drive": str,
    "outcome": str,
    "exit_code": int,
    "reason": str,
    "attempts": int,
    "settings": dict,
}


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
        for name, shape in _shapes(len(self.states)).items():
            values = getattr(self, name)
            if values.shape != shape or not np.all(np.isfinite(values)):
                raise OptionError(f"docking: {name} is not {shape} finite numbers")


def write_docking(file: Any, record: DockingRecord) -> None:
    """Adds the group to an HDF5 file that is being written."""
    group = file.create_group(GROUP)
    header = {name: getattr(record, name) for name in HEADER}
    write_json(group, "header", {**header, "states": list(record.states)})
    for name in _shapes(len(record.states)):
        write_array(group, name, getattr(record, name))


def read_docking(file: SafeFile, frames: int) -> DockingRecord | None:
    """The group of a file with so many frames; None where the run is no docking.

    Raises:
        InputError, OptionError, KeyError, TypeError, ValueError: a group that is damaged.
    """
    if not file.has(f"{GROUP}/header"):
        return None
    header = file.read_json(f"{GROUP}/header")
    arrays: dict[str, Any] = {
        name: np.asarray(
            file.read_array(f"{GROUP}/{name}", dtype_kind="f", shape=shape), dtype=np.float64
        )
        for name, shape in _shapes(frames).items()
    }
    states = tuple(str(state) for state in header["states"])
    if len(states) != frames:
        raise OptionError(f"docking: {len(states)} states for {frames} frames")
    fields: dict[str, Any] = {name: kind(header[name]) for name, kind in HEADER.items()}
    return DockingRecord(**fields, **arrays, states=states)


def _shapes(frames: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays of a docking with so many frames."""
    return {"goal": (3,), "staging": (3,), "commands": (frames, 3), "measured": (frames, 3)}
