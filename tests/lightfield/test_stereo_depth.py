"""Depth from photos, against scenes whose depth and appearance are formulas."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError, StageError
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import Plane
from pipelines.lightfield.depth_completion import complete_depth
from pipelines.lightfield.depth_filtering import fuse_depth, refine_depth_maps
from pipelines.lightfield.stereo_depth import DepthMap, DepthSettings, estimate_depth
from pipelines.lightfield.stereo_neighbours import choose_neighbours, depth_range

PINHOLE = Intrinsics(120, 90, 100.0, 100.0, 59.5, 44.5)
SETTINGS = DepthSettings(largest_side=120, planes=48, neighbours=4)
LIMITS = (1.5, 6.0)
OTHERS = np.array([1, 2, 3, 4])
NO_POINTS, NO_OBSERVATIONS = np.empty((0, 3)), np.empty((0, 2), dtype=np.int64)
# The cameras of these tests look along the world's z axis; this plane lies 3 m before them.
WALL = Plane(np.array([0.0, 0.0, -1.0]), 3.0)

Surface = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


def camera_at(x: float, y: float = 0.0) -> FloatArray:
    pose = np.eye(4)
    pose[:2, 3] = x, y
    return pose


POSES = np.stack(
    [
        camera_at(0.0),
        camera_at(-0.25),
        camera_at(0.25, 0.03),
        camera_at(0.02, 0.2),
        camera_at(-0.03, -0.2),
    ]
)


def texture(x: FloatArray, y: FloatArray) -> FloatArray:
    """Grey levels without repetition, in points of a surface (metres)."""
    waves = [(7.0, 2.0, 0.3), (-3.0, 9.1, 1.1), (17.3, -11.0, 2.0), (23.0, 19.0, 0.7)]
    grey = np.full(x.shape, 127.0)
    for a, b, c in waves:
        grey += 25.0 * np.sin(a * x + b * y + c + np.sin(1.3 * y))
    return grey


def plane_surface(a: float, b: float, c: float) -> Surface:
    """The plane z = a x + b y + c in world coordinates."""

    def at(origin: FloatArray, rays: FloatArray) -> tuple[FloatArray, FloatArray]:
        # Along a ray with z = 1 from height z = 0, the parameter is the depth.
        depth = (a * origin[0] + b * origin[1] + c) / (1.0 - a * rays[..., 0] - b * rays[..., 1])
        points = origin[:2] + rays[..., :2] * depth[..., None]
        return depth, texture(points[..., 0], points[..., 1])

    return at


def card_before_wall(origin: FloatArray, rays: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A square of 0.7 m at 2 m before a wall at 4 m."""
    card_depth, card = plane_surface(0.0, 0.0, 2.0)(origin, rays)
    wall_depth, wall = plane_surface(0.0, 0.0, 4.0)(origin, rays)
    points = origin[:2] + rays[..., :2] * card_depth[..., None]
    on_card = np.all(np.abs(points) < 0.35, axis=-1)
    return np.where(on_card, card_depth, wall_depth), np.where(on_card, 255.0 - card, wall)


