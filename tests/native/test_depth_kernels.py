"""Kernels that make depth maps in C++ against slow NumPy ones, and what they refuse."""

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipelines import native
from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray, ImageArray

SIZES = [(1, 1), (1, 7), (6, 1), (2, 3), (9, 13), (8, 40)]
every_size = pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[1]}x{size[0]}")
sizes = st.tuples(st.integers(1, 12), st.integers(1, 40))
seeds = st.integers(0, 2**32 - 1)
# Any float32, infinities and NaN among them.
WILD = np.array([0.0, -0.0, 1e-40, 0.3, 1.0, -2.0, 1e30, -1e30, np.inf, -np.inf, np.nan])


def photo(rng: np.random.Generator, size: tuple[int, int]) -> ImageArray:
    return rng.integers(0, 256, size, dtype=np.uint8)


def map_between(rng: np.random.Generator, count: int, spread: float = 0.1) -> FloatArray:
    """Some maps (count, 3, 4) that move pixels a little, and more where a surface is near."""
    maps = np.zeros((count, 3, 4))
    maps[:, :, :3] = np.eye(3)
    maps[:, :2] += rng.normal(0.0, spread, (count, 2, 4)) * [1.0, 1.0, 3.0, 30.0]
    maps[:, 2] += rng.normal(0.0, 0.01 * spread, (count, 4))
    return maps


# --- the sweep -----------------------------------------------------------------------------------


def slow_sweep(
    reference: ImageArray,
    photos: list[ImageArray],
    maps: FloatArray,
    levels: FloatArray,
    best: int,
    saturation: float,
) -> FloatArray:
    """Unrounded costs (H, W, D)."""
    height, width = reference.shape
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    grey = np.pad(reference.astype(np.float64), 1, mode="edge")
    costs = np.full((len(photos), height, width, len(levels)), np.nan)
    around = [(y, x) for y in range(3) for x in range(3) if (y, x) != (1, 1)]
    for number, other in enumerate(photos):
        for plane, level in enumerate(levels):
            points = np.stack([columns, rows, np.ones_like(rows), np.full_like(rows, level)])
            u, v, depth = np.einsum("ij,jyx->iyx", maps[number], points)
            u, v = u / np.maximum(depth, 1e-6), v / np.maximum(depth, 1e-6)
            near_u = np.clip(u, 0.0, other.shape[1] - 1)
            near_v = np.clip(v, 0.0, other.shape[0] - 1)
            left, top = np.int64(near_u), np.int64(near_v)
            right = np.minimum(left + 1, other.shape[1] - 1)
            below = np.minimum(top + 1, other.shape[0] - 1)
            across, down = near_u - left, near_v - top
            upper = (1 - across) * other[top, left] + across * other[top, right]
            lower = (1 - across) * other[below, left] + across * other[below, right]
            warped = np.pad((1 - down) * upper + down * lower, 1, mode="edge")
            total = np.zeros((height, width))
            for y, x in around:
                window = np.s_[y : y + height, x : x + width]
                own = grey[window] - grey[1:-1, 1:-1]
                total += np.minimum(abs(own - (warped[window] - warped[1:-1, 1:-1])), saturation)
            away = np.maximum(abs(u - near_u), abs(v - near_v))
            is_seen = (away <= 0.5) & (depth > 1e-6)
            costs[number, ..., plane] = np.where(is_seen, 30.0 * total / saturation, np.nan)
    ordered = np.sort(costs, axis=0)[:best]  # NaN last
    counted = np.isfinite(ordered).sum(axis=0)
    return np.asarray(np.nansum(ordered, axis=0) / np.where(counted > 0, counted, np.nan))


@every_size
@pytest.mark.parametrize("best", [1, 2, 9])
def test_costs_are_those_of_plain_arrays(size: tuple[int, int], best: int) -> None:
    rng = np.random.default_rng(best)
    photos = [photo(rng, shape) for shape in (size, (size[0] + 2, size[1] + 1), (1, 1), (5, 9))]
    maps, levels = map_between(rng, len(photos)), np.linspace(0.05, 1.0, 7)
    arguments = (photo(rng, size), photos, maps, levels, best, 20.0)
    found = native.plane_sweep(*arguments)
    expected = slow_sweep(*arguments)
    is_seen = np.isfinite(expected)
    np.testing.assert_allclose(found[is_seen], expected[is_seen], atol=0.51)
    # Where none of the photos shows the pixel: the mean of its other planes.
    counted = is_seen.sum(axis=2)
    mean = np.where(is_seen, found, 0).sum(axis=2) // np.maximum(counted, 1)
    expected_mean = np.broadcast_to(mean[..., None], found.shape)
    np.testing.assert_array_equal(found[~is_seen], expected_mean[~is_seen])


