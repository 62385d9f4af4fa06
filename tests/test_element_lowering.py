"""Elements and rows of arrays in compiled functions, against NumPy's."""

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from numba.core.errors import NumbaError

from pipelines.lightfield.compiled import compiled, compiled_leaf

# Indices of all kinds that occur: constants, whole numbers with and without a sign, long and short.
ROW, COLUMN, LAYER = 2, np.int32(1), np.uintp(3)


@compiled_leaf
def sums(rows: Any, weights: Any) -> float:
    """Reads rows of rows."""
    total = 0.0
    for row in rows:
        for i in range(len(row)):
            total += row[i] * weights[i]
    return total


def read(flat: Any, matrix: Any, block: Any, row: Any, column: Any, layer: Any) -> Any:
    """Elements by all numbers of indices, and views by fewer."""
    return (
        flat[row],
        matrix[row, column],
        matrix[row][column],
        block[row, column, layer],
        block[row, column][layer],
        block[row][column, layer],
        matrix[1, 0],
        block[0, column, 2],
        sums(block[row], block[0, column]),
        block[row].size,
        block[row].shape[0],
        matrix[row].strides[0],
    )


def write(flat: Any, matrix: Any, block: Any, row: Any, column: Any, layer: Any) -> None:
    """The same places, with numbers of other types."""
    flat[row] = 7
    matrix[row, column] = True
    matrix[1][column] = 9
    block[row, column, layer] = np.float32(2.5)
    block[row, 0, 1] = row
    block[0] = 3


read_kernel: Any = compiled(read)
write_kernel: Any = compiled(write)


def arrays(dtype: Any) -> list[Any]:
    """One, two and three dimensions, of small whole numbers."""
    generator = np.random.default_rng(0)
    shapes = ((3,), (3, 2), (3, 2, 4))
    return [generator.integers(0, 2, shape).astype(dtype) for shape in shapes]


def gapped(given: Any) -> Any:
    """The same numbers with gaps between them."""
    wide = np.zeros((*given.shape[:-1], 2 * given.shape[-1]), given.dtype)
    wide[..., ::2] = given
    return wide[..., ::2]


@pytest.mark.parametrize(
    ("dtype", "arrange"),
    [
        (np.float32, np.ascontiguousarray),
        (np.int64, np.ascontiguousarray),
        (np.uint8, np.ascontiguousarray),
        (np.bool_, np.ascontiguousarray),
        (np.float64, gapped),
    ],
)
def test_elements_and_rows_are_those_of_numpy(dtype: Any, arrange: Any) -> None:
    given, expected = [[arrange(own) for own in arrays(dtype)] for _ in range(2)]
    flat, matrix, block = expected
    row, column, layer = ROW, int(COLUMN), int(LAYER)
    wanted = read(flat, matrix, block, row, column, layer)
    assert read_kernel(*given, ROW, COLUMN, LAYER) == pytest.approx(wanted)
    write_kernel(*given, ROW, COLUMN, LAYER)
    write(flat, matrix, block, row, column, layer)
    for own, other in zip(given, expected, strict=True):
        np.testing.assert_array_equal(own, other)


def test_an_index_from_the_end_does_not_compile() -> None:
    @compiled
    def last(values: Any) -> Any:
        return values[-1]

    with pytest.raises(NumbaError, match="counts from the start"):
        last(np.ones(2))


@pytest.mark.parametrize(("index", "is_inside"), [(0, True), (1, True), (2, False), (-1, False)])
def test_with_checks_a_process_ends_at_an_index_outside(index: int, is_inside: bool) -> None:
    code = (
        "import numpy as np\n"
        "from pipelines.lightfield.compiled import compiled\n"
        "kernel = compiled(lambda values, index: values[0, index])\n"
        f"print(kernel(np.array([[5.0, 5.0], [6.0, 6.0]]), {index}))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"LFNAV_CHECK_INDICES": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode == 0, done.stdout) == (is_inside, "5.0\n" if is_inside else "")
    # Ended by a signal, not by an exception.
    assert is_inside or (done.returncode < 0 and done.stderr == "")
