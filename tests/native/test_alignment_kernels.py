"""Kernels of image alignment in C++ against slow NumPy ones, and what they refuse."""

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipelines import native
from pipelines.artifacts.arrays import Float32Array, FloatArray

SHAPES = [(1, 1), (1, 9), (9, 1), (2, 3), (3, 3), (5, 4), (7, 63), (6, 64), (5, 65), (30, 141)]
FLAT = 10.0
every_shape = pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: f"{shape[1]}x{shape[0]}")


def image(rng: np.random.Generator, shape: tuple[int, int], share: float) -> Float32Array:
    """Smooth in places, and so much of it covered."""
    values = rng.uniform(0.0, 255.0, (*shape, 3))
    values[:, : shape[1] // 3] = 128.0
    covered = rng.random((*shape, 1)) < share
    return np.concatenate([values, covered], axis=2).astype(np.float32)


def changed(rng: np.random.Generator, view: Float32Array, share: float) -> Float32Array:
    """What a camera sees of a view, some of it something else."""
    values = 0.9 * view[..., :3] + 7.0 + rng.normal(0.0, 12.0, (*view.shape[:2], 3))
    other = rng.random(view.shape[:2]) < 0.1
    values[other] = rng.uniform(0.0, 255.0, (int(other.sum()), 3))
    covered = rng.random((*view.shape[:2], 1)) < share
    return np.concatenate([values, covered], axis=2).astype(np.float32)


def pair(shape: tuple[int, int], seed: int, share: float = 0.97) -> list[Float32Array]:
    rng = np.random.default_rng(seed)
    view = image(rng, shape, share)
    return [view, changed(rng, view, share)]


# --- the error ---------------------------------------------------------------------------------


def slow_robust_error(
    view: Float32Array, target: Float32Array, gain: float, offset: float, limit: float
) -> float:
    covered, used = view[..., 3] > 0.0, target[..., 3] > 0.0
    values, wanted = view[..., :3].astype(np.float64), target[..., :3].astype(np.float64)
    ratio = np.abs(gain * values + offset - wanted) / limit
    loss = np.where(ratio < 1.0, 1.0 - (1.0 - ratio**2) ** 3, 1.0)
    loss[~covered] = 1.0
    return float(limit**2 / 6.0 * loss[used].mean()) if used.any() else 0.0


@every_shape
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_the_error_is_that_of_plain_arrays(shape: tuple[int, int], share: float) -> None:
    view, target = pair(shape, 1, share)
    found = native.robust_error(view, target, 1.1, -4.0, 40.0)
    assert found == pytest.approx(slow_robust_error(view, target, 1.1, -4.0, 40.0), rel=2e-6)


def test_an_image_without_pixels_has_no_error() -> None:
    nothing = np.zeros((0, 7, 4), np.float32)
    assert native.robust_error(nothing, nothing, 1.0, 0.0, 40.0) == 0.0


# --- brightness --------------------------------------------------------------------------------


def slow_brightness(
    view: Float32Array, target: Float32Array, stride: int, cutoff: float
) -> tuple[float, float, float]:
    """With exact medians."""
    some = np.s_[::stride, ::stride]
    used = (view[some][..., 3] > 0.0) & (target[some][..., 3] > 0.0)
    values = view[some][used][:, :3].astype(np.float64).reshape(-1)
    wanted = target[some][used][:, :3].astype(np.float64).reshape(-1)
    gain, offset, scale = 1.0, float(np.median(wanted - values)), 10.0
    for step in range(4):
        errors = np.abs(gain * values + offset - wanted)
        scale = max(10.0, 1.4826 * float(np.median(errors)))
        if step == 3:
            break
        weights = np.clip(1.0 - (errors / (cutoff * scale)) ** 2, 0.0, None) ** 2
        mean, wanted_mean = np.average(values, weights=weights), np.average(wanted, weights=weights)
        variance = np.average((values - mean) ** 2, weights=weights)
        if variance < 1.0:
            break
        products = np.average((values - mean) * (wanted - wanted_mean), weights=weights)
        gain = float(np.clip(products / variance, 1.0 / 3.0, 3.0))
        offset = float(wanted_mean - gain * mean)
    return gain, offset, scale


@pytest.mark.parametrize("shape", [(30, 40), (31, 141), (60, 80)])
@pytest.mark.parametrize("stride", [1, 3])
def test_brightness_is_that_of_plain_arrays(shape: tuple[int, int], stride: int) -> None:
    view, target = pair(shape, 2)
    found = native.fitted_brightness(view, target, stride, 4.685, 10.0, 3.0)
    expected = slow_brightness(view, target, stride, 4.685)
    # The medians are those of bins an eighth and a quarter of a grey level wide.
    assert found[0] == pytest.approx(expected[0], abs=2e-3)
    assert found[1] == pytest.approx(expected[1], abs=0.3)
    assert found[2] == pytest.approx(expected[2], abs=0.2)
    assert found[0] == pytest.approx(0.9, abs=0.05)


@every_shape
def test_brightness_of_few_pixels_is_finite(shape: tuple[int, int]) -> None:
    view, target = pair(shape, 3)
    gain, offset, scale = native.fitted_brightness(view, target, 2, 4.685, 10.0, 3.0)
    assert 1.0 / 3.0 <= gain <= 3.0
    assert abs(offset) <= 1000.0
    assert scale >= 10.0


def test_nothing_to_compare_leaves_brightness_as_it_is() -> None:
    view, target = pair((30, 40), 4, share=0.0)
    assert native.fitted_brightness(view, target, 1, 4.685, 10.0, 3.0) == (1.0, 0.0, 10.0)


def test_a_view_of_one_colour_tells_no_gain() -> None:
    view, target = np.full((2, 9, 9, 4), 1.0, np.float32)
    view[..., :3], target[..., :3] = 100.0, 130.0
    gain, offset, _ = native.fitted_brightness(view, target, 1, 4.685, 10.0, 3.0)
    assert gain == 1.0
    assert offset == pytest.approx(30.0, abs=0.25)


# --- normal equations --------------------------------------------------------------------------


def arguments(shape: tuple[int, int], unknowns: int, seed: int = 5) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    view, target = pair(shape, seed)
    rotation = Rotation.from_rotvec(rng.standard_normal(3)).as_matrix()
    axes = np.concatenate([np.eye(3), np.eye(3)])[:unknowns]
    return {
        "image": view,
        "inverse_depth": rng.uniform(0.1, 1.0, shape).astype(np.float32),
        "target": target,
        "gain": 0.95,
        "offset": 3.0,
        "limit": 40.0,
        "flat": FLAT,
        "intrinsics": np.array([50.0, 55.0, shape[1] / 2, shape[0] / 3]),
        "rotation": rotation,
        "lever": rng.standard_normal(3),
        "axes": axes,
        "is_rotation": np.arange(unknowns) >= (2 if unknowns == 3 else 3),
        "tiles_across": 4,
    }


def slow_normal_equations(given: dict[str, Any]) -> tuple[FloatArray, FloatArray]:
    """Pixel by pixel, with the derivative of a projection by the chain rule."""
    view, target = given["image"].astype(np.float64), given["target"].astype(np.float64)
    height, width = view.shape[:2]
    fx, fy, cx, cy = given["intrinsics"]
    unknowns, tiles = len(given["axes"]), given["tiles_across"]
    hessian = np.zeros((unknowns + 2, unknowns + 2))
    gradients = np.zeros((tiles**2, unknowns + 2))
    for y in range(1, height - 1):
        for x in range(1, width - 1):
            cross = [(y, x), (y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1)]
            if target[y, x, 3] == 0.0 or any(view[place][3] == 0.0 for place in cross):
                continue
            across = (view[y, x + 1, :3] - view[y, x - 1, :3]) / 2.0
            down = (view[y + 1, x, :3] - view[y - 1, x, :3]) / 2.0
            if max(np.abs(across).max(), np.abs(down).max()) < FLAT / 2.0:
                continue
            depth = 1.0 / float(given["inverse_depth"][y, x])
            point = depth * np.array([(x - cx) / fx, (y - cy) / fy, 1.0])
            projection = np.array(
                [
                    [fx / depth, 0.0, -fx * point[0] / depth**2],
                    [0.0, fy / depth, -fy * point[1] / depth**2],
                ]
            )
            jacobian = np.empty((3, unknowns + 2))
            for k, (axis, turns) in enumerate(
                zip(given["axes"], given["is_rotation"], strict=True)
            ):
                # Seen from the camera at a lever from the body's origin.
                arm = given["lever"] + given["rotation"] @ point
                motion = np.cross(axis, arm) if turns else axis
                pixels = projection @ (-given["rotation"].T @ motion)
                jacobian[:, k] = -given["gain"] * (across * pixels[0] + down * pixels[1])
            jacobian[:, unknowns] = view[y, x, :3]
            jacobian[:, unknowns + 1] = 1.0
            error = given["gain"] * view[y, x, :3] + given["offset"] - target[y, x, :3]
            weight = np.clip(1.0 - (error / given["limit"]) ** 2, 0.0, None) ** 2
            hessian += jacobian.T @ (weight[:, None] * jacobian)
            tile = y * tiles // height * tiles + x * tiles // width
            gradients[tile] += jacobian.T @ (weight * error)
    return hessian, gradients


@every_shape
@pytest.mark.parametrize("unknowns", [3, 6])
def test_normal_equations_are_those_of_single_pixels(shape: tuple[int, int], unknowns: int) -> None:
    given = arguments(shape, unknowns)
    hessian, gradients = native.normal_equations(**given)
    expected, tiles = slow_normal_equations(given)
    assert hessian.shape == (unknowns + 2, unknowns + 2)
    assert gradients.shape == (16, unknowns + 2)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected))) + 1e-9
    np.testing.assert_allclose(hessian / scale, expected / scale, atol=1e-6)
    largest = np.abs(tiles).max(axis=0) + 1e-9
    np.testing.assert_allclose(gradients / largest, tiles / largest, atol=1e-6)
    np.testing.assert_array_equal(hessian, hessian.T)


