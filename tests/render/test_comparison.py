"""The costs against plain formulas, and that looking at nothing never wins."""

from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.plane import plane_inverse_depth
from pipelines.lightfield.views import with_depth
from pipelines.render.choices import Blending, Cost, Quality
from pipelines.render.comparison import (
    GRADIENT_LIMIT,
    LARGEST_GAIN,
    NO_TABLE,
    ROBUST_LIMIT,
    UNCOVERED_GRADIENT,
    UNCOVERED_ROBUST,
    UNCOVERED_SQUARED,
    UNCOVERED_ZNCC,
    compare,
    prepared,
    prepared_pixels,
)
from pipelines.render.renderer import Renderer
from tests.lightfield_samples import WALL, looking, photo, photographed, pinhole

# Evidence is of another kind: test_evidence_cost.
COSTS = tuple(cost for cost in Cost if cost is not Cost.EVIDENCE)
every_cost = pytest.mark.parametrize("cost", COSTS)


def packed(image: Float32Array, covered: BoolArray) -> Float32Array:
    """A rendered view as the comparison takes it: RGB, and 1 where covered."""
    return np.concatenate([image, covered[..., None].astype(np.float32)], axis=2)


def cost_of(
    cost: Cost, image: Float32Array, covered: BoolArray, query: Float32Array, fit_gain: bool
) -> float:
    return compare(cost, packed(image, covered), prepared(query), fit_gain, NO_TABLE)


def formula(
    cost: Cost, image: FloatArray, covered: BoolArray, query: FloatArray, gain: float
) -> float:
    """Every cost as its docstring says it."""
    difference = gain * image - query
    if cost is Cost.SQUARED:
        each = (difference**2).mean(axis=2) / 255.0**2
        return float(np.where(covered, each, UNCOVERED_SQUARED).mean())
    if cost is Cost.ROBUST:
        each = np.minimum(np.abs(difference), ROBUST_LIMIT).mean(axis=2) / ROBUST_LIMIT
        return float(np.where(covered, each, UNCOVERED_ROBUST).mean())
    if cost is Cost.ZNCC:
        share = float(covered.mean())
        correlation = np.corrcoef(image[covered].ravel(), query[covered].ravel())[0, 1]
        return float(share * (1.0 - correlation) / 2.0 + (1.0 - share) * UNCOVERED_ZNCC)
    total = []
    for axis in (0, 1):
        both = np.minimum(*(np.take(covered, i, axis) for i in _neighbours(covered, axis)))
        slope = np.minimum(np.abs(np.diff(difference, axis=axis)), GRADIENT_LIMIT).mean(axis=2)
        total.append(np.where(both, slope / GRADIENT_LIMIT, UNCOVERED_GRADIENT).ravel())
    return float(np.concatenate(total).mean())


def _neighbours(array: BoolArray, axis: int) -> tuple[range, range]:
    length = array.shape[axis]
    return range(length - 1), range(1, length)


def random_pair(seed: int, coverage: float = 0.8) -> tuple[Float32Array, BoolArray, Float32Array]:
    generator = np.random.default_rng(seed)
    shape = (11, 17)
    covered = generator.random(shape) < coverage
    image = generator.uniform(0.0, 255.0, (*shape, 3)) * covered[..., None]
    query = 0.6 * image + 0.4 * generator.uniform(0.0, 255.0, (*shape, 3))
    return image.astype(np.float32), covered, query.astype(np.float32)


@every_cost
@pytest.mark.parametrize("coverage", [1.0, 0.8, 0.2])
def test_each_cost_is_its_formula(cost: Cost, coverage: float) -> None:
    for seed in range(5):
        image, covered, query = random_pair(seed, coverage)
        found = cost_of(cost, image, covered, query, False)
        expected = formula(cost, image.astype(float), covered, query.astype(float), 1.0)
        assert found == pytest.approx(expected, rel=1e-5)
        assert 0.0 < found < 1.0


