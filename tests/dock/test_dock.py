"""Docking in front of a painted wall: docked, and every other outcome."""

import functools
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.dock.dock import Report
from pipelines.dock.docking_log import Docking
from pipelines.dock.exploration import Search
from pipelines.dock.robot import CheckedRobot, Movement, RobotError
from pipelines.dock.robots.faults import FaultyRobot
from pipelines.dock.robots.noise import MotionNoise, SimulatedMotion
from pipelines.dock.settings import DockSettings
from pipelines.dock.states import OutcomeKind
from pipelines.localize.run import Run, load_run, save_run
from tests.dock_samples import (
    EXACT,
    GOAL,
    START,
    NoMove,
    NoNumbers,
    PaintedRobot,
    WrongSize,
    docked,
)
from tests.report_samples import facing_wall


def near_wall(**changes: Any) -> DockSettings:
    values: dict[str, Any] = {
        "least_distance": 0.4,
        "staging_distance": 0.5,
        **changes,
    }
    return DockSettings(**values)


def check_docked(robot: PaintedRobot) -> None:
    state = robot.motion.state
    assert np.linalg.norm(state[:2] - GOAL[:2]) < 0.025
    assert abs(state[2] - GOAL[2]) < math.radians(1.0)
    assert robot.is_stopped


@functools.cache
def faulty_docking(
    kind: str, step: int, drive: str
) -> tuple[PaintedRobot, FaultyRobot, Docking, Run]:
    """A robot, the same with a fault, and its docking; several tests look at the same one."""
    inner = PaintedRobot()
    robot = FaultyRobot(inner, kind, step)
    return inner, robot, *docked(robot, near_wall(drive=drive))


# --- docked -------------------------------------------------------------------------------------


@pytest.mark.parametrize("drive", ["omni", "diff"])
def test_a_robot_is_docked(drive: str, tmp_path: Any) -> None:
    start = START if drive == "omni" else facing_wall(0.2, 2.0, 0.2)
    robot, reports = PaintedRobot(start), list[Report]()
    docking, run = docked(
        robot, near_wall(drive=drive), listener=reports.append, start=tuple(start)
    )
    assert docking.outcome.kind is OutcomeKind.DOCKED
    check_docked(robot)
    assert [report.step for report in reports] == list(range(len(docking.entries)))
    states = list(dict.fromkeys(report.state for report in reports))
    assert states == ["searching", "staging", "approach", "alignment", "docked"]
    if drive == "diff":
        assert all(abs(l - f * math.tan(t / 2)) < 1e-9 for f, l, t in robot.commands)
    save_run(tmp_path / "run.h5", run, overwrite=False)
    again = load_run(tmp_path / "run.h5")
    assert again.docking is not None
    assert (again.docking.outcome, again.docking.exit_code) == ("docked", 0)
    np.testing.assert_array_equal(again.docking.commands[:-1], np.array(robot.commands))
    np.testing.assert_array_equal(again.docking.goal, GOAL)
    assert again.groundtruth is not None
    np.testing.assert_array_equal(again.groundtruth[-1], robot.motion.state)


def test_it_finds_the_wall_when_it_starts_with_its_back_to_it() -> None:
    robot = PaintedRobot(facing_wall(0.2, 1.9, turn=math.pi))
    docking, _ = docked(robot, near_wall(), start=None)
    assert docking.outcome.kind is OutcomeKind.DOCKED
    check_docked(robot)
    # Until it was localized it rotated on the spot and did not drive.
    searching = [entry for entry in docking.entries if entry.state == "searching"]
    assert len(searching) > 4
    assert all(entry.command.distance == 0.0 for entry in searching)


def test_a_robot_that_is_told_a_wrong_start_finds_out() -> None:
    robot = PaintedRobot(facing_wall(-0.6, 2.2))
    docking, _ = docked(robot, near_wall(), start=tuple(facing_wall(1.8, 0.9, turn=0.6)))
    assert docking.outcome.kind is OutcomeKind.DOCKED
    check_docked(robot)


def test_systematic_errors_of_odometry_do_no_harm() -> None:
    robot = PaintedRobot(noise=MotionNoise(scale=0.15, drift=math.radians(9.0)))
    docking, _ = docked(robot, near_wall())
    assert docking.outcome.kind is OutcomeKind.DOCKED
    check_docked(robot)


def test_the_same_seeds_give_the_same_run() -> None:
    commands = []
    for _ in range(2):
        robot = PaintedRobot()
        docked(robot, near_wall(max_steps=6))
        commands.append(robot.commands)
    assert commands[0] == commands[1]


# --- a view that is covered ---------------------------------------------------------------------