def test_what_pixels_hold_that_do_not_count_changes_nothing() -> None:
    given = arguments((30, 70), 6)
    expected = native.normal_equations(**given)
    uncovered, unused = given["image"][..., 3] == 0.0, given["target"][..., 3] == 0.0
    assert uncovered.any()
    assert unused.any()
    given["image"][uncovered, :3] = np.nan
    given["inverse_depth"][uncovered] = np.inf
    given["target"][unused, :3] = np.nan
    for found, wanted in zip(native.normal_equations(**given), expected, strict=True):
        np.testing.assert_array_equal(found, wanted)


def test_images_that_are_no_numbers_lead_nowhere() -> None:
    given = arguments((30, 70), 6)
    for name in ("image", "target", "inverse_depth"):
        for value in (np.nan, np.inf, -np.inf, 3e38):
            worse = given | {name: given[name].copy()}
            worse[name][..., :3] = value
            native.normal_equations(**worse)
            native.robust_error(worse["image"], worse["target"], 1.0, 0.0, 40.0)
            native.fitted_brightness(worse["image"], worse["target"], 1, 4.685, 10.0, 3.0)


# --- arguments ---------------------------------------------------------------------------------


def unaligned(array: Float32Array) -> Float32Array:
    memory = np.zeros(array.nbytes + 1, np.uint8)
    shifted = memory[1:].view(array.dtype).reshape(array.shape)
    shifted[...] = array
    return shifted


