"""The benchmark compares like with like: OpenCV computes the same images and costs."""

import numpy as np
import pytest

from benchmarks.run import (
    OPENCV,
    Work,
    fused_costs,
    opencv_costs,
    opencv_image,
    opencv_work,
    ratios,
    table,
    work_of,
    workshop_scene,
)
from pipelines.lightfield.blending import Blending
from pipelines.lightfield.renderer import Renderer


@pytest.fixture(scope="module")
def work() -> Work:
    return work_of(workshop_scene(), 40, 30, count=6)


def renderer_of(work: Work, blending: Blending) -> Renderer:
    return Renderer(work.views, work.scene.plane, blending, threads=1)


def test_opencv_computes_the_images_of_the_net(work: Work) -> None:
    prepared, renderer = opencv_work(work), renderer_of(work, Blending.DELAUNAY)
    for particle, pose in enumerate(work.poses):
        rendering = renderer.render(pose, work.intrinsics)
        assert rendering.coverage == 1.0
        difference = np.abs(opencv_image(prepared, particle) - rendering.image)
        # Positions are rounded to 1/32 pixel there, grey levels to whole numbers here.
        assert difference.max() < 3.0
        assert difference.mean() < 1.0


def test_opencv_computes_the_costs(work: Work) -> None:
    costs = fused_costs(renderer_of(work, Blending.DELAUNAY), work)
    np.testing.assert_allclose(opencv_costs(opencv_work(work)), costs, atol=2e-4)
    assert costs.max() > 0.005
    assert costs[0] < 1e-4


def test_three_views_are_blended_at_every_pixel(work: Work) -> None:
    weights = opencv_work(work).weights
    assert weights.min() > 0.0
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-5)
    # As large as the virtual pixels: neither finer nor coarser photos are read.
    assert np.all(work.views.arrays.level_size[:, 0] == [80, 60])


def test_the_table_shows_times_and_ratios() -> None:
    row = {OPENCV: 200.0, "fused, delaunay, 3 views": 100.0, "fused, unstructured, 3 views": 150.0}
    figures = {"40x30": row, "80x60": {name: 4.0 * value for name, value in row.items()}}
    assert ratios(figures, Blending.DELAUNAY) == {"40x30": 0.5, "80x60": 0.5}
    figures["40x30"] = {**row, "once": 5000.0}
    lines = table(figures).splitlines()
    assert lines[3] == "| fused, delaunay, 3 views | 100 (0.50) | 400 (0.50) |"
    assert lines[-1] == "| once | 5000 (25.00) |  |"
