"""Which poses leave the node, and as what: nothing before a pose is known, nothing while lost.

Navigation stops when the transform from odometry's frame to the map grows old. So a pose that is
not known any more is not repeated, and nobody drives by it.
"""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.pose import inverse
from pipelines.localize.run import BY_ODOMETRY, ESTIMATE_PREFERENCE, FrameRecord
from pipelines.localize.state_space import StateSpace

# Of these statuses a frame has one pose; of an image that shows nothing it is odometry's.
KNOWN = ("tracking", *BY_ODOMETRY)


@dataclass(frozen=True)
class KnownPose:
    """A pose that may be published.

    Attributes:
        stamp: ns, of the image.
        map_from_base: ``(4, 4)``.
        map_from_odom: ``(4, 4)``, what odometry has drifted by.
        covariance: ``(6, 6)`` of x, y, z and the rotations about the map's axes, metres and
            radians; zero where a robot on a floor cannot err.
        is_measured: whether the image says so; else odometry carries the pose on.
        confidence: probability that the pose is right, 0 to 1.
    """

    stamp: int
    map_from_base: FloatArray
    map_from_odom: FloatArray
    covariance: FloatArray
    is_measured: bool
    confidence: float


def known_pose(
    record: FrameRecord, space: StateSpace, stamp: int, odom_from_base: FloatArray
) -> KnownPose | None:
    """The pose of a frame, where it is known.

    Args:
        record: of the frame.
        space: what a state is.
        stamp: of the image, ns.
        odom_from_base: ``(4, 4)`` by odometry at that moment.

    Returns:
        None while the robot is searched for or lost.
    """
    names = [name for name in ESTIMATE_PREFERENCE if name in record.estimates]
    if record.status not in KNOWN or not names:
        return None
    covariance = record.covariance
    if names[0] == "refined" and record.refined_covariance is not None:
        covariance = record.refined_covariance
    map_from_base = space.poses(record.estimates[names[0]])
    return KnownPose(
        stamp=stamp,
        map_from_base=map_from_base,
        map_from_odom=map_from_base @ inverse(odom_from_base),
        covariance=full_covariance(covariance, space),
        is_measured=record.status not in BY_ODOMETRY,
        confidence=record.confidence,
    )


def full_covariance(covariance: FloatArray, space: StateSpace) -> FloatArray:
    """The covariance ``(6, 6)`` of a pose from that of a state ``(D, D)``."""
    axes = [0, 1, 5] if space.angles == 1 else list(range(6))
    full = np.zeros((6, 6))
    full[np.ix_(axes, axes)] = covariance
    return full


def weighted_particles(
    record: FrameRecord, space: StateSpace, most: int
) -> tuple[FloatArray, FloatArray]:
    """Poses ``(M, 4, 4)`` and weights ``(M,)`` of the heaviest particles.

    Args:
        record: of a frame.
        space: what a state is.
        most: how many are shown at most; the weights are those of all particles.
    """
    weights = np.exp(record.log_weights)
    chosen = np.sort(np.argsort(-weights, kind="stable")[:most])
    return space.poses(record.particles[chosen]), weights[chosen]


class PosePublishing:
    """Remembers what has been published, so that it can be repeated for an image without a pose."""

    def __init__(self) -> None:
        self._known: KnownPose | None = None

    def update(self, pose: KnownPose | None) -> KnownPose | None:
        """Takes the pose of the newest frame, None where it is not known.

        Returns:
            What may be published: a pose that odometry carries on only where there was one.
        """
        if pose is not None and not pose.is_measured and self._known is None:
            return None
        self._known = pose
        return pose

    def repeated(self, stamp: int) -> FloatArray | None:
        """``map_from_odom`` for an image that the filter did not take.

        Args:
            stamp: of the image, ns.

        Returns:
            None where no pose is known, or one of a later image is.
        """
        if self._known is None or stamp <= self._known.stamp:
            return None
        return self._known.map_from_odom
