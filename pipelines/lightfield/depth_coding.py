"""Prediction of depth maps within themselves, by which they compress well."""

import numpy as np
from numpy.typing import NDArray


def differences_of(levels: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """What a plane through the pixels on the left, above and diagonally above fails to predict.

    On surfaces that are flat in space inverse depth is linear in the image, so that nearly all
    that is left is small. Signs alternate (0, -1, 1, -2, ...) so that small numbers have small
    bytes; arithmetic is modulo 2^16 and loses nothing.

    Args:
        levels: ``(h, w)``.

    Returns:
        ``(h, w)``; ``levels_of`` turns it back.
    """
    zero = np.uint16(0)
    signed = np.diff(np.diff(levels, axis=0, prepend=zero), axis=1, prepend=zero).view(np.int16)
    return ((signed << 1) ^ (signed >> 15)).view(np.uint16)


def levels_of(differences: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """The levels ``(h, w)`` of which ``differences_of`` made these."""
    wrapped = (differences >> 1) ^ (np.uint16(0) - (differences & 1))
    return np.cumsum(np.cumsum(wrapped, axis=1, dtype=np.uint16), axis=0, dtype=np.uint16)