@pytest.mark.parametrize("drive", ["omni", "diff"])
@pytest.mark.parametrize("step", [4, 7, 9])
def test_it_waits_until_people_have_walked_on(drive: str, step: int) -> None:
    start = START if drive == "omni" else facing_wall(0.3, 2.0, 0.2)
    inner = PaintedRobot(start)
    robot = FaultyRobot(inner, "people", step)
    docking, _ = docked(robot, near_wall(drive=drive), start=tuple(start))
    assert docking.outcome.kind is OutcomeKind.DOCKED
    check_docked(inner)
    states = [entry.state for entry in docking.entries]
    assert states.count("waiting") >= 3
    # It went on where it was, and neither moved meanwhile nor began a new search.
    first = states.index("waiting")
    assert "searching" not in states[first:]
    still = [entry.command for entry in docking.entries if entry.state == "waiting"]
    assert all(command == Movement() for command in still[:4])


@pytest.mark.parametrize("drive", ["omni", "diff"])
@pytest.mark.parametrize("kind", ["cover", "frozen", "black"])
@pytest.mark.parametrize("step", [4, 8, 10])
def test_a_view_that_stays_covered_never_ends_as_docked(drive: str, kind: str, step: int) -> None:
    inner, _, docking, _ = faulty_docking(kind, step, drive)
    outcome = docking.outcome.kind
    if outcome is OutcomeKind.DOCKED:
        # It was there before.
        check_docked(inner)
        assert len(docking.entries) <= step + 3
        return
    assert outcome in {OutcomeKind.VIEW_BLOCKED, OutcomeKind.LOST, OutcomeKind.ROBOT_FAILED}
    covered = docking.entries[step:]
    # After the step on which it happened it drives half a metre at most.
    assert sum(entry.command.distance for entry in covered[1:]) < 0.5


# --- every other outcome -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "kind", "words"),
    [
        ("blocked", OutcomeKind.BLOCKED, "did not happen"),
        ("slipping", OutcomeKind.BLOCKED, "did not happen"),
        ("black", OutcomeKind.LOST, "show nothing"),
        ("frozen", OutcomeKind.ROBOT_FAILED, "one and the same, although odometry moves"),
        ("cover", OutcomeKind.VIEW_BLOCKED, "the view stayed covered"),
        (
            "driver",
            OutcomeKind.ROBOT_FAILED,
            "ConnectionError: no answer from the motor controller",
        ),
    ],
)
def test_a_fault_at_step_4_is_named_and_the_robot_is_stopped(
    fault: str, kind: OutcomeKind, words: str
) -> None:
    _, robot, docking, run = faulty_docking(fault, 4, "omni")
    assert docking.outcome.kind is kind
    assert words in docking.outcome.reason
    assert robot.is_stopped
    assert len(run.frames) == len(docking.entries) > 4
    assert run.docking is not None
    assert run.docking.exit_code == kind.value
    assert run.docking.states[-1] == kind.word


class Hanging(PaintedRobot):
    """From the fifth image on its camera gives the same one, while the robot moves."""

    def __init__(self) -> None:
        super().__init__()
        self._images: list[ImageArray] = []

    def take_image(self) -> ImageArray:
        if len(self._images) < 5:
            self._images.append(super().take_image())
        return self._images[-1].copy()


def test_a_camera_that_hangs_ends_the_docking_before_the_robot_goes_far() -> None:
    robot = Hanging()
    docking, run = docked(robot, near_wall())
    # Not blocked: odometry says that the robot moves, so that the camera is at fault.
    assert docking.outcome.kind is OutcomeKind.ROBOT_FAILED
    assert "the camera hangs" in docking.outcome.reason
    assert robot.is_stopped
    stale = [frame.status == "stale" for frame in run.frames]
    assert stale[:5] == [False] * 5
    assert 1 <= sum(stale) <= 6


def test_outside_of_the_area() -> None:
    robot = PaintedRobot()
    docking, _ = docked(robot, near_wall(), area=(-0.2, 1.0, -2.8, -0.3))
    assert docking.outcome.kind is OutcomeKind.OUT_OF_AREA
    assert robot.is_stopped
    assert robot.commands == []


class Slow(PaintedRobot):
    """Its camera is slow."""

    def take_image(self) -> ImageArray:
        time.sleep(0.06)
        return super().take_image()


@pytest.mark.parametrize(
    ("robot", "limit"), [(PaintedRobot(), {"max_steps": 3}), (Slow(), {"max_seconds": 0.1})]
)
def test_timed_out(robot: PaintedRobot, limit: dict[str, Any]) -> None:
    docking, _ = docked(robot, near_wall(**limit))
    assert docking.outcome.kind is OutcomeKind.TIMED_OUT
    assert robot.is_stopped


class Snow(PaintedRobot):
    """Its camera shows nothing but noise."""

    def take_image(self) -> ImageArray:
        shape = (self.camera.height, self.camera.width, 3)
        return np.random.default_rng(len(self.commands)).integers(0, 255, shape).astype(np.uint8)


