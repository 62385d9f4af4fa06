"""Which photos of a world show what a camera image shows, and in which areas it may be taken.

An inverted index of visual words (Sivic, Zisserman 2003, "Video Google"): each word lists the
photos that show it, with the signatures of their features. An image's features look up their words'
lists, no others, so that the cost hardly grows with the number of photos: the larger a map, the
more words it has. Nothing of colours or brightness is compared, only SIFT
features, which bear other light, another camera and another distance.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from pipelines.artifacts.arrays import BoolArray, Float32Array, FloatArray, ImageArray, IntArray
from pipelines.artifacts.processes import in_threads
from pipelines.artifacts.stages import Progress, no_progress
from pipelines.geometry.camera import Camera
from pipelines.lightfield.local_features import find_features
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.visual_words import Vocabulary, learn_vocabulary, sample_size

# Features of an image, at most: the strongest.
MAX_FEATURES = 300
# Pixels a radian: finer images are reduced to this.
RESOLUTION = 340.0
# An image's feature is looked up in so many words.
WORDS_LOOKED_UP = 3
# Signatures that differ in more bits show something else; and how fast a match loses weight.
MAX_BITS, SIGMA_BITS = 24, 10.0
WEIGHT_OF_BITS = np.exp(-((np.arange(MAX_BITS + 1) / SIGMA_BITS) ** 2)).astype(np.float32)
# How fast a feature loses weight that many areas match, and so many that make no difference yet.
RARITY, MATCHED_ANYWAY = 2.0, 1.0
# Photos whose features are put into words together.
BATCH = 64
# Descriptors are stored as bytes, in units of this; few of their numbers are above 0.5.
UNIT = 1.0 / 512.0


# Of each photo ``(F, 128)`` descriptors, as ``describe`` makes them.
PhotoFeatures: TypeAlias = Mapping[int, ImageArray]


@dataclass(frozen=True)
class RetrievalIndex:
    """The inverted index of N photos.

    Attributes:
        vocabulary: of W words.
        starts: ``(W + 1,)`` where each word's list begins.
        photos: ``(E,)`` photos in the lists, ascending within each.
        signatures: ``(E,)`` of their features.
        count: N.
    """

    vocabulary: Vocabulary
    starts: IntArray
    photos: NDArray[np.unsignedinteger]
    signatures: NDArray[np.uint64]
    count: int

    def scores(
        self, descriptors: Float32Array, home: IntArray, kept: BoolArray | None = None
    ) -> FloatArray:
        """How much of an image each photo shows.

        Features vote for the photos that show them; the more areas match a feature, the less it
        says about any of them, and the less it counts.

        Args:
            descriptors: ``(F, 128)`` of the image's features, unit vectors.
            home: ``(N,)`` the area in which each photo is at home; -1: in none.
            kept: ``(N,)`` photos that are looked at; None: all.

        Returns:
            ``(N,)``, 0: nothing.
        """
        features, photos, matches = self._matches(
            descriptors, home if kept is None else np.where(kept, home, -1)
        )
        best = np.zeros((len(descriptors), int(home.max(initial=0)) + 1), dtype=np.float32)
        np.maximum.at(best, (features, home[photos]), matches)
        weights = (MATCHED_ANYWAY + best.sum(axis=1)) ** -RARITY
        total = np.bincount(photos, matches * weights[features], minlength=self.count)
        return np.asarray(total / max(1, len(descriptors)), dtype=np.float64)

    def _matches(
        self, descriptors: Float32Array, home: IntArray
    ) -> tuple[IntArray, IntArray, Float32Array]:
        """Features, the photos in areas that match them, and how well they do, 0 to 1."""
        words, signatures = self.vocabulary.quantise(descriptors, WORDS_LOOKED_UP)
        words, signatures = words.reshape(-1), signatures.reshape(-1)
        lengths = self.starts[words + 1] - self.starts[words]
        ends = np.cumsum(lengths)
        rows = np.arange(lengths.sum()) + np.repeat(self.starts[words] - ends + lengths, lengths)
        bits = np.bitwise_count(np.repeat(signatures, lengths) ^ self.signatures[rows])
        alike = np.flatnonzero((bits <= MAX_BITS) & (home[self.photos[rows]] >= 0))
        lookups = np.repeat(np.arange(len(words)), lengths)[alike]
        pairs = lookups // WORDS_LOOKED_UP * self.count + self.photos[rows[alike]]
        # A photo that shows a feature several times shows it once.
        order = np.lexsort((bits[alike], pairs))
        first = order[np.flatnonzero(np.diff(pairs[order], prepend=-1))]
        matches = WEIGHT_OF_BITS[bits[alike[first]]]
        return pairs[first] // self.count, pairs[first] % self.count, matches


def describe(image: ImageArray, camera: Camera, used: ImageArray | None = None) -> ImageArray:
    """The features of an image as they are kept and looked up.

    Args:
        image: ``(height, width, 3)`` RGB, as recorded.
        camera: that took it.
        used: ``(height, width)``, 0 where nothing shall be looked at; None: nowhere.

    Returns:
        ``(F, 128)`` descriptors, ``UNIT`` a level; F is 0 to ``MAX_FEATURES``.
    """
    pinhole = camera.intrinsics
    reduction = min(1.0, 2.0 * RESOLUTION / (pinhole.fx + pinhole.fy))
    size = max(1, round(reduction * max(camera.width, camera.height)))
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    found = find_features(np.asarray(grey, dtype=np.uint8), size, MAX_FEATURES, used)
    levels = np.rint(found.descriptors / UNIT).clip(0.0, 255.0)
    return np.asarray(levels, dtype=np.uint8)


def features_of(scene: Scene, views: Sequence[int]) -> list[ImageArray]:
    """The features of some photos of a scene, as ``describe`` makes them."""

    def of_view(view: int) -> ImageArray:
        return describe(scene.image(view), scene.camera_of(view))

    return list(in_threads(of_view, views))


def unit_vectors(descriptors: ImageArray) -> Float32Array:
    """Descriptors ``(F, 128)`` as ``describe`` made them, as unit vectors."""
    values = descriptors.astype(np.float32)
    lengths = np.sqrt(np.einsum("ij,ij->i", values, values))
    values /= np.maximum(lengths, np.float32(1e-9))[:, None]
    return values


def build_retrieval_index(
    parts: Sequence[Callable[[], PhotoFeatures]],
    photos: int,
    rng: np.random.Generator,
    progress: Progress = no_progress,
) -> RetrievalIndex:
    """Learns the vocabulary and fills the index, one part of the map after the other.

    Args:
        parts: each returns the features of some photos, by their numbers, which are in no other
            part; called three times, and no two parts are held in memory at once.
        photos: how many the map has; those in no part have no features.
        rng: chooses what the vocabulary is learnt from.
        progress: told how far the work is.

    Raises:
        InputError: what a part raises.
    """
    described = {photo: len(descriptors) for photo, descriptors in _each(parts)}
    counts = np.zeros(photos, dtype=np.int64)
    counts[list(described)] = list(described.values())
    total = int(counts.sum())
    starts = np.append(0, np.cumsum(counts))
    chosen = np.sort(rng.choice(total, sample_size(total), replace=False))
    # A map without any feature has a vocabulary too.
    sample = np.zeros((max(1, len(chosen)), 128), dtype=np.uint8)
    for photo, descriptors in _each(parts):
        first, end = np.searchsorted(chosen, starts[photo : photo + 2])
        sample[first:end] = descriptors[chosen[first:end] - starts[photo]]
    vocabulary = learn_vocabulary(unit_vectors(sample), total, rng)
    words = np.zeros(total, dtype=np.int32)
    signatures = np.zeros(total, dtype=np.uint64)
    remaining = iter(progress(_each(parts), "index photos", len(described)))
    while batch := list(islice(remaining, BATCH)):
        rows = np.concatenate([np.arange(starts[p], starts[p + 1]) for p, _ in batch])
        together = np.concatenate([descriptors for _, descriptors in batch])
        found, signs = vocabulary.quantise(unit_vectors(together))
        words[rows], signatures[rows] = found[:, 0], signs[:, 0]
    # Features are in the order of the photos, and stay so within each word.
    order = np.argsort(words, kind="stable")
    ends = np.cumsum(np.bincount(words, minlength=vocabulary.words))
    owners = np.repeat(np.arange(photos), counts).astype(np.min_scalar_type(photos))
    return RetrievalIndex(vocabulary, np.append(0, ends), owners[order], signatures[order], photos)


def _each(parts: Sequence[Callable[[], PhotoFeatures]]) -> Iterator[tuple[int, ImageArray]]:
    """Photos and their descriptors, part by part."""
    for part in parts:
        yield from part().items()
