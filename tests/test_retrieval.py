"""Thumbnails: their costs against the renderer's, and that the true place is among the best."""

import numpy as np
import pytest
from scipy.stats import qmc

from pipelines.artifacts.array_types import BoolArray, Float32Array, FloatArray
from pipelines.geometry.pose import inverse, world_from_base_planar
from pipelines.lightfield.comparison import Cost, compare, prepared
from pipelines.lightfield.compiled import compiled
from pipelines.lightfield.renderer import Renderer
from pipelines.localize.appearance import (
    DISTINCT_ANGLE,
    DISTINCT_POSITION,
    TILES_ACROSS,
    TILES_DOWN,
    WORST_TILE,
    AppearanceIndex,
    best_distinct,
    build_index,
    spread_states,
    states_around_views,
)
from pipelines.localize.belief import region_of_area
from pipelines.localize.observation import Observation, Observer
from pipelines.localize.state_space import PLANAR, SPATIAL
from tests.report_samples import CAMERA, MOUNT, facing_wall, photo, wall_scene

compiled_compare = compiled(compare)
SCENE = wall_scene()
REGION = region_of_area(SCENE.bounds)
OBSERVER = Observer(CAMERA, [16])
OBSERVATION = OBSERVER(photo(facing_wall(-0.4, 1.7, 0.15))).by_width[16]


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer.of_scene(SCENE, 48, threads=1)


@pytest.fixture(scope="module")
def index(renderer: Renderer) -> AppearanceIndex:
    states = spread_states(PLANAR, REGION, 3000)
    return build_index(renderer, PLANAR, MOUNT, OBSERVATION.intrinsics, states)


def tile_costs(image: Float32Array, covered: BoolArray, query: Float32Array) -> FloatArray:
    """The renderer's comparison, tile by tile."""
    height, width = covered.shape
    rows, columns = (
        np.arange(height) * TILES_DOWN // height,
        np.arange(width) * TILES_ACROSS // width,
    )
    found = []
    for row in range(TILES_DOWN):
        for column in range(TILES_ACROSS):
            tile = np.ix_(rows == row, columns == column)
            seen = covered[tile][..., None].astype(np.float32)
            own = np.concatenate([image[tile], seen], axis=2)
            found.append(compiled_compare(int(Cost.SQUARED), own, prepared(query[tile]), True))
    return np.array(found)


def test_costs_are_the_renderers_tile_by_tile(renderer: Renderer, index: AppearanceIndex) -> None:
    chosen = index.states[::7]
    images, covered = renderer.render_many(PLANAR.poses(chosen) @ MOUNT, OBSERVATION.intrinsics)
    query = OBSERVATION.image.astype(np.float32)
    expected = [
        np.minimum(tile_costs(image, seen, query), WORST_TILE).mean()
        for image, seen in zip(images, covered, strict=True)
    ]
    coverage = covered.mean(axis=(1, 2))
    # Views of everything, of nothing, and of both are among them.
    assert np.any(coverage == 1.0)
    assert np.any(coverage == 0.0)
    assert np.any((coverage > 0.2) & (coverage < 0.8))
    # Sums of squares in single precision.
    np.testing.assert_allclose(index.costs(OBSERVATION)[::7], expected, atol=2e-5)