def view_of(surface: Surface, pose: FloatArray) -> tuple[FloatArray, ImageArray]:
    """Exact depth ``(H, W)`` and image ``(H, W, 3)``; 9 rays a pixel, as a sensor averages."""
    columns, rows = np.meshgrid(np.arange(PINHOLE.width) * 1.0, np.arange(PINHOLE.height) * 1.0)

    def look(u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        x, y = (u - PINHOLE.cx) / PINHOLE.fx, (v - PINHOLE.cy) / PINHOLE.fy
        return surface(pose[:3, 3], np.stack([x, y, np.ones_like(x)], axis=-1))

    offsets = (-1 / 3, 0.0, 1 / 3)
    samples = [look(columns + u, rows + v)[1] for u in offsets for v in offsets]
    grey = np.clip(np.round(np.mean(np.stack(samples), axis=0)), 0, 255).astype(np.uint8)
    image = np.stack([grey, grey, grey], axis=-1)
    return look(columns, rows)[0], image


def scene_of(surface: Surface) -> tuple[FloatArray, list[ImageArray]]:
    """Exact depth of all views ``(N, H, W)`` and their images."""
    depths, images = zip(*(view_of(surface, pose) for pose in POSES), strict=True)
    return np.stack(depths), list(images)


def estimate(images: Sequence[ImageArray], view: int = 0) -> DepthMap:
    others = np.array([index for index in range(len(POSES)) if index != view])
    intrinsics = [PINHOLE] * len(images)
    return estimate_depth(images, intrinsics, POSES, view, others, LIMITS, SETTINGS)


def relative_error(depth_map: DepthMap, truth: FloatArray) -> FloatArray:
    return np.asarray(np.abs(1.0 / depth_map.inverse_depth / truth - 1.0))


def away_from_border(width: int = 6) -> BoolArray:
    inner = np.zeros((PINHOLE.height, PINHOLE.width), dtype=np.bool_)
    inner[width:-width, width:-width] = True
    return inner


@pytest.mark.parametrize(
    "surface",
    [plane_surface(0.0, 0.0, 2.9), plane_surface(0.6, 0.0, 3.0), plane_surface(-0.2, 0.9, 3.3)],
    ids=["fronto-parallel", "slanted", "like a floor"],
)
def test_planes_are_found_to_one_percent(surface: Surface) -> None:
    depths, images = scene_of(surface)
    found = estimate(images)
    error = relative_error(found, depths[0])[away_from_border()]
    assert np.median(error) < 0.004
    assert np.mean(error < 0.01) > 0.95
    assert np.mean(found.confident) > 0.95


def test_exposure_does_not_matter() -> None:
    depths, images = scene_of(plane_surface(0.6, 0.0, 3.0))
    brighter = [np.minimum(images[0] + np.uint8(20), 255).astype(np.uint8), *images[1:]]
    error = relative_error(estimate(brighter), depths[0])[away_from_border()]
    assert np.mean(error < 0.01) > 0.9


def test_both_layers_are_found_and_the_edge_between_them_lies_right() -> None:
    depths, images = scene_of(card_before_wall)
    maps = [estimate(images, view) for view in range(len(POSES))]
    neighbours = [np.array([j for j in range(5) if j != i]) for i in range(5)]
    refined = refine_depth_maps(maps, POSES, neighbours, SETTINGS)
    error = relative_error(refined[0], depths[0])
    is_card = depths[0] < 3.0
    assert np.mean(error[is_card] < 0.01) > 0.9
    assert np.mean(error[~is_card & away_from_border()] < 0.01) > 0.9
    # The same number of pixels on the card, to one pixel around it.
    found = np.count_nonzero(1.0 / refined[0].inverse_depth < 3.0)
    assert found == pytest.approx(np.count_nonzero(is_card), abs=4 * 35)


def test_images_without_texture_give_finite_depth_and_no_confidence() -> None:
    blank = [np.full((PINHOLE.height, PINHOLE.width, 3), 90, np.uint8)] * len(POSES)
    found = estimate(blank)
    assert np.all(np.isfinite(found.inverse_depth))
    assert np.all((1 / found.inverse_depth > 1.49) & (1 / found.inverse_depth < 6.01))
    assert not np.any(found.confident)
    completed = complete_depth(found)
    np.testing.assert_array_equal(completed.inverse_depth, found.inverse_depth)


def test_a_blank_patch_is_not_confident_while_its_surroundings_are() -> None:
    def surface(origin: FloatArray, rays: FloatArray) -> tuple[FloatArray, FloatArray]:
        depth, grey = plane_surface(0.0, 0.0, 3.0)(origin, rays)
        points = origin[:2] + rays[..., :2] * depth[..., None]
        return depth, np.where(np.all(np.abs(points) < 0.5, axis=-1), 127.0, grey)

    confident = estimate(scene_of(surface)[1]).confident
    assert not np.any(confident[36:54, 50:70])
    assert np.mean(confident[:20]) > 0.95


def test_threads_do_not_change_the_result() -> None:
    _, images = scene_of(card_before_wall)
    views = range(len(POSES))
    one_by_one = [estimate(images, view) for view in views]
    with ThreadPoolExecutor(max_workers=4) as pool:
        together = list(pool.map(lambda view: estimate(images, view), views))
    neighbours = [np.array([j for j in views if j != i]) for i in views]
    first = refine_depth_maps(one_by_one, POSES, neighbours, SETTINGS, workers=1)
    second = refine_depth_maps(together, POSES, neighbours, SETTINGS, workers=4)
    for a, b in zip([*one_by_one, *first], [*together, *second], strict=True):
        assert a.inverse_depth.tobytes() == b.inverse_depth.tobytes()
        assert a.confident.tobytes() == b.confident.tobytes()


def exact_maps(surface: Surface) -> list[DepthMap]:
    depths, _ = scene_of(surface)
    sure = np.ones(depths[0].shape, dtype=np.bool_)
    return [DepthMap((1.0 / depth).astype(np.float32), sure, PINHOLE) for depth in depths]


def test_fusion_mends_what_the_neighbours_know_better() -> None:
    maps = exact_maps(plane_surface(0.6, 0.0, 3.0))
    wrong = maps[0].inverse_depth.copy()
    wrong[30:60, 40:80] *= 1.5
    spoiled = [replace(maps[0], inverse_depth=wrong), *maps[1:]]
    fused = fuse_depth(spoiled, POSES, 0, OTHERS, SETTINGS)
    error = np.abs(fused.inverse_depth / maps[0].inverse_depth - 1.0)
    assert np.max(error[away_from_border()]) < 0.01
    assert np.all(fused.confident[away_from_border()])


def test_what_no_neighbour_sees_is_not_confident() -> None:
    maps = exact_maps(plane_surface(0.0, 0.0, 3.0))
    aside = POSES.copy()
    aside[1:, 0, 3] = 1.5
    fused = fuse_depth(maps, aside, 0, OTHERS, SETTINGS)
    # A camera 1.5 m to the right sees nothing of the left 50 columns of a wall 3 m away.
    assert not np.any(fused.confident[:, :49])
    assert np.mean(fused.confident[:, 52:]) > 0.99
    assert not np.any(fuse_depth(maps, aside, 0, np.empty(0, np.int64), SETTINGS).confident)


def test_a_floor_is_carried_on_as_the_plane_that_it_is() -> None:
    truth = exact_maps(plane_surface(0.2, -0.9, 3.0))[0]
    confident = np.ones_like(truth.confident)
    confident[65:] = False
    holed = replace(
        truth,
        inverse_depth=np.where(confident, truth.inverse_depth, np.float32(0.2)),
        confident=confident,
    )
    completed = complete_depth(holed)
    np.testing.assert_array_equal(completed.confident, confident)
    np.testing.assert_array_equal(completed.inverse_depth[:65], truth.inverse_depth[:65])
    error = np.abs(completed.inverse_depth / truth.inverse_depth - 1.0)[65:]
    assert np.mean(error) < 0.02
    assert np.max(error) < 0.08


def test_neighbours_stand_around_the_view_and_never_look_elsewhere() -> None:
    poses = np.stack([camera_at(0.1 * index) for index in range(21)])
    poses[9, :3, :3] = np.diag([-1.0, 1.0, -1.0])  # looks away from the wall
    chosen = choose_neighbours(poses, [PINHOLE] * 21, WALL, NO_POINTS, NO_OBSERVATIONS, 4)
    assert len(chosen) == 21
    middle = chosen[10]
    assert len(set(middle.tolist())) == 4
    assert not {9, 10} & set(middle.tolist())
    assert np.min(middle) < 10 < np.max(middle)
    # 5 degrees at 3 m are 0.26 m; less than 1 degree tells nothing about depth.
    assert abs(abs(int(middle[0]) - 10) - 2.6) < 2.0


def test_neighbours_without_common_view_are_none() -> None:
    poses = np.stack([camera_at(0.0), camera_at(30.0), camera_at(30.2)])
    chosen = choose_neighbours(poses, [PINHOLE] * 3, WALL, NO_POINTS, NO_OBSERVATIONS, 4)
    assert [indices.tolist() for indices in chosen] == [[], [2], [1]]


def test_shared_points_decide_between_neighbours() -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-1.0, 1.0, (60, 2)), np.full(60, 3.0)])
    poses = np.stack([camera_at(0.0), camera_at(-0.26), camera_at(0.26)])
    matched = np.array([(point, view) for point in range(60) for view in (0, 2)])
    chosen = choose_neighbours(poses, [PINHOLE] * 3, WALL, points, matched, 1)
    assert chosen[0].tolist() == [2]


