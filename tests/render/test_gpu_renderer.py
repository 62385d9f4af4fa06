"""The GPU against the readable renderer and the CPU path.

A GPU computes in single precision. Where a pixel lies within 1e-6 of an image's border, of a depth
map's pixel or of a pyramid level's range, rounding decides; such pixels are rare, and one of them
moves a cost by less than 2e-4.
"""

import zlib
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("wgpu", reason='no wgpu: pip install "lfnav[gpu]"')

from pipelines.artifacts.arrays import Float32Array, FloatArray
from pipelines.artifacts.errors import OptionError, StageError
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane
from pipelines.lightfield.views import Views, build_views
from pipelines.render import gpu_renderer
from pipelines.render.choices import Blending, Cost, Quality
from pipelines.render.comparison import (
    UNCOVERED_GRADIENT,
    UNCOVERED_ROBUST,
    UNCOVERED_SQUARED,
    UNCOVERED_ZNCC,
)
from pipelines.render.gpu_device import Gpu
from pipelines.render.gpu_renderer import GpuRenderer
from pipelines.render.gpu_work import MEMORY_AT_A_TIME, Sizes, tile_bytes
from pipelines.render.reference import render_reference
from pipelines.render.renderer import Renderer
from tests.lightfield_samples import WALL, looking, noise_views, pinhole, tilted_wall
from tests.render.test_evidence_cost import random_evidence
from tests.render.test_renderers_agree import (
    ARRANGEMENTS,
    RESOLUTIONS,
    LightField,
    at_wall,
    beside,
    general,
    grazing,
    many,
    somewhere,
    with_depth,
)

ROUNDING, ONE_PIXEL = 1e-6, 2e-4
CAMERA = pinhole(24, 18, 20.0)
COSTS = tuple(cost for cost in Cost if cost is not Cost.EVIDENCE)


def assert_same_image(
    gpu: Gpu,
    light_field: LightField,
    camera: Intrinsics,
    blending: Blending,
    quality: Quality = Quality.PLANE,
) -> float:
    """The GPU renders what the readable renderer does; returns the share of covered pixels."""
    views, plane, pose = light_field
    expected, covered = render_reference(views, plane, pose, camera, blending, quality)
    renderer = GpuRenderer(views, plane, blending, quality, threads=1, gpu=gpu)
    images, found = renderer.render_many(pose[None], camera)
    np.testing.assert_array_equal(found[0], covered)
    assert np.abs(images[0] - expected).max() < 0.05
    return float(covered.mean())


@pytest.mark.parametrize("blending", Blending)
def test_random_scenes(gpu: Gpu, blending: Blending) -> None:
    coverage = []
    for number, arrangement in enumerate(ARRANGEMENTS):
        # From there all projected centres are infinitely far: which is the nearest is chance.
        if arrangement is beside and blending is Blending.DELAUNAY:
            continue
        generator = np.random.default_rng(zlib.crc32(arrangement.__name__.encode()))
        camera = RESOLUTIONS[number % len(RESOLUTIONS)]
        coverage.append(assert_same_image(gpu, arrangement(generator), camera, blending))
    assert max(coverage) > 0.9
    assert np.mean(coverage) > 0.4


@pytest.mark.parametrize("blending", Blending)
@pytest.mark.parametrize("quality", [Quality.FINE, Quality.MEDIUM])
def test_depth_maps(gpu: Gpu, blending: Blending, quality: Quality) -> None:
    for number, known in enumerate((1.0, 0.7, 0.2)):
        generator = np.random.default_rng([19, number])
        views, plane, pose = general(generator)
        deep = with_depth(views, generator, known)
        camera = RESOLUTIONS[number]
        assert assert_same_image(gpu, (deep, plane, pose), camera, blending, quality) > 0.2


def test_photos_of_many_sizes_seen_from_near_and_far(gpu: Gpu) -> None:
    for number, side in enumerate((24, 9, 4)):
        generator = np.random.default_rng([11, number])
        poses = np.array([looking(somewhere(generator, 2.0, 4.0), at_wall(generator))] * 5)
        poses[:, :3, 3] += generator.normal(0.0, 0.3, (5, 3))
        intrinsics = [
            pinhole(int(width), int(0.7 * width), 0.8 * float(width))
            for width in generator.integers(20, 200, 5)
        ]
        images = [
            generator.integers(0, 256, (camera.height, camera.width, 3)).astype(np.uint8)
            for camera in intrinsics
        ]
        views = build_views(images, intrinsics, poses)
        pose = looking(somewhere(generator, 2.0, 9.0), at_wall(generator))
        camera = pinhole(side, side, 0.9 * side)
        field = views, tilted_wall(generator), pose
        assert_same_image(gpu, field, camera, Blending.UNSTRUCTURED)


