"""What docking in a world takes of its areas."""

from dataclasses import replace

import numpy as np
import pytest

from pipelines.artifacts.errors import OptionError
from pipelines.dock.docking_map import docking_map
from pipelines.lightfield.open_world import OpenWorld, open_world
from pipelines.lightfield.stage import ModelSettings
from pipelines.lightfield.world import AreaSettings, model_world
from tests.world_samples import TWO_ROOMS, rooms_reconstruction

PLACES = [(x, 0.0) for x in (-1.0, -0.6, -0.2, 0.2, 0.6, 1.0)]


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> OpenWorld:
    """Two rooms, of whose 24 photos each area holds 6."""
    folder = tmp_path_factory.mktemp("few")
    rooms_reconstruction(folder, PLACES)
    (folder / "areas.toml").write_text(TWO_ROOMS, encoding="utf-8")
    settings = ModelSettings(plane=(0.0, 0.0, 1.0, 0.0), max_views=6)
    model_world(folder / "map", folder / "world", AreaSettings(folder / "areas.toml"), settings)
    return open_world(folder / "world")


@pytest.mark.parametrize("x", [-1.0, -0.1, 0.6])
def test_photos_around_a_goal_are_those_that_areas_hold(world: OpenWorld, x: float) -> None:
    around = docking_map(world).around(np.array([[x, 0.0, 0.0]]))
    numbers = [world.index.image_names.index(name) for name in around.image_names]
    assert numbers
    assert world.held[numbers].all()
    np.testing.assert_array_equal(around.world_from_camera, world.index.world_from_camera[numbers])


def test_areas_without_photos_of_their_own_are_no_place_for_a_goal(world: OpenWorld) -> None:
    held = np.flatnonzero(world.held)
    home = world.index.home.copy()
    home[held] = 1 - home[held]
    views = tuple(
        replace(area, views=area.views[~np.isin(area.views, np.flatnonzero(home == number))])
        for number, area in enumerate(world.index.areas)
    )
    other = replace(world, index=replace(world.index, home=home, areas=views))
    with pytest.raises(OptionError, match="hold none of their own photos"):
        docking_map(other).around(np.array([[-1.0, 0.0, 0.0]]))
