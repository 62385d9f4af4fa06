"""When the pose of a dock is sent, and nav2's dock database."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipelines.artifacts.errors import OptionError
from pipelines.geometry.pose import planar_state_of, world_from_base_planar
from pipelines.ros.detector_settings import DetectorSettings
from pipelines.ros.dock_detection import base_from_dock, objection
from pipelines.ros.pose_publishing import KnownPose
from pipelines.ros.pose_track import NANOSECONDS
from tests.chain_samples import lfnav, map_elevators, succeed

GOAL = (1.0, 2.0, math.pi / 2)
NOW = 100 * NANOSECONDS
SURE = KnownPose(
    NOW,
    world_from_base_planar([1.0, 1.5, math.pi / 2]),
    np.eye(4),
    np.diag([1e-4, 1e-4, 0.0, 0.0, 0.0, 1e-4]),
    is_measured=True,
    confidence=0.9,
)
DETECTOR = DetectorSettings(goal=GOAL)


def test_the_dock_is_seen_from_the_robot() -> None:
    state = planar_state_of(base_from_dock(SURE, GOAL))
    np.testing.assert_allclose(state, [0.5, 0.0, 0.0], atol=1e-12)
    assert objection(SURE, DETECTOR, NOW + NANOSECONDS) == ""


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"stamp": NOW - NANOSECONDS * 11 // 10}, "the image is 1.10 s old"),
        ({"is_measured": False}, "the image shows nothing"),
        ({"confidence": 0.4}, "the confidence is 0.40"),
        ({"covariance": np.eye(6) * 0.04}, "the position has a standard deviation of 0.20 m"),
        ({"map_from_base": np.eye(4) * 1.0 + 9.0 * np.eye(4, k=3)}, "the dock is 8.2 m away"),
    ],
)
def test_what_is_old_or_not_sure_is_not_sent(change: dict[str, object], text: str) -> None:
    assert objection(replace(SURE, **change), DETECTOR, NOW) == text  # type: ignore[arg-type]


def test_settings() -> None:
    assert objection(SURE, DetectorSettings(), NOW) == "there is no goal"
    with pytest.raises(OptionError, match="X,Y,DEG"):
        DetectorSettings(goal=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    with pytest.raises(OptionError, match="least_confidence 2 is not between"):
        DetectorSettings(least_confidence=2.0)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return map_elevators(tmp_path_factory.mktemp("scene"), "--geometry", "plane")


def test_the_dock_database(scene: Path, tmp_path: Path) -> None:
    path = tmp_path / "docks.yaml"
    docks = ("--dock", "home=-1.15,-1.65,90", "--dock", "spare=0,-2,-90")
    succeed("export", scene, "--format", "nav2-docks", *docks, "-o", path)
    assert path.read_text().splitlines()[1:] == [
        "docks:",
        "  home:",
        "    type: simple_charging_dock",
        "    frame: map",
        "    pose: [-1.150000, -1.650000, 1.570796]",
        "    id: home",
        "  spare:",
        "    type: simple_charging_dock",
        "    frame: map",
        "    pose: [0.000000, -2.000000, -1.570796]",
        "    id: spare",
    ]


@pytest.mark.parametrize(
    ("docks", "text"),
    [
        ((), "there are no docks"),
        (("--dock", "home=50,0,0"), "dock home lies outside of the scene model"),
        (("--dock", "ho me=0,-2,0"), "is not a name"),
        (("--dock", "home=0,-2"), "NAME=X,Y,DEG"),
        (("--dock", "0,-2,0"), "NAME=X,Y,DEG"),
        (("--dock", "a=0,-2,0", "--dock", "a=0,-2,0"), "each name once"),
    ],
)
def test_docks_that_are_none(
    scene: Path, tmp_path: Path, docks: tuple[str, ...], text: str
) -> None:
    path = tmp_path / "docks.yaml"
    outcome = lfnav("export", scene, "--format", "nav2-docks", *docks, "-o", path)
    assert outcome.code in (1, 2)
    assert text in outcome.err
    assert not path.exists()


def test_options_of_other_formats(scene: Path, tmp_path: Path) -> None:
    options = ("--format", "colmap", "--dock", "a=0,0,0")
    outcome = lfnav("export", scene, *options, "-o", tmp_path / "project")
    assert "are for --format nav2-docks" in outcome.err
