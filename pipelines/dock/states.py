"""States, transitions and outcomes of docking.

The robot is in one **phase** at a time (``Phase``). (``state`` without more is a pose ``(3,)``.)

| phase     | goes on to | when                                                               |
|-----------|------------|--------------------------------------------------------------------|
| searching | staging    | localized in three consecutive images                              |
|           | route      | the same, where no straight line leads to the staging pose         |
| route     | staging    | a straight line leads to the staging pose                          |
| staging   | approach   | at the staging pose; each time counts as an attempt                |
| approach  | alignment  | within 12 cm of the goal                                           |
|           | staging    | too far from the goal's axis, or beyond the goal                   |
| alignment | docked     | at the goal, and the consistency gate accepts the estimate         |
|           | staging    | too many steps, or away from the goal                              |
| any       | waiting    | no longer localized where the map shows something: a covered view  |
| waiting   | the former | localized where odometry says                                      |
|           | searching  | localized elsewhere, or still covered after all viewpoints         |
| any       | searching  | no longer localized for another reason                             |
| any       | finished   | there is an outcome (``OutcomeKind``)                              |
"""

from dataclasses import dataclass, field
from enum import Enum

from pipelines.dock.covered_view import ViewWait
from pipelines.dock.dead_reckoning import DeadReckonedPose
from pipelines.dock.exploration import Search
from pipelines.dock.navigation import Travel
from pipelines.dock.robot import STANDSTILL, Movement


class Phase(Enum):
    """Phases of docking; the value is their name in run files and messages."""

    SEARCHING = "searching"
    WAITING = "waiting"
    ROUTE = "route"
    STAGING = "staging"
    APPROACH = "approach"
    ALIGNMENT = "alignment"
    FINISHED = "finished"


class OutcomeKind(Enum):
    """Outcomes of docking; the value is the exit code. 1 and 2 are errors and wrong usage."""

    DOCKED = 0
    LOST = 10
    BLOCKED = 11
    OUT_OF_AREA = 12
    TIMED_OUT = 13
    ROBOT_FAILED = 14
    VIEW_BLOCKED = 15
    NO_WAY = 16
    INTERRUPTED = 130

    @property
    def word(self) -> str:
        """Its name in messages and files, for example ``out of area``."""
        return self.name.lower().replace("_", " ")


@dataclass(frozen=True)
class Outcome:
    """How docking ended.

    Attributes:
        kind: the outcome.
        reason: one line that says why.
    """

    kind: OutcomeKind
    reason: str


@dataclass(frozen=True)
class DockingState:
    """State of the docking state machine between two images.

    "Consecutive" images or movements are those up to the last one.

    Attributes:
        phase: the current phase.
        search: directions viewed since the robot was last localized.
        localized_images: consecutive images in which the robot is localized.
        blind_images: consecutive images that show nothing.
        stalled_movements: consecutive movements that did not happen.
        refused_movements: consecutive movements that safety did not allow.
        attempts: times that the robot left the staging pose.
        alignment_steps: steps since alignment began.
        docked_images: consecutive images that show the robot at the goal.
        accepted_images: consecutive images whose estimate the consistency gate accepts.
        side_views: times that the robot moved beside the goal to look from there.
        objection: what spoke against the last estimate at the goal; empty: nothing.
        lost_views: rotations on the way to staging after which the robot was not localized.
        stale_images: consecutive images that repeat the previous one although odometry moved.
        last_known: the last localized pose, carried on by odometry; None before the first.
        wait: what was done since the view was covered; None while it is clear.
        resumed: the phase to go back to when the view is clear again.
        is_covered: whether waiting for a clear view was in vain and the robot has not been
            localized since.
        travel: progress on the route to the staging pose.
    """

    phase: Phase = Phase.SEARCHING
    search: Search = field(default_factory=Search)
    localized_images: int = 0
    blind_images: int = 0
    stalled_movements: int = 0
    refused_movements: int = 0
    attempts: int = 0
    alignment_steps: int = 0
    docked_images: int = 0
    accepted_images: int = 0
    side_views: int = 0
    objection: str = ""
    lost_views: int = 0
    stale_images: int = 0
    last_known: DeadReckonedPose | None = None
    wait: ViewWait | None = None
    resumed: Phase = Phase.STAGING
    is_covered: bool = False
    travel: Travel = field(default_factory=Travel)


@dataclass(frozen=True)
class Decision:
    """What to do next.

    Attributes:
        state: the state of docking from now on.
        movement: the next movement, unless there is an outcome.
        outcome: how docking ended; None while it goes on.
    """

    state: DockingState
    movement: Movement = STANDSTILL
    outcome: Outcome | None = None
