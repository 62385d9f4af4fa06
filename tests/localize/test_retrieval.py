"""Image retrieval: scores against their formula, and that the true place is among the best."""

import numpy as np
import pytest
from scipy.stats import qmc

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray
from pipelines.geometry.pose import inverse, world_from_base_planar
from pipelines.localize.belief import region_of_area
from pipelines.localize.observation import Observation, Observer
from pipelines.localize.retrieval import (
    DISTINCT_ANGLE,
    DISTINCT_POSITION,
    FAINT,
    TILES_ACROSS,
    TILES_DOWN,
    RetrievalIndex,
    best_distinct,
    build_index,
    spread_states,
    states_around_views,
)
from pipelines.localize.state_space import PLANAR, SPATIAL
from pipelines.render.channels import ZERO, views_in_channels
from pipelines.render.choices import Channels
from pipelines.render.renderer import Renderer
from tests.report_samples import CAMERA, MOUNT, facing_wall, photo, wall_scene

SCENE = wall_scene()
REGION = region_of_area(SCENE.bounds)
OBSERVER = Observer(CAMERA, [16])
COLOURS = OBSERVER(photo(facing_wall(-0.4, 1.7, 0.15))).by_width[16]
OBSERVATION = COLOURS.in_channels(Channels.CONTRAST)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    colours = Renderer.of_scene(SCENE, 48, threads=1)
    return Renderer(views_in_channels(colours.views, Channels.CONTRAST), colours.plane, threads=1)


@pytest.fixture(scope="module")
def index(renderer: Renderer) -> RetrievalIndex:
    states = spread_states(PLANAR, REGION, 3000)
    return build_index(renderer, PLANAR, MOUNT, OBSERVATION.intrinsics, states)


def score_by_hand(image: Float32Array, covered: BoolArray, query: Float32Array) -> float:
    """Tile by tile: the correlation, weighted by how much the query shows there."""
    height, width = covered.shape
    rows = np.arange(height) * TILES_DOWN // height
    columns = np.arange(width) * TILES_ACROSS // width
    total = 0.0
    for row in range(TILES_DOWN):
        for column in range(TILES_ACROSS):
            tile = np.ix_(rows == row, columns == column)
            known = np.isfinite(query[tile]).all(axis=2)
            if not known.any():
                continue
            own = np.where(covered[tile][..., None], image[tile].astype(float) - ZERO, 0.0)[known]
            taken = query[tile].astype(float)[known] - ZERO
            floor = 3.0 * FAINT**2 * known.sum()
            energy = (taken**2).sum()
            total += energy * (own * taken).sum() / np.sqrt((own**2).sum() * energy + floor**2)
    return total


def test_scores_are_their_formula_tile_by_tile(renderer: Renderer, index: RetrievalIndex) -> None:
    chosen = index.states[::29]
    images, covered = renderer.render_many(PLANAR.poses(chosen) @ MOUNT, OBSERVATION.intrinsics)
    coverage = covered.mean(axis=(1, 2))
    # Views of everything, of nothing, and of both are among them.
    assert np.any(coverage == 1.0)
    assert np.any(coverage == 0.0)
    assert np.any((coverage > 0.2) & (coverage < 0.8))
    gaps = OBSERVATION.image.copy()
    gaps[np.random.default_rng(0).uniform(size=gaps.shape[:2]) < 0.3] = np.nan
    gaps[:4, :4] = np.nan
    for query in (OBSERVATION.image, gaps):
        expected = [
            score_by_hand(image, seen, query) for image, seen in zip(images, covered, strict=True)
        ]
        found = index.scores(Observation(query, OBSERVATION.intrinsics))[::29]
        scale = float(np.nansum((query - ZERO) ** 2))
        # Sums of squares in single precision.
        np.testing.assert_allclose(found, expected, atol=2e-5 * scale)


def test_views_of_nothing_score_nothing(renderer: Renderer, index: RetrievalIndex) -> None:
    poses = PLANAR.poses(index.states) @ MOUNT
    _, covered = renderer.render_many(poses, OBSERVATION.intrinsics)
    empty = ~covered.any(axis=(1, 2))
    assert empty.sum() > 100
    np.testing.assert_array_equal(index.scores(OBSERVATION)[empty], 0.0)
    # Nor does an image that shows nothing prefer any place.
    nothing = np.full_like(OBSERVATION.image, ZERO)
    np.testing.assert_array_equal(index.scores(Observation(nothing, OBSERVATION.intrinsics)), 0.0)
    hidden = np.full_like(OBSERVATION.image, np.nan)
    np.testing.assert_array_equal(index.scores(Observation(hidden, OBSERVATION.intrinsics)), 0.0)