@every_cost
def test_each_cost_with_its_gain_of(cost: Cost) -> None:
    for seed in range(5):
        image, covered, query = random_pair(seed)
        a, b = image[covered].astype(float), query[covered].astype(float)
        gain = float(np.clip((a * b).sum() / (a * a).sum(), 1.0 / LARGEST_GAIN, LARGEST_GAIN))
        # Least squares: no other factor is better.
        least = ((gain * a - b) ** 2).sum()
        assert all(((factor * a - b) ** 2).sum() >= least for factor in (gain - 0.01, gain + 0.01))
        if cost is Cost.ROBUST:
            # Its gain is fitted to the colours that are nearly equal already.
            near = np.abs(a - b) < ROBUST_LIMIT
            assert 0.2 < near.mean() < 0.95
            gain = float((a[near] * b[near]).sum() / (a[near] ** 2).sum())
        found = cost_of(cost, image, covered, query, True)
        expected = formula(cost, image.astype(float), covered, query.astype(float), gain)
        assert found == pytest.approx(expected, rel=1e-5)


@every_cost
def test_a_change_of_exposure_costs_nothing_with_a_gain(cost: Cost) -> None:
    image, covered, _ = random_pair(3, 1.0)
    for factor in (0.7, 1.0, 1.4):
        query = (factor * image).astype(np.float32)
        assert cost_of(cost, image, covered, query, True) == pytest.approx(0.0, abs=1e-6)
    if cost is not Cost.ZNCC:
        query = (0.7 * image).astype(np.float32)
        assert cost_of(cost, image, covered, query, False) > 0.01
        # Three times as bright is no exposure but another place.
        query = (image / 3.0).astype(np.float32)
        assert cost_of(cost, image, covered, query, True) > 0.01


@pytest.mark.parametrize("cost", [Cost.SQUARED, Cost.GRADIENT])
def test_gains_are_limited(cost: Cost) -> None:
    image, covered, _ = random_pair(3, 1.0)
    nothing = np.zeros_like(covered)
    for factor, gain in ((9.0, LARGEST_GAIN), (1.0 / 9.0, 1.0 / LARGEST_GAIN)):
        query = (factor * image).astype(np.float32)
        expected = formula(cost, image.astype(float), covered, query.astype(float), gain)
        assert cost_of(cost, image, covered, query, True) == pytest.approx(expected, rel=1e-5)
    # Where there is nothing to fit, nothing is changed.
    for view, seen in ((np.zeros_like(image), covered), (image, nothing)):
        expected = cost_of(cost, view, seen, image, False)
        assert cost_of(cost, view, seen, image, True) == expected


@every_cost
def test_values_under_uncovered_pixels_do_not_matter(cost: Cost) -> None:
    image, covered, query = random_pair(4, 0.6)
    other = np.where(covered[..., None], image, np.float32(77.0)).astype(np.float32)
    for fit_gain in (False, True):
        expected = cost_of(cost, image, covered, query, fit_gain)
        assert cost_of(cost, other, covered, query, fit_gain) == expected


@every_cost
def test_flat_and_uncovered_images_have_finite_costs(cost: Cost) -> None:
    flat = np.full((6, 5, 3), 99.0, dtype=np.float32)
    query = random_pair(1)[2][:6, :5].copy()
    for covered in (np.ones((6, 5), bool), np.zeros((6, 5), bool), np.eye(6, 5, dtype=bool)):
        for image in (flat, np.zeros_like(flat)):
            for target in (flat, query, np.zeros_like(flat)):
                for fit_gain in (False, True):
                    found = cost_of(cost, image, covered, target, fit_gain)
                    assert 0.0 <= found <= 1.0


@every_cost
@pytest.mark.parametrize("blending", Blending)
def test_looking_at_nothing_never_beats_the_truth(cost: Cost, blending: Blending) -> None:
    poses = [looking([x, -3.0, 1.0], [x, 0.0, 1.0]) for x in (-1.0, 0.0, 1.0)]
    views = photographed(poses, pinhole(64, 48, 40.0), WALL)
    camera = pinhole(40, 30, 25.0)
    true_pose = looking([0.2, -2.5, 1.0], [0.1, 0.0, 1.0])
    query = photo(true_pose, camera)
    poses = [
        true_pose,
        looking([0.2, -2.5, 1.0], [0.1, -9.0, 1.0]),  # looks away
        looking([0.2, 2.5, 1.0], [0.1, 0.0, 1.0]),  # from behind
        looking([30.0, -2.5, 1.0], [30.0, 0.0, 1.0]),  # no photo there
        looking([2.8, -2.5, 1.0], [3.5, 0.0, 1.0]),  # a strip of what photos show
        looking([0.2, -60.0, 1.0], [0.1, 0.0, 1.0]),  # the photos as a speck
    ]
    renderer = Renderer(views, WALL, blending, threads=1)
    for fit_gain in (False, True):
        costs = renderer.costs(np.array(poses), camera, query, cost, fit_gain)
        assert costs[0] < 0.25 * costs[1:].min()
        # The three that see nothing cost what nothing costs.
        np.testing.assert_allclose(costs[1:4], costs[1])
        assert costs[1] == pytest.approx(
            [UNCOVERED_SQUARED, UNCOVERED_ROBUST, UNCOVERED_ZNCC, UNCOVERED_GRADIENT][cost]
        )


