"""How the fast path is compiled: one decorator, so that all kernels agree."""

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compiles a function to machine code on first use and keeps the result on disk.

    It releases the interpreter lock, divides as the processor does (no exception for zero), and may
    fuse multiplication and addition; infinities and NaN keep their meaning.
    """
    decorate = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
    # To callers a compiled function is the function that it was made from.
    return cast("Function", decorate(function))