def poses_around(generator: np.random.Generator, count: int) -> FloatArray:
    return np.array(
        [looking(somewhere(generator, 1.5, 5.0), at_wall(generator)) for _ in range(count)]
    )


def camera_image(
    renderer: Renderer, pose: FloatArray, camera: Intrinsics, generator: np.random.Generator
) -> Float32Array:
    """What is seen at a pose, brighter, noisy, and with pixels that do not count."""
    image = 1.1 * renderer.render_many(pose[None], camera)[0][0]
    query = np.clip(image + generator.normal(0.0, 15.0, image.shape), 0.0, 255.0)
    query[generator.uniform(size=query.shape[:2]) < 0.1] = np.nan
    return np.asarray(query, dtype=np.float32)


def assert_same_costs(found: FloatArray, expected: FloatArray) -> None:
    assert len(np.unique(expected)) > len(expected) // 2
    difference = np.abs(found - expected)
    assert np.median(difference) < ROUNDING
    assert difference.max() < ONE_PIXEL


@pytest.mark.parametrize("fit_gain", [False, True])
@pytest.mark.parametrize("cost", COSTS)
def test_costs_of_a_plane(gpu: Gpu, cost: Cost, fit_gain: bool) -> None:
    for number, arrangement in enumerate((general, grazing, many)):
        generator = np.random.default_rng([5, number])
        views, plane, pose = arrangement(generator)
        camera = RESOLUTIONS[number]
        renderer = Renderer(views, plane, threads=1)
        poses = np.concatenate([pose[None], poses_around(generator, 30)])
        query = camera_image(renderer, pose, camera, generator)
        expected = renderer.costs(poses, camera, query, cost, fit_gain)
        found = GpuRenderer(views, plane, gpu=gpu).costs(poses, camera, query, cost, fit_gain)
        assert_same_costs(found, expected)


@pytest.mark.parametrize(
    ("blending", "quality"),
    [
        (Blending.DELAUNAY, Quality.PLANE),
        (Blending.DELAUNAY, Quality.MEDIUM),
        (Blending.UNSTRUCTURED, Quality.MEDIUM),
        (Blending.UNSTRUCTURED, Quality.COARSE),
    ],
)
def test_costs_of_nets_and_depth_maps(gpu: Gpu, blending: Blending, quality: Quality) -> None:
    generator = np.random.default_rng(6)
    views, plane, pose = many(generator)
    views = with_depth(views, generator, 0.9)
    renderer = Renderer(views, plane, blending, quality, threads=1)
    poses = np.concatenate([pose[None], poses_around(generator, 40)])
    query = camera_image(renderer, pose, CAMERA, generator)
    on_gpu = GpuRenderer(views, plane, blending, quality, gpu=gpu)
    for cost in (Cost.SQUARED, Cost.ROBUST):
        expected = renderer.costs(poses, CAMERA, query, cost, True)
        assert_same_costs(on_gpu.costs(poses, CAMERA, query, cost, True), expected)


@pytest.mark.parametrize(
    ("blending", "quality"),
    [
        (Blending.UNSTRUCTURED, Quality.PLANE),
        (Blending.DELAUNAY, Quality.PLANE),
        (Blending.UNSTRUCTURED, Quality.MEDIUM),
        (Blending.DELAUNAY, Quality.MEDIUM),
    ],
)
def test_evidence(gpu: Gpu, blending: Blending, quality: Quality) -> None:
    for number, arrangement in enumerate((general, grazing, many)):
        generator = np.random.default_rng([31, number])
        views, plane, pose = arrangement(generator)
        if quality is not Quality.PLANE:
            views = with_depth(views, generator, 0.8)
        camera = RESOLUTIONS[number]
        renderer = Renderer(views, plane, blending, quality, threads=1)
        on_gpu = GpuRenderer(views, plane, blending, quality, gpu=gpu)
        poses = np.concatenate([pose[None], poses_around(generator, 30)])
        query = camera_image(renderer, pose, camera, generator)
        # More rows and columns than pixels in a group of four, and no entry like another.
        evidence = random_evidence(generator)
        expected, found = (
            each.costs(poses, camera, query, Cost.EVIDENCE, False, evidence)
            for each in (renderer, on_gpu)
        )
        # Where a difference lies on the border of two bins, rounding decides; that is rare.
        largest = np.abs(np.diff(evidence.table, axis=1)).max()
        difference = np.abs(found - expected)
        assert np.median(difference) < 1e-3
        assert difference.max() < 3.0 * largest
        # What is not covered adds exactly nothing, the table of the last call is not remembered.
        away = looking([0.2, -2.5, 1.0], [0.1, -9.0, 1.0])[None]
        assert on_gpu.costs(away, camera, query, Cost.EVIDENCE, False, evidence)[0] == 0.0
        doubled = replace(evidence, table=2.0 * evidence.table)
        again = on_gpu.costs(poses, camera, query, Cost.EVIDENCE, False, doubled)
        np.testing.assert_allclose(again, 2.0 * found, rtol=1e-5, atol=1e-4)
        with pytest.raises(OptionError, match="takes a table of evidence"):
            on_gpu.costs(poses, camera, query, Cost.EVIDENCE, False)


