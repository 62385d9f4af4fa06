"""The fast renderer against the readable one: white-noise photos, random scenes and poses."""

import zlib
from collections.abc import Callable

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane, plane_inverse_depth
from pipelines.geometry.pose import base_from_camera_mount, world_from_base_planar
from pipelines.lightfield.views import Views, build_views, without_view
from pipelines.render.blending import MOST_RANKED
from pipelines.render.choices import Blending, Quality
from pipelines.render.reference import render_reference
from pipelines.render.renderer import Renderer
from pipelines.render.view_mapping import ViewMapping
from tests.lightfield_samples import WALL, looking, noise_views, pinhole, tilted_wall

LightField = tuple[Views, Plane, FloatArray]
RESOLUTIONS = (pinhole(24, 18, 20.0), pinhole(41, 29, 50.0), Intrinsics(9, 13, 8.0, 9.0, 3.3, 7.1))


def somewhere(generator: np.random.Generator, near: float, far: float) -> FloatArray:
    """A place in front of the wall, at a distance between ``near`` and ``far``."""
    return np.array(
        [generator.uniform(-2.0, 2.0), -generator.uniform(near, far), generator.uniform(0.3, 1.7)]
    )


def at_wall(generator: np.random.Generator) -> FloatArray:
    return np.array([generator.uniform(-1.5, 1.5), 0.0, generator.uniform(0.0, 2.0)])


def light_field(
    generator: np.random.Generator, centres: FloatArray, virtual: FloatArray
) -> LightField:
    """Views and a virtual camera that look at the wall, each in its way, over a tilted plane."""
    roll = generator.uniform(-0.3, 0.3, len(centres) + 1)
    poses = [
        looking(centre, at_wall(generator), float(turn))
        for centre, turn in zip(centres, roll[1:], strict=True)
    ]
    pose = looking(virtual, at_wall(generator), float(roll[0]))
    return noise_views(poses, generator), tilted_wall(generator), pose


def general(generator: np.random.Generator) -> LightField:
    count = int(generator.integers(3, 12))
    centres = np.array([somewhere(generator, 2.0, 4.0) for _ in range(count)])
    return light_field(generator, centres, somewhere(generator, 1.5, 5.0))


def many(generator: np.random.Generator) -> LightField:
    centres = np.array([somewhere(generator, 2.0, 4.0) for _ in range(40)])
    return light_field(generator, centres, somewhere(generator, 1.5, 5.0))


def crowd(generator: np.random.Generator) -> LightField:
    """More views than are ranked at every corner."""
    centres = np.array([somewhere(generator, 2.0, 4.0) for _ in range(MOST_RANKED + 30)])
    return light_field(generator, centres, somewhere(generator, 1.5, 5.0))


def collinear(generator: np.random.Generator) -> LightField:
    steps = np.sort(generator.uniform(-2.0, 2.0, 7))[:, None]
    centres = somewhere(generator, 2.0, 4.0) + steps * np.array([1.0, 0.1, 0.05])
    return light_field(generator, centres, somewhere(generator, 1.5, 5.0))


def mirrored(generator: np.random.Generator) -> LightField:
    """The virtual camera between the recording positions and the wall."""
    centres = np.array([somewhere(generator, 2.5, 4.0) for _ in range(8)])
    return light_field(generator, centres, somewhere(generator, 1.0, 2.0))


def amid(generator: np.random.Generator) -> LightField:
    """Recording positions before and behind the virtual camera."""
    centres = np.array([somewhere(generator, 1.5, 4.5) for _ in range(8)])
    return light_field(generator, centres, somewhere(generator, 2.5, 3.5))


def one_view(generator: np.random.Generator) -> LightField:
    return light_field(
        generator, somewhere(generator, 2.0, 4.0)[None], somewhere(generator, 2.0, 4.0)
    )


def two_views(generator: np.random.Generator) -> LightField:
    centres = np.array([somewhere(generator, 2.0, 4.0) for _ in range(2)])
    return light_field(generator, centres, somewhere(generator, 2.0, 4.0))


def robot(generator: np.random.Generator) -> LightField:
    """All cameras at the same height and level: the mesh lies on the horizon."""
    mount = base_from_camera_mount([0.1, 0.0, 1.0], [0.0, 0.0, 0.0])
    count = 9
    states = np.column_stack(
        [
            generator.uniform(-2.0, 2.0, count),
            generator.uniform(-4.0, -1.5, count),
            np.pi / 2.0 + generator.uniform(-0.6, 0.6, count),
        ]
    )
    poses = world_from_base_planar(states) @ mount
    return noise_views(list(poses[1:]), generator), WALL, poses[0]


