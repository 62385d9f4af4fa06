"""Summary of a data set, for ``lfnav info``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.dataset.dataset import IMAGE_LIST, Dataset, load_dataset
from pipelines.dataset.left_out import left_out_text
from pipelines.geometry.trajectory import Trajectory


@dataclass(frozen=True)
class DatasetDescription:
    """A summary of a data set.

    Attributes:
        dataset: what was read.
        has_times: whether the timestamps were recorded; those of a plain folder are made up.
    """

    dataset: Dataset
    has_times: bool

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people; the first row holds the column headings."""
        dataset, camera = self.dataset, self.dataset.camera
        rows: list[tuple[str, ...]] = [
            ("data set", str(dataset.root)),
            ("images", str(len(dataset))),
            *([("not taken", left_out_text(dataset.left_out))] if dataset.left_out else []),
            ("duration", f"{_duration(dataset):.2f} s" if self.has_times else "unknown"),
        ]
        if camera is None:
            rows.append(("camera", "unknown (no camera.toml)"))
        else:
            intrinsics = camera.intrinsics
            rows += [
                ("camera", f"{camera.model} {camera.width}x{camera.height}"),
                ("focal length", f"{intrinsics.fx:.1f} x {intrinsics.fy:.1f} px"),
                ("distortion", "yes" if camera.has_distortion else "no"),
            ]
        if dataset.base_from_camera is None:
            rows.append(("mount", "none: the body is the camera"))
        else:
            x, y, z = dataset.base_from_camera[:3, 3]
            rows.append(("mount", f"{x:.3f}, {y:.3f}, {z:.3f} m"))
        rows += [
            ("odometry", _trajectory_text(dataset.odometry)),
            ("ground truth", _trajectory_text(dataset.groundtruth)),
            ("depth images", str(_depth_count(dataset))),
            ("mask", "none" if dataset.mask is None else dataset.mask.text),
        ]
        return rows

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types, SI units."""
        dataset, camera = self.dataset, self.dataset.camera
        return {
            "kind": "dataset",
            "path": str(dataset.root),
            "images": len(dataset),
            "not_taken": dict(dataset.left_out),
            "duration": _duration(dataset) if self.has_times else None,
            "camera": None if camera is None else camera.to_dict(),
            "base_from_camera": None
            if dataset.base_from_camera is None
            else dataset.base_from_camera.tolist(),
            "odometry": _trajectory_dict(dataset.odometry),
            "groundtruth": _trajectory_dict(dataset.groundtruth),
            "depth_images": _depth_count(dataset),
            "mask_left_out": None if dataset.mask is None else dataset.mask.left_out,
        }


def describe_dataset(path: Path) -> DatasetDescription:
    """Reads a data set (of images the headers, not the pixels) and describes it.

    Raises:
        InputError: something is missing, damaged or contradictory.
    """
    return DatasetDescription(load_dataset(path), (path / IMAGE_LIST).is_file())


def _duration(dataset: Dataset) -> float:
    return float(dataset.timestamps[-1] - dataset.timestamps[0])


def _path_length(trajectory: Trajectory) -> float:
    """Metres travelled: the sum of the straight steps from pose to pose."""
    steps = np.diff(trajectory.poses[:, :3, 3], axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())


def _trajectory_text(trajectory: Trajectory | None) -> str:
    if trajectory is None:
        return "none"
    return f"{len(trajectory)} poses, {_path_length(trajectory):.2f} m"


def _trajectory_dict(trajectory: Trajectory | None) -> dict[str, Any] | None:
    if trajectory is None:
        return None
    return {
        "poses": len(trajectory),
        "path_length": _path_length(trajectory),
        "start": float(trajectory.timestamps[0]),
        "end": float(trajectory.timestamps[-1]),
    }


def _depth_count(dataset: Dataset) -> int:
    return sum(name is not None for name in dataset.depth_names or ())
