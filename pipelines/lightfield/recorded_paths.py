"""The graph of recorded positions: where a camera was, and from where to where one can go.

Two photos that were taken within a step of each other are linked. How long a step is follows from
the recording itself: the minimum spanning tree of the positions has an edge a photo, and a step is
a little longer than nearly all of these. So a wall that a recording never passed separates what
stands on both sides of it, as long as the photos keep farther from it than from each other.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
import scipy.spatial

from pipelines.artifacts.arrays import FloatArray, IntArray

# A step: this multiple of a percentile of the edges of the minimum spanning tree.
STEP_PERCENTILE, STEP_MULTIPLE = 99.0, 1.5
# Nearer neighbours than these give the minimum spanning tree; of a place with more photos than that
# the edges are short anyway.
TREE_NEIGHBOURS = 32
# Rows of the table of distances that are computed at once.
_ROWS = 512


@dataclass(frozen=True)
class RecordedPaths:
    """The graph of N recorded positions.

    Attributes:
        positions: ``(N, 3)`` metres, where the cameras were.
        links: ``(E, 2)`` pairs of positions, the smaller index first, in ascending order.
        lengths: ``(E,)`` metres.
        step: the longest link that there can be, metres.
    """

    positions: FloatArray
    links: IntArray
    lengths: FloatArray
    step: float

    def without(self, dropped: IntArray) -> "RecordedPaths":
        """The graph without some of its links, given by their numbers."""
        links, lengths = np.delete(self.links, dropped, 0), np.delete(self.lengths, dropped)
        return RecordedPaths(self.positions, links, lengths, self.step)

    def matrix(self) -> scipy.sparse.csr_array:
        """The lengths as a symmetric ``(N, N)`` matrix; photos from one place are linked too."""
        count = len(self.positions)
        # A stored zero is no link for SciPy's graph algorithms.
        lengths = np.maximum(self.lengths, 1e-9)
        first, second = self.links.T
        rows, columns = np.concatenate([first, second]), np.concatenate([second, first])
        values = np.concatenate([lengths, lengths])
        return scipy.sparse.csr_array((values, (rows, columns)), shape=(count, count))

    def walking_distances(self, farthest: float) -> Iterator[tuple[IntArray, FloatArray]]:
        """How far it is along the links from each position to all others.

        Args:
            farthest: longer ways than this count as infinite.

        Yields:
            Indices ``(R,)`` and the distances ``(R, N)`` from these; all positions in the end.
        """
        graph = self.matrix()
        for start in range(0, len(self.positions), _ROWS):
            rows = np.arange(start, min(start + _ROWS, len(self.positions)))
            yield rows, scipy.sparse.csgraph.dijkstra(graph, indices=rows, limit=farthest)


def recorded_paths(world_from_camera: FloatArray) -> RecordedPaths:
    """Links the positions that lie within a step of each other.

    Args:
        world_from_camera: ``(N, 4, 4)``.
    """
    positions = np.ascontiguousarray(world_from_camera[:, :3, 3])
    tree = scipy.spatial.KDTree(positions)
    step = _step(positions, tree)
    links = tree.query_pairs(step, output_type="ndarray").astype(np.int64).reshape(-1, 2)
    links = links[np.lexsort((links[:, 1], links[:, 0]))]
    lengths = np.linalg.norm(positions[links[:, 0]] - positions[links[:, 1]], axis=1)
    return RecordedPaths(positions, links, lengths, step)


def _step(positions: FloatArray, tree: scipy.spatial.KDTree) -> float:
    """The longest distance that one photo may be from the next on the same path, metres."""
    count = len(positions)
    neighbours = min(TREE_NEIGHBOURS, count)
    if neighbours < 2:
        return 0.0
    distances, columns = tree.query(positions, neighbours)
    rows = np.repeat(np.arange(count), neighbours)
    values = np.maximum(np.ravel(distances), 1e-9)
    near = scipy.sparse.csr_array((values, (rows, columns.ravel())), shape=(count, count))
    edges = scipy.sparse.csgraph.minimum_spanning_tree(near).data
    return STEP_MULTIPLE * float(np.percentile(edges, STEP_PERCENTILE))