def coincident(generator: np.random.Generator) -> LightField:
    """A camera that turned about its centre at each of three places."""
    places = np.array([somewhere(generator, 2.0, 4.0) for _ in range(3)])
    return light_field(generator, np.repeat(places, 7, axis=0), somewhere(generator, 1.5, 5.0))


def at_a_recorded_place(generator: np.random.Generator) -> LightField:
    centres = np.array([somewhere(generator, 2.0, 4.0) for _ in range(6)])
    return light_field(generator, centres, centres[2])


def beside(generator: np.random.Generator) -> LightField:
    """On the line of the recordings, looking across it: all centres project to infinity."""
    xs = np.sort(generator.uniform(-2.0, 2.0, 8))
    places = np.column_stack([xs, np.full(8, -3.0), np.full(8, 1.0)])
    poses = [looking(place, place + np.array([0.0, 1.0, 0.0])) for place in places]
    return noise_views(poses[1:], generator), WALL, poses[0]


def views_behind_the_plane(generator: np.random.Generator) -> LightField:
    centres = np.array([somewhere(generator, 2.0, 4.0) for _ in range(8)])
    centres[::2, 1] *= -1.0
    return light_field(generator, centres, somewhere(generator, 1.5, 5.0))


def grazing(generator: np.random.Generator) -> LightField:
    """A wide view along the wall: part of it shows no wall at all."""
    centres = np.array([somewhere(generator, 1.0, 3.0) for _ in range(6)])
    views, plane, _ = light_field(generator, centres, centres[0])
    place = somewhere(generator, 0.8, 2.0)
    return views, plane, looking(place, place + np.array([3.0, 1.0, 0.1]))


ARRANGEMENTS: tuple[Callable[[np.random.Generator], LightField], ...] = (
    general,
    many,
    crowd,
    collinear,
    mirrored,
    amid,
    one_view,
    two_views,
    robot,
    coincident,
    at_a_recorded_place,
    beside,
    views_behind_the_plane,
    grazing,
)


def assert_agree(
    views: Views,
    plane: Plane,
    pose: FloatArray,
    camera: Intrinsics,
    blending: Blending,
    quality: Quality = Quality.PLANE,
) -> float:
    """Both renderers agree to one grey level; returns the share of covered pixels."""
    expected, covered = render_reference(views, plane, pose, camera, blending, quality)
    rendering = Renderer(views, plane, blending, quality, threads=1).render(pose, camera)
    np.testing.assert_array_equal(rendering.covered, covered)
    assert np.abs(rendering.image - expected).max() <= 1.0
    return rendering.coverage


@pytest.mark.parametrize("blending", Blending)
@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_random_scenes(
    arrangement: Callable[[np.random.Generator], LightField], blending: Blending
) -> None:
    coverage = []
    for number in range(9):
        generator = np.random.default_rng([zlib.crc32(arrangement.__name__.encode()), number])
        views, plane, pose = arrangement(generator)
        camera = RESOLUTIONS[number % len(RESOLUTIONS)]
        coverage.append(assert_agree(views, plane, pose, camera, blending))
    # Nothing is shown by agreeing on black images.
    assert max(coverage) > 0.4