def test_neighbours_need_two_views_and_a_count() -> None:
    with pytest.raises(StageError, match="at least two"):
        choose_neighbours(POSES[:1], [PINHOLE], WALL, NO_POINTS, NO_OBSERVATIONS, 4)
    with pytest.raises(OptionError, match="at least 1"):
        choose_neighbours(POSES, [PINHOLE] * 5, WALL, NO_POINTS, NO_OBSERVATIONS, 0)


def test_range_from_points_ignores_a_few_wild_ones() -> None:
    depths = np.concatenate([np.linspace(2.0, 5.0, 400), [0.01, 900.0]])
    points = np.column_stack([np.zeros((len(depths), 2)), depths])
    observations = np.column_stack([np.arange(len(depths)), np.zeros(len(depths), np.int64)])
    near, far = depth_range(0, POSES, PINHOLE, WALL, points, observations)
    assert near == pytest.approx(0.85 * 2.0, rel=0.02)
    assert far == pytest.approx(1.25 * 5.0, rel=0.02)


def test_range_from_the_plane_contains_it_with_room() -> None:
    near, far = depth_range(0, POSES, PINHOLE, WALL, NO_POINTS, NO_OBSERVATIONS)
    assert 0.5 < near < 0.5 * 3.0
    assert 2.0 * 3.0 < far < 30.0


