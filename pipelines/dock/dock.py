"""The loop of a docking: take an image, localize, decide, move, until there is an outcome.

Whatever happens, the robot is stopped first, and what was recorded so far is handed back.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray
from pipelines.artifacts.errors import LfnavError, OptionError
from pipelines.dock.agreement import aligned_fix, confirmed, map_covariance
from pipelines.dock.clearance import Clearance
from pipelines.dock.competing_poses import Rivals
from pipelines.dock.consistency_gate import Doubt, contradicts
from pipelines.dock.covered_view import LOOKS
from pipelines.dock.docking_log import Docking, Entry
from pipelines.dock.exploration import Explorer
from pipelines.dock.fine_alignment import FineAlignment
from pipelines.dock.outcomes import Ending, Outcome
from pipelines.dock.planar_motion import distance_between, position_sigma
from pipelines.dock.pose_estimate import Fix, fix_of
from pipelines.dock.robot import STANDSTILL, CheckedRobot, Movement, RobotError
from pipelines.dock.safety import Safety
from pipelines.dock.settings import DockSettings
from pipelines.dock.smoothing import Smoother
from pipelines.dock.stall_detection import Moment, moment_of, stood_still
from pipelines.dock.state_machine import Memory, Phase, Pilot
from pipelines.dock.visibility import Lookout
from pipelines.geometry.camera import Undistorter
from pipelines.lightfield.scene import Scene
from pipelines.localize.localizer import Localizer
from pipelines.localize.measurement_model import VIEW_RESOLUTION_FACTOR, MeasurementModel
from pipelines.localize.run import BY_ODOMETRY, FrameRecord
from pipelines.localize.settings import LocalizerSettings
from pipelines.render.choices import Quality
from pipelines.render.renderer_choice import renderer_of_scene
from pipelines.render.surface import quality_named


@dataclass(frozen=True)
class Report:
    """What can be said of a step while the docking goes on.

    Attributes:
        step: number of the image.
        state: name of the state.
        status: of the filter.
        estimate: ``(3,)`` or None where there is nothing to rely on.
        sigma: metres, of the estimate.
        distance: metres from the goal; None likewise.
        command: the movement that comes next.
        doubt: at the goal, what speaks against the estimate; empty where nothing does.
    """

    step: int
    state: str
    status: str
    estimate: FloatArray | None
    sigma: float
    distance: float | None
    command: Movement
    doubt: str = ""


Listener = Callable[[Report], None]

# After so many images running that the belief cannot explain, it is given up for a new search.
LARGEST_LOST = 2
# Fixes are aligned with the photos from this far beyond the staging pose on, metres.
ALIGNED_BEYOND_STAGING = 0.3


@dataclass(frozen=True)
class Equipment:
    """What a docking works with.

    Attributes:
        robot: checked.
        localizer: of the robot's camera in the scene.
        searching: makes a new one that knows nothing, where the first was lost for good.
        alignment: makes its estimates finer.
        pilot: with goal and bounds.
        settings: of the docking.
        mask: ``(height, width)``, True where the robot's images are used; None: everywhere.
        notes: what a person should know before.
    """

    robot: CheckedRobot
    localizer: Localizer
    searching: Callable[[], Localizer]
    alignment: FineAlignment
    pilot: Pilot
    settings: DockSettings
    mask: BoolArray | None = None
    notes: tuple[str, ...] = ()


def equipment_of(
    scene: Scene,
    robot: CheckedRobot,
    goal: FloatArray,
    settings: DockSettings,
    filter_settings: LocalizerSettings,
    rng: np.random.Generator,
    mask: BoolArray | None = None,
) -> Equipment:
    """Makes localizer and pilot for a robot in a scene.

    Args:
        scene: the light field.
        robot: checked.
        goal: ``(3,)`` x, y in metres and heading in radians.
        settings: of the docking.
        filter_settings: of the filter; its area is one that the robot must not leave.
        rng: of the filter.
        mask: ``(height, width)``, True where images of the robot's camera are to be used; None:
            everywhere.

    Raises:
        OptionError: a goal where no robot can be or whose view the map does not show, an area
            outside of the scene, a filter with six degrees of freedom.
    """
    if filter_settings.state_space.angles != 1:
        raise OptionError("docking takes place on a floor: the filter needs 3 degrees of freedom")
    chosen = filter_settings
    x_min, x_max, y_min, y_max = chosen.area or map(float, scene.bounds)
    clearance = Clearance(scene, float(robot.base_from_camera[2, 3]))
    safety = Safety((x_min, x_max, y_min, y_max), clearance, settings.distance_kept)
    safety.check_goal(goal)
    renderer = renderer_of_scene(
        scene,
        VIEW_RESOLUTION_FACTOR * chosen.fine_width,
        chosen.blending,
        quality_named(chosen.quality, bool(scene.depth), Quality.MEDIUM),
        chosen.threads,
        chosen.device,
    )

    model = MeasurementModel.of_scene(scene, robot.base_from_camera, chosen)

    def localizer_of(start: tuple[float, ...] | None) -> Localizer:
        own = replace(chosen, start=start)
        return Localizer(scene, robot.camera, robot.base_from_camera, own, rng, model, mask)

    intrinsics = Undistorter(robot.camera).intrinsics
    mount, width = robot.base_from_camera, chosen.fine_width
    lookout = Lookout(renderer, model, mount, intrinsics, width, mask)
    goal_note = lookout.check_goal(goal)
    settings, staging_note = lookout.staged(goal, settings)
    explorer = Explorer(renderer, robot.base_from_camera, intrinsics, safety)
    reach = settings.staging_distance + ALIGNED_BEYOND_STAGING
    alignment = FineAlignment(
        scene, robot.camera, robot.base_from_camera, chosen, goal, reach, mask
    )
    pilot = Pilot(goal, settings, safety, explorer)
    return Equipment(
        robot,
        localizer_of(chosen.start),
        lambda: localizer_of(None),
        alignment,
        pilot,
        settings,
        mask,
        tuple(note for note in (goal_note, staging_note) if note),
    )


def dock(equipment: Equipment, listener: Listener) -> Docking:
    """Docks a robot.

    Args:
        equipment: robot, localizer, pilot.
        listener: told of every step.

    Returns:
        What happened and how it ended; also after Ctrl-C and when the robot fails.
    """
    loop = _Loop(equipment, listener)
    try:
        outcome = loop.run()
    except KeyboardInterrupt:
        outcome = Outcome(Ending.INTERRUPTED, "interrupted from the keyboard")
    except RobotError as error:
        outcome = Outcome(Ending.ROBOT_FAILED, str(error))
    finally:
        # Before anything else, an error of the filter included.
        failure = _stopped(equipment.robot)
    if failure is not None and outcome.ending is not Ending.ROBOT_FAILED:
        outcome = Outcome(Ending.ROBOT_FAILED, f"{failure} (after: {outcome.reason})")
    return loop.finished(outcome)


def _stopped(robot: CheckedRobot) -> str | None:
    """Stops the robot; what went wrong, if anything did."""
    try:
        robot.stop()
    except LfnavError as error:
        return str(error)
    return None


class _Loop:
    """The state of a docking while it goes on."""

    def __init__(self, equipment: Equipment, listener: Listener) -> None:
        self._robot = equipment.robot
        self._localizer = equipment.localizer
        self._searching = equipment.searching
        self._lost_images = 0
        self._alignment = equipment.alignment
        self._pilot = equipment.pilot
        self._settings = equipment.settings
        self._mask = equipment.mask
        self._listener = listener
        self._entries: list[Entry] = []
        self._memory = Memory()
        self._rivals = Rivals()
        self._map_covariance = map_covariance(self._localizer.settings)
        self._smoother = Smoother()
        self._doubt = Doubt()
        self._began = time.monotonic()
        self._filter_seconds = 0.0

    def run(self) -> Outcome:
        """Goes on until there is an outcome."""
        command, measured = STANDSTILL, STANDSTILL
        before: Moment | None = None
        while True:
            spent = self._robot.seconds
            image = self._robot.take_image()
            true_state = self._robot.true_state()
            frame = self._localized(image, measured, spent)
            frame, seen, fix = self._fixed(frame, image, measured)
            # What is held against odometry must not have been made with it.
            now = moment_of(image, seen, self._mask)
            still = before is not None and stood_still(command, measured, before, now)
            if before is not None and self._doubt(
                not still and contradicts(measured, before.fix, seen)
            ):
                self._localizer, self._lost_images = self._searching(), 0
                self._memory = replace(self._memory, anchor=None, wait=None)
                fix = replace(fix, is_sure=False)
                now = replace(now, fix=replace(seen, is_sure=False))
            decision = self._pilot.decide(self._memory, fix, still, measured)
            outcome = decision.outcome or self._exhausted()
            state = Phase.FINISHED if outcome is not None else decision.memory.phase
            self._memory = replace(decision.memory, phase=state)
            command = STANDSTILL if outcome is not None else decision.movement
            word = state.value if outcome is None else outcome.ending.word
            entry = Entry(frame, image, word, command, STANDSTILL, true_state)
            self._entries.append(entry)
            self._tell(frame, fix, word, command)
            if outcome is not None:
                return outcome
            if state is Phase.WAITING and command == STANDSTILL and not self._robot.is_simulated:
                time.sleep(self._settings.patience / LOOKS)
            measured = self._robot.move(command)
            self._entries[-1] = replace(entry, measured=measured)
            before = now

    def finished(self, outcome: Outcome) -> Docking:
        """The docking as it ended."""
        if self._entries and self._entries[-1].state != outcome.ending.word:
            self._entries[-1] = replace(self._entries[-1], state=outcome.ending.word)
        seconds = {
            "total": time.monotonic() - self._began,
            "robot": self._robot.seconds,
            "filter": self._filter_seconds,
        }
        return Docking(
            entries=tuple(self._entries),
            outcome=outcome,
            attempts=self._memory.attempts,
            goal=self._pilot.goal,
            staging=self._pilot.staging,
            seconds=seconds,
        )

    def _localized(self, image: ImageArray, measured: Movement, spent: float) -> FrameRecord:
        number = len(self._entries)
        elapsed = time.monotonic() - self._began
        # A simulated robot has no clock: the same seed gives the same run.
        timestamp = float(number) if self._robot.is_simulated else elapsed
        start = time.monotonic()
        # While the view is covered the belief is carried on: the robot knows where it is.
        is_given_up = self._memory.wait is None and not self._memory.is_covered
        if self._lost_images > LARGEST_LOST and is_given_up:
            self._localizer, self._lost_images = self._searching(), 0
        frame = self._localizer.step(
            image, measured.vector() if number else None, timestamp, f"step {number:04d}"
        )
        self._filter_seconds += time.monotonic() - start
        if frame.status not in BY_ODOMETRY:
            self._lost_images = self._lost_images + 1 if frame.status == "lost" else 0
        took = self._robot.seconds - spent
        return replace(frame, seconds={**frame.seconds, "robot": took})

    def _fixed(
        self, frame: FrameRecord, image: ImageArray, measured: Movement
    ) -> tuple[FrameRecord, Fix, Fix]:
        """The frame with the estimate ``docking``; the image's own fix; the one to act on."""
        start = time.monotonic()
        own = fix_of(frame)
        candidates = self._alignment(own, image, self._rivals.expected(measured))
        seen = aligned_fix(own, self._rivals(candidates, measured), self._map_covariance)
        fix = confirmed(seen, self._smoother(seen, measured))
        took = time.monotonic() - start
        self._filter_seconds += took
        estimates = dict(frame.estimates)
        if fix.is_sure:
            estimates["docking"] = fix.state
        seconds = {**frame.seconds, "alignment": took}
        return replace(frame, estimates=estimates, seconds=seconds), seen, fix

    def _exhausted(self) -> Outcome | None:
        settings = self._settings
        if len(self._entries) >= settings.max_steps:
            return Outcome(Ending.TIMED_OUT, f"{settings.max_steps} steps were not enough")
        elapsed = time.monotonic() - self._began
        if elapsed > settings.max_seconds:
            return Outcome(Ending.TIMED_OUT, f"{settings.max_seconds:g} seconds were not enough")
        return None

    def _tell(self, frame: FrameRecord, fix: Fix, state: str, command: Movement) -> None:
        known = fix.state if fix.is_sure else None
        self._listener(
            Report(
                step=len(self._entries) - 1,
                state=state,
                status=frame.status,
                estimate=known,
                sigma=position_sigma(fix.covariance),
                distance=None if known is None else distance_between(known, self._pilot.goal),
                command=command,
                doubt=fix.what_speaks_against if state == Phase.ALIGNMENT.value else "",
            )
        )
