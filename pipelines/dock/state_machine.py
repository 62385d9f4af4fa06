"""The state machine of a docking: what to do next, from what is known now.

    searching --> staging --> approach --> alignment --> docked
        ^            ^____________________________|  (retries)
        |____ from anywhere, as soon as the belief is no longer narrow, after waiting for the view
              to become clear again where the map shows something there

``Pilot.decide`` takes what is remembered and what was just seen, and gives back the next movement
or an outcome, and what to remember; it keeps nothing itself.
"""

from dataclasses import dataclass, field, replace
from enum import Enum

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.controller import (
    SHORTEST,
    diff_movement_along,
    diff_movement_to,
    is_near,
    nearing,
    omni_movement,
)
from pipelines.dock.covered_view import LARGEST_STALE, Anchor, Wait, next_look
from pipelines.dock.exploration import DIRECTIONS, ENOUGH_COVERED, Explorer, Search
from pipelines.dock.outcomes import Ending, Outcome
from pipelines.dock.planar_motion import (
    behind,
    distance_between,
    heading_sigma,
    movement_between,
    position_sigma,
    turn_between,
)
from pipelines.dock.pose_estimate import Fix
from pipelines.dock.robot import STANDSTILL, Movement
from pipelines.dock.safety import Safety
from pipelines.dock.settings import DockSettings

# The belief has to be narrow in so many images running before the robot drives by it.
SURE_IMAGES = 3
# So many images running that show nothing (all round), movements that did not happen, movements
# that were not allowed: then there is no point in going on.
LARGEST_BLIND, LARGEST_STILL, LARGEST_REFUSED = 14, 3, 4
# At the staging pose: metres and radians.
STAGED_POSITION, STAGED_HEADING = 0.1, 0.1
# From here on the robot aligns itself, metres.
ALIGNMENT_DISTANCE = 0.12
# So many images at the goal, and so many running by which nothing speaks against the fix; so many
# steps of alignment, then it begins again from staging.
DOCKED_IMAGES, CONFIRMED_IMAGES, LARGEST_ALIGNMENT = 2, 3, 12
# After so many images at the goal that are not confirmed it looks from a place beside: metres, and
# radians for a robot that can only turn; first on one side, then on the other, and it is given so
# many steps more for each.
UNCONFIRMED_IMAGES, BESIDE, BESIDE_TURN, BOTH_SIDES, BESIDE_STEPS = 2, 0.1, 0.1, 2, 5
# Farther from the goal's axis than this while approaching: back to staging, metres.
LARGEST_OFFSET = 0.25
SIGMAS = 2.0
# A view of which the map shows less than this is not waited for.
LEAST_AWAITED = 0.3
# A turn that tries out whether a new belief holds, radians.
SMALLEST_TRIAL, LARGEST_TRIAL = 0.05, 0.15
# A robot that looks round and may have been found, with this confidence, keeps what it sees
# in view for another image; so often in one search.
HINT_CONFIDENCE, MOST_HINTS = 0.1, 6


class Phase(Enum):
    """The named states."""

    SEARCHING = "searching"
    WAITING = "waiting"
    STAGING = "staging"
    APPROACH = "approach"
    ALIGNMENT = "alignment"
    FINISHED = "finished"


@dataclass(frozen=True)
class Memory:
    """What the pilot has to remember from one image to the next.

    Attributes:
        phase: the state it is in.
        search: what was looked at since the belief was last narrow.
        sure_images: images running with a narrow belief.
        blind_images: images running that show nothing.
        still_movements: movements running that did not happen.
        refused: movements running that safety did not allow.
        attempts: times that it left the staging pose.
        alignment_steps: since it began to align itself.
        docked_images: images running that show the robot at the goal.
        confirmed_images: images running by which nothing speaks against the fix.
        looks_beside: times that it went aside from the goal to look from there.
        doubt: what spoke against the last fix at the goal.
        lost_views: turns on the way to staging after which the belief was no longer narrow.
        stale_images: images running that are one and the same although the robot has moved.
        anchor: where it is by its last fix and odometry; None before the first.
        wait: for the view to become clear again; None where it is clear.
        resumed: the state to go back to then.
        is_covered: whether the view was lost from a known place, and no image since then was of a
            known place.
    """

    phase: Phase = Phase.SEARCHING
    search: Search = field(default_factory=Search)
    sure_images: int = 0
    blind_images: int = 0
    still_movements: int = 0
    refused: int = 0
    attempts: int = 0
    alignment_steps: int = 0
    docked_images: int = 0
    confirmed_images: int = 0
    looks_beside: int = 0
    doubt: str = ""
    lost_views: int = 0
    stale_images: int = 0
    anchor: Anchor | None = None
    wait: Wait | None = None
    resumed: Phase = Phase.STAGING
    is_covered: bool = False


