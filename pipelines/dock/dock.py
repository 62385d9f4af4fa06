"""The docking loop: take an image, localize, decide, move, until there is an outcome.

However docking ends, the robot is stopped first, and all that was recorded so far is returned.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray
from pipelines.artifacts.errors import LfnavError, OptionError
from pipelines.dock.competing_poses import CompetingPoses
from pipelines.dock.consistency_gate import (
    ConsistencyGate,
    gated_by_image,
    gated_estimate,
    map_covariance,
    violates_odometry,
)
from pipelines.dock.covered_view import WAITING_IMAGES
from pipelines.dock.docking_log import Docking, Entry
from pipelines.dock.docking_map import docking_map
from pipelines.dock.exploration import Explorer
from pipelines.dock.fine_alignment import FineAlignment
from pipelines.dock.planar_motion import behind, distance_between, position_sigma
from pipelines.dock.pose_estimate import PoseEstimate, pose_estimate_of
from pipelines.dock.road_map import RoadMap
from pipelines.dock.robot import STANDSTILL, CheckedRobot, Movement, RobotError
from pipelines.dock.safety import Safety
from pipelines.dock.settings import DockSettings
from pipelines.dock.smoothing import Smoother
from pipelines.dock.stall_detection import Snapshot, is_stalled, snapshot_of
from pipelines.dock.state_machine import DockingStateMachine
from pipelines.dock.states import DockingState, Outcome, OutcomeKind, Phase
from pipelines.dock.visibility import VisibilityCheck
from pipelines.geometry.camera import Undistorter
from pipelines.lightfield.area_map import AreaMap
from pipelines.lightfield.open_world import OpenWorld
from pipelines.lightfield.scene import Scene
from pipelines.localize.localizer import Localizer
from pipelines.localize.measurement_model import VIEW_RESOLUTION_FACTOR
from pipelines.localize.run import BY_ODOMETRY, FrameRecord
from pipelines.localize.settings import LocalizerSettings
from pipelines.render.choices import Quality
from pipelines.render.renderer_choice import renderer_of_scene
from pipelines.render.surface import quality_named


@dataclass(frozen=True)
class Report:
    """One step of docking, reported while it goes on.

    Attributes:
        step: number of the image, from 0.
        state: name of the phase or, in the last step, of the outcome.
        status: the filter's status of this frame.
        estimate: state ``(3,)`` of the robot; None where it is not localized.
        sigma: standard deviation of the position along its least certain direction, metres.
        distance: distance to the goal by the estimate, metres; None where it is not localized.
        command: the next movement.
        objection: during alignment, what speaks against docking by the estimate; else empty.
    """

    step: int
    state: str
    status: str
    estimate: FloatArray | None
    sigma: float
    distance: float | None
    command: Movement
    objection: str = ""


Listener = Callable[[Report], None]

# After more consecutive images than this with the filter's status "lost", localization starts anew.
LARGEST_LOST = 2
# Estimates are aligned with the photos from this far beyond the staging pose on, metres.
ALIGNED_BEYOND_STAGING = 0.3


@dataclass(frozen=True)
class Equipment:
    """All parts of the docking loop.

    Attributes:
        robot: the robot, checked.
        localizer: localizes the robot's camera in the scene.
        new_localizer: makes a localizer that starts anywhere, for a robot that was lost for good.
        alignment: aligns the localizer's estimates at full resolution.
        state_machine: decides on movements; holds goal and safety bounds.
        settings: the docking's settings, with the staging distance that was chosen in the end.
        mask: ``(height, width)``, True where the robot's images are used; None: everywhere.
        notes: lines that a user should know before docking begins.
        areas: of the world that the robot is localized in; None: it is one scene.
    """

    robot: CheckedRobot
    localizer: Localizer
    new_localizer: Callable[[], Localizer]
    alignment: FineAlignment
    state_machine: DockingStateMachine
    settings: DockSettings
    mask: BoolArray | None = None
    notes: tuple[str, ...] = ()
    areas: AreaMap | None = None


def equipment_of(
    scene: Scene | OpenWorld,
    robot: CheckedRobot,
    goal: FloatArray,
    settings: DockSettings,
    filter_settings: LocalizerSettings,
    rng: np.random.Generator,
    mask: BoolArray | None = None,
    road_map: RoadMap | None = None,
) -> Equipment:
    """Makes the parts of the docking loop for a robot in a scene.

    Args:
        scene: the light field, or a world of several.
        robot: the robot, checked.
        goal: ``(3,)`` x, y in metres and heading in radians.
        settings: the docking's settings.
        filter_settings: the filter's settings; its area is one that the robot must not leave.
        rng: the filter's random numbers.
        mask: ``(height, width)``, True where images of the robot's camera are to be used; None:
            everywhere.
        road_map: places that can be driven; None: where the map's photos were taken.

    Raises:
        OptionError: a goal where no robot can be or whose view the map does not show, an area
            outside of the scene, a filter with six degrees of freedom, settings that a world does
            not take, too little memory for one.
    """
    if filter_settings.state_space.angles != 1:
        raise OptionError("docking takes place on a floor: the filter needs 3 degrees of freedom")
    chosen = filter_settings
    whole = docking_map(scene)
    around = whole.around(np.stack([goal, behind(goal, settings.staging_distance)]))
    x_min, x_max, y_min, y_max = chosen.area or map(float, whole.bounds)
    clearance = whole.clearance(around, float(robot.base_from_camera[2, 3]))
    safety = Safety((x_min, x_max, y_min, y_max), clearance, settings.distance_kept, whole.ground)
    safety.check_goal(goal)
    renderer = renderer_of_scene(
        around,
        VIEW_RESOLUTION_FACTOR * chosen.fine_width,
        chosen.blending,
        quality_named(chosen.quality, bool(around.depth), Quality.MEDIUM),
        chosen.threads,
        chosen.device,
    )

    followed = whole.follow(around, robot.base_from_camera, chosen)
    model = followed.model

    def localizer_of(start: tuple[float, ...] | None) -> Localizer:
        own = replace(chosen, start=start)
        where, mount = followed.where, robot.base_from_camera
        return Localizer(where, robot.camera, mount, own, rng, model, mask)

    intrinsics = Undistorter(robot.camera).intrinsics
    mount, width = robot.base_from_camera, chosen.fine_width
    visibility = VisibilityCheck(renderer, model, mount, intrinsics, width, mask)
    goal_note = visibility.check_goal(goal)
    settings, staging_note = visibility.visible_staging(goal, settings)
    explorer = Explorer(followed.views or renderer, robot.base_from_camera, intrinsics, safety)
    reach = settings.staging_distance + ALIGNED_BEYOND_STAGING
    alignment = FineAlignment(
        around, robot.camera, robot.base_from_camera, chosen, goal, reach, mask
    )
    return Equipment(
        robot,
        localizer_of(chosen.start),
        lambda: localizer_of(None),
        alignment,
        DockingStateMachine(goal, settings, safety, explorer, road_map or whole.road_map()),
        settings,
        mask,
        tuple(note for note in (goal_note, staging_note) if note),
        whole.areas,
    )


def dock(equipment: Equipment, listener: Listener) -> Docking:
    """Docks a robot.

    Args:
        equipment: the parts of the loop.
        listener: is called with a report of every step.

    Returns:
        All steps and the outcome, also after Ctrl-C and when the robot fails.
    """
    loop = _Loop(equipment, listener)
    try:
        outcome = loop.run()
    except KeyboardInterrupt:
        outcome = Outcome(OutcomeKind.INTERRUPTED, "interrupted from the keyboard")
    except RobotError as error:
        outcome = Outcome(OutcomeKind.ROBOT_FAILED, str(error))
    finally:
        # Before anything else, whatever was raised.
        failure = _stopped(equipment.robot)
    if failure is not None and outcome.kind is not OutcomeKind.ROBOT_FAILED:
        outcome = Outcome(OutcomeKind.ROBOT_FAILED, f"{failure} (after: {outcome.reason})")
    return loop.finished(outcome)


def _stopped(robot: CheckedRobot) -> str | None:
    """Stops the robot; returns the error message if that fails."""
    try:
        robot.stop()
    except LfnavError as error:
        return str(error)
    return None


class _Loop:
    """What changes while docking goes on."""

    def __init__(self, equipment: Equipment, listener: Listener) -> None:
        self._robot = equipment.robot
        self._localizer = equipment.localizer
        self._new_localizer = equipment.new_localizer
        self._lost_images = 0
        self._alignment = equipment.alignment
        self._state_machine = equipment.state_machine
        self._settings = equipment.settings
        self._mask = equipment.mask
        self._listener = listener
        self._entries: list[Entry] = []
        self._state = DockingState()
        self._competing_poses = CompetingPoses()
        self._map_covariance = map_covariance(self._localizer.settings)
        self._smoother = Smoother()
        self._gate = ConsistencyGate()
        self._began = time.monotonic()
        self._filter_seconds = 0.0

    def run(self) -> Outcome:
        """Goes on until there is an outcome."""
        command, measured = STANDSTILL, STANDSTILL
        before: Snapshot | None = None
        while True:
            spent = self._robot.seconds
            image = self._robot.take_image()
            true_state = self._robot.true_state()
            frame = self._localized(image, measured, spent)
            frame, own, estimate = self._estimated(frame, image, measured)
            # Odometry has no part in the image's own estimate, so that the two can be compared.
            now = snapshot_of(image, own, self._mask)
            stalled = before is not None and is_stalled(command, measured, before, now)
            if before is not None and self._gate(
                not stalled and violates_odometry(measured, before.estimate, own)
            ):
                self._localizer, self._lost_images = self._new_localizer(), 0
                self._state = replace(self._state, last_known=None, wait=None)
                estimate = replace(estimate, is_localized=False)
                now = replace(now, estimate=replace(own, is_localized=False))
            decision = self._state_machine.decide(self._state, estimate, stalled, measured)
            outcome = decision.outcome or self._exhausted()
            phase = Phase.FINISHED if outcome is not None else decision.state.phase
            self._state = replace(decision.state, phase=phase)
            command = STANDSTILL if outcome is not None else decision.movement
            word = phase.value if outcome is None else outcome.kind.word
            entry = Entry(frame, image, word, command, STANDSTILL, true_state)
            self._entries.append(entry)
            self._tell(frame, estimate, word, command)
            if outcome is not None:
                return outcome
            if phase is Phase.WAITING and command == STANDSTILL and not self._robot.is_simulated:
                time.sleep(self._settings.patience / WAITING_IMAGES)
            measured = self._robot.move(command)
            self._entries[-1] = replace(entry, measured=measured)
            before = now

    def finished(self, outcome: Outcome) -> Docking:
        """All that was recorded, with the outcome."""
        if self._entries and self._entries[-1].state != outcome.kind.word:
            self._entries[-1] = replace(self._entries[-1], state=outcome.kind.word)
        seconds = {
            "total": time.monotonic() - self._began,
            "robot": self._robot.seconds,
            "filter": self._filter_seconds,
        }
        return Docking(
            entries=tuple(self._entries),
            outcome=outcome,
            attempts=self._state.attempts,
            goal=self._state_machine.goal,
            staging=self._state_machine.staging,
            seconds=seconds,
        )

    def _localized(self, image: ImageArray, measured: Movement, spent: float) -> FrameRecord:
        """The filter's frame of an image, with the robot's time for it.

        Args:
            image: ``(H, W, 3)`` RGB.
            measured: the last movement by odometry.
            spent: the robot's time (seconds) before it took the image.
        """
        number = len(self._entries)
        elapsed = time.monotonic() - self._began
        # A simulated robot has no clock: the same seed gives the same run.
        timestamp = float(number) if self._robot.is_simulated else elapsed
        start = time.monotonic()
        # While the view is covered the belief is kept: odometry carries it on.
        is_abandoned = self._state.wait is None and not self._state.is_covered
        if self._lost_images > LARGEST_LOST and is_abandoned:
            self._localizer, self._lost_images = self._new_localizer(), 0
        frame = self._localizer.step(
            image, measured.vector() if number else None, timestamp, f"step {number:04d}"
        )
        self._filter_seconds += time.monotonic() - start
        if frame.status not in BY_ODOMETRY:
            self._lost_images = self._lost_images + 1 if frame.status == "lost" else 0
        took = self._robot.seconds - spent
        return replace(frame, seconds={**frame.seconds, "robot": took})

    def _estimated(
        self, frame: FrameRecord, image: ImageArray, measured: Movement
    ) -> tuple[FrameRecord, PoseEstimate, PoseEstimate]:
        """Aligns and smooths a frame's estimate.

        Args:
            frame: by the filter.
            image: ``(H, W, 3)`` RGB.
            measured: the last movement by odometry.

        Returns:
            The frame with the estimate ``docking`` added, the estimate by this image alone, and the
            estimate to act on.
        """
        start = time.monotonic()
        by_filter = pose_estimate_of(frame)
        expected = self._competing_poses.expected(measured)
        candidates = self._alignment(by_filter, image, expected)
        selected = self._competing_poses(candidates, measured)
        own = gated_estimate(by_filter, selected, self._map_covariance)
        estimate = gated_by_image(own, self._smoother(own, measured))
        took = time.monotonic() - start
        self._filter_seconds += took
        estimates = dict(frame.estimates)
        if estimate.is_localized:
            estimates["docking"] = estimate.state
        seconds = {**frame.seconds, "alignment": took}
        return replace(frame, estimates=estimates, seconds=seconds), own, estimate

    def _exhausted(self) -> Outcome | None:
        """The outcome where steps or time are used up."""
        settings = self._settings
        if len(self._entries) >= settings.max_steps:
            return Outcome(OutcomeKind.TIMED_OUT, f"{settings.max_steps} steps were not enough")
        elapsed = time.monotonic() - self._began
        if elapsed > settings.max_seconds:
            return Outcome(
                OutcomeKind.TIMED_OUT, f"{settings.max_seconds:g} seconds were not enough"
            )
        return None

    def _tell(
        self, frame: FrameRecord, estimate: PoseEstimate, state: str, command: Movement
    ) -> None:
        """Reports a step to the listener."""
        known = estimate.state if estimate.is_localized else None
        goal = self._state_machine.goal
        self._listener(
            Report(
                step=len(self._entries) - 1,
                state=state,
                status=frame.status,
                estimate=known,
                sigma=position_sigma(estimate.covariance),
                distance=None if known is None else distance_between(known, goal),
                command=command,
                objection=estimate.objection if state == Phase.ALIGNMENT.value else "",
            )
        )
