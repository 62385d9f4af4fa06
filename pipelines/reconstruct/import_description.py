"""Summary of an import: how the source was recognised, its result, and the next command."""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dataset.dataset import GROUNDTRUTH_FILE
from pipelines.geometry.camera import Camera


@dataclass(frozen=True)
class ImportSummary:
    """The ``Summary`` of an import.

    Attributes:
        output: the data set.
        kind: the kind of source that was recognised.
        evidence: the file by which it was, or "--from".
        images: their number.
        cameras: those that took them; none where they are unknown.
        world_from_camera: ``(N, 4, 4)``; None without poses.
        is_metric: whether lengths are metres.
        depth_images: their number.
        points: number of the scene points that came along.
        reconstruction: the reconstruction's folder; None where the source has no exact poses.
        notes: what the user should know.
    """

    output: Path
    kind: str
    evidence: str
    images: int
    cameras: tuple[Camera, ...]
    world_from_camera: FloatArray | None
    is_metric: bool
    depth_images: int
    points: int
    reconstruction: Path | None
    notes: tuple[str, ...]

    def next_command(self) -> str:
        """The command line that goes on from here."""
        if self.reconstruction is not None:
            return f"lfnav model {shlex.quote(str(self.reconstruction))} -o scene.h5"
        folder = shlex.quote(str(self.output))
        if self.world_from_camera is None:
            return f"lfnav reconstruct {folder} -o map --method sfm"
        poses = shlex.quote(str(self.output / GROUNDTRUTH_FILE))
        return f"lfnav reconstruct {folder} -o map --method poses --poses {poses}"

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        rows: list[tuple[str, ...]] = [
            ("data set", str(self.output)),
            ("source taken for", f"{self.kind} ({self.evidence})"),
            ("images", str(self.images)),
            ("camera", self._camera_text()),
            ("poses", self._poses_text()),
        ]
        if self.depth_images:
            rows.append(("depth images", str(self.depth_images)))
        if self.points:
            rows.append(("points", str(self.points)))
        rows += [("note", note) for note in self.notes]
        rows.append(("next", self.next_command()))
        return rows

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "kind": "import",
            "path": str(self.output),
            "source": self.kind,
            "evidence": self.evidence,
            "images": self.images,
            "cameras": [camera.to_dict() for camera in self.cameras],
            "poses": 0 if self.world_from_camera is None else len(self.world_from_camera),
            "metric": self.is_metric,
            "depth_images": self.depth_images,
            "points": self.points,
            "reconstruction": None if self.reconstruction is None else str(self.reconstruction),
            "notes": list(self.notes),
            "next_command": self.next_command(),
        }

    def _camera_text(self) -> str:
        if not self.cameras:
            return "unknown (structure from motion estimates it)"
        first = self.cameras[0]
        text = f"{first.model} {first.width}x{first.height}, {first.intrinsics.fx:.1f} px"
        if len(self.cameras) == 1:
            return text
        return f"{len(self.cameras)} cameras, the first {text} (no camera.toml)"

    def _poses_text(self) -> str:
        if self.world_from_camera is None:
            return "none"
        sides = np.ptp(self.world_from_camera[:, :3, 3], axis=0).tolist()
        unit = "m" if self.is_metric else "units (--scale says how many metres one is)"
        return " x ".join(f"{side:.3g}" for side in sides) + f" {unit}"
