"""Rendering and comparing in C++: what costs are of, what changes nothing, what is refused."""

import gc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pipelines import native
from pipelines.artifacts.arrays import Float32Array, FloatArray, Int32Array
from pipelines.geometry.camera import Intrinsics
from pipelines.lightfield.views import with_depth as with_depths
from pipelines.render.blending import MOST_RANKED, candidate_positions, tile_borders
from pipelines.render.candidate_views import build_index
from pipelines.render.choices import Blending, Cost, Quality
from pipelines.render.comparison import (
    EVIDENCE_BINS,
    EVIDENCE_ROWS,
    PixelEvidence,
    compare,
    evidence_table,
    prepared,
)
from pipelines.render.delaunay_mesh import MESH_LIMITS
from pipelines.render.depth_samples import take_samples
from pipelines.render.reference import frustum_positions
from pipelines.render.renderer import Renderer
from pipelines.render.surface import depth_inverse_depth, source_views
from tests.lightfield_samples import WALL, looking, noise_views, pinhole, tilted_wall
from tests.render.test_renderers_agree import at_wall, somewhere, with_depth

SIZES = [pinhole(24, 18, 20.0), pinhole(41, 29, 50.0), pinhole(1, 1, 1.0), pinhole(3, 2, 3.0)]


def light_field(
    count: int,
    seed: int,
    blending: Blending = Blending.UNSTRUCTURED,
    quality: Quality = Quality.PLANE,
) -> tuple[Renderer, FloatArray]:
    """A renderer of so many photos of a wall, and poses that look at it or past it."""
    generator = np.random.default_rng(seed)
    recorded = [
        looking(somewhere(generator, 2.0, 4.0), at_wall(generator), float(roll))
        for roll in generator.uniform(-0.3, 0.3, count)
    ]
    views = noise_views(recorded, generator)
    if quality is not Quality.PLANE:
        views = with_depth(views, generator, known=0.8)
    renderer = Renderer(views, tilted_wall(generator), blending, quality, threads=1)
    poses = [
        looking(somewhere(generator, 1.0, 5.0), at_wall(generator) * [3.0, 1.0, 2.0])
        for _ in range(40)
    ]
    return renderer, np.array(poses)


def camera_image(camera: Intrinsics, seed: int, share: float) -> Float32Array:
    generator = np.random.default_rng(seed)
    image = generator.uniform(0.0, 255.0, (camera.height, camera.width, 3)).astype(np.float32)
    image[generator.random(image.shape[:2]) > share] = np.nan
    return image


def evidence() -> PixelEvidence:
    generator = np.random.default_rng(3)
    # So little from bin to bin that rounding at a border of two changes nothing.
    table = 1e-4 * generator.standard_normal((EVIDENCE_ROWS, EVIDENCE_BINS)).astype(np.float32)
    edges = np.linspace(60.0, 300.0, EVIDENCE_ROWS - 1, dtype=np.float32)
    rows = 0.5 * np.arange(1, EVIDENCE_ROWS + 1, dtype=np.float32)
    return PixelEvidence(edges, table + rows[:, None], np.zeros(EVIDENCE_ROWS, np.float32))


def drawn(
    renderer: Renderer, poses: FloatArray, camera: Intrinsics, chosen: Int32Array
) -> tuple[Float32Array, Float32Array]:
    native = renderer._native
    return native.draw(poses, native.surfaces(poses, camera), camera, chosen)


@pytest.mark.parametrize("quality", [Quality.PLANE, Quality.FINE])
@pytest.mark.parametrize("count", [1, 12, MOST_RANKED + 30])
@pytest.mark.parametrize("camera", SIZES, ids=lambda camera: f"{camera.width}x{camera.height}")
@pytest.mark.parametrize("cost", Cost)
@pytest.mark.parametrize("blending", Blending)
def test_costs_are_those_of_the_views_that_are_drawn(
    blending: Blending, cost: Cost, camera: Intrinsics, count: int, quality: Quality
) -> None:
    renderer, poses = light_field(count, count, blending, quality)
    says = evidence() if cost is Cost.EVIDENCE else None
    views = [renderer.render_with_surface(pose, camera).rgba for pose in poses]
    for share in (1.0, 0.3):
        query = camera_image(camera, 5, share)
        target = prepared(query)
        if says is not None:
            target[..., 3] *= 1.0 + says.rows(target[..., :3])
        for fit_gain in (False, True):
            found = renderer.costs(poses, camera, query, cost, fit_gain, says)
            table = evidence_table(cost, says)
            expected = [compare(cost, view, target, fit_gain, table) for view in views]
            np.testing.assert_allclose(found, expected, rtol=2e-4, atol=2e-4)


