"""Visual words: a vocabulary of local features, learnt from the photos of the map.

A tree of two levels (Nister, Stewenius 2006, "Scalable recognition with a vocabulary tree"): a
feature belongs to the nearest of K centres, and there to the nearest of that centre's own K, its
word. A word is coarse. What it leaves of the feature is kept as 64 signs, its signature (Hamming
embedding, Jegou, Douze, Schmid 2008): features that show the same differ in few of them.
"""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import Float32Array, IntArray
from pipelines.reconstruct.clustering import k_means, nearest_centres

# A signature has a bit for each of so many principal components.
DIMENSIONS = 64
# Features a word on average, and limits to the number K of centres a level.
FEATURES_A_WORD = 24
MIN_CENTRES, MAX_CENTRES = 4, 192
# Iterations of k-means; later ones move few features.
ITERATIONS = 8
# Features a word from which the centres are learnt, at most.
LEARNT_A_WORD = 16
# Principal components are those of so many features.
PRINCIPAL_SAMPLE = 50_000
# Other words that are looked up beside the nearest one lie in so many of the first level's cells.
NEAR_CELLS = 2


@dataclass(frozen=True)
class Vocabulary:
    """A tree of visual words.

    Attributes:
        mean: ``(128,)`` of descriptors.
        projection: ``(128, 64)`` onto principal components, which are then rotated at random, so
            that each has its share of the variance.
        coarse: ``(K, 64)`` centres of the first level, projected.
        fine: ``(K, K, 64)`` centres of the second level; word ``K i + j`` has centre ``[i, j]``.
    """

    mean: Float32Array
    projection: Float32Array
    coarse: Float32Array
    fine: Float32Array

    @property
    def words(self) -> int:
        """How many there are."""
        return len(self.coarse) ** 2

    def quantise(
        self, descriptors: Float32Array, count: int = 1
    ) -> tuple[IntArray, np.ndarray[tuple[int, ...], np.dtype[np.uint64]]]:
        """The words of features, and their signatures.

        Args:
            descriptors: ``(F, 128)`` unit vectors.
            count: how many of the nearest words, at most K.

        Returns:
            Words ``(F, count)``, nearest first, and for each the signature ``(F, count)``.
        """
        points = np.asarray((descriptors - self.mean) @ self.projection, dtype=np.float32)
        words, distances = self._candidates(points, count)
        order = np.argsort(distances, axis=1, kind="stable")[:, :count]
        words = np.take_along_axis(words, order, axis=1)
        centres = self.fine.reshape(-1, DIMENSIONS)[words]
        bits = np.packbits(points[:, None] > centres, axis=2)
        return words, np.ascontiguousarray(bits).view(np.uint64)[..., 0]

    def _candidates(self, points: Float32Array, count: int) -> tuple[IntArray, Float32Array]:
        """Of each near cell the ``count`` nearest words, and their distances, less a constant."""
        size = len(self.coarse)
        cells = 1 if count == 1 else NEAR_CELLS
        near = nearest_centres(points, self.coarse, cells)[0]
        words = np.empty((len(points), cells, count), dtype=np.int64)
        distances = np.empty((len(points), cells, count), dtype=np.float32)
        for column in range(cells):
            order = np.argsort(near[:, column], kind="stable")
            ends = np.searchsorted(near[order, column], np.arange(size + 1))
            for cell in np.flatnonzero(np.diff(ends)):
                rows = order[ends[cell] : ends[cell + 1]]
                found, distance = nearest_centres(points[rows], self.fine[cell], count)
                words[rows, column] = size * cell + found
                distances[rows, column] = distance
        shape = len(points), cells * count
        return words.reshape(shape), distances.reshape(shape)


def learn_vocabulary(
    descriptors: Float32Array, features: int, rng: np.random.Generator
) -> Vocabulary:
    """A vocabulary for a map.

    Args:
        descriptors: ``(S, 128)`` unit vectors, a sample of the map's, at least one.
        features: how many features the whole map has: the more, the more words.
        rng: draws the first centres and the rotation.
    """
    mean = descriptors.mean(axis=0)
    some = descriptors[:: 1 + len(descriptors) // PRINCIPAL_SAMPLE] - mean
    components = np.linalg.eigh(some.T @ some)[1][:, : -DIMENSIONS - 1 : -1]
    rotation = np.linalg.qr(rng.standard_normal((DIMENSIONS, DIMENSIONS)))[0]
    projection = (components @ rotation).astype(np.float32)
    points = descriptors @ projection - mean @ projection
    size = centres_for(features)
    coarse = _centres(points, size, rng)
    cell = nearest_centres(points, coarse, 1)[0][:, 0]
    fine = np.stack([_centres(points[cell == i], size, rng, coarse[i]) for i in range(size)])
    return Vocabulary(mean, projection, coarse, fine)


def centres_for(features: int) -> int:
    """How many centres a level has, for a map of so many features."""
    return int(np.clip(np.sqrt(features / FEATURES_A_WORD), MIN_CENTRES, MAX_CENTRES))


def sample_size(features: int) -> int:
    """How many features to learn a vocabulary from."""
    return min(features, LEARNT_A_WORD * centres_for(features) ** 2)


def _centres(
    points: Float32Array,
    count: int,
    rng: np.random.Generator,
    fallback: Float32Array | None = None,
) -> Float32Array:
    """Centres ``(count, 64)`` of points by k-means; of no points the fallback, many times."""
    if len(points) == 0:
        return np.tile(np.float32(0.0) if fallback is None else fallback, (count, 1))
    start = points[rng.choice(len(points), count, replace=len(points) < count)]
    return k_means(points, start, ITERATIONS)
