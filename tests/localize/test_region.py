"""Regions with free ground: where a body is looked for, and the density of that."""

from dataclasses import replace

import numpy as np
import pytest

from pipelines.artifacts.errors import OptionError
from pipelines.lightfield.free_ground import FreeGround
from pipelines.lightfield.scene import Scene
from pipelines.localize.belief import Region, uniform_belief
from pipelines.localize.localizer import region_of
from pipelines.localize.retrieval import spread_states
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import PLANAR, SPATIAL, StateSpace
from tests.report_samples import wall_scene

# A ring of eight cells of a metre around one that is not free.
RING = np.ones((3, 3), dtype=np.bool_)
RING[1, 1] = False
GROUND = FreeGround(np.array([-1.0, -4.0]), 1.0, RING)
REGION = Region(np.array([-1.0, -4.0]), np.array([2.0, -1.0]), GROUND)
HOLE = np.array([0.5, -2.5])


def scene_with_ground() -> Scene:
    return replace(wall_scene(), ground=GROUND, bounds=GROUND.bounds)


def test_all_draws_are_above_free_ground() -> None:
    states = uniform_belief(PLANAR, REGION, 4000, np.random.default_rng(0)).states
    assert REGION.contains(states).all()
    assert np.abs(states[:, :2] - HOLE).max(axis=1).min() > 0.5 - 1e-9
    counts = np.histogram2d(states[:, 0], states[:, 1], bins=3)[0]
    np.testing.assert_allclose(counts[RING], 500, atol=80)
    assert np.ptp(states[:, 2]) > 6.0


def test_spread_states_cover_the_free_ground_evenly_and_always_the_same() -> None:
    states = spread_states(PLANAR, REGION, 1600)
    assert states.shape == (1600, 3)
    assert REGION.contains(states).all()
    np.testing.assert_array_equal(states, spread_states(PLANAR, REGION, 1600))
    counts = np.histogram2d(states[:, 0], states[:, 1], bins=3)[0]
    np.testing.assert_allclose(counts[RING], 200, atol=12)


def test_without_free_ground_states_are_spread_as_before() -> None:
    box = Region(REGION.low, REGION.high)
    # The first of the Halton sequence: 0, 0, 0 and 1/2, 1/3, 1/5 of the way.
    third = spread_states(PLANAR, box, 2)[1]
    np.testing.assert_allclose(third, [0.5, -3.0, -np.pi + 0.2 * 2.0 * np.pi])
    # The sequence with ground is a part of the one without.
    whole = spread_states(PLANAR, box, 400)
    kept = whole[GROUND.contains(whole[:, :2])]
    np.testing.assert_array_equal(spread_states(PLANAR, REGION, len(kept)), kept)


@pytest.mark.parametrize("space", [PLANAR, SPATIAL])
def test_the_density_integrates_to_one(space: StateSpace) -> None:
    low, high = np.array([-1.0, -4.0, 0.2]), np.array([2.0, -1.0, 1.7])
    region = Region(low[: space.positions], high[: space.positions], GROUND)
    volume = 8.0 * (1.5 if space is SPATIAL else 1.0) * space.orientation_volume()
    assert region.log_density(space) == pytest.approx(-np.log(volume))
    states = region.sample(space, 500, np.random.default_rng(2))
    assert region.contains(states).all()


def test_the_scenes_free_ground_is_where_a_robot_is_looked_for() -> None:
    region = region_of(scene_with_ground(), LocalizerSettings())
    assert region.ground is not None
    np.testing.assert_array_equal(region.ground.cells, RING)
    assert not region.contains(np.append(HOLE, 0.0)[None]).any()
    assert region_of(wall_scene(), LocalizerSettings()).ground is None


def test_an_area_narrows_the_free_ground() -> None:
    scene = scene_with_ground()
    region = region_of(scene, LocalizerSettings(area=(-5.0, 0.2, -5.0, 5.0)))
    states = region.sample(PLANAR, 200, np.random.default_rng(3))
    assert (states[:, 0] < 0.0).all()
    with pytest.raises(OptionError, match="free ground"):
        region_of(scene, LocalizerSettings(area=(0.1, 0.9, -2.9, -2.1)))
    with pytest.raises(OptionError, match="outside"):
        region_of(scene, LocalizerSettings(area=(20.0, 21.0, -2.9, -2.1)))


def test_a_camera_in_a_hand_is_looked_for_above_free_ground() -> None:
    region = region_of(scene_with_ground(), LocalizerSettings(degrees_of_freedom=6))
    states = region.sample(SPATIAL, 300, np.random.default_rng(4))
    assert states.shape == (300, 6)
    assert GROUND.contains(states[:, :2]).all()
