"""The pose of a dock as nav2's docking server takes it, and when it is worth sending.

A robot that docks follows every pose it gets. So a pose that is old, or not sure, is not sent, and
the server waits for a better one, or gives up.
"""

import math

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.pose import inverse, world_from_base_planar
from pipelines.ros.detector_settings import DetectorSettings
from pipelines.ros.pose_publishing import KnownPose
from pipelines.ros.pose_track import NANOSECONDS


def base_from_dock(pose: KnownPose, goal: tuple[float, ...]) -> FloatArray:
    """``(4, 4)``: where the docked robot will be, seen from the robot now.

    Args:
        pose: of the robot.
        goal: x, y, heading in the map.
    """
    return inverse(pose.map_from_base) @ world_from_base_planar(goal)


def objection(pose: KnownPose, settings: DetectorSettings, now: int) -> str:
    """Why the pose of a dock is not to be sent; empty where it is.

    Args:
        pose: of the robot.
        settings: what is sure enough.
        now: ns, of the clock that stamps images.
    """
    if settings.goal is None:
        return "there is no goal"
    age = (now - pose.stamp) / NANOSECONDS
    if age > settings.max_age:
        return f"the image is {age:.2f} s old"
    if not pose.is_measured:
        return "the image shows nothing"
    if pose.confidence < settings.least_confidence:
        return f"the confidence is {pose.confidence:.2f}"
    sigma = math.sqrt(float(np.linalg.eigvalsh(pose.covariance[:2, :2])[-1]))
    if sigma > settings.largest_sigma:
        return f"the position has a standard deviation of {sigma:.2f} m"
    distance = float(np.linalg.norm(base_from_dock(pose, settings.goal)[:2, 3]))
    if distance > settings.detection_range:
        return f"the dock is {distance:.1f} m away"
    return ""
