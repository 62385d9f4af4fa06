"""Photos that look alike, found by one descriptor a photo.

The descriptors of a photo's features are gathered by visual words into a vector of locally
aggregated descriptors (VLAD: Jegou et al. 2010; signs and roots as in Arandjelovic and Zisserman
2013). The words are learnt from the photos themselves, so nothing has to be downloaded.
"""

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray, IntArray
from pipelines.artifacts.errors import StageError, reason_of
from pipelines.reconstruct.clustering import k_means, nearest_centres
from pipelines.reconstruct.pose_graph import Drift

WORDS, ITERATIONS = 32, 10
# Descriptors of all photos together that the words are learnt from.
LEARNT_FROM = 40_000
# The photos most alike to each that are taken.
ALIKE = 10
CHUNK = 128


def photo_descriptors(database: Path, names: list[str], seed: int) -> Float32Array:
    """One descriptor a photo, from the features in COLMAP's database.

    Args:
        database: after the features were extracted.
        names: of the photos there.
        seed: of the choice of descriptors that the words are learnt from.

    Returns:
        ``(N, WORDS * D)`` of unit length; zeros for a photo without features.

    Raises:
        StageError: the database cannot be read.
    """
    generator = np.random.default_rng(seed)
    share = -(-LEARNT_FROM // max(1, len(names)))
    try:
        with closing(sqlite3.connect(f"{database.as_uri()}?mode=ro", uri=True)) as connection:
            learnt = []
            for name in names:
                own = _features(connection, name)
                learnt.append(own[generator.permutation(len(own))[:share]])
            words = _words(np.concatenate(learnt), generator)
            return np.array([_aggregated(_features(connection, name), words) for name in names])
    except sqlite3.Error as error:
        raise StageError(
            f"the database of structure from motion is unreadable: {reason_of(error)}"
        ) from error


def alike_pairs(descriptors: Float32Array, possible: "PossiblePairs") -> list[tuple[int, int]]:
    """Pairs of photos that look alike; each photo proposes ``ALIKE`` others.

    Args:
        descriptors: ``(N, K)`` of unit length.
        possible: says which photos may be near each other at all.

    Returns:
        Pairs (i, j) with i < j, sorted, each once.
    """
    chosen: set[tuple[int, int]] = set()
    for start in range(0, len(descriptors), CHUNK):
        rows = np.arange(start, min(len(descriptors), start + CHUNK))
        likeness = descriptors[rows] @ descriptors.T
        likeness[~possible(rows)] = -np.inf
        best = np.argsort(-likeness, axis=1, kind="stable")[:, :ALIKE]
        for row, partners in zip(rows.tolist(), best, strict=True):
            for partner in partners[np.isfinite(likeness[row - start, partners])].tolist():
                chosen.add((min(row, partner), max(row, partner)))
    return sorted(chosen)


class PossiblePairs:
    """Which photos may see the same by what is known of their places.

    Args:
        world_from_camera: ``(N, 4, 4)`` in time order.
        path: ``(N,)`` metres walked.
        reach: metres between cameras that may see the same.
        drift: of the poses.
    """

    def __init__(
        self, world_from_camera: FloatArray, path: FloatArray, reach: float, drift: Drift
    ) -> None:
        self._places, self._axes = world_from_camera[:, :3, 3], world_from_camera[:, :3, 2]
        self._path, self._reach, self._drift = path, reach, drift

    def __call__(self, rows: IntArray) -> BoolArray:
        """For each of the photos ``rows`` and every photo: may they see the same? ``(R, N)``."""
        distance = np.linalg.norm(self._places[rows][:, None] - self._places, axis=2)
        root = np.sqrt(np.abs(self._path[rows][:, None] - self._path))
        near = distance < self._reach + self._drift.place(root)
        # Nobody recognises what is seen from the other side.
        facing = self._axes[rows] @ self._axes.T > 0.0
        return np.asarray(near & facing & (rows[:, None] != np.arange(len(self._places))))


def _features(connection: sqlite3.Connection, name: str) -> Float32Array:
    """Descriptors ``(F, D)`` of a photo's features, of unit length."""
    row = connection.execute(
        "SELECT rows, cols, data FROM descriptors JOIN images "
        "ON images.image_id = descriptors.image_id WHERE name = ?",
        (name,),
    ).fetchone()
    if row is None or row[0] == 0:
        return np.zeros((0, 128), dtype=np.float32)
    values = np.frombuffer(row[2], np.uint8).reshape(row[0], row[1]).astype(np.float32)
    lengths = np.linalg.norm(values, axis=1, keepdims=True)
    return np.asarray(values / np.maximum(lengths, 1e-9), np.float32)


def _words(features: Float32Array, generator: np.random.Generator) -> Float32Array:
    """Means ``(WORDS, D)`` of clusters of features; zeros where there are none."""
    if len(features) == 0:
        return np.zeros((1, features.shape[1]), dtype=np.float32)
    start = features[generator.permutation(len(features))[:WORDS]]
    return k_means(features, start, ITERATIONS)


def _aggregated(features: Float32Array, words: Float32Array) -> Float32Array:
    nearest, _ = nearest_centres(features, words, 1)
    of_word = (nearest == np.arange(len(words))).astype(np.float32)
    sums = of_word.T @ features - of_word.sum(axis=0)[:, None] * words
    sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-9)
    vector = np.sign(sums) * np.sqrt(np.abs(sums))
    return np.asarray(vector.ravel() / max(1e-9, float(np.linalg.norm(vector))), np.float32)
