"""Summary of a reconstruction, for people and for programs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.geometry.camera import cameras_text
from pipelines.reconstruct.reconstruction import Reconstruction, load_reconstruction

SHOWN_DROPPED = 5
# Key in ``statistics`` -> what people read, and how many digits.
SHOWN_STATISTICS = {
    "mean_reprojection_error_px": ("mean reprojection error (px)", 2),
    "mean_track_length": ("mean track length (images)", 1),
    "median_triangulation_angle_deg": ("median triangulation angle (deg)", 1),
    "alignment_position_rmse_m": ("alignment to odometry, position (m)", 3),
    "alignment_rotation_rmse_deg": ("alignment to odometry, rotation (deg)", 2),
    "odometry_drift_m": ("drift of odometry, at most (m)", 3),
    "odometry_drift_deg": ("drift of odometry's heading, at most (deg)", 2),
    "planar_rms_px": ("adjusted in the plane, error (px)", 2),
    "planar_moved_m": ("adjusted in the plane, moved by (m)", 3),
}


@dataclass(frozen=True)
class ReconstructionSummary:
    """A ``Summary`` of a reconstruction."""

    path: Path
    reconstruction: Reconstruction

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        content = self.reconstruction
        total = len(content.image_names) + len(content.dropped)
        rows: list[tuple[str, ...]] = [
            ("reconstruction", str(self.path)),
            ("method", content.method),
            ("images with a pose", f"{len(content.image_names)} of {total}"),
            ("scale from", content.scale_source),
            ("extent of the cameras", _extent_text(self.extent(), self.unit())),
            ("camera", cameras_text(content.cameras)),
            ("points", str(len(content.points))),
        ]
        for key, (label, digits) in SHOWN_STATISTICS.items():
            value = content.statistics.get(key)
            if isinstance(value, (int, float)):
                rows.append((label, f"{value:.{digits}f}"))
        pieces = content.statistics.get("pieces")
        if isinstance(pieces, list) and len(pieces) > 1:
            sizes = ", ".join(str(size) for size in pieces)
            rows.append(("images in pieces that odometry joins", sizes))
        lone = content.statistics.get("placed_by_odometry")
        if isinstance(lone, int) and lone:
            rows.append(("images placed by odometry alone", str(lone)))
        dropped = list(content.dropped.items())
        rows += [(f"dropped {name}", reason) for name, reason in dropped[:SHOWN_DROPPED]]
        if len(dropped) > SHOWN_DROPPED:
            rows.append(("dropped besides", f"{len(dropped) - SHOWN_DROPPED} images"))
        return rows

    def unit(self) -> str:
        """The unit of lengths."""
        return "units" if self.reconstruction.scale_source == "arbitrary" else "m"

    def extent(self) -> tuple[float, float, float]:
        """Sides of the box about the camera centres, along x, y, z."""
        centres = self.reconstruction.world_from_camera[:, :3, 3]
        x, y, z = np.ptp(centres, axis=0).tolist()
        return x, y, z

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        content = self.reconstruction
        return {
            "kind": "reconstruction",
            "path": str(self.path),
            "method": content.method,
            "scale_source": content.scale_source,
            "images": len(content.image_names),
            "images_total": len(content.image_names) + len(content.dropped),
            "dropped": dict(content.dropped),
            "points": len(content.points),
            "observations": len(content.observations),
            "cameras": [camera.to_dict() for camera in content.cameras],
            "extent": list(self.extent()),
            "statistics": dict(content.statistics),
        }


def _extent_text(extent: tuple[float, float, float], unit: str) -> str:
    return " x ".join(f"{side:.2f}" for side in extent) + f" {unit}"


def describe_reconstruction(path: Path) -> ReconstructionSummary:
    """Reads a reconstruction and summarizes it.

    Raises:
        InputError: missing, no reconstruction, or damaged.
    """
    return ReconstructionSummary(path, load_reconstruction(path))