def test_nothing_costs_about_as_much_as_a_wrong_view() -> None:
    """Neither a refuge for particles nor a wall around the edge of the map."""
    poses = [looking([x, -3.0, 1.0], [x, 0.0, 1.0]) for x in (-4.0, -2.0, 0.0, 2.0, 4.0)]
    views = photographed(poses, pinhole(64, 48, 30.0), WALL)
    camera = pinhole(40, 30, 25.0)
    query = photo(looking([0.0, -2.5, 1.0], [0.0, 0.0, 1.0]), camera)
    wrong = np.array([looking([x, -2.5, 1.0], [x, 0.0, 1.0]) for x in (-3.5, -1.7, 1.3, 2.1, 3.2)])
    nothing = looking([0.0, 2.0, 1.0], [0.0, 9.0, 1.0])[None]
    for cost in COSTS:
        costs = Renderer(views, WALL, threads=1).costs(
            np.concatenate([wrong, nothing]), camera, query, cost, True
        )
        assert 0.3 < costs[-1] / costs[:-1].mean() < 3.0


def test_threads_and_company_do_not_change_a_cost() -> None:
    generator = np.random.default_rng(1)
    poses = [looking([x, -3.0, 1.0], [x, 0.0, 1.0]) for x in (-1.0, 0.0, 1.0)]
    views = photographed(poses, pinhole(48, 36, 30.0), WALL)
    camera = pinhole(16, 12, 10.0)
    query = photo(poses[1], camera)
    many = np.array(
        [
            looking([x, -2.5, 1.0], [y, 0.0, 1.0])
            for x, y in generator.uniform(-2.0, 2.0, (101, 2)).tolist()
        ]
    )
    alone = Renderer(views, WALL, threads=1)
    for cost in COSTS:
        expected = alone.costs(many, camera, query, cost, True)
        assert len(np.unique(expected)) > 90
        for threads in (2, 5):
            found = Renderer(views, WALL, threads=threads).costs(many, camera, query, cost, True)
            np.testing.assert_array_equal(found, expected)
        one_by_one = [alone.costs(pose[None], camera, query, cost, True)[0] for pose in many[:9]]
        np.testing.assert_array_equal(one_by_one, expected[:9])
        # The cost is that of the rendered view.
        rendering = alone.render(many[5], camera)
        direct = cost_of(
            cost,
            rendering.image.astype(np.float32),
            rendering.covered,
            query.astype(np.float32),
            True,
        )
        assert direct == pytest.approx(expected[5], abs=2e-3)
    assert alone.costs(np.empty((0, 4, 4)), camera, query, Cost.ROBUST, True).shape == (0,)