@dataclass(frozen=True)
class Decision:
    """What to do.

    Attributes:
        memory: to remember.
        movement: to make, if there is no outcome.
        outcome: how it ended; None while it goes on.
    """

    memory: Memory
    movement: Movement = STANDSTILL
    outcome: Outcome | None = None


class Pilot:
    """Decides.

    Args:
        goal: ``(3,)``.
        settings: how to move, when to stop.
        safety: bounds of all movements.
        explorer: chooses the movements of a search.
    """

    def __init__(
        self, goal: FloatArray, settings: DockSettings, safety: Safety, explorer: Explorer
    ) -> None:
        self.goal = goal
        self.staging = behind(goal, settings.staging_distance)
        self.settings = settings
        self._safety = safety
        self._explorer = explorer

    def decide(
        self, memory: Memory, fix: Fix, still: bool = False, measured: Movement = STANDSTILL
    ) -> Decision:
        """The next movement, or the outcome.

        Args:
            memory: from the image before.
            fix: where the robot is taken to be now.
            still: whether the last movement did not happen (``blockage.stood_still``).
            measured: the last movement, as odometry says.
        """
        seen = replace(
            memory,
            sure_images=memory.sure_images + 1 if fix.is_sure else 0,
            blind_images=memory.blind_images + 1 if fix.is_blind else 0,
            still_movements=memory.still_movements + 1 if still else 0,
            confirmed_images=memory.confirmed_images + 1 if fix.is_sure and not fix.doubt else 0,
            stale_images=memory.stale_images + 1 if fix.status == "stale" else 0,
            search=memory.search.after(measured),
            anchor=None if memory.anchor is None else memory.anchor.after(measured),
            is_covered=memory.is_covered and not fix.is_sure,
        )
        outcome = self._hopeless(seen, fix)
        if outcome is not None:
            return Decision(replace(seen, phase=Phase.FINISHED), outcome=outcome)
        if memory.wait is not None:
            return self._waited(seen, fix)
        turned = measured.turn if abs(measured.turn) > SMALLEST_TRIAL else 0.0
        is_underway = memory.phase is not Phase.SEARCHING
        if is_underway and self._is_worth_waiting(seen, fix, turned):
            waiting = replace(seen, wait=Wait(turned=turned), resumed=memory.phase)
            return self._waited(waiting, fix)
        if not fix.is_sure or (memory.phase is Phase.SEARCHING and seen.sure_images < SURE_IMAGES):
            return self._searching(seen, fix, measured)
        return self._underway(replace(seen, search=Search()), fix)

    def _hopeless(self, memory: Memory, fix: Fix) -> Outcome | None:
        if memory.still_movements >= LARGEST_STILL:
            return Outcome(
                Ending.BLOCKED,
                f"{memory.still_movements} movements running did not happen, as odometry and "
                "images say",
            )
        if memory.blind_images >= LARGEST_BLIND:
            return Outcome(
                Ending.LOST, f"the last {memory.blind_images} camera images show nothing"
            )
        if memory.stale_images >= LARGEST_STALE:
            return Outcome(
                Ending.ROBOT_FAILED,
                f"the last {memory.stale_images} camera images are one and the same, although "
                "odometry moves: the camera hangs",
            )
        if memory.is_covered and memory.search.steps >= DIRECTIONS:
            return Outcome(
                Ending.VIEW_BLOCKED,
                "the view stayed covered: the robot waited, looked past and all round, and no "
                "image shows where it is",
            )
        if memory.search.steps >= self.settings.max_search:
            return Outcome(
                Ending.LOST,
                f"the robot looked round for {memory.search.steps} steps and was not found",
            )
        if not fix.is_sure:
            return None
        outside = self._safety.outside_by(fix.state)
        if outside > SIGMAS * position_sigma(fix.covariance):
            return Outcome(
                Ending.OUT_OF_AREA, f"the robot is {outside:.2f} m outside of the allowed area"
            )
        return None

    def _is_worth_waiting(self, memory: Memory, fix: Fix, turned: float) -> bool:
        """Whether the view was lost where the map shows enough to look at."""
        if fix.is_sure or memory.anchor is None:
            return False
        # After a turn the reason may be that the map shows too little there.
        least = ENOUGH_COVERED if turned != 0.0 else LEAST_AWAITED
        return self._explorer.shown_share(memory.anchor.state) >= least

    def _waited(self, memory: Memory, fix: Fix) -> Decision:
        """Looks again, until the view is clear or everything was tried."""
        wait, anchor = memory.wait, memory.anchor
        if wait is None or anchor is None or (fix.is_sure and not anchor.agrees(fix)):
            # It was carried elsewhere, or had been there all the time.
            return self._searching(replace(memory, wait=None, search=Search()), fix, STANDSTILL)
        if fix.is_sure:
            clear = replace(memory, phase=memory.resumed, wait=None, search=Search())
            return self._underway(clear, fix)
        look = next_look(wait, anchor, self.settings.drive, self._safety)
        if look is None:
            search = replace(memory, wait=None, search=Search(), is_covered=True)
            return self._searching(search, fix, STANDSTILL)
        movement, then = look
        return Decision(replace(memory, phase=Phase.WAITING, wait=then, docked_images=0), movement)

    def _searching(self, memory: Memory, fix: Fix, measured: Movement) -> Decision:
        """Looks round, but first back to where the view was lost from."""
        movement, search = self._explorer.movement(
            memory.search, fix.modes, self.settings.largest_turn
        )
        if fix.is_sure:
            movement = self._trial(fix, memory.search)
        elif memory.phase is not Phase.SEARCHING and abs(measured.turn) > SMALLEST_TRIAL:
            movement = Movement(turn=-measured.turn)
            memory = replace(memory, lost_views=memory.lost_views + 1)
        elif _is_hint(fix) and memory.search.hints < MOST_HINTS:
            # What another image would confirm stays in view.
            movement = self._trial(fix, memory.search)
            search = replace(search, hints=search.hints + 1)
        again = replace(
            memory, phase=Phase.SEARCHING, search=search, alignment_steps=0, docked_images=0
        )
        return Decision(again, movement)

    def _trial(self, fix: Fix, search: Search) -> Movement:
        """A small turn that shows whether a new belief holds; it keeps what is seen in view."""
        turn = turn_between(fix.state, self.goal)
        if abs(turn) < SMALLEST_TRIAL:
            turn = search.direction * LARGEST_TRIAL
        return Movement(turn=max(-LARGEST_TRIAL, min(LARGEST_TRIAL, turn)))

    def _underway(self, memory: Memory, fix: Fix) -> Decision:
        memory = replace(memory, anchor=Anchor.of(fix), is_covered=False)
        phase = self._phase(memory, fix)
        is_attempt = phase is Phase.APPROACH and memory.phase is not Phase.APPROACH
        memory = replace(memory, phase=phase, attempts=memory.attempts + is_attempt)
        if phase is Phase.STAGING:
            memory = replace(memory, alignment_steps=0, docked_images=0, looks_beside=0)
            return self._allowed(memory, fix, self._towards_staging(fix, memory))
        if phase is Phase.APPROACH:
            if memory.attempts > self.settings.max_attempts:
                return Decision(
                    replace(memory, phase=Phase.FINISHED),
                    outcome=Outcome(
                        Ending.TIMED_OUT,
                        f"{self.settings.max_attempts} attempts from the staging pose failed"
                        + (f"; at the goal {memory.doubt}" if memory.doubt else ""),
                    ),
                )
            return self._allowed(memory, fix, self._towards_goal(fix))
        return self._aligning(memory, fix)

    def _phase(self, memory: Memory, fix: Fix) -> Phase:
        """The state for this image, when the belief is narrow."""
        distance = distance_between(fix.state, self.goal)
        if memory.phase is Phase.ALIGNMENT:
            return Phase.STAGING if self._must_retry(memory, fix) else Phase.ALIGNMENT
        staged = is_near(fix.state, self.staging, STAGED_POSITION, STAGED_HEADING)
        if memory.phase is not Phase.APPROACH:
            return Phase.APPROACH if staged else Phase.STAGING
        if distance < ALIGNMENT_DISTANCE:
            return Phase.ALIGNMENT
        offset = movement_between(self.goal, fix.state)
        is_astray = abs(offset.left) > LARGEST_OFFSET or offset.forward > ALIGNMENT_DISTANCE
        return Phase.STAGING if is_astray else Phase.APPROACH

    def _must_retry(self, memory: Memory, fix: Fix) -> bool:
        allowed = LARGEST_ALIGNMENT + BESIDE_STEPS * memory.looks_beside
        too_long = memory.alignment_steps >= allowed
        return too_long or distance_between(fix.state, self.goal) > 2.0 * ALIGNMENT_DISTANCE

    def _towards_staging(self, fix: Fix, memory: Memory) -> Movement:
        settings = self.settings
        if settings.drive == "omni":
            step = nearing(distance_between(fix.state, self.staging), settings)
            return omni_movement(fix.state, self.staging, step, settings.largest_turn)
        return diff_movement_to(
            fix.state,
            self.staging,
            settings,
            self._safety.is_allowed,
            self._explorer.sees,
            memory.lost_views,
        )

    def _towards_goal(self, fix: Fix) -> Movement:
        settings = self.settings
        if settings.drive == "diff":
            return diff_movement_along(fix.state, self.goal, settings)
        step = nearing(distance_between(fix.state, self.goal), settings)
        # First onto the axis, then along it: halfway there the robot is straight behind the goal.
        ahead = movement_between(self.goal, fix.state)
        target = behind(self.goal, max(0.0, -ahead.forward - step))
        return omni_movement(fix.state, target, step, settings.largest_turn)

    def _aligning(self, memory: Memory, fix: Fix) -> Decision:
        settings = self.settings
        memory = replace(memory, alignment_steps=memory.alignment_steps + 1)
        if self._is_docked(fix):
            doubt = fix.what_speaks_against or memory.doubt
            memory = replace(memory, docked_images=memory.docked_images + 1, doubt=doubt)
            # Against the filter it takes images from both sides.
            is_settled = not fix.is_disputed or memory.looks_beside >= BOTH_SIDES
            is_confirmed = memory.confirmed_images >= CONFIRMED_IMAGES and is_settled
            if memory.docked_images >= DOCKED_IMAGES and is_confirmed:
                return Decision(
                    replace(memory, phase=Phase.FINISHED),
                    outcome=Outcome(Ending.DOCKED, self._docked_text(fix)),
                )
            was_patient = memory.docked_images > UNCONFIRMED_IMAGES
            if was_patient and not is_confirmed and memory.looks_beside < BOTH_SIDES:
                return self._beside(memory, fix)
            return Decision(memory, STANDSTILL)
        memory = replace(memory, docked_images=0)
        if settings.drive == "omni":
            movement = omni_movement(
                fix.state, self.goal, settings.largest_step, settings.largest_turn
            )
        else:
            movement = diff_movement_along(fix.state, self.goal, settings)
            if movement == STANDSTILL:
                # Beside the goal: no turn and no drive leads there any more.
                begin_again = replace(memory, phase=Phase.STAGING, alignment_steps=0)
                return self._allowed(begin_again, fix, self._towards_staging(fix, memory))
        return self._allowed(memory, fix, movement)

    def _beside(self, memory: Memory, fix: Fix) -> Decision:
        """Looks from beside the goal, where another pose would not fit as well; then comes back."""
        side = 1.0 if memory.looks_beside % 2 == 0 else -1.0
        memory = replace(memory, docked_images=0, looks_beside=memory.looks_beside + 1)
        step = STANDSTILL
        if self.settings.drive == "omni":
            wanted = Movement(left=side * BESIDE)
            step = self._safety.restricted(fix.state, fix.covariance, wanted)
        return Decision(memory, step if step.distance > 0.0 else Movement(turn=side * BESIDE_TURN))

    def _is_docked(self, fix: Fix) -> bool:
        settings = self.settings
        distance, turn = self.distances(fix)
        return (
            fix.is_aligned
            and distance <= settings.position_tolerance
            and turn <= settings.heading_tolerance
            and distance + SIGMAS * position_sigma(fix.covariance) <= settings.position_bound
            and turn + SIGMAS * heading_sigma(fix.covariance) <= settings.heading_bound
        )

    def distances(self, fix: Fix) -> tuple[float, float]:
        """Metres and radians from the goal."""
        return distance_between(fix.state, self.goal), abs(turn_between(fix.state, self.goal))

    def _docked_text(self, fix: Fix) -> str:
        distance, _ = self.distances(fix)
        bound = distance + SIGMAS * position_sigma(fix.covariance)
        return (
            f"{100.0 * distance:.1f} cm from the goal by the estimate, "
            f"within {100.0 * bound:.1f} cm by its covariance"
        )

    def _allowed(self, memory: Memory, fix: Fix, movement: Movement) -> Decision:
        """The movement, as far as safety allows it."""
        allowed = self._safety.restricted(fix.state, fix.covariance, movement)
        is_refused = movement.distance > SHORTEST and allowed.distance == 0.0
        refused = memory.refused + 1 if is_refused else 0
        if refused >= LARGEST_REFUSED:
            return Decision(
                replace(memory, phase=Phase.FINISHED),
                outcome=Outcome(
                    Ending.BLOCKED,
                    "the scene's surface or the end of the allowed area lies in the way",
                ),
            )
        return Decision(replace(memory, refused=refused), allowed)


def _is_hint(fix: Fix) -> bool:
    """Whether an image shows something of the map that another image would confirm."""
    return fix.status == "global" and fix.confidence >= HINT_CONFIDENCE
