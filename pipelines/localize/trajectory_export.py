"""A run's estimated trajectory in the formats that other programs read.

The pose that leaves is ``world_from_base``, with z = 0 for a robot on the floor. Frames in which
the filter gave no estimate are left out where the format carries times; KITTI's does not, so there
they are an error.
"""

import csv
import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arguments import checked_choice, checked_instance
from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.atomic import check_output, write_text
from pipelines.artifacts.errors import StageError
from pipelines.geometry.pose import quaternion_of
from pipelines.geometry.trajectory import Trajectory, format_tum
from pipelines.localize.run import FrameRecord, Run, load_run
from pipelines.localize.state_space import known_states

EUROC_HEADER = (
    "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], "
    "q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
)
# What the numbers of a state are called, with their units inside; tables say degrees.
STATE_NAMES = {
    "planar": ("x_m", "y_m", "heading_rad"),
    "spatial": ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad"),
}
CSV_COLUMNS_BEFORE_STATE = ("frame", "timestamp_s", "image")
CSV_COLUMNS_AFTER_STATE = ("status", "confidence", "effective_sample_size", "particles")


@dataclass(frozen=True)
class ExportSummary:
    """A ``Summary`` of what was written."""

    path: Path
    format_name: str
    estimate: str
    poses: int
    frames: int

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        return [
            ("trajectory", str(self.path)),
            ("format", self.format_name),
            ("estimate", self.estimate),
            ("poses", f"{self.poses} of {self.frames} frames"),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "path": str(self.path),
            "format": self.format_name,
            "estimate": self.estimate,
            "poses": self.poses,
            "frames": self.frames,
        }


def export_run_file(
    run_path: Path, output: Path, format_name: str, estimate: str | None, overwrite: bool
) -> ExportSummary:
    """Writes the trajectory of a run file, atomically.

    Raises:
        InputError: the run cannot be read, or the output exists or cannot be written.
        OptionError: an unknown format, or the run has no estimate of this name.
        StageError: a frame without an estimate in a format that has no times.
    """
    check_output(output, overwrite)
    run = load_run(run_path)
    text = export_trajectory(run, format_name, estimate)
    write_text(output, text, overwrite)
    name = run.default_estimate if estimate is None else estimate
    poses = len(_estimated_frames(run.estimated_states(name)))
    return ExportSummary(output, format_name, name, poses, len(run.frames))


def export_trajectory(run: Run, format_name: str, estimate: str | None = None) -> str:
    """The run's trajectory as text.

    Args:
        run: the run.
        format_name: ``tum`` (Sturm et al. 2012), ``kitti`` (Geiger et al. 2012), ``euroc`` (Burri
            et al. 2016), ``csv`` or ``json``.
        estimate: which estimate; None for the run's default.

    Returns:
        Poses world_from_base, metres; their axes are those of REP-103.

    Raises:
        OptionError: an unknown format, or the run has no estimate of this name.
        StageError: a frame without an estimate in a format that has no times.
    """
    checked_instance(run, "the run", Run)
    checked_choice(format_name, "format", FORMATS)
    name = run.default_estimate if estimate is None else estimate
    checked_instance(name, "estimate", str)
    return FORMATS[format_name](run, name)


def estimated_trajectory(run: Run, estimate: str | None = None) -> Trajectory:
    """The estimated poses world_from_base; frames without an estimate are left out.

    Args:
        run: the run.
        estimate: which estimate; None for the run's default.

    Raises:
        OptionError: the run has no estimate of this name.
    """
    checked_instance(run, "the run", Run)
    states = run.estimated_states(estimate)
    frames = _estimated_frames(states)
    return Trajectory(run.timestamps[frames], run.space.poses(states[frames]))


def _estimated_frames(states: FloatArray) -> list[int]:
    return [int(index) for index in np.flatnonzero(known_states(states))]


def _tum(run: Run, estimate: str) -> str:
    return format_tum(estimated_trajectory(run, estimate))


def _kitti(run: Run, estimate: str) -> str:
    states = run.estimated_states(estimate)
    if len(_estimated_frames(states)) < len(states):
        missing = int(np.flatnonzero(~known_states(states))[0])
        raise StageError(
            f"frame {missing} has no estimate, and KITTI's format, a line a frame without times, "
            "has no way to leave it out; export to another format"
        )
    rows = run.space.poses(states)[:, :3, :].reshape(-1, 12)
    return "".join(" ".join(f"{value:.12e}" for value in row) + "\n" for row in rows)


def _euroc(run: Run, estimate: str) -> str:
    trajectory = estimated_trajectory(run, estimate)
    lines = [EUROC_HEADER]
    for time, pose, quaternion in zip(
        trajectory.timestamps, trajectory.poses, quaternion_of(trajectory.poses), strict=True
    ):
        scalar_first = (quaternion[3], *quaternion[:3])
        values = ",".join(f"{value:.9f}" for value in (*pose[:3, 3], *scalar_first))
        lines.append(f"{nanoseconds(float(time))},{values}")
    return "\n".join(lines) + "\n"


def nanoseconds(seconds: float) -> int:
    """A timestamp as a whole number of nanoseconds."""
    # Through the shortest decimal: as a product of floats, 1305031102.175304 s would come out up to
    # 100 ns beside 1305031102175304000.
    return round(Decimal(repr(seconds)) * 1_000_000_000)


def _csv(run: Run, estimate: str) -> str:
    states = run.estimated_states(estimate)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [name.replace("_rad", "_deg") for name in STATE_NAMES[run.space.name]]
    writer.writerow([*CSV_COLUMNS_BEFORE_STATE, *names, *CSV_COLUMNS_AFTER_STATE])
    for index in _estimated_frames(states):
        frame, state = run.frames[index], states[index].copy()
        state[run.space.positions :] = np.degrees(state[run.space.positions :])
        writer.writerow(
            [
                index,
                repr(float(frame.timestamp)),
                frame.image_name,
                *(f"{value:.9f}" for value in state),
                frame.status,
                f"{frame.confidence:.6f}",
                f"{frame.effective_sample_size:.3f}",
                len(frame.particles),
            ]
        )
    return text.getvalue()


def _json(run: Run, estimate: str) -> str:
    states = run.estimated_states(estimate)
    content = {
        "format": "lfnav trajectory",
        "scene_identifier": run.scene_identifier,
        "dataset": run.dataset_name,
        "estimate": estimate,
        "seed": run.seed,
        "frames": [
            _json_frame(index, frame, state, STATE_NAMES[run.space.name])
            for index, (frame, state) in enumerate(zip(run.frames, states, strict=True))
        ],
    }
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def _json_frame(
    index: int, frame: FrameRecord, state: FloatArray, names: tuple[str, ...]
) -> dict[str, Any]:
    known = bool(np.all(np.isfinite(state)))
    return {
        "frame": index,
        "timestamp_s": float(frame.timestamp),
        "image": frame.image_name,
        "state": _json_state(state, names) if known else None,
        "status": frame.status,
        "confidence": float(frame.confidence),
        "effective_sample_size": float(frame.effective_sample_size),
        "particles": len(frame.particles),
        "covariance": frame.covariance.tolist(),
        "modes": [
            {**_json_state(mode[:-1], names), "share": float(mode[-1])} for mode in frame.modes
        ],
    }


def _json_state(state: FloatArray, names: tuple[str, ...]) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, state, strict=True)}


FORMATS: dict[str, Callable[[Run, str], str]] = {
    "tum": _tum,
    "kitti": _kitti,
    "euroc": _euroc,
    "csv": _csv,
    "json": _json,
}
