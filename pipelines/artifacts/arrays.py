"""Arrays as arguments: their types' names, as they appear in signatures, and one check of them all.

Shapes stand in the docstrings.
"""

from types import EllipsisType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipelines.artifacts.errors import OptionError, reason_of

FloatArray: TypeAlias = NDArray[np.float64]
Float32Array: TypeAlias = NDArray[np.float32]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]
ImageArray: TypeAlias = NDArray[np.uint8]
Int32Array: TypeAlias = NDArray[np.int32]
# Lengths of axes; None: any; an ellipsis in the first place: any number of axes before the others.
Shape: TypeAlias = tuple[int | EllipsisType | None, ...]


def checked_array(
    value: ArrayLike | None,
    name: str,
    shape: Shape,
    dtype: type[np.generic] = np.float64,
    *,
    finite: bool = True,
) -> NDArray[Any]:
    """An argument as an array of the shape and type that a function works with.

    Args:
        value: what the caller handed over: an array, or nested sequences of numbers.
        name: what the message calls it.
        shape: a length for each axis; None: any length; an ellipsis in the first place: any number
            of axes before the others.
        dtype: the type of the result. What it cannot hold exactly is refused and not rounded:
            colours from 0 to 1 are no 8-bit image.
        finite: whether NaN and infinity are refused.

    Returns:
        The array itself where it has that type already, else a copy.

    Raises:
        OptionError: no such array.
    """
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise OptionError(f"{name}: no array of numbers ({reason_of(error)})") from error
    if not _holds(dtype, array.dtype):
        wanted = np.dtype(dtype)
        found = type(value).__name__ if array.dtype.kind in "OUSV" else str(array.dtype)
        raise OptionError(f"{name} of type {found} instead of an array of {wanted}")
    if not _fits(array.shape, shape):
        raise OptionError(f"{name} of shape {_text(array.shape)} instead of {_text(shape)}")
    if finite and array.dtype.kind == "f" and not np.all(np.isfinite(array)):
        raise OptionError(f"{name}: a number is not finite")
    return array.astype(dtype, copy=False)


def _holds(wanted: type[np.generic], found: np.dtype[Any]) -> bool:
    """Whether numbers of one type are numbers of another; truth values are no numbers."""
    if found == wanted:
        return True
    if (found.kind == "b") != (np.dtype(wanted).kind == "b"):
        return False
    return found.kind in "biuf" and np.can_cast(found, wanted, "safe")


def _fits(found: tuple[int, ...], wanted: Shape) -> bool:
    if wanted[:1] == (...,):
        wanted = wanted[1:]
        found = found[max(0, len(found) - len(wanted)) :]
    return len(found) == len(wanted) and all(
        length in (None, given) for length, given in zip(wanted, found, strict=True)
    )


def _text(shape: Shape) -> str:
    names = [
        "any" if length is None else "..." if length is ... else str(length) for length in shape
    ]
    return f"({', '.join(names)}{',' if len(names) == 1 else ''})"