def some_work(seed: int) -> tuple[Views, Plane, FloatArray, Float32Array]:
    generator = np.random.default_rng(seed)
    views, plane, pose = many(generator)
    query = camera_image(Renderer(views, plane, threads=1), pose, CAMERA, generator)
    return views, plane, poses_around(generator, 50), query


@pytest.mark.parametrize("blending", Blending)
def test_chunks_and_repetition_change_no_bit(
    gpu: Gpu, blending: Blending, monkeypatch: pytest.MonkeyPatch
) -> None:
    views, plane, poses, query = some_work(1)
    whole = GpuRenderer(views, plane, blending, gpu=gpu)
    # No more workgroups than this, and few of them in one buffer.
    limits = {**gpu.limits, "max-compute-workgroups-per-dimension": 7}
    few = GpuRenderer(views, plane, blending, gpu=replace(gpu, limits=limits))
    for cost in (Cost.SQUARED, Cost.ROBUST):
        expected = whole.costs(poses, CAMERA, query, cost, True)
        for _ in range(2):
            again = whole.costs(poses, CAMERA, query, cost, True)
            np.testing.assert_array_equal(again, expected)
        np.testing.assert_array_equal(few.costs(poses, CAMERA, query, cost, True), expected)
        alone = [whole.costs(pose[None], CAMERA, query, cost, True)[0] for pose in poses[:3]]
        np.testing.assert_array_equal(alone, expected[:3])
        with monkeypatch.context() as patch:
            patch.setattr(gpu_renderer, "POSES_KEPT", 16)
            found = whole.costs(poses, CAMERA, query, cost, True)
            np.testing.assert_array_equal(found, expected)
    images, covered = whole.render_many(poses[:9], CAMERA)
    in_parts, covered_in_parts = few.render_many(poses[:9], CAMERA)
    np.testing.assert_array_equal(in_parts, images)
    np.testing.assert_array_equal(covered_in_parts, covered)
    assert whole.costs(poses[:0], CAMERA, query, Cost.SQUARED, True).shape == (0,)


def test_working_memory_is_bounded_by_the_gpu(gpu: Gpu) -> None:
    camera = pinhole(40, 30, 30.0)
    for largest in (1 << 27, 1 << 20):
        limits = {**gpu.limits, "max-storage-buffer-binding-size": largest}
        limited = replace(gpu, limits=limits)
        sizes = Sizes(camera, tile_bytes(camera), 2.0, has_images=True)
        together = sizes.poses_at_a_time(limited, view_count=28)
        each = sizes.bytes_per_pose()
        assert together >= 1
        assert together * max(each.values()) <= largest
        assert together * sum(each.values()) <= MEMORY_AT_A_TIME
        # The most work for one go, whatever the number of views.
        assert sizes.poses_at_a_time(limited, 10_000_000) < together
    with pytest.raises(OptionError, match=r"4000x3000 pixels is too large .* device cpu"):
        huge = pinhole(4000, 3000, 3000.0)
        Sizes(huge, tile_bytes(huge), 0.0, has_images=True).poses_at_a_time(limited, 28)


def test_a_thousand_views_share_the_cards_layers(gpu: Gpu) -> None:
    generator = np.random.default_rng(3)
    centres = [somewhere(generator, 2.0, 4.0) for _ in range(1000)]
    poses = np.array([looking(centre, at_wall(generator)) for centre in centres])
    images = list(generator.integers(0, 256, (1000, 12, 16, 3)).astype(np.uint8))
    views = build_views(images, [pinhole(16, 12, 14.0)] * 1000, poses)
    query = generator.integers(0, 256, (18, 24, 3)).astype(np.uint8)
    expected = Renderer(views, WALL).costs(poses[:5], CAMERA, query, Cost.SQUARED, False)
    # As many as every GPU has; the fewest with which these views fit; one less.
    for layers, side in ((256, 8192), (1, 1024)):
        limits = {
            **gpu.limits,
            "max-texture-array-layers": layers,
            "max-texture-dimension-2d": side,
        }
        renderer = GpuRenderer(views, WALL, gpu=replace(gpu, limits=limits))
        found = renderer.costs(poses[:5], CAMERA, query, Cost.SQUARED, False)
        np.testing.assert_allclose(found, expected, atol=ONE_PIXEL)
    limits["max-texture-dimension-2d"] = 300
    with pytest.raises(StageError, match=r"1000 photos .* do not fit .* device cpu"):
        GpuRenderer(views, WALL, gpu=replace(gpu, limits=limits))


