"""How functions are compiled: what is left out to save time, and that nothing else goes with it."""

import gc
import sys
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba.core.errors import NumbaError, TypingError

from pipelines.artifacts.array_types import FloatArray, IntArray
from pipelines.lightfield.compiled import compiled, compiled_leaf, compiled_part
from pipelines.lightfield.record_type import compiled_record


@compiled_leaf
def raised(value: float, power: int) -> float:
    """A step that others call with constants and with variables."""
    result = 1.0
    for _ in range(power):
        result *= value
    return result


@compiled
def polynomial(value: float, coefficients: FloatArray) -> float:
    """Calls the step in both ways."""
    total = raised(value, 2) - value * value
    for power in range(len(coefficients)):
        total += coefficients[power] * raised(value, power)
    return total


@compiled
def impossible(value: float) -> float:
    """What no compiler can do: text plus a number."""
    return float("one" + value)  # type: ignore[operator]


@compiled_record
class Line(NamedTuple):
    """A record in a record."""

    places: FloatArray
    order: IntArray


@compiled_record
class Drawing(NamedTuple):
    """A record."""

    line: Line
    matrix: FloatArray
    is_open: bool
    scale: float


@compiled_part
def sum_in_order(line: Line, scale: float) -> float:
    """Reads a record that stands in another one, and writes to it."""
    total = 0.0
    for number in line.order:
        total = scale * total + line.places[number]
        line.places[number] = -1.0
    return total


def drawn(drawing: Drawing, count: int) -> float:
    """Uses all that a record holds."""
    total = sum_in_order(drawing.line, drawing.scale)
    for i in range(count):
        drawing.matrix[i, 1] += total
    return total if drawing.is_open else -total


drawn_kernel = compiled(drawn)


@compiled
def wrong_attribute(line: Line) -> float:
    """Reads what a record does not hold."""
    return float(line.nothing)  # type: ignore[attr-defined]


def recompiled(function: object, *arguments: object) -> Any:
    """A compiled function, compiled now and not found on disk."""
    kernel: Any = function
    kernel(*arguments)
    kernel.recompile()
    return kernel


def test_a_step_is_compiled_once_for_constants_and_variables() -> None:
    coefficients = np.array([1.0, -2.0, 0.5])
    expected = np.polyval(coefficients[::-1], 3.0)
    assert recompiled(polynomial, 3.0, coefficients)(3.0, coefficients) == pytest.approx(expected)
    step: Any = raised
    assert len(step.dispatcher.signatures) == 1


def test_a_step_called_from_python_is_the_plain_function() -> None:
    assert raised(3.0, 4) == 81.0


def test_unused_objects_are_searched_for_again_after_compiling() -> None:
    assert gc.isenabled()
    recompiled(polynomial, 3.0, np.ones(2))
    assert gc.isenabled()
    with pytest.raises(TypingError):
        impossible(1.0)
    assert gc.isenabled()
    gc.disable()
    try:
        recompiled(polynomial, 3.0, np.ones(2))
        assert not gc.isenabled()
    finally:
        gc.enable()


@pytest.mark.parametrize("is_open", [True, False])
def test_a_record_is_passed_whole(is_open: bool) -> None:
    line = Line(np.array([1.0, 2.0, 4.0]), np.array([2, 0]))
    drawing = Drawing(line, np.zeros((3, 2)), is_open, 10.0)
    references = [sys.getrefcount(own) for own in (*line, drawing.matrix)]
    sign = 1.0 if is_open else -1.0
    assert recompiled(drawn_kernel, drawing, 0)(drawing, 2) == sign * (10.0 * -1.0 - 1.0)
    # What was written in the first call was read in the second one.
    np.testing.assert_array_equal(line.places, [-1.0, 2.0, -1.0])
    np.testing.assert_array_equal(drawing.matrix, [[0.0, -11.0], [0.0, -11.0], [0.0, 0.0]])
    assert [sys.getrefcount(own) for own in (*line, drawing.matrix)] == references


def test_records_of_other_arrays_are_of_another_type() -> None:
    drawing = Drawing(Line(np.ones(2), np.array([1])), np.zeros((2, 2)), True, 1.0)
    kernel: Any = drawn_kernel
    assert kernel(drawing, 1) == 1.0
    turned = drawing._replace(
        matrix=np.zeros((2, 2)).T, line=drawing.line._replace(places=np.ones(2))
    )
    assert kernel(turned, 1) == 1.0
    assert turned.matrix[0, 1] == 1.0


def test_an_attribute_that_a_record_does_not_have_does_not_compile() -> None:
    with pytest.raises(TypingError, match="nothing"):
        wrong_attribute(Line(np.ones(1), np.zeros(1, np.int64)))


def test_a_function_that_makes_an_array_does_not_compile() -> None:
    @compiled
    def wasteful(count: int) -> float:
        return float(np.zeros(count)[0])

    with pytest.raises(NumbaError):
        wasteful(3)