@pytest.mark.parametrize("quality", [Quality.PLANE, Quality.MEDIUM])
@pytest.mark.parametrize("blending", Blending)
def test_threads_and_batches_change_nothing(blending: Blending, quality: Quality) -> None:
    renderer, poses = light_field(30, 7, blending, quality)
    camera = SIZES[1]
    query = camera_image(camera, 8, 0.5)
    expected = renderer.costs(poses, camera, query, Cost.ROBUST, True)
    for threads in (3, 40):
        several = Renderer(renderer.views, renderer.plane, blending, quality, threads=threads)
        found = several.costs(poses, camera, query, Cost.ROBUST, True)
        np.testing.assert_array_equal(found, expected)
    single = [renderer.costs(pose[None], camera, query, Cost.ROBUST, True)[0] for pose in poses]
    np.testing.assert_array_equal(single, expected)


@pytest.mark.parametrize("quality", [Quality.PLANE, Quality.FINE])
@pytest.mark.parametrize("blending", Blending)
def test_which_pixels_are_compared_does_not_change_what_they_show(
    blending: Blending, quality: Quality
) -> None:
    renderer, poses = light_field(12, 9, blending, quality)
    camera = SIZES[1]
    every = np.arange(camera.width * camera.height, dtype=np.int32)
    whole, depths = drawn(renderer, poses, camera, every)
    some = every[3::7].copy()
    images, inverse_depths = drawn(renderer, poses, camera, some)
    np.testing.assert_array_equal(images, whole[:, some])
    np.testing.assert_array_equal(inverse_depths, depths[:, some])


@pytest.mark.parametrize("quality", [Quality.PLANE, Quality.FINE])
@pytest.mark.parametrize("blending", Blending)
def test_poses_that_are_no_numbers_show_nothing(blending: Blending, quality: Quality) -> None:
    renderer, poses = light_field(MOST_RANKED + 6, 10, blending, quality)
    for value in (np.nan, np.inf, 1e300):
        images, inverse_depths = drawn(
            renderer, np.full_like(poses, value), SIZES[0], np.arange(9, dtype=np.int32)
        )
        assert np.isfinite(images).all()
        assert not images.any()
        assert quality is Quality.PLANE or not inverse_depths.any()


@pytest.mark.parametrize("blending", Blending)
@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, -1.0, 1e-44, 1e38])
def test_depths_that_are_no_distances_lead_nowhere(value: float, blending: Blending) -> None:
    """Whatever depth maps hold, pixels are colours or nothing, and all other depths still count."""
    renderer, poses = light_field(9, 13, quality=Quality.FINE)
    views = renderer.views
    generator = np.random.default_rng(14)
    for share in (0.2, 1.0):
        depths = [views.depth_map(view).copy() for view in range(len(views))]
        for depth in depths:
            depth[generator.uniform(size=depth.shape) < share] = value
        strange = Renderer(with_depths(views, depths), WALL, blending, Quality.FINE, threads=1)
        every = np.arange(SIZES[1].width * SIZES[1].height, dtype=np.int32)
        images, _ = drawn(strange, poses, SIZES[1], every)
        assert np.isfinite(images).all()
        assert images.min() >= 0.0
        assert images.max() <= 255.01
        if value <= 0.0 or np.isnan(value):
            assert images.any() == (share < 1.0)


def test_a_camera_amid_the_depth_maps_sees_the_surface_of_the_readable_version() -> None:
    """Narrow views of parts of what depth maps show, some from before it and from behind."""
    renderer, _ = light_field(9, 15, quality=Quality.FINE)
    generator, camera = np.random.default_rng(16), pinhole(90, 70, 260.0)
    covered = 0.0
    for number in range(30):
        place = generator.uniform([-2.5, -4.0, 0.0], [2.5, 0.5, 2.0])
        target = generator.uniform([-1.5, 0.0, 0.3], [1.5, 0.3, 1.7])
        pose = looking(place, target, generator.uniform(-3.0, 3.0))
        quality = (Quality.FINE, Quality.MEDIUM, Quality.COARSE)[number % 3]
        own = Renderer(renderer.views, WALL, quality=quality, threads=1)
        found = own.render_with_surface(pose, camera).inverse_depth
        expected = depth_inverse_depth(renderer.views, pose, camera, quality)
        # At the border of two cells a sample may round to the other one.
        differs = ~np.isclose(found, expected, rtol=1e-4, atol=0.0)
        assert differs.mean() < 0.002
        covered += float((expected > 0.0).mean()) / 30.0
    assert 0.3 < covered < 1.0