@every_cost
@pytest.mark.parametrize("blending", Blending)
@pytest.mark.parametrize(
    ("quality", "fit_gain"), [(Quality.PLANE, False), (Quality.PLANE, True), (Quality.MEDIUM, True)]
)
def test_leaving_pixels_out_renders_the_others_as_before(
    cost: Cost, blending: Blending, quality: Quality, fit_gain: bool
) -> None:
    """Whatever is left: a lattice, a few pixels, a corner, one; where views end and where not."""
    generator = np.random.default_rng(3)
    poses = [looking([x, -3.0, 1.0], [x, 0.0, 1.0]) for x in (-1.4, 0.0, 0.6, 1.3)]
    views = photographed(poses, pinhole(48, 36, 60.0), WALL)
    camera = pinhole(31, 22, 17.0)
    pose = looking([0.2, -2.5, 1.0], [0.7, 0.0, 1.2])
    # Rendered first, so that nothing is left in memory of what is wanted.
    elsewhere = looking([-0.9, -1.5, 1.3], [-0.2, 0.0, 0.8])
    walls = [plane_inverse_depth(WALL, own, pinhole(48, 36, 60.0)) for own in poses]
    walls = [wall * generator.uniform(0.9, 1.1, wall.shape) for wall in walls]
    views = with_depth(views, [wall.astype(np.float32) for wall in walls])
    renderer = Renderer(views, WALL, blending, quality, threads=1)
    view = renderer.render_with_surface(pose, camera)
    assert 0.3 < view.covered.mean() < 0.95
    rows, columns = np.indices((camera.height, camera.width))
    kept = [
        (columns + 2 * rows) % 5 == 3,
        generator.uniform(size=rows.shape) < 0.03,
        (rows > 15) & (columns < 12),
        (rows == 21) & (columns == 30),
    ]
    for is_kept in kept:
        query = generator.uniform(0.0, 255.0, (*rows.shape, 3)).astype(np.float32)
        query[~is_kept] = np.nan
        renderer.costs(elsewhere[None], camera, query, cost, fit_gain)
        found = renderer.costs(pose[None], camera, query, cost, fit_gain)[0]
        expected = compare(cost, view.rgba, prepared(query), fit_gain, NO_TABLE)
        assert found == pytest.approx(expected, rel=1e-5)


def test_impossible_requests_are_refused() -> None:
    poses = [looking([0.0, -3.0, 1.0], [0.0, 0.0, 1.0])]
    views = photographed(poses, pinhole(48, 36, 30.0), WALL)
    camera = pinhole(16, 12, 10.0)
    renderer = Renderer(views, WALL, threads=1)
    for shape in ((12, 15, 3), (16, 12, 3), (12, 16), (12, 16, 4), (1, 12, 16, 3)):
        with pytest.raises(OptionError, match="16x12"):
            renderer.costs(np.array(poses), camera, np.zeros(shape, np.uint8), Cost.SQUARED, False)
    for threads in (0, -1):
        with pytest.raises(OptionError, match="threads"):
            Renderer(views, WALL, threads=threads)


@every_cost
@pytest.mark.parametrize("fit_gain", [False, True])
def test_pixels_that_are_not_to_be_compared_do_not_count(cost: Cost, fit_gain: bool) -> None:
    image, covered, query = random_pair(0)
    # Whole columns at the border: what is left is an image of its own.
    query[:, 12:] = np.nan
    own, seen = np.ascontiguousarray(image[:, :12]), np.ascontiguousarray(covered[:, :12])
    wanted = np.ascontiguousarray(query[:, :12])
    expected = cost_of(cost, own, seen, wanted, fit_gain)
    assert cost_of(cost, image, covered, query, fit_gain) == pytest.approx(expected, rel=1e-6)


@every_cost
def test_where_nothing_is_to_be_compared_the_cost_is_finite(cost: Cost) -> None:
    image, covered, query = random_pair(1)
    query[:] = np.nan
    assert 0.0 <= cost_of(cost, image, covered, query, True) <= 1.0


def test_what_stands_in_front_does_not_change_the_robust_costs_gain() -> None:
    image, covered, _ = random_pair(2, 1.0)
    query = (0.9 * image).astype(np.float32)
    query[:, :6] = 250.0
    costs = [
        formula(Cost.ROBUST, image.astype(float), covered, query.astype(float), gain)
        for gain in (0.84, 0.96)
    ]
    # Of the colours in front, a few happen to be nearly equal: the gain is about 0.9.
    assert cost_of(Cost.ROBUST, image, covered, query, True) < min(costs)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_pixels_that_are_compared_are_prepared_as_the_whole_image_is(dtype: type) -> None:
    generator = np.random.default_rng(4)
    query: Any = generator.integers(0, 256, (7, 9, 3)).astype(dtype)
    if dtype is np.float32:
        query[generator.uniform(size=query.shape) < 0.2] = np.nan
    whole = prepared(query).reshape(-1, 4)
    chosen, pixels = prepared_pixels(query)
    np.testing.assert_array_equal(chosen, np.flatnonzero(whole[:, 3]))
    np.testing.assert_array_equal(pixels[0], whole[chosen])
    assert (len(chosen) < len(whole)) == (dtype is np.float32)