def test_uncovered_tiles_add_nothing(renderer: Renderer) -> None:
    states = np.array([facing_wall(x, 1.7, 0.15) for x in (-2.9, -2.5, 2.4, 2.8)])
    found = build_index(renderer, PLANAR, MOUNT, OBSERVATION.intrinsics, states)
    _, covered = renderer.render_many(PLANAR.poses(states) @ MOUNT, OBSERVATION.intrinsics)
    assert np.all(covered.mean(axis=(1, 2)) < 1.0)
    scores = found.scores(OBSERVATION)
    # What an image shows where a view is empty does not matter.
    for number, seen in enumerate(covered):
        other = OBSERVATION.image.copy()
        height, width = seen.shape
        rows = np.arange(height) * TILES_DOWN // height
        columns = np.arange(width) * TILES_ACROSS // width
        for row in range(TILES_DOWN):
            for column in range(TILES_ACROSS):
                tile = np.ix_(rows == row, columns == column)
                if not seen[tile].any():
                    other[tile] = 255.0 - other[tile]
        assert not np.array_equal(other, OBSERVATION.image)
        again = found.scores(Observation(other, OBSERVATION.intrinsics))
        assert again[number] == pytest.approx(scores[number], abs=1e-2)


def test_another_exposure_changes_no_order(index: RetrievalIndex) -> None:
    plain = index.scores(OBSERVATION)
    for gain, offset in ((0.6, 0.0), (0.7, 30.0), (1.0, -40.0)):
        lit = Observation((gain * COLOURS.image + offset).astype(np.float32), COLOURS.intrinsics)
        scores = index.scores(lit.in_channels(Channels.CONTRAST))
        assert np.corrcoef(plain, scores)[0, 1] > 0.998
        best = np.argsort(-plain)[:20]
        assert len(set(best) & set(np.argsort(-scores)[:20])) >= 17
        assert int(np.argmax(scores)) in best[:3]


def test_pixels_that_do_not_show_the_scene_do_not_count(index: RetrievalIndex) -> None:
    height, width = COLOURS.image.shape[:2]
    tile = (slice(0, height // TILES_DOWN), slice(0, width // TILES_ACROSS))
    hidden = COLOURS.image.copy()
    hidden[tile] = np.nan
    masked = Observation(hidden, COLOURS.intrinsics).in_channels(Channels.CONTRAST)
    plain, found = index.scores(OBSERVATION), index.scores(masked)
    assert np.all(np.isfinite(found))
    assert np.corrcoef(plain, found)[0, 1] > 0.9
    assert int(np.argmax(found)) in np.argsort(-plain)[:20]


def test_the_true_place_is_among_the_best(index: RetrievalIndex) -> None:
    rng = np.random.default_rng(0)
    for _ in range(6):
        truth = facing_wall(rng.uniform(-1.0, 1.0), rng.uniform(1.3, 2.0), rng.uniform(-0.3, 0.3))
        observation = OBSERVER(photo(truth)).by_width[16].in_channels(Channels.CONTRAST)
        best = best_distinct(PLANAR, index.states, index.scores(observation), 10)
        offsets = PLANAR.difference(index.states[best], truth)
        near = (np.hypot(*offsets[:, :2].T) < 0.5) & (np.abs(offsets[:, 2]) < 0.25)
        assert near.any()


def by_hand(states: FloatArray, scores: FloatArray, count: int) -> list[int]:
    """One after the other, each compared with all that were chosen."""
    chosen: list[int] = []
    for index in np.argsort(-scores, kind="stable"):
        near = [
            np.hypot(*(states[index] - states[other])[:2]) <= DISTINCT_POSITION
            and abs(PLANAR.difference(states[index], states[other])[2]) <= DISTINCT_ANGLE
            for other in chosen
        ]
        if not any(near):
            chosen.append(int(index))
    return chosen[:count]


@pytest.mark.parametrize("seed", range(5))
def test_the_best_are_distinct_and_best_first(seed: int) -> None:
    rng = np.random.default_rng(seed)
    states = PLANAR.uniform(np.zeros(2), np.array([1.5, 1.5]), 300, rng)
    scores = rng.random(300)
    for count in (1, 7, 1000):
        found = best_distinct(PLANAR, states, scores, count)
        assert found.tolist() == by_hand(states, scores, count)


def test_equal_states_are_one() -> None:
    states = np.tile([1.0, 2.0, 0.5], (20, 1))
    assert best_distinct(PLANAR, states, -np.arange(20.0), 5).tolist() == [0]


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
