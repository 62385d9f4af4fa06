"""Rendered views against what the camera would really see: rays cut with the plane."""

import numpy as np
import pytest

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.geometry.camera import Camera, Intrinsics, Undistorter
from pipelines.geometry.plane import Plane, plane_from_coefficients, plane_inverse_depth
from pipelines.geometry.pose import inverse
from pipelines.lightfield.views import (
    Views,
    area_average,
    build_views,
    pinhole_query,
    query_intrinsics,
    shrink,
    with_depth,
)
from pipelines.render.choices import Blending, Quality
from pipelines.render.renderer import Renderer, Rendering
from tests.lightfield_samples import (
    WALL,
    looking,
    photographed,
    pinhole,
    pinhole_rays,
    pixels_of,
    recorded_rays,
    surface_points,
    true_image,
    waves,
)

RECORDED = pinhole(96, 72, 80.0)
VIRTUAL = pinhole(64, 48, 50.0)
TILTED = plane_from_coefficients([0.25, -1.0, -0.15, 0.1])
every_blending = pytest.mark.parametrize("blending", Blending)


def truth(pose: FloatArray, camera: Intrinsics, plane: Plane) -> FloatArray:
    return true_image(pose, pinhole_rays(camera, pixels_of(camera)), plane)


def seen_by_any(
    pose: FloatArray, camera: Intrinsics, plane: Plane, views: Views, poses: list[FloatArray]
) -> tuple[BoolArray, BoolArray]:
    """Pixels that surely are, and surely are not, in some photo (a hair's breadth is neither)."""
    points, hit = surface_points(pose, pinhole_rays(camera, pixels_of(camera)), plane)
    inside, near = np.zeros(hit.shape, bool), np.zeros(hit.shape, bool)
    for view, recorded in enumerate(poses):
        local = points @ inverse(recorded)[:3, :3].T + inverse(recorded)[:3, 3]
        pinhole_camera = views.intrinsics[view]
        with np.errstate(divide="ignore", invalid="ignore"):
            x = pinhole_camera.fx * local[..., 0] / local[..., 2] + pinhole_camera.cx
            y = pinhole_camera.fy * local[..., 1] / local[..., 2] + pinhole_camera.cy
        margin = np.minimum(
            np.minimum(x + 0.5, pinhole_camera.width - 0.5 - x),
            np.minimum(y + 0.5, pinhole_camera.height - 0.5 - y),
        )
        in_front = hit & (local[..., 2] > 0.0)
        inside |= in_front & (margin > 1e-6)
        near |= in_front & (np.abs(margin) <= 1e-6)
    return inside, ~inside & ~near


def assert_true(
    rendering: Rendering,
    expected: FloatArray,
    inside: BoolArray,
    outside: BoolArray,
    mean: float = 2.0,
) -> None:
    """Colours as they should be where covered; covered exactly where any photo looks."""
    assert np.all(rendering.covered[inside])
    assert not np.any(rendering.covered[outside])
    assert not rendering.image[~rendering.covered].any()
    difference = np.abs(rendering.image - expected)[rendering.covered]
    assert difference.mean() < mean
    # No pixel is far off either. Within half a (coarse) pixel of a photo's border its outermost
    # pixel is repeated, which displaces the texture by up to that.
    steps = [np.abs(np.diff(expected, axis=axis)).max() for axis in (0, 1)]
    assert difference.max() < 4.0 + 0.75 * max(steps)


