"""Does the belief move as the wheels do? One that does not is about another place.

In a scene with places that look alike a belief can settle on the wrong one, explain the images
tolerably, and follow reflections from step to step. What gives it away is odometry: at the right
place, estimates move as it says to a few centimetres, whatever its scale; at the wrong one they
jump.
"""

import math
from collections import deque

from pipelines.dock.planar_motion import movement_between
from pipelines.dock.pose_estimate import Fix
from pipelines.dock.robot import Movement

# Estimate and odometry may differ by this: metres, of the distance; radians, a metre, of the turn.
POSITION, POSITION_SHARE = 0.08, 0.2
HEADING, HEADING_A_METRE, HEADING_SHARE = math.radians(4.0), math.radians(12.0), 0.05
# So many contradictions in so many movements, and the belief is given up. One may be slip.
MOST, WINDOW = 3, 6


def contradicts(measured: Movement, before: Fix, after: Fix) -> bool:
    """Whether two fixes are farther apart, or nearer, than the movement between them allows.

    Args:
        measured: by odometry.
        before: the fix before the movement.
        after: the fix after it.
    """
    if not (before.is_sure and after.is_sure):
        return False
    placed = movement_between(before.state, after.state)
    apart = math.hypot(placed.forward - measured.forward, placed.left - measured.left)
    turned = abs(math.remainder(placed.turn - measured.turn, 2.0 * math.pi))
    far = POSITION + POSITION_SHARE * measured.distance
    wide = HEADING + HEADING_A_METRE * measured.distance + HEADING_SHARE * abs(measured.turn)
    return apart > far or turned > wide


class Doubt:
    """Counts contradictions among the last movements."""

    def __init__(self) -> None:
        self._last: deque[bool] = deque(maxlen=WINDOW)

    def __call__(self, contradiction: bool) -> bool:
        """Whether the belief is to be given up; the count then begins anew.

        Args:
            contradiction: whether the last movement was one.
        """
        self._last.append(contradiction)
        given_up = sum(self._last) >= MOST
        if given_up:
            self._last.clear()
        return given_up