def test_lost() -> None:
    robot = Snow()
    docking, _ = docked(robot, near_wall(max_search=14), start=None)
    assert docking.outcome.kind is OutcomeKind.LOST
    assert robot.is_stopped
    # It never drives towards a guess; it may only back away.
    assert all(forward <= 0.0 and left == 0.0 for forward, left, _ in robot.commands)


class Interrupted(PaintedRobot):
    """Somebody presses Ctrl-C while it moves."""

    def move(self, forward: float, left: float, turn: float) -> Any:
        if len(self.commands) == 2:
            raise KeyboardInterrupt
        return super().move(forward, left, turn)


def test_control_c_stops_the_robot_and_keeps_the_run() -> None:
    robot = Interrupted()
    docking, run = docked(robot, near_wall())
    assert docking.outcome.kind is OutcomeKind.INTERRUPTED
    assert robot.is_stopped
    assert len(run.frames) == 3


def test_exit_codes_are_distinct_and_none_is_an_error_or_wrong_usage() -> None:
    codes = [kind.value for kind in OutcomeKind]
    assert len(set(codes)) == len(codes)
    assert {1, 2}.isdisjoint(codes)
    assert [kind for kind in OutcomeKind if kind.value == 0] == [OutcomeKind.DOCKED]


# --- bad input ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (facing_wall(4.0, 1.5), "outside of the allowed area"),
        (facing_wall(0.0, -0.5), "outside of the allowed area"),
        (facing_wall(0.0, 0.2), "nearer than the least distance"),
    ],
)
def test_a_goal_where_no_robot_can_be(goal: FloatArray, words: str) -> None:
    robot = PaintedRobot()
    with pytest.raises(OptionError, match=words):
        docked(robot, near_wall(), goal)
    assert robot.commands == []


def test_a_goal_behind_the_surface() -> None:
    with pytest.raises(OptionError, match="inside the scene's surface"):
        docked(PaintedRobot(), near_wall(), facing_wall(0.0, -0.5), area=(-3.0, 3.0, -3.0, 3.0))


@pytest.mark.parametrize(
    ("robot", "words"),
    [
        (NoMove, "lacks move"),
        (WrongSize, "20x10 pixels with 3 channels of uint8, its camera says 48x36"),
        (NoNumbers, "three finite numbers"),
    ],
)
def test_violations_of_the_robot_protocol(robot: Callable[[], Any], words: str) -> None:
    with pytest.raises(RobotError, match=words):
        checked = CheckedRobot(robot())
        checked.take_image()
        checked.move(Movement())


@pytest.mark.parametrize("name", ["largest_step", "least_distance", "max_seconds"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_settings_that_make_no_sense(name: str, value: float) -> None:
    with pytest.raises(OptionError, match="is not between"):
        DockSettings(**{name: value})  # type: ignore[arg-type]


def test_a_robot_of_a_known_size_comes_nearer_than_one_of_unknown() -> None:
    assert DockSettings().distance_kept == 0.5
    assert DockSettings(robot_radius=0.3).distance_kept == pytest.approx(0.35)
    assert DockSettings(robot_radius=0.3, least_distance=0.4).distance_kept == 0.4
    with pytest.raises(OptionError, match="touches the surface"):
        DockSettings(robot_radius=0.3, least_distance=0.2)


# --- parts --------------------------------------------------------------------------------------


def test_simulated_odometry_errs_as_it_is_told() -> None:
    noise = MotionNoise(0.0, 0.0, 0.0, scale=0.15, drift=0.1)
    motion = SimulatedMotion(np.zeros(3), noise, np.random.default_rng(0))
    measured = motion.move(Movement(2.0, 0.0, 0.0))
    np.testing.assert_allclose(motion.state, [2.0, 0.0, 0.0])
    np.testing.assert_allclose(measured.vector(), [2.3, 0.0, 0.2])
    random = MotionNoise(0.0, 0.02, math.radians(0.5))
    moving = SimulatedMotion(np.zeros(3), random, np.random.default_rng(0))
    errors = np.array([moving.move(Movement(1.0)).vector() - [1.0, 0.0, 0.0] for _ in range(2000)])
    np.testing.assert_allclose(errors.std(axis=0), [0.02, 0.0, math.radians(0.5)], rtol=0.06)


def test_slipping_wheels_are_not_felt() -> None:
    noise = MotionNoise(0.0, 0.0, 0.0, slip=1.0, slip_share=0.25)
    motion = SimulatedMotion(np.zeros(3), noise, np.random.default_rng(0))
    assert motion.move(Movement(0.4)) == Movement(0.4)
    np.testing.assert_allclose(motion.state, [0.3, 0.0, 0.0])
    assert EXACT.slip == 0.0


def test_a_search_remembers_all_directions_viewed() -> None:
    search = Search()
    for _ in range(11):
        search = search.after(Movement(turn=2.0 * math.pi / 12.0))
    assert search.viewed | {search.number} == set(range(12))
    assert search.steps == 11