ARRAYS: list[tuple[str, Callable[[Any], object], type[Exception], str]] = [
    ("image", lambda a: None, TypeError, "NoneType"),
    ("image", lambda a: a.tolist(), TypeError, "list"),
    ("image", lambda a: a.astype(np.float64), TypeError, "float64"),
    ("image", lambda a: a.astype(">f4"), TypeError, "image"),
    ("image", lambda a: a.astype(object), TypeError, "object"),
    ("image", lambda a: a[..., :3].copy(), ValueError, "(*, *, 4) expected, got (20, 30, 3)"),
    ("image", lambda a: a[0], ValueError, "got (30, 4)"),
    ("image", lambda a: np.float32(1.0), ValueError, "got ()"),
    ("image", lambda a: a[:, ::-1], ValueError, "C order"),
    ("image", np.asfortranarray, ValueError, "C order"),
    ("image", lambda a: np.broadcast_to(a[:1], a.shape), ValueError, "C order"),
    ("image", unaligned, ValueError, "aligned"),
    ("target", lambda a: a[1:], ValueError, "(20, 30, 4) expected, got (19, 30, 4)"),
    ("inverse_depth", lambda a: a.T, ValueError, "(20, 30) expected, got (30, 20)"),
    ("inverse_depth", lambda a: a.astype(np.uint8), TypeError, "uint8"),
    ("intrinsics", lambda a: a[:3], ValueError, "(4,) expected, got (3,)"),
    ("intrinsics", lambda a: a.astype(np.float32), TypeError, "float64"),
    ("rotation", lambda a: a.T, ValueError, "C order"),
    ("lever", lambda a: a[:, None], ValueError, "(3,)"),
    ("axes", lambda a: np.eye(3)[[0] * 7], ValueError, "at most 6"),
    ("is_rotation", lambda a: a[:2], ValueError, "(3,) expected, got (2,)"),
    ("is_rotation", lambda a: a.astype(np.uint8), TypeError, "bool"),
    ("gain", lambda a: "1", TypeError, "str"),
    ("gain", lambda a: np.nan, ValueError, "finite"),
    ("offset", lambda a: np.inf, ValueError, "finite"),
    ("limit", lambda a: 0.0, ValueError, "above 0"),
    ("flat", lambda a: None, TypeError, "NoneType"),
    ("tiles_across", lambda a: 0, ValueError, "from 1"),
    ("tiles_across", lambda a: 2**70, ValueError, "from 1"),
    ("tiles_across", lambda a: 2.5, TypeError, "float"),
]


