"""Summary of a run, for people and for programs."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.run import STATUSES, Run, load_run
from pipelines.localize.state_space import StateSpace

# Key of a run's provenance; not there: metres.
UNIT_OF_LENGTH = "unit_of_length"


@dataclass(frozen=True)
class RunSummary:
    """A ``Summary`` of a run."""

    path: Path
    run: Run

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        run, last = self.run, self.run.frames[-1]
        camera = run.camera
        times = run.timestamps
        counts = Counter(frame.status for frame in run.frames)
        rows: list[tuple[str, ...]] = [
            ("run", str(self.path)),
            ("data set", run.dataset_name),
            ("scene", f"{run.scene_path} ({run.scene_identifier[:12]})"),
            ("camera", f"{camera.model} {camera.width}x{camera.height}"),
            ("frames", f"{len(run.frames)}, {times[0]:.3f} to {times[-1]:.3f} s"),
            ("status", ", ".join(f"{status} {counts[status]}" for status in STATUSES)),
            ("particles, first and last frame", self._particles_text()),
            ("estimates", ", ".join(run.estimate_names) or "none"),
            ("last estimate", self._last_estimate_text()),
            ("last confidence", f"{last.confidence:.2f} ({last.status})"),
            ("seconds a frame", f"{self.seconds_per_frame():.3f}"),
            ("odometry", "no" if run.odometry is None else "yes"),
            ("ground truth", "no" if run.groundtruth is None else "yes"),
            ("seed", str(run.seed)),
        ]
        rows += [(f"setting {name}", str(run.settings[name])) for name in sorted(run.settings)]
        rows += [("note", note) for note in notes_of(run)]
        return rows

    def seconds_per_frame(self) -> float:
        """Mean wall time, all stages together."""
        return float(np.mean(self.run.frame_seconds))

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        run, last = self.run, self.run.frames[-1]
        counts = Counter(frame.status for frame in run.frames)
        return {
            "kind": "run",
            "path": str(self.path),
            "dataset": run.dataset_name,
            "scene_path": run.scene_path,
            "scene_identifier": run.scene_identifier,
            "frames": len(run.frames),
            "status": {status: counts[status] for status in STATUSES},
            "particles": [len(frame.particles) for frame in run.frames],
            "estimates": list(run.estimate_names),
            "last": {
                "timestamp_s": float(last.timestamp),
                "estimates": {name: state.tolist() for name, state in last.estimates.items()},
                "status": last.status,
                "confidence": float(last.confidence),
            },
            "seconds_per_frame": self.seconds_per_frame(),
            "odometry": run.odometry is not None,
            "groundtruth": run.groundtruth is not None,
            "seed": run.seed,
            "notes": list(notes_of(run)),
            "settings": dict(run.settings),
            "provenance": dict(run.provenance),
        }

    def _particles_text(self) -> str:
        first, last = self.run.frames[0], self.run.frames[-1]
        return f"{len(first.particles)}, {len(last.particles)}"

    def _last_estimate_text(self) -> str:
        # Of the last frame alone: "none" is an answer, the pose of an earlier frame is not.
        if not self.run.own_estimate_names:
            return "none"
        name = self.run.default_estimate
        state = self.run.frames[-1].estimates.get(name)
        if state is None:
            return f"none ({self.run.frames[-1].status})"
        return f"{name}: {_state_text(self.run.space, state, unit_of(self.run))}"


def unit_of(run: Run) -> str:
    """The unit of a run's lengths, the scene's: "m", or "units" where nobody knows its scale."""
    return "units" if run.provenance.get(UNIT_OF_LENGTH) == "units" else "m"


def notes_of(run: Run) -> tuple[str, ...]:
    """Lines on what is suspicious about a run's inputs; they are kept in its provenance."""
    notes = run.provenance.get("notes", ())
    if not isinstance(notes, (list, tuple)):
        return ()
    return tuple(" ".join(str(note).split()) for note in notes)


def _state_text(space: StateSpace, state: FloatArray, unit: str) -> str:
    lengths = [f"{axis} {value:.3f} {unit}" for axis, value in zip("xyz", state, strict=False)]
    angles = ", ".join(f"{value:.1f}" for value in np.degrees(state[space.positions :]))
    name = "heading" if space.angles == 1 else "rotation vector"
    return f"{', '.join(lengths[: space.positions])}, {name} {angles} deg"


def describe_run(path: Path) -> RunSummary:
    """Reads a run and summarizes it.

    Raises:
        InputError: not a run, of a newer schema, or damaged.
    """
    return RunSummary(path, load_run(path))
