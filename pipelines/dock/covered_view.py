"""What to do while something covers the view: wait, look again, look past it; never drive blindly.

A robot that has just known where it was knows it still, by its wheels. If its image suddenly shows
nothing of the map, somebody has most probably walked in front of it, and will walk on. It stands
still and looks again; then it looks past whoever stays, from a little to the left and right; and
only then it begins to search. Where the robot is taken to be meanwhile (the anchor) comes from
odometry alone, and all that it drives without seeing anything are two steps of ``ASIDE``.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.planar_motion import (
    distance_between,
    heading_sigma,
    moved,
    position_sigma,
    turn_between,
)
from pipelines.dock.pose_estimate import Fix
from pipelines.dock.robot import STANDSTILL, Movement
from pipelines.dock.safety import Safety

# So many looks standing still, and so many from each place beside.
LOOKS, LOOKS_ASIDE = 5, 2
# So far to one side and as far to the other: metres, and radians for a robot that can only turn.
ASIDE, ASIDE_TURN = 0.15, math.radians(15.0)
# From the one side to the other is twice as far.
SIDES = (1.0, -2.0)
# A camera that shows one and the same image so often, although the robot has moved, hangs.
LARGEST_STALE = 6
# What odometry adds to the anchor's uncertainty: metres and radians a movement, and of it.
STEP_POSITION, POSITION_SHARE = 0.005, 0.1
STEP_HEADING, HEADING_SHARE, HEADING_A_METRE = math.radians(0.5), 0.05, math.radians(6.0)
# A belief goes on where the anchor is, to within this and two standard deviations.
SAME_POSITION, SAME_HEADING, SIGMAS = 0.1, math.radians(4.0), 2.0


@dataclass(frozen=True)
class Anchor:
    """Where the robot is by its last fix and its wheels.

    Attributes:
        state: ``(3,)``.
        covariance: ``(3, 3)``.
    """

    state: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, fix: Fix) -> "Anchor":
        """At a fix."""
        return cls(fix.state, fix.covariance)

    def after(self, measured: Movement) -> "Anchor":
        """After a movement, as odometry measured it."""
        if measured == STANDSTILL:
            return self
        state = moved(self.state, measured)
        across = np.eye(3)
        across[0, 2] = -(state[1] - self.state[1])
        across[1, 2] = state[0] - self.state[0]
        position = STEP_POSITION + POSITION_SHARE * measured.distance
        heading = STEP_HEADING + HEADING_SHARE * abs(measured.turn)
        heading += HEADING_A_METRE * measured.distance
        noise = np.diag([position**2, position**2, heading**2])
        covariance = across @ self.covariance @ across.T + noise
        return Anchor(state, covariance)

    def agrees(self, fix: Fix) -> bool:
        """Whether a fix is where the wheels say."""
        metres = SAME_POSITION + SIGMAS * (
            position_sigma(self.covariance) + position_sigma(fix.covariance)
        )
        radians = SAME_HEADING + SIGMAS * (
            heading_sigma(self.covariance) + heading_sigma(fix.covariance)
        )
        return (
            distance_between(fix.state, self.state) <= metres
            and abs(turn_between(fix.state, self.state)) <= radians
        )


@dataclass(frozen=True)
class Wait:
    """How long the view was covered so far.

    Attributes:
        looks: images since the robot stands where it stands.
        asides: places beside that were tried.
        turned: radians of the turn after which the view was lost; 0: it was no turn.
    """

    looks: int = 0
    asides: int = 0
    turned: float = 0.0


def next_look(
    wait: Wait, anchor: Anchor, drive: str, safety: Safety
) -> tuple[Movement, Wait] | None:
    """How to look again; None where everything was tried.

    Args:
        wait: so far, this image included.
        anchor: where the robot is.
        drive: ``omni`` or ``diff``.
        safety: bounds of all movements.
    """
    if wait.looks < (LOOKS if wait.asides == 0 else LOOKS_ASIDE):
        return STANDSTILL, replace(wait, looks=wait.looks + 1)
    if wait.asides == len(SIDES):
        return None
    then = replace(wait, looks=1, asides=wait.asides + 1)
    if wait.asides == 0 and wait.turned != 0.0:
        # Something was to be seen there.
        return Movement(turn=-wait.turned), then
    side = SIDES[wait.asides]
    if wait.turned != 0.0:
        side = math.copysign(1.0, side)
    movement = Movement(turn=side * ASIDE_TURN)
    if drive == "omni":
        step = safety.restricted(anchor.state, anchor.covariance, Movement(left=side * ASIDE))
        movement = step if step.distance > 0.0 else Movement(turn=math.copysign(ASIDE_TURN, side))
    return movement, then
