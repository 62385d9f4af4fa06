"""Free ground against the geometry of a room that is known, and as a set of cells."""

from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.lightfield.free_ground import FreeGround
from pipelines.lightfield.ground_carving import MARGIN, free_ground
from tests.room_samples import (
    CAMERA,
    DOOR_HIGH,
    DOOR_LOW,
    HIGH,
    LOW,
    PARTITION_X,
    exact_depth,
    poses_all_around,
)

# An L of three cells of half a metre.
CELLS = np.array([[True, True], [True, False]])
GROUND = FreeGround(np.array([1.0, -2.0]), 0.5, CELLS)


def grid_of_places(step: float = 0.05) -> FloatArray:
    x, y = np.meshgrid(np.arange(-3.0, 9.0, step), np.arange(-3.0, 6.0, step))
    return np.stack([x.ravel(), y.ravel()], axis=1)


@pytest.fixture(scope="module")
def carved() -> FreeGround:
    poses = poses_all_around()
    return free_ground(poses, [CAMERA] * len(poses), exact_depth(poses))


def test_the_room_is_free_and_what_lies_behind_its_walls_is_not(carved: FreeGround) -> None:
    places = grid_of_places()
    free = carved.contains(places)
    slack = 0.1
    west = np.all((places > LOW[:2]) & (places < [PARTITION_X, HIGH[1]]), axis=1)
    assert free[west].all()
    # A margin and a cell beyond the walls, and nothing farther.
    beyond = np.any(
        (places < LOW[:2] - MARGIN - slack) | (places > HIGH[:2] + MARGIN + slack), axis=1
    )
    assert not free[beyond].any()


def test_behind_a_partition_only_what_is_seen_through_its_doorway_is_free(
    carved: FreeGround,
) -> None:
    middle = 0.5 * (DOOR_LOW + DOOR_HIGH)
    assert carved.contains(np.array([[PARTITION_X + 0.5, middle]])).all()
    # From the nearest photo, 0.8 m or more before the doorway, these corners cannot be seen.
    hidden = np.array([[PARTITION_X + 0.6, 0.2], [PARTITION_X + 0.6, HIGH[1] - 0.1]])
    assert not carved.contains(hidden).any()


def test_the_ground_ends_as_far_from_the_photos_as_they_usually_see() -> None:
    poses, places = poses_all_around(), grid_of_places()
    depth = exact_depth(poses)
    for index, view in enumerate(depth):
        # One photo in three sees nothing for 50 m.
        view.inverse_depth[:] = 0.5 if index % 3 else 0.02
    free = free_ground(poses, [CAMERA] * len(poses), depth).contains(places)
    nearest = np.linalg.norm(places[:, None] - poses[None, ::8, :2, 3], axis=2).min(axis=1)
    assert free[nearest < 1.5].all()
    assert not free[nearest > 2.0 + MARGIN + 0.15].any()


def test_where_photos_were_taken_is_free_whatever_they_show() -> None:
    poses = poses_all_around()[:3]
    blind = exact_depth(poses)
    for depth in blind:
        # A lens cap: everything is 5 cm away.
        depth.inverse_depth[:] = 20.0
    ground = free_ground(poses, [CAMERA] * 3, blind)
    assert ground.contains(poses[:, :2, 3]).all()
    assert ground.area < 1.0


def test_a_cell_is_hit_by_places_in_it() -> None:
    inside = np.array([[1.0, -2.0], [1.9, -1.6], [1.2, -1.1]])
    outside = np.array([[1.6, -1.2], [0.9, -2.0], [1.2, -0.9], [9.0, 9.0], [-9.0, -9.0]])
    assert GROUND.contains(inside).all()
    assert not GROUND.contains(outside).any()
    assert GROUND.area == pytest.approx(0.75)
    np.testing.assert_allclose(GROUND.bounds, [1.0, 2.0, -2.0, -1.0])


def test_bounds_are_those_of_the_free_cells() -> None:
    cells = np.zeros((4, 5), dtype=np.bool_)
    cells[2, 3] = True
    np.testing.assert_allclose(
        FreeGround(np.zeros(2), 0.1, cells).bounds, [0.3, 0.4, 0.2, 0.3], atol=1e-12
    )


def test_draws_fill_the_cells_evenly() -> None:
    drawn = GROUND.sample(6000, np.random.default_rng(1))
    assert GROUND.contains(drawn).all()
    counts = [
        np.count_nonzero(np.all(np.floor((drawn - GROUND.corner) / 0.5) == cell, axis=1))
        for cell in ([0, 0], [1, 0], [0, 1])
    ]
    np.testing.assert_allclose(counts, 2000, atol=150)


def test_distance_is_to_the_nearest_free_cell() -> None:
    assert GROUND.distance(np.array([1.2, -1.8])) == 0.0
    assert GROUND.distance(np.array([2.3, -1.1])) == pytest.approx(np.hypot(0.3, 0.4))
    assert GROUND.distance(np.array([0.0, -1.5])) == pytest.approx(1.0)


def test_an_area_keeps_the_cells_whose_centres_it_holds() -> None:
    part = GROUND.within(np.array([1.5, 9.0, -9.0, 9.0]))
    assert part is not None
    assert part.contains(np.array([[1.7, -1.7]])).all()
    assert not part.contains(np.array([[1.2, -1.7]])).any()
    assert GROUND.within(np.array([1.5, 2.0, -1.5, -1.0])) is None


@pytest.mark.parametrize(
    "changes",
    [
        {"cell": 0.0},
        {"cell": float("nan")},
        {"corner": np.array([np.inf, 0.0])},
        {"cells": np.zeros((2, 2), dtype=np.bool_)},
        {"cells": np.zeros((0, 3), dtype=np.bool_)},
        {"cells": np.ones(3, dtype=np.bool_)},
    ],
)
def test_ground_that_is_none(changes: dict[str, Any]) -> None:
    with pytest.raises(OptionError):
        FreeGround(**{"corner": np.zeros(2), "cell": 0.1, "cells": CELLS, **changes})
