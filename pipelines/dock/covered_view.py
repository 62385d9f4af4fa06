"""Recovery from a covered view: wait, look past the obstruction, and never drive blindly.

A robot whose last image was localized still knows its pose by odometry. If the next image shows
nothing of the map, most probably somebody walked in front of the camera and will walk on. The robot
stands still and takes images. Then it looks past the obstruction from a little to the left and to
the right. Only then does it search. Its pose is dead-reckoned meanwhile, and all that it drives
without a localized image are two steps of ``SIDESTEP``.
"""

import math
from dataclasses import dataclass, replace

from pipelines.dock.dead_reckoning import DeadReckonedPose
from pipelines.dock.robot import STANDSTILL, Movement
from pipelines.dock.safety import Safety

# Images taken while standing still where the view was lost, and at each place beside it.
WAITING_IMAGES, IMAGES_BESIDE = 5, 2
# Distance to the place on either side, metres; yaw (radians) for a robot that can only rotate.
SIDESTEP, SIDE_YAW = 0.15, math.radians(15.0)
# From the one side to the other is twice as far.
SIDES = (1.0, -2.0)


@dataclass(frozen=True)
class ViewWait:
    """What was done since the view was covered.

    Attributes:
        images: images taken since the robot stands where it stands.
        sidesteps: places beside that were tried.
        rotated: yaw (radians) of the rotation after which the view was lost; 0: it was none.
    """

    images: int = 0
    sidesteps: int = 0
    rotated: float = 0.0


def next_viewpoint(
    wait: ViewWait, pose: DeadReckonedPose, drive: str, safety: Safety
) -> tuple[Movement, ViewWait] | None:
    """The movement before the next image, and the wait after it; None where all was tried.

    Args:
        wait: what was done so far, this image included.
        pose: where the robot is by odometry.
        drive: kind of drive, ``omni`` or ``diff``.
        safety: bounds of all movements.
    """
    if wait.images < (WAITING_IMAGES if wait.sidesteps == 0 else IMAGES_BESIDE):
        return STANDSTILL, replace(wait, images=wait.images + 1)
    if wait.sidesteps == len(SIDES):
        return None
    then = replace(wait, images=1, sidesteps=wait.sidesteps + 1)
    if wait.sidesteps == 0 and wait.rotated != 0.0:
        # The image before the rotation was localized: rotate back.
        return Movement(turn=-wait.rotated), then
    side = SIDES[wait.sidesteps]
    if wait.rotated != 0.0:
        side = math.copysign(1.0, side)
    movement = Movement(turn=side * SIDE_YAW)
    if drive == "omni":
        step = safety.restricted(pose.state, pose.covariance, Movement(left=side * SIDESTEP))
        movement = step if step.distance > 0.0 else Movement(turn=math.copysign(SIDE_YAW, side))
    return movement, then