@pytest.mark.parametrize("quality", [Quality.PLANE, Quality.COARSE])
@pytest.mark.parametrize("blending", Blending)
def test_images_of_extreme_sides_are_rendered(blending: Blending, quality: Quality) -> None:
    renderer, poses = light_field(5, 19, blending, quality)
    for width, height in ((20_000, 1), (1, 20_000)):
        camera = pinhole(width, height, 1.0 * max(width, height))
        image = renderer.render_with_surface(poses[0], camera).rgba
        assert image.shape == (height, width, 4)
        assert np.isfinite(image).all()
        cost = renderer.costs(poses[:1], camera, image[..., :3].copy(), Cost.SQUARED, False)
        assert np.isfinite(cost).all()


@pytest.mark.parametrize("blending", Blending)
def test_no_poses_cost_nothing_and_no_pixels_give_no_image(blending: Blending) -> None:
    renderer, poses = light_field(5, 20, blending)
    camera = SIZES[0]
    images, depths = drawn(renderer, poses[:0], camera, np.arange(9, dtype=np.int32))
    assert images.shape == (0, 9, 4)
    assert depths.shape == (0, 9)
    images, _ = drawn(renderer, poses[:3], camera, np.arange(0, dtype=np.int32))
    assert images.shape == (3, 0, 4)
    assert (
        renderer.costs(poses[:0], camera, camera_image(camera, 1, 1.0), Cost.ROBUST, True).size == 0
    )


@pytest.mark.parametrize("has_mesh", [False, True])
def test_a_light_field_without_photos_shows_nothing(has_mesh: bool) -> None:
    given = scene_arguments()
    lengths = ("level_start", "level_size", "projection", "rays", "centres", "focal", "usable")
    more = ("depth_start", "depth_size", "pooled_start", "order", "numbers", "members", "blocks")
    nothing = {name: given[name][:0] for name in (*lengths, *more, "groups")}
    scene = native.LightField(**given | nothing | {"has_mesh": has_mesh})
    views = views_arguments()
    views["sources"] = views["sources"] - 1
    images, _ = scene.views(**views).render()
    assert images.shape == (40, 7, 4)
    assert not images.any()


# --- arguments ---------------------------------------------------------------------------------


def scene_arguments() -> dict[str, Any]:
    renderer, _ = light_field(5, 11, quality=Quality.FINE)
    views, usable = renderer.views.arrays, np.ones(5, dtype=np.bool_)
    index = build_index(renderer.views, usable)
    assert renderer.plane is not None
    names = ("texels", "level_start", "level_size", "projection", "rays", "centres", "focal")
    depths = ("inverse_depth", "depth_start", "depth_size")
    more = ("origin", "order", "numbers", "members", "blocks", "groups")
    return {
        **{name: getattr(views, name) for name in (*names, *depths)},
        "pooled_depth": views.pooled_depth,
        "pooled_start": views.pooled_start,
        "usable": usable,
        **{name: getattr(index, name) for name in more},
        "plane": renderer.plane.coefficients(),
        "depth_settings": np.array([1.25, 5.0, 1.1, 0.125, 1.05]),
        "penalties": np.array([0.05, 0.03, 1e-6, 1e-4]),
        "most_ranked": 64,
        "smallest_weight": 1e-6,
        "has_mesh": True,
        "mesh": MESH_LIMITS,
    }


