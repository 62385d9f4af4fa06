"""The docking state machine: from the state and a new pose estimate to the next movement.

The phases, their transitions and the outcomes are listed in ``states``. ``DockingStateMachine``
holds goal, settings and safety bounds, which do not change; all that does change goes in and comes
out as a ``DockingState``.
"""

from dataclasses import replace

from pipelines.artifacts.arrays import FloatArray
from pipelines.dock.controller import (
    SHORTEST,
    diff_movement_along,
    diff_movement_to,
    nearing,
    omni_movement,
)
from pipelines.dock.covered_view import ViewWait, next_viewpoint
from pipelines.dock.dead_reckoning import DeadReckonedPose
from pipelines.dock.exploration import DIRECTIONS, ENOUGH_COVERED, Explorer, Search
from pipelines.dock.navigation import Navigator
from pipelines.dock.planar_motion import (
    behind,
    distance_between,
    heading_sigma,
    is_near,
    movement_between,
    position_sigma,
    yaw_between,
)
from pipelines.dock.pose_estimate import PoseEstimate
from pipelines.dock.road_map import RoadMap
from pipelines.dock.robot import STANDSTILL, Movement
from pipelines.dock.safety import Safety
from pipelines.dock.settings import DockSettings
from pipelines.dock.states import Decision, DockingState, Outcome, OutcomeKind, Phase

# The robot drives after this many consecutive images in which it is localized.
LOCALIZED_IMAGES = 3
# Docking ends after this many consecutive images that show nothing, images that repeat the previous
# one, movements that did not happen, or movements that were not allowed.
LARGEST_BLIND, LARGEST_STALE, LARGEST_STALLED, LARGEST_REFUSED = 14, 6, 3, 4
# The robot is at the staging pose within this: metres and radians.
STAGED_POSITION, STAGED_HEADING = 0.1, 0.1
# Alignment begins at this distance from the goal, metres.
ALIGNMENT_DISTANCE = 0.12
# Docked are this many consecutive images at the goal, and this many consecutive accepted estimates.
# After this many steps alignment starts again from the staging pose.
DOCKED_IMAGES, ACCEPTED_IMAGES, LARGEST_ALIGNMENT = 2, 3, 12
# After more images at the goal than this without acceptance, the robot looks from beside.
UNACCEPTED_IMAGES = 2
# Distance to the place beside the goal, metres; yaw (radians) for a robot that can only rotate.
SIDE_DISTANCE, SIDE_YAW = 0.1, 0.1
# One view from either side; each allows this many more steps of alignment.
BOTH_SIDES, SIDE_STEPS = 2, 5
# Approaching farther from the goal's axis than this, the robot goes back to staging, metres.
LARGEST_OFFSET = 0.25
# Bounds are stated with this many standard deviations.
SIGMAS = 2.0
# A view of which the map shows less than this share is not waited for.
LEAST_AWAITED = 0.3
# Rotations that test a new belief lie between these, radians.
SMALLEST_TRIAL, LARGEST_TRIAL = 0.05, 0.15
# A searching robot keeps a view with at least this confidence for one more image; this many times
# in a search.
HINT_CONFIDENCE, MOST_HINTS = 0.1, 6