def test_far_from_the_origin_of_the_world(gpu: Gpu) -> None:
    """Coordinates of kilometres, as of a national grid, cost no accuracy."""
    views, plane, poses, query = some_work(2)
    shift = np.array([412_345.0, 5_654_321.0, 150.0])
    arrays = views.arrays
    projection = arrays.projection.copy()
    projection[:, :, 3] -= projection[:, :, :3] @ shift
    moved = Views(
        arrays._replace(projection=projection, centres=arrays.centres + shift), views.intrinsics
    )
    moved_plane = Plane(plane.normal, plane.offset - float(plane.normal @ shift))
    moved_poses = poses.copy()
    moved_poses[:, :3, 3] += shift
    expected = Renderer(views, plane, threads=1).costs(poses, CAMERA, query, Cost.SQUARED, True)
    on_gpu = GpuRenderer(moved, moved_plane, gpu=gpu)
    assert_same_costs(on_gpu.costs(moved_poses, CAMERA, query, Cost.SQUARED, True), expected)


@pytest.mark.parametrize("blending", Blending)
def test_what_sees_nothing_costs_what_nothing_costs(gpu: Gpu, blending: Blending) -> None:
    generator = np.random.default_rng(4)
    centres = np.array([somewhere(generator, 2.0, 4.0) for _ in range(5)])
    views = noise_views([looking(centre, at_wall(generator)) for centre in centres], generator)
    blind = np.array(
        [
            looking([0.3, -2.0, 1.0], [0.1, -9.0, 1.2]),  # looks away
            looking([0.3, 2.0, 1.0], [0.1, 0.0, 1.2]),  # from behind
            looking([90.0, -2.0, 1.0], [90.0, 0.0, 1.0]),  # no photo there
        ]
    )
    query = generator.integers(0, 256, (18, 24, 3)).astype(np.uint8)
    nothing = UNCOVERED_SQUARED, UNCOVERED_ROBUST, UNCOVERED_ZNCC, UNCOVERED_GRADIENT
    renderer = GpuRenderer(views, WALL, blending, gpu=gpu)
    for cost in COSTS:
        found = renderer.costs(blind, CAMERA, query, cost, False)
        np.testing.assert_allclose(found, nothing[cost], rtol=1e-6)
    assert not renderer.render(blind[0], CAMERA).covered.any()
    # All views behind the plane: none is left.
    behind = Plane(-WALL.normal, 0.0)
    none = GpuRenderer(views, behind, blending, gpu=gpu)
    assert none.costs(blind[1:2], CAMERA, query, Cost.SQUARED, False)[0] == pytest.approx(0.06)


def test_an_image_of_which_nothing_counts(gpu: Gpu) -> None:
    views, plane, poses, query = some_work(5)
    query[:] = np.nan
    renderer = GpuRenderer(views, plane, gpu=gpu)
    reference = Renderer(views, plane, threads=1)
    for cost in COSTS:
        expected = reference.costs(poses[:4], CAMERA, query, cost, False)
        found = renderer.costs(poses[:4], CAMERA, query, cost, False)
        np.testing.assert_allclose(found, expected, atol=1e-7)


def test_impossible_requests_are_refused(gpu: Gpu) -> None:
    views, plane, poses, query = some_work(6)
    renderer = GpuRenderer(views, plane, gpu=gpu)
    with pytest.raises(OptionError, match="24x18"):
        renderer.costs(poses, CAMERA, query[:-1], Cost.SQUARED, False)
    with pytest.raises(OptionError, match="needs depth maps"):
        GpuRenderer(views, plane, quality=Quality.FINE, gpu=gpu)


def test_surfaces_for_the_alignment_are_the_cpus(gpu: Gpu) -> None:
    views, plane, poses, _ = some_work(7)
    found = GpuRenderer(views, plane, gpu=gpu).render_with_surface(poses[0], CAMERA)
    expected = Renderer(views, plane, threads=1).render_with_surface(poses[0], CAMERA)
    np.testing.assert_array_equal(found.image, expected.image)
    np.testing.assert_array_equal(found.inverse_depth, expected.inverse_depth)