@pytest.mark.parametrize("blending", Blending)
def test_views_finer_than_the_virtual_camera(blending: Blending) -> None:
    """Whole pyramids come into play: photos of up to 200 pixels in virtual images of 24 to 4."""
    used = set()
    for number in range(12):
        generator = np.random.default_rng([11, number])
        poses = [looking(somewhere(generator, 2.0, 4.0), at_wall(generator)) for _ in range(5)]
        intrinsics = [
            pinhole(int(width), int(0.7 * width), 0.8 * float(width))
            for width in generator.integers(60, 200, 5)
        ]
        images = [
            generator.integers(0, 256, (camera.height, camera.width, 3)).astype(np.uint8)
            for camera in intrinsics
        ]
        views = build_views(images, intrinsics, np.array(poses))
        pose = looking(somewhere(generator, 2.0, 9.0), at_wall(generator))
        side = (24, 9, 4)[number % 3]
        camera = pinhole(side, side, float(generator.uniform(0.3, 1.5)) * side)
        plane = tilted_wall(generator)
        assert_agree(views, plane, pose, camera, blending)
        mapping = ViewMapping.of(views, pose, camera)
        inverse_depth = plane_inverse_depth(plane, pose, camera)[side // 2, side // 2]
        pixel = np.array([side // 2, side // 2, 1.0])
        middle = mapping.into_all_views(pixel, float(inverse_depth))
        scale = views.arrays.focal / (camera.fx * middle[:, 2])
        used |= set(np.floor(np.log2(scale) + 0.5).astype(int).tolist())
    assert used >= {1, 2, 3, 4}


@pytest.mark.parametrize("blending", Blending)
def test_nothing_is_seen_from_behind_or_looking_away(blending: Blending) -> None:
    generator = np.random.default_rng(7)
    centres = np.array([somewhere(generator, 2.0, 4.0) for _ in range(5)])
    views, plane, _ = light_field(generator, centres, centres[0])
    away = looking([0.3, -2.0, 1.0], [0.1, -9.0, 1.2])
    behind = looking([0.3, 2.0, 1.0], [0.1, 0.0, 1.2])
    behind_looking_on = looking([0.3, 2.0, 1.0], [0.1, 9.0, 1.2])
    for pose in (away, behind, behind_looking_on):
        camera = RESOLUTIONS[0]
        assert assert_agree(views, plane, pose, camera, blending) == 0.0
        assert not Renderer(views, plane, blending, threads=1).render(pose, camera).image.any()


@pytest.mark.parametrize("blending", Blending)
def test_no_view_in_front_of_the_plane_covers_nothing(blending: Blending) -> None:
    generator = np.random.default_rng(8)
    centres = np.array([somewhere(generator, 2.0, 4.0) for _ in range(4)]) * [1.0, -1.0, 1.0]
    views, plane, pose = light_field(generator, centres, somewhere(generator, 2.0, 3.0))
    assert assert_agree(views, plane, pose, RESOLUTIONS[0], blending) == 0.0


def with_depth(views: Views, generator: np.random.Generator, known: float) -> Views:
    """The same photos with random depth maps: a rough wall, blocks before it, gaps in both."""
    images = [views.level(view, 0) for view in range(len(views))]
    poses = np.tile(np.eye(4), (len(views), 1, 1))
    depths = []
    for view, camera in enumerate(views.intrinsics):
        height, width = camera.height // 2, camera.width // 2
        rays = views.arrays.rays[view]
        distance = abs(views.centres[view, 1]) / max(abs(float(rays[1, 2])), 0.3)
        depth = np.full((height, width), 1.0 / distance)
        depth *= generator.uniform(0.97, 1.03, depth.shape)
        row, column = generator.integers(0, height - 3), generator.integers(0, width - 3)
        depth[row : row + height // 3, column : column + width // 3] *= 1.8
        depth[generator.uniform(size=depth.shape) > known] = 0.0
        depths.append(depth.astype(np.float32))
        matrix = np.column_stack([rays @ camera.matrix(), views.centres[view]])
        poses[view, :3] = matrix
    return build_views(images, views.intrinsics, poses, depths)


@pytest.mark.parametrize("quality", [Quality.FINE, Quality.MEDIUM, Quality.COARSE])
@pytest.mark.parametrize("blending", Blending)
def test_random_scenes_with_depth(blending: Blending, quality: Quality) -> None:
    """Surfaces from depth maps with edges and gaps, hidden views, meshes of all sizes."""
    coverage = []
    for number in range(14):
        generator = np.random.default_rng([19, number])
        arrangement = (general, robot, mirrored, amid, coincident, one_view, many, crowd)[
            number % 8
        ]
        views, plane, pose = arrangement(generator)
        known = (1.0, 0.7, 0.2)[number % 3]
        camera = RESOLUTIONS[number % len(RESOLUTIONS)]
        views = with_depth(views, generator, known)
        coverage.append(assert_agree(views, plane, pose, camera, blending, quality))
    assert max(coverage) > 0.4


@pytest.mark.parametrize("quality", [Quality.PLANE, Quality.MEDIUM])
@pytest.mark.parametrize("blending", Blending)
def test_without_a_view_others_are_rendered_as_by_a_renderer_of_them(
    blending: Blending, quality: Quality
) -> None:
    generator = np.random.default_rng(23)
    views, plane, pose = many(generator)
    views = with_depth(views, generator, 1.0)
    whole, camera = Renderer(views, plane, blending, quality, threads=1), RESOLUTIONS[1]
    before = whole.render(pose, camera).image
    changed = 0
    for index in range(len(views)):
        rest = whole.without_view(index)
        anew = Renderer(without_view(views, index), plane, blending, quality, threads=1)
        expected = anew.render(pose, camera)
        np.testing.assert_array_equal(rest.render(pose, camera).image, expected.image)
        assert len(rest.views) == len(views) - 1
        changed += int(np.any(expected.image != before))
    # Left out is what was asked for: some of the views are seen, and not all.
    assert 0 < changed < len(views)
    np.testing.assert_array_equal(whole.render(pose, camera).image, before)
