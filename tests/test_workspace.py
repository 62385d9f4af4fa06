"""Memory for views that is used again: by one at a time, not too much of it, without traces."""

import numpy as np
import pytest

from pipelines.lightfield.blending import Blending
from pipelines.lightfield.comparison import Cost
from pipelines.lightfield.renderer import Renderer, every_pixel
from pipelines.lightfield.workspace import (
    MOST_KEPT_PIXELS,
    MOST_KEPT_SIZES,
    Workspace,
    Workspaces,
)
from tests.lightfield_samples import WALL, looking, noise_views, pinhole

PLACES = np.linspace(-1.5, 1.5, 7)
VIEWS = noise_views(
    [looking([x, -3.0, 1.0], [x, 0.0, 1.0]) for x in PLACES], np.random.default_rng(0)
)
POSES = np.stack([looking([x, -2.0 - x, 1.2], [0.0, 0.0, 1.0], 0.2) for x in PLACES])
CAMERAS = (pinhole(24, 18, 20.0), pinhole(48, 36, 40.0), pinhole(30, 40, 25.0))


def fresh_renderer(blending: Blending) -> Renderer:
    return Renderer(VIEWS, WALL, blending, threads=1)


def taken(spaces: Workspaces, width: int, height: int) -> Workspace:
    """A workspace that is back already."""
    chosen = np.arange(width * height, dtype=np.int32)
    with spaces.one_for(width, height, chosen) as space:
        assert space.labels.shape == (height, width)
        return space


def test_a_workspace_is_used_again_but_not_by_two_at_once() -> None:
    spaces = Workspaces(fresh_renderer(Blending.UNSTRUCTURED)._field)
    first = taken(spaces, 20, 15)
    assert taken(spaces, 20, 15) is first
    chosen = every_pixel(pinhole(20, 15, 1.0))
    with spaces.one_for(20, 15, chosen) as outer, spaces.one_for(20, 15, chosen[::3]) as inner:
        assert outer is first
        assert inner.labels is not outer.labels
        np.testing.assert_array_equal(inner.order.chosen, chosen[::3])


def test_no_more_than_a_few_sizes_are_kept_and_no_large_one() -> None:
    spaces = Workspaces(fresh_renderer(Blending.UNSTRUCTURED)._field)
    first = taken(spaces, 20, 15)
    for width in range(21, 21 + MOST_KEPT_SIZES):
        taken(spaces, width, 15)
    assert taken(spaces, 20, 15) is not first
    height = MOST_KEPT_PIXELS // 400 + 1
    assert taken(spaces, 400, height) is not taken(spaces, 400, height)


@pytest.mark.parametrize("blending", Blending)
def test_what_was_rendered_before_leaves_no_traces(blending: Blending) -> None:
    generator = np.random.default_rng(1)
    used = fresh_renderer(blending)
    for _ in range(3):
        for camera in CAMERAS:
            query = generator.uniform(0.0, 255.0, (camera.height, camera.width, 3))
            query[generator.uniform(size=query.shape[:2]) < generator.uniform()] = np.nan
            image = query.astype(np.float32)
            found = used.costs(POSES, camera, image, Cost.ROBUST, True)
            wanted = fresh_renderer(blending).costs(POSES, camera, image, Cost.ROBUST, True)
            np.testing.assert_array_equal(found, wanted)
            drawn, covered = used.render_many(POSES, camera)
            fresh, shown = fresh_renderer(blending).render_many(POSES, camera)
            np.testing.assert_array_equal(drawn, fresh)
            np.testing.assert_array_equal(covered, shown)
            # Some pixels are shown by views that their cells do not have, some by none.
            assert 0.3 < covered.mean() < 1.0
