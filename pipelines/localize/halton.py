"""The Halton sequence: points more even than random numbers, and the same every time."""

import numpy as np

from pipelines.artifacts.array_types import FloatArray


def radical_inverses(count: int, base: int) -> FloatArray:
    """``(count,)``: 0, 1, 2 ... with their digits mirrored at the point, in [0, 1)."""
    rest, result = np.arange(count), np.zeros(count)
    worth = 1.0 / base
    while rest.any():
        result += worth * (rest % base)
        rest, worth = rest // base, worth / base
    return result
