"""Which points a depth map hides, sixteen at a time, against a look at each of them."""

import numpy as np
import pytest

from pipelines.artifacts.array_types import Float32Array, IntArray
from pipelines.lightfield.blending import OCCLUSION_FACTOR
from pipelines.lightfield.compiled import compiled
from pipelines.lightfield.occlusion_kernels import (
    EVERY_LANE,
    hidden_lanes,
    is_occluded,
)
from pipelines.lightfield.vector_code import LANES
from pipelines.lightfield.views import ViewArrays, with_depth
from tests.lightfield_samples import looking, noise_views

SIZES = ((37, 29), (8, 8), (1, 5), (64, 1), (300, 200), (256, 136))


def arrays_with_depth(generator: np.random.Generator) -> ViewArrays:
    """Photos with depth maps of several sizes, much of them near and far by turns."""
    poses = [looking([x, -3.0, 1.0], [x, 0.0, 1.0]) for x in range(len(SIZES))]
    depths = []
    for width, height in SIZES:
        depth = generator.uniform(0.1, 2.0, (height, width))
        # Far away in places, in large maps as large as many blocks.
        side = 24 if min(width, height) > 100 else 1
        far = generator.uniform(size=(-(-height // side), -(-width // side))) < 0.5
        depth[np.kron(far, np.ones((side, side), np.bool_))[:height, :width]] = 0.01
        depths.append(depth.astype(np.float32))
    return with_depth(noise_views(poses, generator), depths).arrays


@compiled
def hidden_among(
    lanes: int, views: ViewArrays, view: int, scratch: Float32Array, level: int, result: IntArray
) -> None:
    """Calls ``hidden_lanes`` with the points of the scratch."""
    places = (np.uintp(0), np.uintp(LANES), np.uintp(2 * LANES))
    result[0] = hidden_lanes(lanes, views, view, level, scratch, places)


@pytest.mark.parametrize("view", range(len(SIZES)))
@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize("seed", range(5))
def test_lanes_are_hidden_where_the_map_has_something_nearer(
    view: int, level: int, seed: int
) -> None:
    generator = np.random.default_rng([seed, view])
    views = arrays_with_depth(generator)
    width, height = views.level_size[view, 0]
    # Middles of pixels are half of one from their corners, on each level.
    scale = (views.level_size[view, level] / views.level_size[view, 0]).astype(np.float32)
    shown, hidden = 0, 0
    for _ in range(20):
        column = generator.uniform(-0.5, width - 0.5, LANES).astype(np.float32)
        row = generator.uniform(-0.5, height - 0.5, LANES).astype(np.float32)
        own = generator.uniform(0.2, 2.5, LANES).astype(np.float32)
        wanted = int(generator.integers(0, EVERY_LANE, endpoint=True))
        result = np.zeros(1, np.int64)
        x, y = (column + 0.5) * scale[0] - 0.5, (row + 0.5) * scale[1] - 0.5
        scratch = np.concatenate([x, y, own]).astype(np.float32)
        hidden_among(wanted, views, view, scratch, level, result)
        for lane in range(LANES):
            place = float(column[lane]), float(row[lane])
            expected = is_occluded(views, view, *place, float(own[lane]))
            is_wanted = bool(wanted >> lane & 1)
            assert bool(result[0] >> lane & 1) == (is_wanted and expected)
            shown += is_wanted and not expected
            hidden += is_wanted and expected
        assert result[0] <= EVERY_LANE
    assert hidden > 5
    assert shown > 5


def test_what_lies_outside_is_taken_to_the_border() -> None:
    """Places that are no numbers, or far outside, are looked up on the border of the map."""
    generator = np.random.default_rng(0)
    views = arrays_with_depth(generator)
    strange = np.array([np.inf, -np.inf, 1e30, -1e30, -7.0, 1e6, np.nan, -0.5], np.float32)
    column, row = np.repeat(strange, 2), np.tile(strange, 2)
    for view, (width, height) in enumerate(SIZES):
        start = views.depth_start[view]
        depth = views.inverse_depth[start : start + width * height].reshape(height, width)
        for _ in range(20):
            row = generator.permutation(row)
            own = generator.uniform(0.2, 2.5, LANES).astype(np.float32)
            result = np.zeros(1, np.int64)
            hidden_among(EVERY_LANE, views, view, np.concatenate([column, row, own]), 0, result)
            # What is no number goes to the last.
            x, y = (np.where(np.isnan(v) | (v > 0.0), -1, 0) for v in (column, row))
            expected = depth[y, x] > OCCLUSION_FACTOR * own
            np.testing.assert_array_equal(
                [result[0] >> lane & 1 for lane in range(LANES)], expected
            )
