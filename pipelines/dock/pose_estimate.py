"""The pose estimate that docking acts on: where the robot is, and how far that can be trusted."""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.planar_motion import position_sigma
from pipelines.localize.run import FrameRecord

# The robot is localized when one mode holds this share of the weight, when its position is no less
# certain than this (metres), and when it is more probably right than wrong (within 0.1 m and
# 3 degrees).
LEAST_MODE_SHARE = 0.9
LARGEST_POSITION_SIGMA = 0.35
LEAST_DRIVING_CONFIDENCE = 0.5


@dataclass(frozen=True)
class PoseEstimate:
    """A pose on the floor with its covariance and its state of validation.

    Attributes:
        state: ``(3,)`` x and y in metres, heading in radians.
        covariance: ``(3, 3)`` of the state's error, metres and radians.
        modes: ``(K, 4)`` modes of the filter's belief, heaviest first: x, y, heading, and the share
            of the weight.
        is_refined: whether ``state`` was aligned with the image by the filter or by docking.
        is_localized: whether the belief has one narrow mode that explains the image.
        is_blind: whether the image shows nothing that could be compared with the map.
        is_aligned: whether ``state`` was aligned at docking's finest resolution.
        is_stale: whether the image is the previous one although odometry moved.
        status: the filter's status of this frame, one of ``localize.run.STATUSES``.
        confidence: probability that the filter's estimate is right, 0 to 1.
        rejection: why the consistency gate rejects the estimate for docking; empty: accepted.
        overrules_filter: whether images and odometry agree on ``state`` against the filter.
    """

    state: FloatArray
    covariance: FloatArray
    modes: FloatArray
    is_refined: bool
    is_localized: bool
    is_blind: bool
    is_aligned: bool = False
    is_stale: bool = False
    status: str = "tracking"
    confidence: float = 1.0
    rejection: str = ""
    overrules_filter: bool = False

    @property
    def objection(self) -> str:
        """What still speaks against docking by this estimate; empty where nothing does."""
        return self.rejection or ("the filter disagrees" if self.overrules_filter else "")


def pose_estimate_of(record: FrameRecord) -> PoseEstimate:
    """The filter's estimate of a frame with three degrees of freedom, refined where it was."""
    refined = record.estimates.get("refined")
    main = record.modes[0]
    state, covariance = main[:3], record.covariance
    if refined is not None and record.refined_covariance is not None:
        state, covariance = refined, record.refined_covariance
    is_localized = (
        record.status == "tracking"
        and float(main[3]) >= LEAST_MODE_SHARE
        and position_sigma(record.covariance) <= LARGEST_POSITION_SIGMA
        and record.confidence >= LEAST_DRIVING_CONFIDENCE
    )
    return PoseEstimate(
        state=np.asarray(state, dtype=np.float64),
        covariance=covariance,
        modes=record.modes,
        is_refined=refined is not None,
        is_localized=is_localized,
        is_blind=record.status == "blind",
        is_stale=record.status == "stale",
        status=record.status,
        confidence=record.confidence,
    )