def test_the_same_photo_from_the_same_place_costs_nothing() -> None:
    image = photo(np.random.default_rng(0), (20, 31))
    still = np.eye(3, 4)[None]
    assert not native.plane_sweep(image, [image], still, np.array([0.1, 2.0]), 1, 20.0).any()


def test_exposure_costs_nothing() -> None:
    image = photo(np.random.default_rng(0), (20, 31)) // np.uint8(2)
    brighter = (image + np.uint8(90)).astype(np.uint8)
    assert not native.plane_sweep(image, [brighter], np.eye(3, 4)[None], np.ones(1), 1, 9.0).any()


@given(sizes, sizes, seeds)
def test_no_map_leads_out_of_a_photo(
    size: tuple[int, int], other: tuple[int, int], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    photos = [photo(rng, other), photo(rng, size)]
    maps = rng.choice(WILD, (2, 3, 4))
    maps[1] = map_between(rng, 1, spread=10.0)[0]
    levels = rng.choice(WILD, 5)
    volume = native.plane_sweep(photo(rng, size), photos, maps, levels, 2, 20.0)
    assert volume.shape == (*size, 5)
    assert volume.max() <= 240


# --- semi-global matching ------------------------------------------------------------------------

PENALTIES = (6.0, 110.0, 10.0, 12.0)


def slow_matching(
    volume: ImageArray,
    reference: ImageArray,
    step: float,
    jump: float,
    edge_contrast: float,
    least_jump: float,
) -> tuple[FloatArray, FloatArray]:
    height, width, planes = volume.shape
    costs, grey = volume.astype(np.float64), reference.astype(np.float64)
    total = np.zeros_like(costs)
    for down, right in [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if (y, x) != (0, 0)]:
        path = costs.copy()
        for y in range(height)[:: -1 if down < 0 else 1]:
            for x in range(width)[:: -1 if right < 0 else 1]:
                from_y, from_x = y - down, x - right
                if not (0 <= from_y < height and 0 <= from_x < width):
                    continue
                before = path[from_y, from_x]
                contrast = abs(grey[y, x] - grey[from_y, from_x])
                leap = max(jump / (1.0 + contrast / edge_contrast), least_jump)
                beside = np.pad(before, 1, constant_values=np.inf)
                way = np.minimum(beside[:-2], beside[2:]) + step
                way = np.minimum(np.minimum(way, before), before.min() + leap)
                path[y, x] = costs[y, x] + way - before.min()
        total += path
    index = np.zeros((height, width))
    for y in range(height):
        for x in range(width):
            sums, best = total[y, x], int(np.argmin(total[y, x]))
            index[y, x] = best
            if 0 < best < planes - 1:
                ahead, behind = sums[best - 1] - sums[best], sums[best + 1] - sums[best]
                if max(ahead, behind) > 0.0:
                    index[y, x] += 0.5 * (ahead - behind) / max(ahead, behind)
    chosen = (index + 0.5).astype(np.int64)[..., None]
    return index, costs.mean(axis=2) - np.take_along_axis(costs, chosen, axis=2)[..., 0]


@every_size
@pytest.mark.parametrize("planes", [1, 2, 15, 16, 17, 33])
def test_matching_is_that_of_plain_arrays(size: tuple[int, int], planes: int) -> None:
    rng = np.random.default_rng(planes)
    volume = rng.integers(0, 241, (*size, planes), dtype=np.uint8)
    reference = photo(rng, size)
    for penalties in (PENALTIES, (0.37, 51.0, 2.0, 0.4)):
        index, distinct = native.semi_global_matching(volume, reference, *penalties)
        expected_index, expected_distinct = slow_matching(volume, reference, *penalties)
        np.testing.assert_allclose(index, expected_index, atol=1e-4)
        np.testing.assert_allclose(distinct, expected_distinct, atol=1e-3)


def test_without_penalties_each_pixel_is_on_its_own() -> None:
    rng = np.random.default_rng(0)
    volume = rng.integers(0, 241, (5, 9, 20), dtype=np.uint8)
    index, _ = native.semi_global_matching(volume, photo(rng, (5, 9)), 0.0, 0.0, 1.0, 0.0)
    np.testing.assert_array_equal(np.round(index), volume.argmin(axis=2))


@given(sizes, st.integers(1, 40), seeds)
def test_planes_are_among_those_tried(size: tuple[int, int], planes: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    volume = rng.choice(np.array([0, 1, 200, 255], np.uint8), (*size, planes))
    penalties = 10.0 ** rng.uniform(-6.0, 6.0, 4)
    index, distinct = native.semi_global_matching(volume, photo(rng, size), *penalties)
    assert np.all((index >= 0.0) & (index <= planes - 1))
    assert np.all(np.abs(distinct) <= 255.0)


# --- fusion --------------------------------------------------------------------------------------


def slow_fusion(
    own: Float32Array,
    others: list[Float32Array],
    confident: list[BoolArray],
    to_view: FloatArray,
    from_view: FloatArray,
    unsure_trust: float,
    agreement: float,
) -> tuple[FloatArray, FloatArray]:
    height, width = own.shape

    def place(mapping: FloatArray, x: int, y: int, q: float) -> tuple[int, int, float] | None:
        u, v, depth = mapping @ [x, y, 1.0, q]
        if depth <= 1e-6:
            return None
        return int(np.floor(v / depth + 0.5)), int(np.floor(u / depth + 0.5)), q / depth

    def inside(found: tuple[int, int, float] | None, shape: tuple[int, ...]) -> bool:
        return found is not None and 0 <= found[0] < shape[0] and 0 <= found[1] < shape[1]

    candidates = [own.astype(np.float64)]
    for other, mapping in zip(others, to_view, strict=True):
        seen = np.zeros((height, width))
        for y, x in np.ndindex(*other.shape):
            found = place(mapping, x, y, float(other[y, x]))
            if found is not None and inside(found, own.shape):
                seen[found[:2]] = max(seen[found[:2]], np.float32(found[2]))
        candidates.append(seen)
    votes = np.zeros((len(candidates), height, width))
    for number, candidate in enumerate(candidates):
        for other, sure, mapping in zip(others, confident, from_view, strict=True):
            for y, x in np.ndindex(height, width):
                found = place(mapping, x, y, float(candidate[y, x]))
                if candidate[y, x] <= 0.0 or found is None or not inside(found, other.shape):
                    continue
                trust = 1.0 if sure[found[:2]] else unsure_trust
                gap = float(other[found[:2]]) - found[2]
                if abs(gap) <= agreement * found[2]:
                    votes[number, y, x] += trust
                elif gap < 0.0:
                    votes[number, y, x] -= trust
    fused, most = np.zeros((height, width)), np.zeros((height, width))
    for y, x in np.ndindex(height, width):
        best, limit = 0, votes[0, y, x] + 0.5
        for number in range(1, len(candidates)):
            if candidates[number][y, x] > 0.0 and votes[number, y, x] > limit:
                best, limit = number, votes[number, y, x]
        values = np.array([candidate[y, x] for candidate in candidates])
        agreeing = abs(values - values[best]) <= agreement * values[best]
        fused[y, x], most[y, x] = values[agreeing].mean(), votes[best, y, x]
    return fused, most


@every_size
@pytest.mark.parametrize("count", [0, 1, 4])
def test_fusion_is_that_of_plain_arrays(size: tuple[int, int], count: int) -> None:
    rng = np.random.default_rng(count)

    def depth(shape: tuple[int, int]) -> Float32Array:
        return (0.3 * rng.choice([1.0, 1.01, 1.3], shape)).astype(np.float32)

    others = [depth((size[0] + number, size[1] + 2)) for number in range(count)]
    confident = [rng.random(other.shape) < 0.5 for other in others]
    to_view, from_view = map_between(rng, count, 0.02), map_between(rng, count, 0.02)
    arguments = (depth(size), others, confident, to_view, from_view, 0.5, 0.02)
    found, votes = native.fuse_depth(*arguments)
    expected, expected_votes = slow_fusion(*arguments)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    np.testing.assert_allclose(votes, expected_votes, atol=1e-6)


@given(sizes, sizes, seeds)
def test_no_depth_leads_out_of_a_map(
    size: tuple[int, int], other: tuple[int, int], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    wild = [rng.choice(WILD, shape).astype(np.float32) for shape in (size, other, size)]
    confident = [rng.random(shape) < 0.5 for shape in (other, size)]
    maps = [rng.choice(WILD, (2, 3, 4)), map_between(rng, 2, 10.0)]
    for to_view, from_view in (maps, maps[::-1]):
        fused, votes = native.fuse_depth(
            wild[0], wild[1:], confident, to_view, from_view, 0.5, 0.02
        )
        assert fused.shape == votes.shape == size


# --- all of them ---------------------------------------------------------------------------------


def sample(name: str) -> tuple[Any, ...]:
    """Arguments of a kernel."""
    rng = np.random.default_rng(0)
    size = (30, 53)
    depth = rng.uniform(0.2, 0.3, (3, *size)).astype(np.float32)
    sure = rng.random((3, *size)) < 0.7
    maps = map_between(rng, 2, 0.02)
    smooth = cv2.GaussianBlur(photo(rng, size), (0, 0), 2.0)
    if name == "plane_sweep":
        return (smooth, [smooth, photo(rng, size)], maps, np.linspace(0.1, 1.0, 21), 2, 20.0)
    if name == "semi_global_matching":
        return (rng.integers(0, 241, (*size, 21), dtype=np.uint8), smooth, *PENALTIES)
    return (depth[0], list(depth[1:]), list(sure[1:]), maps, maps, 0.5, 0.02)


NAMES = ("plane_sweep", "semi_global_matching", "fuse_depth")
every_kernel = pytest.mark.parametrize("name", NAMES)


def results(name: str) -> list[FloatArray]:
    found = getattr(native, name)(*sample(name))
    parts = found if isinstance(found, tuple) else (found,)
    return [np.asarray(part, dtype=np.float64) for part in parts]


@every_kernel
def test_threads_change_nothing(name: str) -> None:
    alone = results(name)
    with ThreadPoolExecutor(4) as pool:
        for together in pool.map(lambda _: results(name), range(8)):
            for first, second in zip(alone, together, strict=True):
                np.testing.assert_array_equal(first, second)


LEVEL_SCRIPT = """
import sys
import numpy as np
from pipelines import native
from tests.native.test_depth_kernels import NAMES, results
np.savez(sys.argv[1], *[part for name in NAMES for part in results(name)])
print(native.instruction_set())
"""


@pytest.mark.parametrize("level", ["baseline", "x86-64-v3", "x86-64-v4"])
def test_all_instruction_sets_agree(level: str, tmp_path: Any) -> None:
    done = subprocess.run(
        [sys.executable, "-c", LEVEL_SCRIPT, str(tmp_path / "results.npz")],
        env=os.environ | {"LFNAV_INSTRUCTION_SET": level},
        capture_output=True,
        text=True,
        check=True,
    )
    if done.stdout.strip() != level:
        pytest.skip(f"this processor has no {level}")
    own = [part for name in NAMES for part in results(name)]
    with np.load(tmp_path / "results.npz") as other:
        for first, second in zip(own, other.values(), strict=True):
            # Costs are rounded to integers: what is between two may go either way.
            away = np.abs(first - second) > 1e-5 * np.maximum(np.abs(first), 1.0)
            assert np.mean(away) < 0.01
            assert np.max(np.abs(first - second)) <= 1.0


@every_kernel
def test_images_without_pixels_give_such(name: str) -> None:
    for size in ((0, 0), (0, 5), (5, 0)):
        grey, depth = np.zeros(size, np.uint8), np.zeros(size, np.float32)
        arguments: dict[str, tuple[Any, ...]] = {
            "plane_sweep": (grey, [], np.zeros((0, 3, 4)), np.ones(3), 1, 20.0),
            "semi_global_matching": (np.zeros((*size, 3), np.uint8), grey, *PENALTIES),
            "fuse_depth": (depth, [], [], np.zeros((0, 3, 4)), np.zeros((0, 3, 4)), 0.5, 0.02),
        }
        found = getattr(native, name)(*arguments[name])
        for part in found if isinstance(found, tuple) else (found,):
            assert part.shape[:2] == size


def test_many_planes_are_counted_exactly_and_more_refused() -> None:
    volume = np.full((1, 1, 65536), 9, np.uint8)
    volume[0, 0, -1] = 0
    index, distinct = native.semi_global_matching(volume, IMAGE[:1, :1], *PENALTIES)
    assert index[0, 0] == 65535.0
    assert distinct[0, 0] == pytest.approx(9.0, abs=1e-3)
    more = np.zeros((1, 1, 65537), np.uint8)
    with pytest.raises(ValueError, match="volume: from 1 to 65536 planes"):
        native.semi_global_matching(more, IMAGE[:1, :1], *PENALTIES)


def test_no_planes_and_no_photos() -> None:
    image = np.zeros((3, 4), np.uint8)
    nothing = np.zeros((0, 3, 4))
    assert native.plane_sweep(image, [], nothing, np.zeros(0), 1, 20.0).shape == (3, 4, 0)
    assert not native.plane_sweep(image, [], nothing, np.ones(3), 1, 20.0).any()


def with_changed(name: str, position: int, value: object) -> Callable[[], object]:
    arguments = list(sample(name))
    arguments[position] = value
    return lambda: getattr(native, name)(*arguments)


IMAGE, DEPTH = np.zeros((30, 53), np.uint8), np.zeros((30, 53), np.float32)
NO_WIDTH = np.zeros((4, 0), np.uint8)


@pytest.mark.parametrize(
    ("name", "position", "value", "message"),
    [
        ("plane_sweep", 0, IMAGE.astype(np.int16), "reference: an array of uint8"),
        ("plane_sweep", 0, IMAGE[:, ::2], "reference: an array in C order"),
        ("plane_sweep", 0, IMAGE[0], "reference: shape"),
        ("plane_sweep", 0, None, "reference: an array of uint8 expected, got NoneType"),
        ("plane_sweep", 0, np.zeros((1, 40_000), np.uint8), "reference: sides of at most 32768"),
        ("plane_sweep", 1, 3, "photos: a list of arrays expected"),
        ("plane_sweep", 1, [IMAGE], r"maps: shape \(1, 3, 4\) expected, got \(2, 3, 4\)"),
        ("plane_sweep", 1, [IMAGE, "a"], r"photos\[1\]: an array of uint8 expected, got str"),
        ("plane_sweep", 1, [NO_WIDTH, IMAGE], r"photos\[0\]: an image without pixels"),
        ("plane_sweep", 2, np.zeros((2, 4, 4)), "maps: shape"),
        ("plane_sweep", 3, np.zeros((2, 2)), "inverse_depths: shape"),
        ("plane_sweep", 4, 0, "best: an integer from 1"),
        ("plane_sweep", 4, 1.5, "best: an integer expected, got float"),
        ("plane_sweep", 5, 0.0, "saturation: a number above 0"),
        ("plane_sweep", 5, np.nan, "saturation: a finite number"),
        ("semi_global_matching", 0, IMAGE, "volume: shape"),
        ("semi_global_matching", 0, np.zeros((30, 52, 4), np.uint8), "volume: shape"),
        ("semi_global_matching", 0, np.zeros((30, 53, 0), np.uint8), "volume: from 1 to 65536"),
        ("semi_global_matching", 2, -1.0, "step_penalty: at least 0"),
        ("semi_global_matching", 3, 1e9, r"jump_penalty: at most 1e\+06"),
        ("semi_global_matching", 4, 0.0, "edge_contrast: at least 1e-06"),
        ("semi_global_matching", 5, np.inf, "least_jump: a finite number"),
        ("fuse_depth", 0, DEPTH.astype(np.float64), "inverse_depth: an array of float32"),
        ("fuse_depth", 1, [DEPTH], "confident: as many as others expected"),
        ("fuse_depth", 1, [DEPTH[1:], DEPTH], "confident: sizes as of others expected"),
        ("fuse_depth", 2, [DEPTH, DEPTH], r"confident\[0\]: an array of bool"),
        ("fuse_depth", 3, np.zeros((1, 3, 4)), "to_view: shape"),
        ("fuse_depth", 4, np.zeros((2, 12)), "from_view: shape"),
        ("fuse_depth", 5, -1.0, "unsure_trust: at least 0"),
        ("fuse_depth", 6, "much", "agreement: a number expected, got str"),
        ("fuse_depth", 0, DEPTH.T, "inverse_depth: an array in C order"),
    ],
)
def test_other_arguments_are_one_line(
    name: str, position: int, value: object, message: str
) -> None:
    with pytest.raises((TypeError, ValueError), match=f"^{message}") as caught:
        with_changed(name, position, value)()
    assert "\n" not in str(caught.value)