SCENES: list[tuple[str, Callable[[Any], object]]] = [
    ("texels", lambda a: a[: len(a) // 2]),
    ("texels", lambda a: a[:, :3].copy()),
    ("level_start", lambda a: a + 10**6),
    ("level_start", lambda a: a - 2**62),
    ("level_size", lambda a: a * 0),
    ("level_size", lambda a: a + 10**4),
    ("level_size", lambda a: a + 2**60),
    ("projection", lambda a: a[1:]),
    ("rays", lambda a: a[:, 0]),
    ("centres", lambda a: a[:, :2].copy()),
    ("inverse_depth", lambda a: a[:-1]),
    ("depth_start", lambda a: a + 1),
    ("depth_start", lambda a: a - 2**62),
    ("depth_size", lambda a: a * [1, 0]),
    ("depth_size", lambda a: -a),
    ("depth_size", lambda a: a + 2**40),
    ("pooled_depth", lambda a: a[:-1]),
    ("pooled_start", lambda a: a + 1),
    ("depth_settings", lambda a: a[:4]),
    ("depth_settings", lambda a: a * np.nan),
    ("depth_settings", lambda a: a + 1e9),
    ("focal", lambda a: a.astype(np.float32)),
    ("usable", lambda a: a[:4]),
    ("order", lambda a: a + 1),
    ("order", lambda a: a - 1),
    ("numbers", lambda a: a[:-1]),
    ("members", lambda a: a + 100),
    ("members", lambda a: a - 2),
    ("blocks", lambda a: a[:-1]),
    ("groups", lambda a: a[:-1]),
    ("plane", lambda a: a[:3]),
    ("penalties", lambda a: a[:3]),
    ("most_ranked", lambda a: 0),
    ("smallest_weight", lambda a: -1.0),
    ("mesh", lambda a: a[:3]),
]


@pytest.mark.parametrize(("name", "spoil"), SCENES)
def test_a_wrong_array_of_a_scene_is_named(name: str, spoil: Callable[[Any], object]) -> None:
    given = scene_arguments()
    native.LightField(**given)
    # Where a level, or a depth map, ends is a matter of three arrays.
    others = {"texels": "level_start", "level_size": "level_start"}
    others |= {"inverse_depth": "depth_start", "pooled_depth": "pooled_start"}
    named = others.get(name, name)
    with pytest.raises((TypeError, ValueError), match=rf"^({name}|{named}): [^\n]+$"):
        native.LightField(**given | {name: spoil(given[name])})


def views_arguments() -> dict[str, Any]:
    camera = SIZES[0]
    _, poses = light_field(1, 12)
    return {
        "poses": poses,
        "intrinsics": camera.vector(),
        "across": tile_borders(camera.width),
        "down": tile_borders(camera.height),
        "probes_across": candidate_positions(camera.width),
        "probes_down": candidate_positions(camera.height),
        "frustum_across": frustum_positions(camera.width),
        "frustum_down": frustum_positions(camera.height),
        "pixels": np.arange(7, dtype=np.int32),
        "width": camera.width,
        "height": camera.height,
        "samples": None,
        "sources": np.zeros((len(poses), 2), np.int32),
        "spacing": 1.0,
    }


def comparison_arguments() -> dict[str, Any]:
    return {
        "query": np.ones((1, 7, 4), np.float32),
        "cost": int(Cost.EVIDENCE),
        "fit_gain": False,
        "limits": np.array([64.0, 32.0, 1.5]),
        "uncovered": np.array([0.06, 0.8, 0.5, 0.5]),
        "table": np.zeros((9, 24), np.float32),
        "evidence_bin": 10.0,
    }


COMPARISONS: list[tuple[str, Callable[[Any], object]]] = [
    ("poses", lambda a: a[0]),
    ("poses", lambda a: a.astype(np.float32)),
    ("intrinsics", lambda a: a[:3]),
    ("across", lambda a: a + 1),
    ("across", lambda a: a[::-1].copy()),
    ("down", lambda a: a - 1),
    ("down", lambda a: a[:1]),
    ("probes_across", lambda a: a + 1),
    ("probes_down", lambda a: a[:3]),
    ("frustum_across", lambda a: a + 1),
    ("frustum_down", lambda a: -a),
    ("pixels", lambda a: a + 24 * 18 - 6),
    ("pixels", lambda a: a - 1),
    ("pixels", lambda a: a[::-1].copy()),
    ("pixels", lambda a: a // 2),
    ("width", lambda a: 0),
    ("height", lambda a: 2**16),
    ("samples", lambda a: 1),
    ("sources", lambda a: a[:-1]),
    ("sources", lambda a: a + 5),
    ("sources", lambda a: a - 2),
    ("spacing", lambda a: 0.5),
    ("spacing", lambda a: np.nan),
    ("query", lambda a: a[:, :6].copy()),
    ("query", lambda a: 9.0 * a),
    ("query", lambda a: np.nan * a),
    ("query", lambda a: -a),
    ("cost", lambda a: 5),
    ("limits", lambda a: a[:2]),
    ("uncovered", lambda a: a[:3]),
    ("table", lambda a: a[0]),
    ("evidence_bin", lambda a: 0.0),
]


@pytest.mark.parametrize(("name", "spoil"), COMPARISONS)
def test_a_wrong_argument_of_a_comparison_is_named(
    name: str, spoil: Callable[[Any], object]
) -> None:
    scene = native.LightField(**scene_arguments())
    views, given = views_arguments(), comparison_arguments()
    assert scene.views(**views).costs(**given).shape == (40,)
    wrong = spoil((views | given)[name])
    with pytest.raises((TypeError, ValueError), match=rf"^{name}: [^\n]+$"):
        if name in views:
            scene.views(**views | {name: wrong})
        else:
            scene.views(**views).costs(**given | {name: wrong})


@pytest.mark.parametrize("name", ["query", "fit_gain", "evidence_bin"])
def test_a_name_that_is_missing_or_too_much_is_said(name: str) -> None:
    views = native.LightField(**scene_arguments()).views(**views_arguments())
    given = comparison_arguments()
    with pytest.raises(TypeError, match=r"^more: no argument of this name expected$"):
        views.costs(**given | {"more": 1})
    del given[name]
    with pytest.raises(TypeError, match=rf"^{name}: an argument of this name expected$"):
        views.costs(**given)


def test_views_outlive_what_they_were_made_of() -> None:
    arguments, given = scene_arguments(), comparison_arguments()
    views = native.LightField(**arguments).views(**views_arguments())
    expected = views.costs(**given)
    del arguments
    gc.collect()
    np.testing.assert_array_equal(views.costs(**given), expected)


def test_samples_of_another_light_field_are_refused() -> None:
    scene = native.LightField(**scene_arguments())
    renderer, poses = light_field(4, 17, quality=Quality.FINE)
    assert renderer._native is not None
    samples = renderer._native.surfaces(poses, SIZES[0]).samples
    with pytest.raises(ValueError, match=r"^samples: those of this light field expected$"):
        scene.views(**views_arguments() | {"samples": samples})


SAMPLES: list[Callable[[Any], object]] = [
    lambda given: tuple(given)[:3],
    list,
    lambda given: given._replace(values=given.values[:-1]),
    lambda given: given._replace(values=given.values[:, :2].copy()),
    lambda given: given._replace(values=given.values.astype(np.float64)),
    lambda given: given._replace(boxes=given.boxes[:, 1:].copy()),
    lambda given: given._replace(starts=given.starts - 1),
    lambda given: given._replace(ends=given.ends + 1),
    lambda given: given._replace(ends=given.ends + 2**40),
    lambda given: given._replace(ends=given.ends[1:]),
]


@pytest.mark.parametrize("spoil", SAMPLES)
def test_wrong_samples_are_refused(spoil: Callable[[Any], object]) -> None:
    scene = native.LightField(**scene_arguments())
    renderer, _ = light_field(5, 11, quality=Quality.FINE)
    samples = take_samples(renderer.views.arrays, np.ones(5, np.bool_), np.ones(5))
    given = views_arguments() | {"samples": samples}
    assert scene.views(**given).render()[1].any()
    with pytest.raises((TypeError, ValueError), match=r"^samples: [^\n]+$"):
        scene.views(**given | {"samples": spoil(samples)})


CHOOSING: list[tuple[str, object]] = [
    ("poses", np.eye(4)),
    ("usual_inverse_depth", -1.0),
    ("turn_cost", np.nan),
    ("most", 0),
]


@pytest.mark.parametrize(("name", "wrong"), CHOOSING)
def test_a_wrong_argument_of_choosing_sources_is_named(name: str, wrong: object) -> None:
    scene = native.LightField(**scene_arguments())
    given: dict[str, Any] = {
        "poses": np.tile(np.eye(4), (3, 1, 1)),
        "usual_inverse_depth": 1.0,
        "turn_cost": 1.5,
        "most": 2,
    }
    assert scene.sources(**given).shape == (3, 2)
    with pytest.raises((TypeError, ValueError), match=rf"^{name}: [^\n]+$"):
        scene.sources(**given | {name: wrong})


def test_sources_are_those_of_the_readable_version() -> None:
    renderer, poses = light_field(30, 18, quality=Quality.FINE)
    assert renderer._native is not None
    sources = renderer._native.surfaces(poses, SIZES[0]).sources
    for pose, found in zip(poses, sources, strict=True):
        np.testing.assert_array_equal(found, source_views(renderer.views, pose))
