"""Which place belongs to which area of a world."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import h5py
import numpy as np
import scipy

from pipelines.artifacts.arrays import BoolArray, FloatArray, IntArray, checked_array
from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.safe_hdf5 import SafeFile, write_array, write_json

# Farther from the origin no photo was taken, metres.
FARTHEST = 1e8


@dataclass(frozen=True)
class AreaMap:
    """The areas of a world on the floor: a place belongs to the area of the nearest photo.

    Attributes:
        names: of the A areas.
        places: ``(P, 2)`` where photos were taken that are at home in an area, metres.
        home: ``(P,)`` number of the area of each.

    Raises:
        OptionError: shapes that do not fit, no place, one farther away than ``FARTHEST``, or a
            number that is that of no area.
    """

    names: tuple[str, ...]
    places: FloatArray
    home: IntArray

    def __post_init__(self) -> None:
        checked_array(self.places, "places of an area", (None, 2))
        checked_array(self.home, "areas of places", (len(self.places),), np.int64)
        if len(self.places) == 0 or np.any((self.home < 0) | (self.home >= len(self.names))):
            raise OptionError("no place has an area, or one has an area that there is not")
        if np.abs(self.places).max() > FARTHEST:
            raise OptionError(f"a place of an area is more than {FARTHEST:g} m away")

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def _tree(self) -> Any:
        return scipy.spatial.cKDTree(self.places)

    def areas_of(self, places: FloatArray) -> IntArray:
        """The area ``(M,)`` in which each of the places ``(M, 2)``, metres, lies."""
        return np.asarray(self.home[_nearest(self._tree, places)[1]], dtype=np.int64)

    def beside(self, places: FloatArray, area: int, metres: float) -> BoolArray:
        """Which of the places ``(M, 2)`` lie in an area or next to it, ``(M,)``.

        Args:
            places: metres.
            area: its number.
            metres: by so much its nearest photo may be farther than the nearest of all.
        """
        own = self.places[self.home == area]
        if len(own) == 0:
            return np.zeros(len(places), dtype=np.bool_)
        nearest, _ = _nearest(self._tree, places)
        return np.asarray(_nearest(scipy.spatial.cKDTree(own), places)[0] <= nearest + metres)

    def borders(self, places: FloatArray, metres: float) -> BoolArray:
        """Which areas places ``(M, 2)`` lie in or next to, ``(M, A)``.

        Args:
            places: metres.
            metres: by so much the nearest photo of an area may be farther than that of the nearest.
        """
        return np.stack(
            [self.beside(places, area, metres) for area in range(len(self.names))], axis=1
        )

    def near(self, place: FloatArray, metres: float) -> IntArray:
        """Numbers of the areas with a photo taken so near to a place ``(2,)``, rising."""
        return np.unique(self.home[self._tree.query_ball_point(place, metres)]).astype(np.int64)

    def shares(self, places: FloatArray, weights: FloatArray) -> FloatArray:
        """How the weights ``(M,)`` of places ``(M, 2)`` are shared among the areas, ``(A,)``."""
        found = np.bincount(self.areas_of(places), weights=weights, minlength=len(self.names))
        return np.asarray(found, dtype=np.float64)


def _nearest(tree: Any, places: FloatArray) -> tuple[FloatArray, IntArray]:
    """How far the nearest of a tree's points is from each place, and which it is."""
    # The square of a distance must be finite, or no point is the nearest.
    distances, points = tree.query(np.clip(places, -2.0 * FARTHEST, 2.0 * FARTHEST))
    return distances, points


def write_area_map(file: h5py.File, areas: AreaMap) -> None:
    """Stores a map of areas in a file, as the group ``areas``."""
    write_json(file, "areas/names", list(areas.names))
    write_array(file, "areas/places", areas.places)
    write_array(file, "areas/home", areas.home)


def read_area_map(file: SafeFile) -> AreaMap | None:
    """The map of areas in a file; None where it has none.

    Raises:
        InputError: damaged, or of other shapes.
        OptionError: values that do not fit together.
    """
    if not file.has("areas"):
        return None
    return AreaMap(
        tuple(map(str, file.read_json("areas/names"))),
        file.read_array("areas/places", dtype_kind="f", shape=(None, 2)),
        file.read_array("areas/home", dtype_kind="i", shape=(None,)),
    )
