"""Transforms as messages, by their fields."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.pose import quaternion_of, world_from_base_planar
from pipelines.ros.pose_track import NANOSECONDS as SECOND


def transform(parent: str, child: str, stamp: int, pose: FloatArray) -> Any:
    """A TransformStamped, by its fields."""
    x, y, z, w = quaternion_of(pose).tolist()
    px, py, pz = pose[:3, 3].tolist()
    return SimpleNamespace(
        header=SimpleNamespace(
            frame_id=parent,
            stamp=SimpleNamespace(sec=stamp // SECOND, nanosec=stamp % SECOND),
        ),
        child_frame_id=child,
        transform=SimpleNamespace(
            translation=SimpleNamespace(x=px, y=py, z=pz),
            rotation=SimpleNamespace(x=x, y=y, z=z, w=w),
        ),
    )


def planar(x: float, y: float, degrees: float) -> FloatArray:
    return world_from_base_planar([x, y, np.radians(degrees)])