LINE = [looking([x, -3.0, 1.0], [x + 0.1, 0.0, 1.0]) for x in np.linspace(-1.5, 1.5, 6)]
GENERAL = [
    looking([-1.2, -3.0, 0.4], [-0.5, 0.0, 0.9], 0.1),
    looking([0.1, -2.6, 1.9], [0.0, 0.0, 1.1], -0.2),
    looking([1.3, -3.3, 0.6], [0.4, 0.0, 0.8], 0.3),
    looking([-0.4, -3.6, 1.0], [0.2, 0.0, 1.2], -0.1),
    looking([0.6, -2.9, 1.3], [0.9, 0.0, 1.0], 0.0),
]
POSES = {
    "between the positions": looking([0.2, -2.8, 1.0], [0.1, 0.0, 1.0]),
    "in front of them (mirrored mesh)": looking([0.1, -1.5, 0.9], [0.3, 0.0, 1.1], 0.2),
    "behind them": looking([-0.3, -5.0, 1.2], [0.2, 0.0, 0.9], -0.1),
    "beside them, at an angle": looking([2.3, -2.0, 1.1], [0.3, 0.0, 1.0]),
}


@every_blending
@pytest.mark.parametrize("place", POSES)
@pytest.mark.parametrize("recorded", ["line", "general", "one", "two"])
@pytest.mark.parametrize("plane", [WALL, TILTED], ids=["wall", "tilted"])
def test_views_show_what_a_camera_would_see(
    recorded: str, place: str, plane: Plane, blending: Blending
) -> None:
    poses = {"line": LINE, "general": GENERAL, "one": GENERAL[1:2], "two": LINE[2:4]}[recorded]
    pose = POSES[place]
    views = photographed(poses, RECORDED, plane)
    rendering = Renderer(views, plane, blending, threads=1).render(pose, VIRTUAL)
    inside, outside = seen_by_any(pose, VIRTUAL, plane, views, poses)
    assert inside.mean() > 0.15
    assert_true(rendering, truth(pose, VIRTUAL, plane), inside, outside)


@every_blending
@pytest.mark.parametrize("place", POSES)
@pytest.mark.parametrize("recorded", ["line", "general"])
@pytest.mark.parametrize("plane", [WALL, TILTED], ids=["wall", "tilted"])
def test_views_over_depth_maps_show_what_a_camera_would_see(
    recorded: str, place: str, plane: Plane, blending: Blending
) -> None:
    """The same truth where the surface comes from the views' depth maps, mirrored mesh included."""
    poses = {"line": LINE, "general": GENERAL}[recorded]
    pose = POSES[place]
    flat = photographed(poses, RECORDED, plane)
    depths = [plane_inverse_depth(plane, of, RECORDED).astype(np.float32) for of in poses]
    views = with_depth(flat, depths)
    rendering = Renderer(views, plane, blending, Quality.FINE, threads=1).render(pose, VIRTUAL)
    # Beyond what the photos show the mesh goes on a little with the farthest depth.
    inside, _ = seen_by_any(pose, VIRTUAL, plane, views, poses)
    assert inside.mean() > 0.15
    assert rendering.covered[inside].mean() > 0.97
    shown = inside & rendering.covered
    difference = np.abs(rendering.image - truth(pose, VIRTUAL, plane))[shown]
    assert difference.mean() < 2.0


@every_blending
def test_distorted_photos_are_undistorted_once(blending: Blending) -> None:
    camera = Camera("OPENCV", 96, 72, (80.0, 78.0, 46.0, 37.0, -0.25, 0.06, 0.004, -0.003))
    undistorter = Undistorter(camera)
    rays = recorded_rays(camera)
    photos = [np.rint(true_image(pose, rays, WALL)).astype(np.uint8) for pose in GENERAL]
    # Without undistortion the colours are clearly wrong, so that the test says something.
    plain = truth(GENERAL[0], camera.intrinsics, WALL)
    assert np.abs(plain - photos[0]).mean() > 3.0
    images = [undistorter(image) for image in photos]
    views = build_views(images, [undistorter.intrinsics] * len(images), np.array(GENERAL))
    for pose in POSES.values():
        rendering = Renderer(views, WALL, blending, threads=1).render(pose, VIRTUAL)
        inside, outside = seen_by_any(pose, VIRTUAL, WALL, views, GENERAL)
        assert_true(rendering, truth(pose, VIRTUAL, WALL), inside, outside)