class DockingStateMachine:
    """Decides on the next movement.

    Args:
        goal: ``(3,)`` x and y in metres, heading in radians.
        settings: how to move, and when to stop.
        safety: bounds of all movements.
        explorer: chooses the movements of a search.
        road_map: places that can be driven on the way to the staging pose; None: not known.
    """

    def __init__(
        self,
        goal: FloatArray,
        settings: DockSettings,
        safety: Safety,
        explorer: Explorer,
        road_map: RoadMap | None = None,
    ) -> None:
        self.goal = goal
        self.staging = behind(goal, settings.staging_distance)
        self.settings = settings
        self._safety = safety
        self._explorer = explorer
        self._navigator = (
            None if road_map is None else Navigator(road_map, safety, self.staging, settings)
        )

    def decide(
        self,
        state: DockingState,
        estimate: PoseEstimate,
        is_stalled: bool = False,
        measured: Movement = STANDSTILL,
    ) -> Decision:
        """The next movement, or the outcome.

        Args:
            state: of docking, after the previous image.
            estimate: where the robot is by this image.
            is_stalled: whether the last movement did not happen (``stall_detection.is_stalled``).
            measured: the last movement by odometry.
        """
        seen = replace(
            state,
            localized_images=state.localized_images + 1 if estimate.is_localized else 0,
            blind_images=state.blind_images + 1 if estimate.is_blind else 0,
            stalled_movements=state.stalled_movements + 1 if is_stalled else 0,
            accepted_images=state.accepted_images + 1
            if estimate.is_localized and not estimate.rejection
            else 0,
            stale_images=state.stale_images + 1 if estimate.status == "stale" else 0,
            search=state.search.after(measured),
            last_known=None if state.last_known is None else state.last_known.after(measured),
            is_covered=state.is_covered and not estimate.is_localized,
            travel=state.travel.after(measured, is_stalled),
        )
        seen = self._evading(seen, estimate)
        outcome = self._failure(seen, estimate)
        if outcome is not None:
            return Decision(replace(seen, phase=Phase.FINISHED), outcome=outcome)
        if state.wait is not None:
            return self._waiting(seen, estimate)
        rotated = measured.turn if abs(measured.turn) > SMALLEST_TRIAL else 0.0
        is_underway = state.phase is not Phase.SEARCHING
        if is_underway and self._is_worth_waiting(seen, estimate, rotated):
            waiting = replace(seen, wait=ViewWait(rotated=rotated), resumed=state.phase)
            return self._waiting(waiting, estimate)
        if not estimate.is_localized or (
            state.phase is Phase.SEARCHING and seen.localized_images < LOCALIZED_IMAGES
        ):
            return self._searching(seen, estimate, measured)
        return self._driving(replace(seen, search=Search()), estimate)

    def _failure(self, state: DockingState, estimate: PoseEstimate) -> Outcome | None:
        """The outcome where there is no point in going on; None where there is."""
        if state.stalled_movements >= LARGEST_STALLED:
            return Outcome(
                OutcomeKind.BLOCKED,
                f"the last {state.stalled_movements} movements did not happen, by odometry and "
                "images",
            )
        if state.blind_images >= LARGEST_BLIND:
            return Outcome(
                OutcomeKind.LOST, f"the last {state.blind_images} camera images show nothing"
            )
        if state.stale_images >= LARGEST_STALE:
            return Outcome(
                OutcomeKind.ROBOT_FAILED,
                f"the last {state.stale_images} camera images are one and the same, although "
                "odometry moves: the camera hangs",
            )
        if state.is_covered and state.search.steps >= DIRECTIONS:
            return Outcome(
                OutcomeKind.VIEW_BLOCKED,
                "the view stayed covered: the robot waited, looked past it and all round, and was "
                "not localized",
            )
        if state.search.steps >= self.settings.max_search:
            return Outcome(
                OutcomeKind.LOST,
                f"the robot searched for {state.search.steps} steps and was not localized",
            )
        if not estimate.is_localized:
            return None
        outside = self._safety.outside_by(estimate.state)
        if outside > SIGMAS * position_sigma(estimate.covariance):
            return Outcome(
                OutcomeKind.OUT_OF_AREA, f"the robot is {outside:.2f} m outside of the allowed area"
            )
        return None

    def _is_worth_waiting(
        self, state: DockingState, estimate: PoseEstimate, rotated: float
    ) -> bool:
        """Whether the view was lost where the map shows enough of it.

        Args:
            state: of docking.
            estimate: where the robot is by this image.
            rotated: yaw (radians) of the last movement if it was a rotation; else 0.
        """
        if estimate.is_localized or state.last_known is None:
            return False
        # After a rotation the map itself may show too little there.
        least = ENOUGH_COVERED if rotated != 0.0 else LEAST_AWAITED
        return self._explorer.covered_share(state.last_known.state) >= least

    def _waiting(self, state: DockingState, estimate: PoseEstimate) -> Decision:
        """Takes images until the view is clear or all viewpoints were tried."""
        wait, last_known = state.wait, state.last_known
        is_elsewhere = (
            last_known is not None
            and estimate.is_localized
            and not last_known.agrees_with(estimate)
        )
        if wait is None or last_known is None or is_elsewhere:
            # It was carried away, or the pose had been wrong all the time.
            return self._searching(replace(state, wait=None, search=Search()), estimate, STANDSTILL)
        if estimate.is_localized:
            clear = replace(state, phase=state.resumed, wait=None, search=Search())
            return self._driving(clear, estimate)
        viewpoint = next_viewpoint(wait, last_known, self.settings.drive, self._safety)
        if viewpoint is None:
            search = replace(state, wait=None, search=Search(), is_covered=True)
            return self._searching(search, estimate, STANDSTILL)
        movement, then = viewpoint
        return Decision(replace(state, phase=Phase.WAITING, wait=then, docked_images=0), movement)

    def _searching(
        self, state: DockingState, estimate: PoseEstimate, measured: Movement
    ) -> Decision:
        """Rotates on the spot; first back, where a rotation made the robot lose its view."""
        movement, search = self._explorer.movement(
            state.search, estimate.modes, self.settings.largest_turn
        )
        if estimate.is_localized:
            movement = self._trial(estimate, state.search)
        elif state.phase is not Phase.SEARCHING and abs(measured.turn) > SMALLEST_TRIAL:
            movement = Movement(turn=-measured.turn)
            state = replace(state, lost_views=state.lost_views + 1)
        elif _is_hint(estimate) and state.search.hints < MOST_HINTS:
            # Another image may confirm what is in view: keep it there.
            movement = self._trial(estimate, state.search)
            search = replace(search, hints=search.hints + 1)
        state = replace(
            state, phase=Phase.SEARCHING, search=search, alignment_steps=0, docked_images=0
        )
        return Decision(state, movement)

    def _trial(self, estimate: PoseEstimate, search: Search) -> Movement:
        """A small rotation that tests a new belief and keeps what is seen in view."""
        yaw = yaw_between(estimate.state, self.goal)
        if abs(yaw) < SMALLEST_TRIAL:
            yaw = search.direction * LARGEST_TRIAL
        return Movement(turn=max(-LARGEST_TRIAL, min(LARGEST_TRIAL, yaw)))

    def _driving(self, state: DockingState, estimate: PoseEstimate) -> Decision:
        """Route, staging, approach or alignment of a robot that is localized."""
        last_known = DeadReckonedPose(estimate.state, estimate.covariance)
        has_moved = state.last_known is not None and not state.last_known.agrees_with(estimate)
        state = replace(state, last_known=last_known, is_covered=False)
        phase = self._next_phase(state, estimate)
        if phase is Phase.STAGING:
            travelling = self._travelling(state, estimate, has_moved)
            if travelling is not None:
                return travelling
        is_attempt = phase is Phase.APPROACH and state.phase is not Phase.APPROACH
        state = replace(state, phase=phase, attempts=state.attempts + is_attempt)
        if phase is Phase.STAGING:
            state = replace(state, alignment_steps=0, docked_images=0, side_views=0)
            return self._allowed(state, estimate, self._towards_staging(estimate, state))
        if phase is Phase.APPROACH:
            if state.attempts > self.settings.max_attempts:
                return Decision(
                    replace(state, phase=Phase.FINISHED),
                    outcome=Outcome(
                        OutcomeKind.TIMED_OUT,
                        f"{self.settings.max_attempts} attempts from the staging pose failed"
                        + (f"; at the goal {state.objection}" if state.objection else ""),
                    ),
                )
            return self._allowed(state, estimate, self._towards_goal(estimate))
        return self._aligning(state, estimate)

    def _next_phase(self, state: DockingState, estimate: PoseEstimate) -> Phase:
        """The phase of a robot that is localized."""
        distance = distance_between(estimate.state, self.goal)
        if state.phase is Phase.ALIGNMENT:
            return Phase.STAGING if self._must_retry(state, estimate) else Phase.ALIGNMENT
        staged = is_near(estimate.state, self.staging, STAGED_POSITION, STAGED_HEADING)
        if state.phase is not Phase.APPROACH:
            return Phase.APPROACH if staged else Phase.STAGING
        if distance < ALIGNMENT_DISTANCE:
            return Phase.ALIGNMENT
        offset = movement_between(self.goal, estimate.state)
        is_astray = abs(offset.left) > LARGEST_OFFSET or offset.forward > ALIGNMENT_DISTANCE
        return Phase.STAGING if is_astray else Phase.APPROACH

    def _travelling(
        self, state: DockingState, estimate: PoseEstimate, has_moved: bool
    ) -> Decision | None:
        """The next movement along a route; None where a straight line leads to the staging pose.

        Args:
            state: of docking.
            estimate: where the robot is by this image.
            has_moved: whether that is elsewhere than odometry says.
        """
        navigator = self._navigator
        if navigator is None or state.phase not in (Phase.SEARCHING, Phase.ROUTE):
            return None
        if state.phase is Phase.SEARCHING and not navigator.is_needed(estimate.state):
            return None
        travel = state.travel
        if not travel.is_stuck:
            travel = navigator.next(travel, estimate.state, has_moved)
        if navigator.has_arrived(travel):
            return None
        state = replace(state, phase=Phase.ROUTE, travel=travel)
        if travel.failures >= LARGEST_REFUSED:
            outcome = Outcome(OutcomeKind.NO_WAY, navigator.objection(travel))
            return Decision(replace(state, phase=Phase.FINISHED), outcome=outcome)
        decision = self._allowed(state, estimate, navigator.movement(travel, estimate.state))
        if decision.outcome is None:
            return decision
        # Too narrow for what is known of the position: perhaps there is another way.
        travel = navigator.blocked(travel, estimate.state, is_on_map=True)
        return Decision(replace(state, refused_movements=0, travel=travel))

    def _evading(self, state: DockingState, estimate: PoseEstimate) -> DockingState:
        """The state of a robot on a route that has to look for another way after stalls."""
        is_stalled = state.stalled_movements >= LARGEST_STALLED and estimate.is_localized
        on_route = state.phase is Phase.ROUTE and not state.travel.is_stuck
        if self._navigator is None or not (is_stalled and on_route):
            return state
        travel = self._navigator.blocked(state.travel, estimate.state)
        return replace(state, stalled_movements=0, travel=travel)

    def _must_retry(self, state: DockingState, estimate: PoseEstimate) -> bool:
        """Whether alignment took too many steps or led away from the goal."""
        allowed = LARGEST_ALIGNMENT + SIDE_STEPS * state.side_views
        too_long = state.alignment_steps >= allowed
        return too_long or distance_between(estimate.state, self.goal) > 2.0 * ALIGNMENT_DISTANCE

    def _towards_staging(self, estimate: PoseEstimate, state: DockingState) -> Movement:
        """The next movement towards the staging pose."""
        settings = self.settings
        if settings.drive == "omni":
            step = nearing(distance_between(estimate.state, self.staging), settings)
            return omni_movement(estimate.state, self.staging, step, settings.largest_turn)
        return diff_movement_to(
            estimate.state,
            self.staging,
            settings,
            self._safety.is_allowed,
            self._explorer.sees_scene,
            state.lost_views,
        )

    def _towards_goal(self, estimate: PoseEstimate) -> Movement:
        """The next movement of the approach."""
        settings = self.settings
        if settings.drive == "diff":
            return diff_movement_along(estimate.state, self.goal, settings)
        step = nearing(distance_between(estimate.state, self.goal), settings)
        # First onto the axis, then along it: halfway there the robot is straight behind the goal.
        ahead = movement_between(self.goal, estimate.state)
        target = behind(self.goal, max(0.0, -ahead.forward - step))
        return omni_movement(estimate.state, target, step, settings.largest_turn)

    def _aligning(self, state: DockingState, estimate: PoseEstimate) -> Decision:
        """The last centimetres, and whether the robot is docked."""
        settings = self.settings
        state = replace(state, alignment_steps=state.alignment_steps + 1)
        if self._is_docked(estimate):
            state = replace(
                state,
                docked_images=state.docked_images + 1,
                objection=estimate.objection or state.objection,
            )
            # The filter is overruled only by images from both sides.
            may_overrule = state.side_views >= BOTH_SIDES or not estimate.overrules_filter
            is_accepted = state.accepted_images >= ACCEPTED_IMAGES and may_overrule
            if state.docked_images >= DOCKED_IMAGES and is_accepted:
                return Decision(
                    replace(state, phase=Phase.FINISHED),
                    outcome=Outcome(OutcomeKind.DOCKED, self._docked_text(estimate)),
                )
            is_stuck = not is_accepted and state.docked_images > UNACCEPTED_IMAGES
            if is_stuck and state.side_views < BOTH_SIDES:
                return self._side_view(state, estimate)
            return Decision(state, STANDSTILL)
        state = replace(state, docked_images=0)
        if settings.drive == "omni":
            movement = omni_movement(
                estimate.state, self.goal, settings.largest_step, settings.largest_turn
            )
        else:
            movement = diff_movement_along(estimate.state, self.goal, settings)
            if movement == STANDSTILL:
                # Beside the goal: neither rotating nor driving straight leads there any more.
                retry = replace(state, phase=Phase.STAGING, alignment_steps=0)
                return self._allowed(retry, estimate, self._towards_staging(estimate, state))
        return self._allowed(state, estimate, movement)

    def _side_view(self, state: DockingState, estimate: PoseEstimate) -> Decision:
        """Moves beside the goal, where competing poses fit less well; alignment leads back."""
        side = 1.0 if state.side_views % 2 == 0 else -1.0
        state = replace(state, docked_images=0, side_views=state.side_views + 1)
        step = STANDSTILL
        if self.settings.drive == "omni":
            wanted = Movement(left=side * SIDE_DISTANCE)
            step = self._safety.restricted(estimate.state, estimate.covariance, wanted)
        return Decision(state, step if step.distance > 0.0 else Movement(turn=side * SIDE_YAW))

    def _is_docked(self, estimate: PoseEstimate) -> bool:
        """Whether estimate and covariance place the robot at the goal."""
        settings = self.settings
        distance = distance_between(estimate.state, self.goal)
        yaw = abs(yaw_between(estimate.state, self.goal))
        return (
            estimate.is_aligned
            and distance <= settings.position_tolerance
            and yaw <= settings.heading_tolerance
            and distance + SIGMAS * position_sigma(estimate.covariance) <= settings.position_bound
            and yaw + SIGMAS * heading_sigma(estimate.covariance) <= settings.heading_bound
        )

    def _docked_text(self, estimate: PoseEstimate) -> str:
        distance = distance_between(estimate.state, self.goal)
        bound = distance + SIGMAS * position_sigma(estimate.covariance)
        return (
            f"{100.0 * distance:.1f} cm from the goal by the estimate, "
            f"within {100.0 * bound:.1f} cm by its covariance"
        )

    def _allowed(self, state: DockingState, estimate: PoseEstimate, movement: Movement) -> Decision:
        """The movement as far as safety allows it, or the outcome after too many refusals."""
        allowed = self._safety.restricted(estimate.state, estimate.covariance, movement)
        is_refused = movement.distance > SHORTEST and allowed.distance == 0.0
        refused = state.refused_movements + 1 if is_refused else 0
        if refused >= LARGEST_REFUSED:
            return Decision(
                replace(state, phase=Phase.FINISHED),
                outcome=Outcome(
                    OutcomeKind.BLOCKED,
                    "the scene's surface or the end of the allowed area lies in the way",
                ),
            )
        return Decision(replace(state, refused_movements=refused), allowed)


def _is_hint(estimate: PoseEstimate) -> bool:
    """Whether a searching robot may be where the estimate says, for another image to confirm."""
    return estimate.status == "global" and estimate.confidence >= HINT_CONFIDENCE
