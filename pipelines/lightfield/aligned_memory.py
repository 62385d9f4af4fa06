"""Arrays that begin where a processor's widest vectors may, so that none lies across two lines."""

from typing import Any

import numpy as np

# Bytes of a processor's widest vector, and of a line of its near memory.
ALIGNMENT = 64


def aligned(count: int, dtype: Any) -> Any:
    """An array ``(count,)`` of numbers, not set."""
    size = count * np.dtype(dtype).itemsize
    memory = np.empty(size + ALIGNMENT, np.uint8)
    start = -memory.ctypes.data % ALIGNMENT
    return memory[start : start + size].view(dtype)
