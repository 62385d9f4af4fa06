"""Search: a view that may match the map is kept until another image decides."""

import math

import numpy as np
import pytest

from pipelines.dock.clearance import Clearance
from pipelines.dock.exploration import DIRECTION_STEP, Explorer
from pipelines.dock.pose_estimate import PoseEstimate
from pipelines.dock.robot import STANDSTILL, Movement
from pipelines.dock.safety import Safety
from pipelines.dock.settings import DockSettings
from pipelines.dock.state_machine import LARGEST_TRIAL, MOST_HINTS, DockingStateMachine
from pipelines.dock.states import DockingState
from pipelines.render.renderer import Renderer
from tests.report_samples import CAMERA, MOUNT, facing_wall, wall_scene

GOAL = facing_wall(0.0, 1.0)
PLACES = np.array([[*facing_wall(0.5, 2.0), 0.7], [*facing_wall(-0.5, 2.0), 0.3]])


def state_machine() -> DockingStateMachine:
    scene = wall_scene()
    safety = Safety((-3.0, 3.0, -3.0, 0.0), Clearance(scene, 1.0), 0.5)
    renderer = Renderer.of_scene(scene, 48, threads=1)
    explorer = Explorer(renderer, MOUNT, CAMERA.intrinsics, safety)
    return DockingStateMachine(GOAL, DockSettings(), safety, explorer)


def estimate(status: str, confidence: float) -> PoseEstimate:
    return PoseEstimate(
        PLACES[0, :3],
        1e-4 * np.eye(3),
        PLACES,
        is_refined=False,
        is_localized=False,
        is_blind=False,
        status=status,
        confidence=confidence,
    )


def rotations(status: str, confidence: float, count: int) -> list[float]:
    """Rotations (radians) of a robot that gets the same estimate from each image."""
    state, measured, found = DockingState(), STANDSTILL, list[float]()
    own = state_machine()
    for _ in range(count):
        decision = own.decide(state, estimate(status, confidence), measured=measured)
        assert decision.movement is not None
        state, measured = decision.state, decision.movement
        assert isinstance(measured, Movement)
        found.append(abs(measured.turn))
    return found


def test_a_possible_match_stays_in_view_for_a_few_images() -> None:
    found = rotations("global", 0.3, MOST_HINTS + 1)
    assert max(found[:MOST_HINTS]) <= LARGEST_TRIAL
    assert found[MOST_HINTS] > LARGEST_TRIAL


@pytest.mark.parametrize(("status", "confidence"), [("lost", 0.3), ("global", 0.02)])
def test_the_robot_rotates_away_from_what_is_no_possible_match(
    status: str, confidence: float
) -> None:
    assert rotations(status, confidence, 1)[0] == pytest.approx(DIRECTION_STEP)
    assert math.degrees(DIRECTION_STEP) == pytest.approx(30.0)
