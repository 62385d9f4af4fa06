"""Unstructured-lumigraph weights against formulas; that the fast path has the same is elsewhere."""

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import plane_inverse_depth
from pipelines.lightfield.view_penalties import BORDER_PENALTY, BORDER_SHARE, RESOLUTION_PENALTY
from pipelines.lightfield.views import Views, build_views
from pipelines.render.blending import unstructured_weights
from pipelines.render.renderer import Renderer
from pipelines.render.view_mapping import ViewMapping
from tests.lightfield_samples import WALL, looking, pinhole

CAMERA = pinhole(41, 31, 40.0)
# At this pixel the virtual camera, 2 m before the wall, sees the point x = 0, z = 1.
COLUMN, ROW = 20, 15
VIRTUAL = looking([0.0, -2.0, 1.0], [0.0, 0.0, 1.0])
VIEW = pinhole(200, 160, 150.0)


def straight(x: float, y: float) -> FloatArray:
    """A level camera that looks straight at the wall."""
    return looking([x, y, 1.0], [x, 0.0, 1.0])


def at_border(x: float, y: float, share: float) -> FloatArray:
    """A level camera turned until the point has so much of the strip along the left border."""
    margin = share * BORDER_SHARE * VIEW.height
    heading = np.arctan2(-x, -y) + np.arctan((VIEW.cx + 0.5 - margin) / VIEW.fx)
    return looking([x, y, 1.0], [x + np.sin(heading), y + np.cos(heading), 1.0])


def views_at(poses: list[FloatArray], greys: list[int] | None = None) -> Views:
    """Photos of one grey each."""
    values = greys or [128] * len(poses)
    images = [np.full((VIEW.height, VIEW.width, 3), grey, np.uint8) for grey in values]
    return build_views(images, [VIEW] * len(poses), np.array(poses))


def weights_at_pixel(views: Views, camera: Intrinsics = CAMERA) -> FloatArray:
    """``(N,)`` at the middle pixel, which is a corner of the tiles."""
    usable = np.ones(len(views), dtype=bool)
    surface = plane_inverse_depth(WALL, VIRTUAL, camera)
    mapping = ViewMapping.of(views, VIRTUAL, camera)
    result = unstructured_weights(views, usable, mapping, surface)
    weights = np.zeros(len(views))
    np.add.at(weights, result.views[ROW, COLUMN], result.weights[ROW, COLUMN])
    return weights


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 3.0])
def test_two_views_share_by_angle_resolution_and_border(share: float) -> None:
    weights = weights_at_pixel(views_at([straight(0.3, -3.0), at_border(0.2, -2.5, share)]))
    penalty = np.array(
        [
            2.0 * np.sin(0.5 * np.arctan2(x, y)) + RESOLUTION_PENALTY * (np.hypot(x, y) / 2.0 - 1.0)
            for x, y in [(0.3, 3.0), (0.2, 2.5)]
        ]
    )
    penalty[1] += BORDER_PENALTY * max(1.0 / share - 1.0, 0.0)
    expected = np.reciprocal(penalty) / np.reciprocal(penalty).sum()
    np.testing.assert_allclose(weights, expected, rtol=1e-9)


@pytest.mark.parametrize("others", [1, 2, 3, 5])
def test_weights_do_not_jump_where_a_view_ends(others: int) -> None:
    """Whether or not there is another view to take its place among the best."""
    rest = [straight(-0.7 - 0.04 * number, -2.0 - 0.1 * number) for number in range(others)]
    inside, just_inside, outside = (
        weights_at_pixel(views_at([at_border(0.2, -2.0, share), *rest]))
        for share in (3.0, 1e-4, -1e-4)
    )
    assert inside[0] > 0.5
    assert outside[0] == 0.0
    np.testing.assert_allclose(just_inside, outside, atol=3e-3)


def test_seams_are_smaller_than_half_of_what_the_view_weighs() -> None:
    """A bright view among dark ones ends within the picture."""
    camera = pinhole(480, 360, 430.0)
    poses = [at_border(0.2, -2.0, 0.0), straight(-0.7, -2.0), straight(-0.8, -2.1)]
    renderer = Renderer(views_at(poses, [240, 40, 40]), WALL, threads=1)
    image = renderer.render(VIRTUAL, camera).image[camera.height // 2, :, 0].astype(int)
    ends = camera.width // 2
    weighs = image[ends + 60] - 40
    assert image[ends - 3] == 40
    assert weighs > 100
    assert np.abs(np.diff(image)).max() < 0.5 * weighs
