"""Samples of depth maps that are kept: the same as fresh ones, and not too many."""

import numpy as np
import pytest

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.lightfield.views import Views, build_views
from pipelines.render import sample_store
from pipelines.render.choices import Quality
from pipelines.render.depth_samples import BATCH, BATCHES, joined_samples, take_samples
from pipelines.render.renderer import Renderer
from pipelines.render.sample_store import SampleStore
from tests.lightfield_samples import WALL, looking, noise_views, pinhole

CAMERA = pinhole(24, 18, 20.0)
FOCAL, SPACING = 20.0, 3.0


def views_with_depth() -> Views:
    """Six photos with depth maps of different sizes, gaps in them."""
    generator = np.random.default_rng(0)
    poses = [looking([x, -3.0, 1.0], [x, 0.0, 1.0]) for x in np.linspace(-2.0, 2.0, 6)]
    plain = noise_views(poses, generator)
    depths = []
    for number in range(len(plain)):
        shape = (20 + 7 * number, 30 + 5 * number)
        known = generator.uniform(size=shape) > 0.2
        depths.append((known / generator.uniform(2.8, 3.2, shape)).astype(np.float32))
    images = [plain.level(number, 0) for number in range(len(plain))]
    return build_views(images, plain.intrinsics, np.stack(poses), depths)


VIEWS = views_with_depth()


def marked(*views: int) -> BoolArray:
    """Which of the six views."""
    result = np.zeros(len(VIEWS), np.bool_)
    result[list(views)] = True
    return result


def store() -> SampleStore[tuple[BoolArray, FloatArray]]:
    """A store of samples that are named by the views they are of and their steps."""
    return SampleStore(
        VIEWS.arrays,
        lambda views, steps: (views.copy(), steps),
        lambda some, others: (some[0] | others[0], others[1]),
    )


def test_views_are_added_to_what_is_kept() -> None:
    taken = []

    def take(views: BoolArray, steps: FloatArray) -> tuple[BoolArray, FloatArray]:
        taken.append(np.flatnonzero(views).tolist())
        return views.copy(), steps

    kept = SampleStore(VIEWS.arrays, take, lambda some, others: (some[0] | others[0], others[1]))
    first = kept(marked(1, 4), FOCAL, SPACING)
    assert kept(marked(4), FOCAL, SPACING) is first
    more = kept(marked(2), FOCAL, SPACING)
    np.testing.assert_array_equal(more[0], marked(1, 2, 4))
    assert kept(marked(1, 2, 4), FOCAL, SPACING) is more
    assert taken == [[1, 4], [2]]
    # Other vertices, other samples.
    np.testing.assert_allclose(kept(marked(1), FOCAL, 9.0)[1] / more[1], 3.0, rtol=0.01)


def test_no_more_is_kept_than_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    views = VIEWS.arrays
    one, three = (
        take_samples(views, marked(*some), np.ones(6)).values[:, 0].size
        for some in ((1,), (3, 4, 5))
    )
    monkeypatch.setattr(sample_store, "MOST_SAMPLES", int(1.5 * one))
    monkeypatch.setattr(sample_store, "DEPTHS_A_SAMPLE", 1000)
    kept = store()
    first = kept(marked(1), FOCAL, 0.1)
    assert one > 0.7 * views.depth_size[1].prod()
    assert three > 1.5 * one
    assert kept(marked(1), FOCAL, 0.1) is first
    large = kept(marked(3, 4, 5), FOCAL, 0.1)
    np.testing.assert_array_equal(large[0], marked(3, 4, 5))
    assert kept(marked(3, 4, 5), FOCAL, 0.1) is not large
    assert kept(marked(1), FOCAL, 0.1) is first
    # Of two that are too much together the later one stays.
    other = kept(marked(1), FOCAL, 0.2)
    assert kept(marked(1), FOCAL, 0.2) is other
    assert kept(marked(1), FOCAL, 0.1) is not first


@pytest.mark.parametrize("step", [1.0, 1.7, 40.0, 1e6])
def test_samples_are_those_of_the_depth_maps(step: float) -> None:
    views = VIEWS.arrays
    values, boxes, starts, ends = take_samples(views, marked(1, 4), np.full(6, step))
    assert len(values) == ends[-1]
    assert boxes.shape == (6, len(values) + BATCHES)
    np.testing.assert_array_equal(starts[1:], ends[:-1])
    assert not (ends - starts)[[0, 2, 3, 5]].any()
    low, high = boxes[:3] - boxes[3:], boxes[:3] + boxes[3:]
    for axis in range(3):
        own = values[:, axis]
        np.testing.assert_allclose(own.min(axis=1), low[axis, : len(values)], atol=1e-5)
        np.testing.assert_allclose(own.max(axis=1), high[axis, : len(values)], atol=1e-5)
    for view in (1, 4):
        depth = VIEWS.depth_map(view)
        rows, columns = (
            np.unique((step * np.arange(np.ceil(size / step))).astype(int)) for size in depth.shape
        )
        expected = {
            (column - 0.5 * depth.shape[1] + 0.5, row - 0.5 * depth.shape[0] + 0.5, value)
            for row in rows
            for column in columns
            if (value := float(depth[row, column])) > 0.0
        }
        found = values[starts[view] : ends[view]].swapaxes(1, 2).reshape(-1, 3)
        assert {tuple(sample) for sample in found.tolist()} == expected
        # None twice, but those that fill up the last batch.
        assert len(found) == -(-len(expected) // BATCH) * BATCH


def test_joined_samples_are_those_of_each_view() -> None:
    views, steps = VIEWS.arrays, np.full(6, 1.7)
    some = take_samples(views, marked(2, 4), steps)
    joined = joined_samples(some, take_samples(views, marked(0, 3), steps))
    together = take_samples(views, marked(0, 2, 3, 4), steps)
    assert joined.boxes.shape == together.boxes.shape
    for view in range(6):
        own, expected = (
            slice(int(samples.starts[view]), int(samples.ends[view]))
            for samples in (joined, together)
        )
        np.testing.assert_array_equal(joined.values[own], together.values[expected])
        np.testing.assert_array_equal(joined.boxes[:, own], together.boxes[:, expected])


def test_costs_do_not_depend_on_what_was_asked_before() -> None:
    poses = np.stack([looking([x, -2.5, 1.0], [x, 0.0, 1.0]) for x in np.linspace(-1.5, 1.5, 9)])
    renderer = Renderer(VIEWS, WALL, quality=Quality.MEDIUM, threads=1)
    together, _ = renderer.render_many(poses, CAMERA)
    for pose, image in zip(poses, together, strict=True):
        alone = Renderer(VIEWS, WALL, quality=Quality.MEDIUM, threads=1)
        np.testing.assert_array_equal(alone.render_many(pose[None], CAMERA)[0][0], image)
        np.testing.assert_array_equal(renderer.render_many(pose[None], CAMERA)[0][0], image)
