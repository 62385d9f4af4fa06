"""Free ground: the part of the floor where a robot can be and see what the views show.

A grid of square cells. It says where to look for a robot, where a rectangle around everything would
hold mostly walls and what lies behind them.
"""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arguments import checked_number
from pipelines.artifacts.arrays import BoolArray, FloatArray, checked_array
from pipelines.artifacts.errors import OptionError


@dataclass(frozen=True)
class FreeGround:
    """Which cells of a grid on the floor are free.

    Attributes:
        corner: ``(2,)`` x and y of the corner of cell (0, 0) with the smallest coordinates, metres.
        cell: side of a cell, metres.
        cells: ``(R, C)`` whether a cell is free; rows go along y, columns along x.

    Raises:
        OptionError: a corner that is not finite, a side that is not positive, or no free cell.
    """

    corner: FloatArray
    cell: float
    cells: BoolArray

    def __post_init__(self) -> None:
        checked_array(self.corner, "the free ground's corner", (2,))
        checked_number(self.cell, "side of a cell")
        if self.cell <= 0.0 or self.cells.ndim != 2 or not self.cells.any():
            raise OptionError(
                "free ground takes cells of a positive side, at least one of them free"
            )

    @property
    def area(self) -> float:
        """Square metres."""
        return int(np.count_nonzero(self.cells)) * self.cell**2

    @property
    def bounds(self) -> FloatArray:
        """``(4,)`` x_min, x_max, y_min, y_max of the free cells, metres."""
        rows, columns = (np.flatnonzero(self.cells.any(axis=axis)) for axis in (1, 0))
        low = self.corner + self.cell * np.array([columns[0], rows[0]])
        high = self.corner + self.cell * np.array([columns[-1] + 1, rows[-1] + 1])
        return np.array([low[0], high[0], low[1], high[1]])

    def contains(self, places: FloatArray) -> BoolArray:
        """Which places ``(M, 2)``, metres, lie in a free cell: ``(M,)``."""
        index = np.floor((places - self.corner) / self.cell)
        inside = np.all((index >= 0.0) & (index < self.cells.shape[::-1]), axis=1)
        column, row = np.where(inside[:, None], index, 0.0).astype(np.int64).T
        return np.asarray(inside & self.cells[row, column])

    def within(self, area: FloatArray) -> "FreeGround | None":
        """The free cells whose centres lie in an area; None where there are none.

        Args:
            area: ``(4,)`` x_min, x_max, y_min, y_max in metres.
        """
        x, y = (
            self.corner[axis] + self.cell * (np.arange(self.cells.shape[1 - axis]) + 0.5)
            for axis in (0, 1)
        )
        rows, columns = (y >= area[2]) & (y <= area[3]), (x >= area[0]) & (x <= area[1])
        cells = self.cells & rows[:, None] & columns
        return FreeGround(self.corner, self.cell, cells) if cells.any() else None

    def sample(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draws places ``(count, 2)``, metres, uniformly."""
        row, column = np.nonzero(self.cells)
        chosen = rng.integers(0, len(row), count)
        cells = np.stack([column[chosen], row[chosen]], axis=1)
        return np.asarray(self.corner + self.cell * (cells + rng.random((count, 2))))

    def distance(self, place: FloatArray) -> float:
        """Metres from a place ``(2,)`` to the nearest free cell; 0 in one."""
        row, column = np.nonzero(self.cells)
        low = self.corner + self.cell * np.stack([column, row], axis=1)
        outside = np.maximum(np.maximum(low - place, place - low - self.cell), 0.0)
        return float(np.sqrt(np.min(np.sum(outside**2, axis=1))))