def test_impossible_ranges_are_refused() -> None:
    flat = np.zeros_like(POSES)
    flat[:] = camera_at(0.0)
    looking_along = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    with pytest.raises(OptionError, match="no range"):
        depth_range(0, flat, PINHOLE, looking_along, NO_POINTS, NO_OBSERVATIONS)
    _, images = scene_of(plane_surface(0.0, 0.0, 3.0))
    for limits in ((3.0, 3.0), (4.0, 2.0), (0.0, 5.0), (1.0, np.inf), (np.nan, 2.0)):
        with pytest.raises(OptionError, match="no range"):
            estimate_depth(images, [PINHOLE] * 5, POSES, 0, OTHERS, limits, SETTINGS)


def test_one_photo_is_not_enough() -> None:
    _, images = scene_of(plane_surface(0.0, 0.0, 3.0))
    with pytest.raises(StageError, match="no neighbouring photo"):
        estimate_depth(images, [PINHOLE] * 5, POSES, 0, OTHERS[:0], LIMITS, SETTINGS)
    with pytest.raises(StageError, match="no neighbouring photo"):
        estimate_depth(images[:1], [PINHOLE], POSES[:1], 0, OTHERS[:1], LIMITS, SETTINGS)


@pytest.mark.parametrize(
    "change", [{"largest_side": 4}, {"planes": 2}, {"best": 0}, {"agreement": 0.0}]
)
def test_impossible_settings_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(OptionError):
        DepthSettings(**change)  # type: ignore[arg-type]
