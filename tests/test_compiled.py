"""How functions are compiled: what is left out to save time, and that nothing else goes with it."""

import gc
from typing import Any

import numpy as np
import pytest
from numba.core.errors import TypingError

from pipelines.artifacts.array_types import FloatArray
from pipelines.lightfield.compiled import compiled, compiled_leaf


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
