"""What a belief tells the pilot: a pose with its covariance, and whether to act on it."""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.planar_motion import position_sigma
from pipelines.localize.run import FrameRecord

# A belief to act on: one mode with this share of the weight, and no wider than this, metres.
SURE_SHARE = 0.9
SURE_POSITION = 0.35
# Nobody drives by an estimate that is more probably wrong than right (within 0.1 m and 3 degrees).
SURE_CONFIDENCE = 0.5


@dataclass(frozen=True)
class Fix:
    """Where the robot is taken to be.

    Attributes:
        state: ``(3,)``.
        covariance: ``(3, 3)`` of its error, metres and radians.
        modes: ``(K, 4)`` other places where it may be, and their share of the weight; the heaviest
            first.
        is_refined: whether ``state`` was aligned with the image.
        is_sure: whether the belief has one narrow peak that explains the image.
        is_blind: whether the image shows nothing.
        is_stale: whether it is the image before, although odometry says that the robot moved.
        is_aligned: whether ``state`` was aligned at the highest resolution.
        status: of the filter.
        confidence: probability that the filter's estimate is right, 0 to 1.
        doubt: why it may not be docked by; empty where nothing speaks against that.
        is_disputed: whether images and odometry agree on it, and the filter alone does not.
    """

    state: FloatArray
    covariance: FloatArray
    modes: FloatArray
    is_refined: bool
    is_sure: bool
    is_blind: bool
    is_aligned: bool = False
    is_stale: bool = False
    status: str = "tracking"
    confidence: float = 1.0
    doubt: str = ""
    is_disputed: bool = False

    @property
    def what_speaks_against(self) -> str:
        """Of docking by it; empty where nothing does."""
        return self.doubt or ("the filter disagrees" if self.is_disputed else "")


def fix_of(record: FrameRecord) -> Fix:
    """The fix of a frame on the floor."""
    refined = record.estimates.get("refined")
    main = record.modes[0]
    state, covariance = main[:3], record.covariance
    if refined is not None and record.refined_covariance is not None:
        state, covariance = refined, record.refined_covariance
    is_sure = (
        record.status == "tracking"
        and float(main[3]) >= SURE_SHARE
        and position_sigma(record.covariance) <= SURE_POSITION
        and record.confidence >= SURE_CONFIDENCE
    )
    return Fix(
        state=np.asarray(state, dtype=np.float64),
        covariance=covariance,
        modes=record.modes,
        is_refined=refined is not None,
        is_sure=is_sure,
        is_blind=record.status == "blind",
        is_stale=record.status == "stale",
        status=record.status,
        confidence=record.confidence,
    )