def test_the_query_of_a_distorted_camera_is_what_the_model_renders() -> None:
    """Another camera than the map's, at the comparison's size, at the same place."""
    camera = Camera("OPENCV", 160, 120, (110.0, 112.0, 82.0, 57.0, -0.2, 0.05, 0.002, 0.003))
    pose = POSES["between the positions"]
    taken = np.rint(true_image(pose, recorded_rays(camera), WALL)).astype(np.uint8)
    undistorter = Undistorter(camera)
    query, intrinsics = pinhole_query(taken, camera, undistorter, 40)
    assert query.shape == (30, 40, 3)
    assert intrinsics == query_intrinsics(camera, undistorter, 40)
    assert query_intrinsics(camera, undistorter, 400).width == 160
    views = photographed([*LINE, *GENERAL], RECORDED, WALL)
    rendering = Renderer(views, WALL, threads=1).render(pose, intrinsics)
    assert rendering.coverage > 0.9
    difference = np.abs(rendering.image.astype(float) - query)[rendering.covered]
    assert difference.mean() < 2.0


@every_blending
def test_photos_of_several_cameras_and_sizes(blending: Blending) -> None:
    cameras = [RECORDED, Intrinsics(50, 80, 60.0, 66.0, 20.0, 44.0), pinhole(120, 60, 70.0)]
    poses = GENERAL[:3]
    images = [
        np.rint(truth(pose, camera, WALL)).astype(np.uint8)
        for pose, camera in zip(poses, cameras, strict=True)
    ]
    views = build_views(images, cameras, np.array(poses))
    for camera in (VIRTUAL, Intrinsics(37, 61, 30.0, 45.0, 25.0, 20.0)):
        pose = POSES["between the positions"]
        rendering = Renderer(views, WALL, blending, threads=1).render(pose, camera)
        inside, outside = seen_by_any(pose, camera, WALL, views, poses)
        assert inside.mean() > 0.3
        assert_true(rendering, truth(pose, camera, WALL), inside, outside)


@every_blending
def test_views_are_never_used_where_they_cannot_see(blending: Blending) -> None:
    """Red photos left, blue ones right: a pixel that only one sort sees is of that colour alone."""
    poses = [looking([x, -2.0, 1.0], [x, 0.0, 1.0]) for x in (-1.3, -0.9, 0.9, 1.3)]
    camera = pinhole(40, 40, 40.0)
    colours = [[255, 0, 0], [255, 0, 0], [0, 0, 255], [0, 0, 255]]
    images = [np.full((40, 40, 3), colour, dtype=np.uint8) for colour in colours]
    # From behind the wall: its photo must not appear although it is the nearest by far.
    poses.append(looking([0.0, 0.3, 1.0], [0.0, -3.0, 1.0]))
    # Before the wall with its back to it.
    poses.append(looking([0.0, -2.0, 1.0], [0.0, -4.0, 1.0]))
    images += [np.full((40, 40, 3), [0, 255, 0], dtype=np.uint8)] * 2
    views = build_views(images, [camera] * 6, np.array(poses))
    pose = looking([0.0, -3.0, 1.0], [0.0, 0.0, 1.0])
    virtual = pinhole(81, 25, 40.0)
    rendering = Renderer(views, WALL, blending, threads=1).render(pose, virtual)
    points, _ = surface_points(pose, pinhole_rays(virtual, pixels_of(virtual)), WALL)
    x = points[..., 0]
    # Each photo shows one metre to either side of its place.
    left, right = (x > -2.2) & (x < -0.12), (x > 0.12) & (x < 2.2)
    both, none = np.abs(x) < 0.08, np.abs(x) > 2.35
    assert min(left.sum(), right.sum(), both.sum(), none.sum()) > 10
    assert np.all(rendering.image[left] == [255, 0, 0])
    assert np.all(rendering.image[right] == [0, 0, 255])
    assert np.all(rendering.image[both].astype(int).sum(axis=-1) >= 254)
    assert not rendering.image[..., 1].any()
    assert np.all(rendering.covered[both])
    assert not rendering.covered[none].any()


