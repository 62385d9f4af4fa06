"""Alignment at full resolution, against true poses, under the map's lamps and under others."""

import math

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.dock.fine_alignment import FineAlignment
from pipelines.dock.planar_motion import distance_between, yaw_between
from pipelines.dock.pose_estimate import PoseEstimate
from pipelines.geometry.camera import Camera
from tests.dock_samples import FILTER, photo, wall_scene
from tests.report_samples import MOUNT, facing_wall

# Twice the width from which local contrast is aligned, 60 degrees wide.
CAMERA = Camera("SIMPLE_PINHOLE", 200, 150, (173.0, 99.5, 74.5))
TRUTH = facing_wall(0.3, 1.4, 0.05)
# A step aside and a rotation back, which look almost the same in front of a wall.
FLAT = np.array([0.05, 0.01, math.atan(0.05 / 1.4)])


def estimate(state: FloatArray, localized: bool = True) -> PoseEstimate:
    return PoseEstimate(state, np.eye(3) * 1e-4, np.array([[*state, 1.0]]), True, localized, False)


@pytest.fixture(scope="module")
def alignment() -> FineAlignment:
    return FineAlignment(wall_scene(CAMERA), CAMERA, MOUNT, FILTER)


def as_recorded() -> ImageArray:
    noisy = photo(TRUTH, CAMERA) + np.random.default_rng(4).normal(0.0, 2.0, (150, 200, 3))
    return np.asarray(np.clip(np.rint(noisy), 0, 255), dtype=np.uint8)


def in_another_light() -> ImageArray:
    """A lamp on the right: bright there, dark on the left, and its reflection in the middle."""
    image = as_recorded().astype(np.float64)
    rows, columns = np.mgrid[-1.0:1.0:150j, -1.0:1.0:200j]
    lamp = 0.3 + 0.9 * (0.5 + 0.5 * columns) ** 2
    reflection = 80.0 * np.exp(-8.0 * ((columns - 0.2) ** 2 + rows**2))
    lit = lamp[..., None] * image + reflection[..., None]
    return np.asarray(np.clip(np.rint(lit), 0, 255), dtype=np.uint8)


@pytest.mark.parametrize("image", [as_recorded(), in_another_light()], ids=["same", "other"])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_it_finds_the_pose_along_the_flat_direction_in_any_light(
    alignment: FineAlignment, image: ImageArray, side: float
) -> None:
    best = alignment(estimate(TRUTH + side * FLAT), image)[0]
    assert distance_between(best.state, TRUTH) < 0.01
    assert abs(yaw_between(best.state, TRUTH)) < math.radians(0.4)
    assert best.fit > 0.0


def test_alignment_starts_at_expected_states_too(alignment: FineAlignment) -> None:
    found = alignment(estimate(TRUTH + 3.0 * FLAT), as_recorded(), [TRUTH])
    assert min(distance_between(each.state, TRUTH) for each in found) < 0.01
    assert distance_between(found[0].state, TRUTH) < 0.01
    assert [each.fit for each in found] == sorted((each.fit for each in found), reverse=True)


def test_estimates_not_localized_or_far_from_the_goal_are_not_aligned(
    alignment: FineAlignment,
) -> None:
    assert alignment(estimate(TRUTH, localized=False), as_recorded()) == []
    assert alignment(estimate(TRUTH), np.full((150, 200, 3), 90, dtype=np.uint8)) == []
    elsewhere = TRUTH + np.array([1.0, 0.0, 0.0])
    near = FineAlignment(wall_scene(CAMERA), CAMERA, MOUNT, FILTER, elsewhere, reach=0.5)
    assert near(estimate(TRUTH), as_recorded()) == []