@pytest.mark.parametrize(("name", "spoil", "kind", "part"), ARRAYS)
def test_a_wrong_argument_is_named_in_one_line(
    name: str, spoil: Callable[[Any], object], kind: type[Exception], part: str
) -> None:
    given = arguments((20, 30), 3)
    native.normal_equations(**given)
    with pytest.raises(kind) as refused:
        native.normal_equations(**given | {name: spoil(given[name])})
    message = str(refused.value)
    assert "\n" not in message
    assert name in message
    assert part in message


@pytest.mark.parametrize("kernel", ["robust_error", "fitted_brightness"])
def test_images_of_different_sizes_are_refused(kernel: str) -> None:
    view, target = pair((20, 30), 6)
    numbers = (1.0, 0.0, 40.0) if kernel == "robust_error" else (1, 4.685, 10.0, 3.0)
    with pytest.raises(ValueError, match=r"^target: shape \(20, 30, 4\) expected, got \(20, 29, 4"):
        getattr(native, kernel)(view, np.ascontiguousarray(target[:, 1:]), *numbers)


@pytest.mark.parametrize(
    ("place", "value"), [(2, 0), (2, -1), (3, 0.0), (4, -1.0), (5, 0.5), (5, np.nan)]
)
def test_settings_of_brightness_are_checked(place: int, value: float) -> None:
    names = ["view", "target", "stride", "cutoff", "smallest_scale", "largest_gain"]
    given: list[Any] = [*pair((20, 30), 6), 1, 4.685, 10.0, 3.0]
    given[place] = value
    with pytest.raises(ValueError, match=f"^{names[place]}: "):
        native.fitted_brightness(*given)


def test_arrays_that_cannot_be_written_to_are_taken() -> None:
    view, target = pair((20, 30), 6)
    expected = native.robust_error(view, target, 1.0, 0.0, 40.0)
    view.flags.writeable = target.flags.writeable = False
    assert native.robust_error(view, target, 1.0, 0.0, 40.0) == expected


# --- threads and processors --------------------------------------------------------------------


@pytest.fixture
def patient_interpreter() -> Iterator[None]:
    """A thread keeps the interpreter lock until it gives it up itself."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(100.0)
    yield
    sys.setswitchinterval(before)


KERNELS: dict[str, Callable[[dict[str, Any]], object]] = {
    "normal_equations": lambda given: native.normal_equations(**given),
    "robust_error": lambda given: native.robust_error(
        given["image"], given["target"], 1.0, 0.0, 40.0
    ),
    "fitted_brightness": lambda given: native.fitted_brightness(
        given["image"], given["target"], 1, 4.685, 10.0, 3.0
    ),
}


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.usefixtures("patient_interpreter")
def test_the_interpreter_lock_is_released(kernel: str) -> None:
    given = arguments((900, 1200), 6)
    begins, ended = threading.Event(), threading.Event()

    def work() -> None:
        begins.set()
        for _ in range(20):
            KERNELS[kernel](given)
        ended.set()

    thread = threading.Thread(target=work)
    thread.start()
    begins.wait()
    # Had the kernel kept the lock, this thread would only get it when all is over.
    assert not ended.is_set()
    thread.join()
    assert ended.is_set()


SUMS = """
from tests.native.test_alignment_kernels import KERNELS, arguments, native
import numpy as np
print(native.instruction_set())
for kernel in KERNELS.values():
    for part in kernel(arguments((30, 70), 6)) if kernel is not KERNELS["robust_error"] else [
        kernel(arguments((30, 70), 6))
    ]:
        print(*np.asarray(part).ravel().tolist())
"""


def results_at(level: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", SUMS],
        env=os.environ | {"LFNAV_INSTRUCTION_SET": level},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.splitlines()


@pytest.mark.parametrize("level", ["baseline", "x86-64-v3", "x86-64-v4"])
def test_all_instruction_sets_agree(level: str) -> None:
    name, *lines = results_at(level)
    if name != level:
        pytest.skip(f"this processor has no {level}")
    parts: list[object] = []
    for kernel in KERNELS.values():
        result = kernel(arguments((30, 70), 6))
        parts.extend(result if isinstance(result, tuple) else [result])
    for line, part in zip(lines, parts, strict=True):
        expected = np.ravel(np.asarray(part, dtype=np.float64))
        found = np.array([float(word) for word in line.split()])
        largest = np.abs(expected).max()
        np.testing.assert_allclose(found / largest, expected / largest, atol=1e-6)
