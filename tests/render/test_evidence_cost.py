"""The cost EVIDENCE against a plain lookup in images of the readable renderer."""

import zlib
from collections.abc import Callable

import numpy as np
import pytest

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.render.choices import Blending, Cost, Quality
from pipelines.render.comparison import (
    EVIDENCE_BIN,
    EVIDENCE_BINS,
    EVIDENCE_ROWS,
    PixelEvidence,
    compare,
    evidence_table,
    pixel_strength,
    prepared,
)
from pipelines.render.reference import render_reference
from pipelines.render.renderer import Renderer
from tests.lightfield_samples import WALL, looking, noise_views, pinhole
from tests.render.test_renderers_agree import (
    ARRANGEMENTS,
    RESOLUTIONS,
    LightField,
    general,
    grazing,
    many,
    one_view,
    with_depth,
)


def random_evidence(generator: np.random.Generator) -> PixelEvidence:
    """Any table: no entry is like another, so that whoever reads a wrong one is found out."""
    edges = np.sort(generator.uniform(20.0, 350.0, EVIDENCE_ROWS - 1))
    table = generator.normal(0.0, 2.0, (EVIDENCE_ROWS, EVIDENCE_BINS))
    expected = generator.uniform(0.0, 2.0, EVIDENCE_ROWS)
    return PixelEvidence(
        edges.astype(np.float32), table.astype(np.float32), expected.astype(np.float32)
    )


