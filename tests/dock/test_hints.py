"""Looking round: what looked like the map stays in view until another image decides."""

import math

import numpy as np
import pytest

from pipelines.dock.clearance import Clearance
from pipelines.dock.exploration import TURN, Explorer
from pipelines.dock.pose_estimate import Fix
from pipelines.dock.robot import STANDSTILL, Movement
from pipelines.dock.safety import Safety
from pipelines.dock.settings import DockSettings
from pipelines.dock.state_machine import LARGEST_TRIAL, MOST_HINTS, Memory, Pilot
from pipelines.render.renderer import Renderer
from tests.report_samples import CAMERA, MOUNT, facing_wall, wall_scene

GOAL = facing_wall(0.0, 1.0)
PLACES = np.array([[*facing_wall(0.5, 2.0), 0.7], [*facing_wall(-0.5, 2.0), 0.3]])


def pilot() -> Pilot:
    scene = wall_scene()
    safety = Safety((-3.0, 3.0, -3.0, 0.0), Clearance(scene, 1.0), 0.5)
    renderer = Renderer.of_scene(scene, 48, threads=1)
    explorer = Explorer(renderer, MOUNT, CAMERA.intrinsics, safety)
    return Pilot(GOAL, DockSettings(), safety, explorer)


def fix(status: str, confidence: float) -> Fix:
    return Fix(
        PLACES[0, :3],
        1e-4 * np.eye(3),
        PLACES,
        is_refined=False,
        is_sure=False,
        is_blind=False,
        status=status,
        confidence=confidence,
    )


def turns(status: str, confidence: float, count: int) -> list[float]:
    """Of a robot that is told the same of each image."""
    memory, measured, found = Memory(), STANDSTILL, list[float]()
    own = pilot()
    for _ in range(count):
        decision = own.decide(memory, fix(status, confidence), measured=measured)
        assert decision.movement is not None
        memory, measured = decision.memory, decision.movement
        assert isinstance(measured, Movement)
        found.append(abs(measured.turn))
    return found


def test_a_place_that_may_be_the_right_one_stays_in_view_for_a_few_images() -> None:
    found = turns("global", 0.3, MOST_HINTS + 1)
    assert max(found[:MOST_HINTS]) <= LARGEST_TRIAL
    assert found[MOST_HINTS] > LARGEST_TRIAL


@pytest.mark.parametrize(("status", "confidence"), [("lost", 0.3), ("global", 0.02)])
def test_what_is_no_hint_is_turned_away_from(status: str, confidence: float) -> None:
    assert turns(status, confidence, 1)[0] == pytest.approx(TURN)
    assert math.degrees(TURN) == pytest.approx(30.0)
