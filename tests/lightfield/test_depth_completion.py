"""Depth that is carried on from the surfaces around, against a slow version."""

import numpy as np
import pytest
from hypothesis import given

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray
from pipelines.lightfield.depth_completion import carry_on
from tests.native.test_depth_kernels import WILD, every_size, seeds, sizes


def slow_completion(inverse_depth: Float32Array, known: BoolArray) -> FloatArray:
    height, width = inverse_depth.shape
    completed = inverse_depth.astype(np.float64)
    for y, x in zip(*np.nonzero(~known), strict=True):
        opinions = []
        for down, right in [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]:
            steps = 1
            while True:
                row, column = y + steps * down, x + steps * right
                if not (0 <= row < height and 0 <= column < width) or known[row, column]:
                    break
                steps += 1
            if not (0 <= row < height and 0 <= column < width):
                continue
            start = float(inverse_depth[row, column])
            rows, columns = np.mgrid[:height, :width]
            rise = inverse_depth.astype(np.float64) - start
            near = (abs(rows - row) <= 12) & (abs(columns - column) <= 12)
            near &= known & (abs(rise) <= 0.06 * start)
            slopes = np.zeros(2)
            if near.sum() >= 40:
                arms = np.stack([rows[near] - row, columns[near] - column])
                slopes = np.linalg.solve(arms @ arms.T + 50.0 * np.eye(2), arms @ rise[near])
            value = start + slopes @ [y - row, x - column]
            opinions.append(
                (np.clip(value, 0.5 * start, 2.0 * start), 1.0 / (steps * np.hypot(down, right)))
            )
        if opinions:
            values, weights = np.array(sorted(opinions)).T
            is_enough = np.cumsum(weights) >= 0.5 * weights.sum() * (1.0 - 1e-12)
            completed[y, x] = values[is_enough][0]
    return completed


@every_size
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_completion_is_that_of_plain_arrays(size: tuple[int, int], share: float) -> None:
    rng = np.random.default_rng(5)
    rows, columns = np.mgrid[: size[0], : size[1]]
    inverse_depth = 0.3 + 0.002 * rows + 0.001 * columns + 0.004 * rng.random(size)
    inverse_depth[:, size[1] // 2 :] *= 1.5
    known = rng.random(size) < share
    found = carry_on(inverse_depth.astype(np.float32), known)
    expected = slow_completion(inverse_depth.astype(np.float32), known)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@given(sizes, seeds)
def test_completion_takes_any_depth(size: tuple[int, int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    wild = rng.choice(WILD, size).astype(np.float32)
    known = rng.random(size) < rng.random()
    completed = carry_on(wild, known)
    np.testing.assert_array_equal(completed[known], wild[known])


def test_images_without_pixels_stay_such() -> None:
    for size in ((0, 0), (0, 5), (5, 0)):
        assert carry_on(np.zeros(size, np.float32), np.zeros(size, np.bool_)).shape == size