def by_hand(
    image: FloatArray, covered: BoolArray, query: FloatArray, evidence: PixelEvidence
) -> float:
    """Minus the sum over pixels, one after the other."""
    total = 0.0
    for row, column in np.ndindex(*covered.shape):
        taken, rendered = query[row, column], image[row, column]
        if not covered[row, column] or np.isnan(taken).any():
            continue
        difference = float(np.abs(rendered - taken).sum())
        strength = float(np.abs(taken - 128.0).sum())
        own = sum(strength >= edge for edge in evidence.edges)
        total += float(evidence.table[own, min(int(difference // EVIDENCE_BIN), EVIDENCE_BINS - 1)])
    return -total


def slack(
    image: FloatArray, covered: BoolArray, query: FloatArray, evidence: PixelEvidence
) -> float:
    """By how much a cost may be off where rounding decides between two bins."""
    bins = np.abs(image - query).sum(axis=2) / EVIDENCE_BIN
    border = np.rint(bins)
    decides = covered & (np.abs(bins - border) < 0.02) & (border >= 1) & (border < EVIDENCE_BINS)
    steps = np.abs(np.diff(evidence.table, axis=1)).max(axis=0)
    return float(steps[border[decides].astype(int) - 1].sum()) + 1e-3


def packed(image: Float32Array, covered: BoolArray) -> Float32Array:
    return np.concatenate([image, covered[..., None].astype(np.float32)], axis=2)


def compared(
    image: Float32Array, covered: BoolArray, query: Float32Array, evidence: PixelEvidence
) -> float:
    """The comparison by itself."""
    target = prepared(query)
    target[..., 3] *= 1.0 + evidence.rows(target[..., :3])
    table = evidence_table(Cost.EVIDENCE, evidence)
    return compare(Cost.EVIDENCE, packed(image, covered), target, False, table)


@pytest.mark.parametrize("seed", range(6))
def test_it_is_the_sum_of_what_the_table_says(seed: int) -> None:
    generator = np.random.default_rng(seed)
    evidence = random_evidence(generator)
    covered = generator.uniform(size=(9, 13)) < 0.7
    image = generator.integers(0, 256, (9, 13, 3)).astype(np.float32) * covered[..., None]
    query = np.clip(image + generator.integers(-90, 90, image.shape), 0, 255).astype(np.float32)
    query[generator.uniform(size=covered.shape) < 0.2] = np.nan
    # Whole numbers: no rounding anywhere.
    expected = by_hand(image.astype(float), covered, query.astype(float), evidence)
    assert compared(image, covered, query, evidence) == pytest.approx(expected, abs=1e-5)


def test_uncovered_and_hidden_pixels_add_exactly_nothing() -> None:
    generator = np.random.default_rng(0)
    evidence = random_evidence(generator)
    image = generator.integers(0, 256, (9, 13, 3)).astype(np.float32)
    query = generator.integers(0, 256, (9, 13, 3)).astype(np.float32)
    nothing = np.zeros((9, 13), dtype=np.bool_)
    assert compared(image, nothing, query, evidence) == 0.0
    assert compared(image, ~nothing, np.full_like(query, np.nan), evidence) == 0.0
    # One pixel says what it says, wherever it is.
    for row, column in ((0, 0), (4, 7), (8, 12)):
        only = nothing.copy()
        only[row, column] = True
        expected = by_hand(image.astype(float), only, query.astype(float), evidence)
        assert compared(image, only, query, evidence) == pytest.approx(expected, abs=1e-6)
        alone = np.where(only[..., None], query, np.float32(np.nan))
        assert compared(image, ~nothing, alone, evidence) == pytest.approx(expected, abs=1e-6)


def test_rows_are_found_by_strength() -> None:
    edges = np.arange(10.0, 10.0 * EVIDENCE_ROWS, 10.0, dtype=np.float32)
    table = np.zeros((EVIDENCE_ROWS, EVIDENCE_BINS), np.float32)
    evidence = PixelEvidence(edges, table, np.zeros(EVIDENCE_ROWS, np.float32))
    pixels = np.array(
        [[128, 128, 128], [128, 137, 128], [118, 128, 128], [123, 133, 128], [0, 255, 0]]
    ).astype(np.float32)
    np.testing.assert_array_equal(pixel_strength(pixels), [0.0, 9.0, 10.0, 10.0, 383.0])
    np.testing.assert_array_equal(evidence.rows(pixels), [0, 0, 1, 1, EVIDENCE_ROWS - 1])


# --- rendered ----------------------------------------------------------------------------------


def assert_agree(
    light_field: LightField, generator: np.random.Generator, blending: Blending, quality: Quality
) -> float:
    """The fast path's cost is that of the readable renderer's image; returns the coverage."""
    views, plane, pose = light_field
    camera = RESOLUTIONS[int(generator.integers(len(RESOLUTIONS)))]
    image, covered = render_reference(views, plane, pose, camera, blending, quality)
    noisy = np.clip(image + generator.normal(0.0, 25.0, image.shape), 0.0, 255.0)
    query: Float32Array = noisy.astype(np.float32)
    query[generator.uniform(size=covered.shape) < 0.15] = np.nan
    evidence = random_evidence(generator)
    renderer = Renderer(views, plane, blending, quality, threads=1)
    found = renderer.costs(pose[None], camera, query, Cost.EVIDENCE, False, evidence)[0]
    expected = by_hand(image, covered, query.astype(float), evidence)
    assert abs(found - expected) <= slack(image, covered, query.astype(float), evidence)
    # The same number from what the fast renderer itself shows, to the last bit but rounding.
    own, seen = renderer.render_many(pose[None], camera)
    direct = compared(own[0], seen[0], query, evidence)
    assert found == pytest.approx(direct, abs=1e-4)
    return float(covered.mean())


@pytest.mark.parametrize("blending", Blending)
@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_random_scenes(
    arrangement: Callable[[np.random.Generator], LightField], blending: Blending
) -> None:
    coverage = []
    for number in range(3):
        generator = np.random.default_rng([zlib.crc32(arrangement.__name__.encode()), number])
        light_field = arrangement(generator)
        coverage.append(assert_agree(light_field, generator, blending, Quality.PLANE))
    assert max(coverage) > 0.2


@pytest.mark.parametrize("quality", [Quality.FINE, Quality.MEDIUM, Quality.COARSE])
@pytest.mark.parametrize("blending", Blending)
def test_random_scenes_with_depth(blending: Blending, quality: Quality) -> None:
    for number, arrangement in enumerate((general, many, one_view)):
        generator = np.random.default_rng([19, number])
        views, plane, pose = arrangement(generator)
        views = with_depth(views, generator, (1.0, 0.7, 0.2)[number])
        assert_agree((views, plane, pose), generator, blending, quality)


def test_looking_at_nothing_costs_nothing() -> None:
    generator = np.random.default_rng(2)
    poses = [looking([x, -3.0, 1.0], [x, 0.0, 1.0]) for x in (-1.0, 1.0)]
    views, camera = noise_views(poses, generator), pinhole(24, 18, 20.0)
    away = np.array([looking([0.2, -2.5, 1.0], [0.1, -9.0, 1.0])])
    query = generator.uniform(0.0, 255.0, (18, 24, 3)).astype(np.float32)
    for blending in Blending:
        renderer = Renderer(views, WALL, blending, threads=1)
        evidence = random_evidence(generator)
        np.testing.assert_array_equal(
            renderer.costs(away, camera, query, Cost.EVIDENCE, False, evidence), 0.0
        )


def some_work() -> tuple[Renderer, FloatArray, Float32Array, PixelEvidence]:
    generator = np.random.default_rng(3)
    views, plane, pose = many(generator)
    poses = np.repeat(pose[None], 60, axis=0)
    poses[1:, :3, 3] += generator.normal(0.0, 0.2, (59, 3))
    renderer = Renderer(views, plane, threads=1)
    query = renderer.render_many(pose[None], RESOLUTIONS[0])[0][0]
    query = query + generator.normal(0.0, 20.0, query.shape).astype(np.float32)
    query = np.clip(query, 0.0, 255.0).astype(np.float32)
    query[generator.uniform(size=query.shape[:2]) < 0.1] = np.nan
    return renderer, poses, query, random_evidence(generator)


def test_threads_and_company_do_not_change_a_cost() -> None:
    renderer, poses, query, evidence = some_work()
    expected = renderer.costs(poses, RESOLUTIONS[0], query, Cost.EVIDENCE, False, evidence)
    assert len(np.unique(expected)) == len(poses)
    several = Renderer(renderer.views, renderer.plane, threads=3)
    found = several.costs(poses, RESOLUTIONS[0], query, Cost.EVIDENCE, False, evidence)
    np.testing.assert_array_equal(found, expected)
    for index in (0, 17, 59):
        alone = poses[index][None]
        own = renderer.costs(alone, RESOLUTIONS[0], query, Cost.EVIDENCE, False, evidence)
        assert own[0] == expected[index]


def test_one_pixel_in_five_says_a_fifth_on_average() -> None:
    """Over all shifts of the pattern each pixel is compared once: the parts add up to the whole."""
    renderer, poses, query, evidence = some_work()
    camera = RESOLUTIONS[0]
    whole = renderer.costs(poses, camera, query, Cost.EVIDENCE, False, evidence)
    for step in (2, 3, 5):
        parts = np.zeros(len(poses))
        rows, columns = np.indices(query.shape[:2])
        for number in range(step):
            kept = (columns + rows) % step == number
            part = np.where(kept[..., None], query, np.float32(np.nan))
            parts += renderer.costs(poses, camera, part, Cost.EVIDENCE, False, evidence)
        np.testing.assert_allclose(parts, whole, atol=1e-3)


def test_the_caller_keeps_its_arrays() -> None:
    renderer, poses, query, evidence = some_work()
    copies = [poses.copy(), query.copy(), evidence.table.copy(), evidence.edges.copy()]
    renderer.costs(poses, RESOLUTIONS[0], query, Cost.EVIDENCE, False, evidence)
    for array, copy in zip((poses, query, evidence.table, evidence.edges), copies, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_a_table_goes_with_evidence_and_with_no_other_cost() -> None:
    renderer, poses, query, evidence = some_work()
    with pytest.raises(OptionError, match="takes a table of evidence"):
        renderer.costs(poses, RESOLUTIONS[0], query, Cost.EVIDENCE, False)
    for cost in Cost:
        if cost is not Cost.EVIDENCE:
            with pytest.raises(OptionError, match="takes a table of evidence"):
                renderer.costs(poses, RESOLUTIONS[0], query, cost, False, evidence)


def test_a_view_of_the_edge_says_what_its_covered_part_says() -> None:
    """No wall around the map, and no refuge beside it."""
    generator = np.random.default_rng(4)
    views, plane, pose = grazing(generator)
    camera = RESOLUTIONS[1]
    renderer, evidence = Renderer(views, plane, threads=1), random_evidence(generator)
    image, covered = renderer.render_many(pose[None], camera)
    assert 0.05 < covered.mean() < 0.95
    query = generator.uniform(0.0, 255.0, image[0].shape).astype(np.float32)
    hidden = np.where(covered[0][..., None], query, np.float32(np.nan))
    whole, part = (
        renderer.costs(pose[None], camera, each, Cost.EVIDENCE, False, evidence)[0]
        for each in (query, hidden)
    )
    assert whole == pytest.approx(part, abs=1e-4)