def test_black_photos_are_covered_all_the_same() -> None:
    views = build_views([np.zeros((40, 40, 3), np.uint8)], [pinhole(40, 40, 20.0)], LINE[2][None])
    rendering = Renderer(views, WALL, threads=1).render(LINE[2], pinhole(20, 20, 20.0))
    assert rendering.covered.all()
    assert rendering.coverage == 1.0
    assert not rendering.image.any()


@every_blending
@pytest.mark.parametrize("distance", [3.0, 6.0, 12.0, 20.0])
def test_fine_texture_seen_from_afar_goes_to_its_mean(distance: float, blending: Blending) -> None:
    """Stripes of one photo pixel: point samples would be black or white, in waves."""

    def stripes(points: FloatArray) -> FloatArray:
        cell = np.floor(points[..., 0] / 0.02) + np.floor(points[..., 2] / 0.02)
        return np.repeat(np.where(cell % 2 == 0, 40.0, 200.0)[..., None], 3, axis=-1)

    # From one metre, pixels of 1 cm.
    poses = [looking([x, -1.0, 1.0], [x, 0.0, 1.0]) for x in (-0.3, 0.0, 0.3)]
    views = photographed(poses, pinhole(160, 120, 100.0), WALL, stripes)
    pose = looking([0.02, -distance, 1.0], [0.02, 0.0, 1.0])
    camera = pinhole(20, 14, 20.0 * distance)
    if distance == 3.0:
        # 5 cm a pixel at least: the finest level alone would not do.
        texels = views.level(1, 0)[..., 0]
        assert texels.std() > 60.0
    camera = pinhole(9, 7, 3.0 * distance)
    rendering = Renderer(views, WALL, blending, threads=1).render(pose, camera)
    values = rendering.image[rendering.covered].astype(float)
    assert rendering.covered.sum() > 8
    assert abs(values.mean() - 120.0) < 6.0
    assert values.std() < 14.0


def test_pyramid_levels_average_areas() -> None:
    generator = np.random.default_rng(0)
    image = generator.integers(0, 256, (64, 96, 3)).astype(np.uint8)
    views = build_views([image], [pinhole(96, 64, 80.0)], LINE[0][None])
    level = 0
    while tuple(views.arrays.level_size[0, level]) != (12, 8):
        level += 1
        width, height = views.arrays.level_size[0, level]
        scale = 2**level
        assert (width * scale, height * scale) == (96, 64)
        blocks = image.reshape(height, scale, width, scale, 3).mean(axis=(1, 3))
        # Every level rounds once more.
        assert np.abs(views.level(0, level) - blocks).max() < 0.5 * level + 0.51
    assert level == views.arrays.level_size.shape[1] - 1 == 3


def test_shrinking_keeps_where_things_are() -> None:
    """The same wall point, before and after, at the place that the intrinsics say."""
    image = np.rint(truth(LINE[1], RECORDED, WALL)).astype(np.uint8)
    small, camera = shrink(image, RECORDED, 32)
    assert (camera.width, camera.height) == (32, 24)
    difference = np.abs(small - truth(LINE[1], camera, WALL))
    assert difference.mean() < 1.5
    same, unchanged = shrink(image, RECORDED, 96)
    assert same is image
    assert unchanged == RECORDED
    assert shrink(image, RECORDED, None)[1] == RECORDED
    assert area_average(np.full((7, 5, 3), 9, np.uint8), 2, 3).tolist() == [[[9] * 3] * 2] * 3


def test_texture_of_the_tests_is_not_flat() -> None:
    """Else any warp would pass."""
    image = truth(LINE[0], RECORDED, WALL)
    assert image.std() > 40.0
    shifted = truth(LINE[0], Intrinsics(96, 72, 80.0, 80.0, 49.5, 35.5), WALL)
    assert np.abs(shifted - image).mean() > 2.0
    assert waves(np.zeros((2, 3))).shape == (2, 3)