def test_pixels_that_do_not_show_the_scene_do_not_count(index: AppearanceIndex) -> None:
    height, width = OBSERVATION.image.shape[:2]
    tile = (slice(0, height // TILES_DOWN), slice(0, width // TILES_ACROSS))
    spoilt, hidden = OBSERVATION.image.copy(), OBSERVATION.image.astype(np.float32)
    spoilt[tile] = 0.0
    hidden[tile] = np.nan
    plain = index.costs(OBSERVATION)
    masked = index.costs(Observation(hidden, OBSERVATION.intrinsics))
    dirty = index.costs(Observation(spoilt, OBSERVATION.intrinsics))
    best = int(np.argmin(plain))
    assert dirty[best] > 2.0 * plain[best]
    # The mean over the other tiles, all of one size.
    tiles = TILES_ACROSS * TILES_DOWN
    assert masked[best] < 1.5 * plain[best] * tiles / (tiles - 1)
    assert np.all(np.isfinite(masked))


def test_the_true_place_is_among_the_best(index: AppearanceIndex) -> None:
    rng = np.random.default_rng(0)
    for _ in range(6):
        truth = facing_wall(rng.uniform(-1.0, 1.0), rng.uniform(1.3, 2.0), rng.uniform(-0.3, 0.3))
        observation = OBSERVER(photo(truth)).by_width[16]
        best = best_distinct(PLANAR, index.states, index.costs(observation), 10)
        offsets = PLANAR.difference(index.states[best], truth)
        near = (np.hypot(*offsets[:, :2].T) < 0.5) & (np.abs(offsets[:, 2]) < 0.25)
        assert near.any()


def by_hand(states: FloatArray, costs: FloatArray, count: int) -> list[int]:
    """One after the other, each compared with all that were chosen."""
    chosen: list[int] = []
    for index in np.argsort(costs, kind="stable"):
        near = [
            np.hypot(*(states[index] - states[other])[:2]) <= DISTINCT_POSITION
            and abs(PLANAR.difference(states[index], states[other])[2]) <= DISTINCT_ANGLE
            for other in chosen
        ]
        if not any(near):
            chosen.append(int(index))
    return chosen[:count]


@pytest.mark.parametrize("seed", range(5))
def test_the_best_are_distinct_and_cheapest_first(seed: int) -> None:
    rng = np.random.default_rng(seed)
    states = PLANAR.uniform(np.zeros(2), np.array([1.5, 1.5]), 300, rng)
    costs = rng.random(300)
    for count in (1, 7, 1000):
        found = best_distinct(PLANAR, states, costs, count)
        assert found.tolist() == by_hand(states, costs, count)


def test_equal_states_are_one() -> None:
    states = np.tile([1.0, 2.0, 0.5], (20, 1))
    assert best_distinct(PLANAR, states, np.arange(20.0), 5).tolist() == [0]


def test_spread_states_fill_the_region_evenly() -> None:
    states = spread_states(PLANAR, REGION, 4096)
    assert REGION.contains(states).all()
    low, high = np.append(REGION.low, -np.pi), np.append(REGION.high, np.pi)
    cells = np.floor((states - low) / (high - low) * 8).astype(int).clip(0, 7)
    counts = np.bincount(np.ravel_multi_index(tuple(cells.T), (8, 8, 8)), minlength=512)
    # Random numbers would leave a cell with 8 +- 2.8, and a few with none.
    assert counts.min() >= 4
    assert counts.max() <= 13
    # The same every time, and the sequence that scipy knows.
    places = qmc.Halton(3, scramble=False).random(4096)
    there = PLANAR.moved(low + places * (high - low), np.zeros(3))
    np.testing.assert_array_equal(states, there)


def test_hypotheses_of_a_camera_in_the_hand_are_the_views_and_around_them() -> None:
    views = world_from_base_planar(np.array([facing_wall(x, 2.0) for x in (-1.0, 1.0)])) @ MOUNT
    rng = np.random.default_rng(3)
    states = states_around_views(SPATIAL, views, MOUNT, 2000, rng)
    assert len(states) == 2000
    own = SPATIAL.states(views @ inverse(MOUNT))
    np.testing.assert_allclose(states[:2], own, atol=1e-12)
    around = states[2:].reshape(2, -1, 6)
    for mean, cluster in zip(own, around, strict=True):
        deviation = SPATIAL.difference(cluster, mean)
        sigmas = deviation.std(axis=0)
        assert np.all(np.abs(deviation.mean(axis=0)) < 5.0 * sigmas / np.sqrt(len(cluster)))
        np.testing.assert_allclose(sigmas[:3], sigmas[0], rtol=0.1)
        np.testing.assert_allclose(sigmas[3:], sigmas[3], rtol=0.1)
    # Fewer wanted than there are views: the views themselves.
    assert len(states_around_views(SPATIAL, views, MOUNT, 1, rng)) == 2
