"""Docking in another room, from images computed ray by ray: the whole loop."""

import math
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.errors import OptionError
from pipelines.dock.program import DockingResult, dock
from pipelines.dock.robots.faults import FaultyRobot
from pipelines.dock.settings import DockSettings
from pipelines.dock.states import OutcomeKind
from pipelines.localize.settings import LocalizerSettings
from tests.two_room_samples import DOOR, RoomRobot, distance_from_walls, two_rooms

RADIUS = 0.2
START, GOAL = np.array([0.9, 0.7, 0.5]), (4.9, 0.75, math.radians(-90.0))
FILTER = LocalizerSettings(particles=100, start_particles=600, threads=1, start=tuple(START))


def docked(robot: Any, **changes: Any) -> DockingResult:
    values = {"robot_radius": RADIUS, "staging_distance": 0.4, **changes}
    return dock(two_rooms(), robot, GOAL, DockSettings(**values), FILTER)


def check_nothing_was_touched(robot: RoomRobot, radius: float = RADIUS) -> None:
    for before, after in zip(robot.states[:-1], robot.states[1:], strict=True):
        for share in np.linspace(0.0, 1.0, 6):
            assert distance_from_walls(before[:2] + share * (after - before)[:2]) > radius


@pytest.mark.parametrize("drive", ["omni", "diff"])
def test_a_robot_is_docked_in_the_other_room(drive: str) -> None:
    robot = RoomRobot(START)
    result = docked(robot, drive=drive)
    assert result.outcome.kind is OutcomeKind.DOCKED
    error = robot.motion.state - GOAL
    assert np.linalg.norm(error[:2]) < 0.03
    assert abs(math.remainder(error[2], 2.0 * math.pi)) < math.radians(1.0)
    states = list(dict.fromkeys(entry.state for entry in result.docking.entries))
    assert states == ["searching", "route", "staging", "approach", "alignment", "docked"]
    check_nothing_was_touched(robot)


def test_a_closed_door_without_another_is_no_way() -> None:
    robot = RoomRobot(START)
    result = docked(FaultyRobot(robot, f"door@{DOOR[0]},{DOOR[1]}", 0))
    assert result.outcome.kind is OutcomeKind.NO_WAY
    assert result.outcome.kind.word == "no way"
    assert "does not show" in result.outcome.reason
    assert np.linalg.norm(robot.motion.state[:2] - DOOR) > 0.42
    # It went there and found out.
    assert np.linalg.norm(robot.motion.state[:2] - DOOR) < 0.6
    assert result.run is not None
    assert result.run.docking is not None
    assert (result.run.docking.outcome, result.run.docking.exit_code) == ("no way", 16)


def test_wheels_that_are_blocked_on_the_way_are_no_door() -> None:
    result = docked(FaultyRobot(RoomRobot(START), "blocked", 5))
    assert result.outcome.kind is OutcomeKind.BLOCKED
    assert "did not happen" in result.outcome.reason


@pytest.mark.parametrize(
    "kind", ["door@", "door@1", "door@x,y", "door@nan,1", "door@1,2,3", "door"]
)
def test_a_door_needs_a_place(kind: str) -> None:
    with pytest.raises(OptionError, match="door"):
        FaultyRobot(RoomRobot(START), kind, 0)
