"""Parts of a graph by normalised cuts.

A cut is good when little weight runs across it compared with what either side has in all (Shi and
Malik 2000, "Normalized cuts and image segmentation"). The second eigenvector of the normalised
Laplacian orders the nodes, and the best cut along this order is taken; each part is cut again until
it is small enough. Photos of a city are divided like this in structure from motion (Zhu et al.
2018, "Very large-scale global SfM by distributed motion averaging").
"""

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.csgraph
import scipy.sparse.linalg

from pipelines.artifacts.arrays import FloatArray, IntArray

# Beyond this size the eigenvector is found by iteration.
DENSE_NODES = 1500


def divide_graph(
    weights: scipy.sparse.csr_array, largest: int, smallest: int, natural: float
) -> list[IntArray]:
    """Divides a graph into parts of bounded size along its weakest seams.

    Args:
        weights: symmetric ``(N, N)``, not negative, nothing on the diagonal.
        largest: the most nodes of a part; at least twice ``smallest``.
        smallest: the fewest nodes of a part, where a connected component has as many.
        natural: a part that is small enough is cut on as long as the normalised cut is below this.

    Returns:
        The nodes of each part, ascending; the part with the first node comes first.
    """
    _, labels = scipy.sparse.csgraph.connected_components(weights, directed=False)
    waiting = [np.flatnonzero(labels == label) for label in range(labels.max() + 1)]
    finished = []
    while waiting:
        nodes = waiting.pop()
        if len(nodes) < 2 * smallest:
            finished.append(nodes)
            continue
        inner = scipy.sparse.csr_array(weights[nodes][:, nodes])
        side, cost = _best_cut(inner, smallest)
        if len(nodes) > largest or cost < natural:
            waiting += [nodes[side], nodes[~side]]
        else:
            finished.append(nodes)
    return sorted(finished, key=lambda nodes: int(nodes[0]))


def _best_cut(weights: scipy.sparse.csr_array, smallest: int) -> tuple[IntArray, float]:
    """One side of the best cut as a mask ``(N,)``, and its normalised cost, from 0 to 2."""
    count = weights.shape[0]
    order = np.argsort(_second_eigenvector(weights), kind="stable")
    place = np.empty(count, dtype=np.int64)
    place[order] = np.arange(count)
    edges = scipy.sparse.triu(weights, 1).tocoo()
    ends = np.sort(np.stack([place[edges.row], place[edges.col]]), axis=0)
    # An edge from place i to place j > i crosses the cuts before the places i + 1 to j.
    change = np.zeros(count + 1)
    np.add.at(change, ends[0] + 1, edges.data)
    np.add.at(change, ends[1] + 1, -edges.data)
    crossing = np.cumsum(change)[: count + 1]
    volume = np.concatenate([[0.0], np.cumsum(weights.sum(axis=1)[order])])
    cuts = np.arange(smallest, count - smallest + 1)
    before, after = volume[cuts], volume[-1] - volume[cuts]
    cost = crossing[cuts] / np.maximum(before, 1e-12) + crossing[cuts] / np.maximum(after, 1e-12)
    best = int(np.argmin(cost))
    return place < cuts[best], float(cost[best])


def _second_eigenvector(weights: scipy.sparse.csr_array) -> FloatArray:
    """Of the normalised Laplacian, scaled so that it is the relaxed indicator of the best cut."""
    scale = 1.0 / np.sqrt(np.maximum(weights.sum(axis=1), 1e-12))
    diagonal = scipy.sparse.diags_array(scale)
    similarity = scipy.sparse.csr_array(diagonal @ weights @ diagonal)
    count = weights.shape[0]
    if count <= DENSE_NODES:
        _, vectors = scipy.linalg.eigh(similarity.toarray(), subset_by_index=[count - 2, count - 1])
    else:
        # A start vector of our own: the default is random.
        start = np.cos(np.arange(count))
        values, vectors = scipy.sparse.linalg.eigsh(similarity, k=2, which="LA", v0=start)
        vectors = vectors[:, np.argsort(values)]
    return np.asarray(scale * vectors[:, 0])
