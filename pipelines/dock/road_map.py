"""The road map: places where the map's photos were taken, and the ways from one to the next.

Who took the photos could stand at each of these places, and went from one to another of them. In a
world the links between them are those of its index (``lightfield.world_file``), which are cut at
walls where doorways are known. A single scene does not say in which order its photos were taken:
places are linked that lie within a step of each other (``lightfield.recorded_paths``). Whether a
link can be driven is then a matter of the scene's surface (``collision_check``).
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.lightfield.recorded_paths import recorded_paths
from pipelines.lightfield.scene import Scene

# A stored zero is no link for SciPy's graph algorithms.
_SMALLEST_COST = 1e-9


@dataclass(frozen=True)
class RoadMap:
    """A graph of N places on the floor.

    Attributes:
        positions: ``(N, 2)`` metres.
        links: ``(E, 2)`` pairs of places, each pair once.
    """

    positions: FloatArray
    links: IntArray

    @property
    def ends(self) -> tuple[FloatArray, FloatArray]:
        """Where the links begin and end, ``(E, 2)`` each."""
        return self.positions[self.links[:, 0]], self.positions[self.links[:, 1]]


def road_map_of_scene(scene: Scene) -> RoadMap | None:
    """The road map of a single scene; None where no depth map shows which of it can be driven."""
    if not scene.depth:
        return None
    paths = recorded_paths(scene.world_from_camera)
    return RoadMap(paths.positions[:, :2], paths.links)


def cheapest_way(
    road_map: RoadMap, costs: FloatArray, entering: FloatArray, leaving: FloatArray
) -> IntArray | None:
    """The cheapest way from a start over the road map to an end (Dijkstra 1959).

    Args:
        road_map: of N places and E links.
        costs: ``(E,)`` of the links, not negative; infinite: closed.
        entering: ``(N,)`` cost from the start to each place; infinite: it cannot be reached so.
        leaving: ``(N,)`` cost from each place to the end; infinite likewise.

    Returns:
        The places on it, at least one, in the order in which they are passed; None: there is none.
    """
    count = len(road_map.positions)
    places, start, end = np.arange(count), count, count + 1
    first = np.concatenate([road_map.links[:, 0], np.full(count, start), places])
    second = np.concatenate([road_map.links[:, 1], places, np.full(count, end)])
    values = np.concatenate([costs, entering, leaving])
    is_open = np.isfinite(values)
    graph = scipy.sparse.csr_array(
        (np.maximum(values[is_open], _SMALLEST_COST), (first[is_open], second[is_open])),
        shape=(count + 2, count + 2),
    )
    distances, previous = scipy.sparse.csgraph.dijkstra(
        graph, directed=False, indices=np.array([start]), return_predecessors=True
    )
    if not np.isfinite(distances[0, end]):
        return None
    way = [int(previous[0, end])]
    while way[-1] != start:
        way.append(int(previous[0, way[-1]]))
    return np.array(way[-2::-1], dtype=np.int64)
