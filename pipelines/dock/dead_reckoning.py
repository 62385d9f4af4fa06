"""Dead reckoning: the last known pose, carried on by odometry while images do not say more."""

import math
from dataclasses import dataclass

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.planar_motion import (
    heading_sigma,
    is_near,
    moved,
    position_sigma,
    propagated_covariance,
)
from pipelines.dock.pose_estimate import PoseEstimate
from pipelines.dock.robot import STANDSTILL, Movement

# Standard deviations that odometry adds in a movement: metres plus a share of the distance;
# radians, a share of the rotation, and radians a metre.
STEP_POSITION, POSITION_SHARE = 0.005, 0.1
STEP_HEADING, HEADING_SHARE, HEADING_A_METRE = math.radians(0.5), 0.05, math.radians(6.0)
# An estimate agrees with dead reckoning within this (metres, radians) and two standard deviations.
SAME_POSITION, SAME_HEADING, SIGMAS = 0.1, math.radians(4.0), 2.0


@dataclass(frozen=True)
class DeadReckonedPose:
    """Where the robot is by its last known pose and odometry.

    Attributes:
        state: ``(3,)`` x and y in metres, heading in radians.
        covariance: ``(3, 3)`` of the state's error, metres and radians.
    """

    state: FloatArray
    covariance: FloatArray

    def after(self, measured: Movement) -> "DeadReckonedPose":
        """The pose after a movement measured by odometry."""
        if measured == STANDSTILL:
            return self
        state = moved(self.state, measured)
        position = STEP_POSITION + POSITION_SHARE * measured.distance
        heading = STEP_HEADING + HEADING_SHARE * abs(measured.turn)
        heading += HEADING_A_METRE * measured.distance
        return DeadReckonedPose(
            state, propagated_covariance(self.covariance, self.state, state, position, heading)
        )

    def agrees_with(self, estimate: PoseEstimate) -> bool:
        """Whether an estimate lies where odometry says."""
        metres = SAME_POSITION + SIGMAS * (
            position_sigma(self.covariance) + position_sigma(estimate.covariance)
        )
        radians = SAME_HEADING + SIGMAS * (
            heading_sigma(self.covariance) + heading_sigma(estimate.covariance)
        )
        return is_near(estimate.state, self.state, metres, radians)
