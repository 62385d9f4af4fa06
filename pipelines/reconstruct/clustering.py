"""Clusters of features by their nearest centres, for many features and up to thousands of centres.

Visual words are such centres: of one level for photos that are to be matched, of a tree for a map.
"""

import numpy as np
import scipy

from pipelines.artifacts.arrays import Float32Array, IntArray

# Distances that are in memory at once.
MAX_DISTANCES = 4_000_000


def nearest_centres(
    points: Float32Array, centres: Float32Array, count: int
) -> tuple[IntArray, Float32Array]:
    """The centres that lie nearest to each point.

    Args:
        points: ``(P, D)``.
        centres: ``(C, D)``.
        count: how many a point; in no order where more than one.

    Returns:
        Rows of the centres ``(P, count)``, and squared distances less the points' squared norms.
    """
    numbers = np.empty((len(points), count), dtype=np.int64)
    distances = np.empty((len(points), count), dtype=np.float32)
    lengths = np.sum(centres**2, axis=1)
    step = max(1, MAX_DISTANCES // len(centres))
    for start in range(0, len(points), step):
        rows = slice(start, start + step)
        every = lengths - 2.0 * points[rows] @ centres.T
        if count == 1:
            numbers[rows] = every.argmin(axis=1)[:, None]
        else:
            numbers[rows] = np.argpartition(every, count - 1, axis=1)[:, :count]
        distances[rows] = np.take_along_axis(every, numbers[rows], axis=1)
    return numbers, distances


def k_means(points: Float32Array, start: Float32Array, iterations: int) -> Float32Array:
    """Centres of clusters (Lloyd's algorithm).

    Args:
        points: ``(P, D)``, at least one.
        start: ``(C, D)`` the centres to begin with.
        iterations: how many; later ones move few points.

    Returns:
        ``(C, D)``; a centre without points stays where it is.
    """
    centres, rows = start, np.arange(len(points))
    for _ in range(iterations):
        nearest = nearest_centres(points, centres, 1)[0][:, 0]
        members = scipy.sparse.csr_array(
            (np.ones(len(points), dtype=np.float32), (nearest, rows)),
            shape=(len(centres), len(points)),
        )
        sizes = np.bincount(nearest, minlength=len(centres))[:, None]
        centres = np.where(sizes > 0, members @ points / np.maximum(sizes, 1), centres)
        centres = centres.astype(np.float32)
    return centres
