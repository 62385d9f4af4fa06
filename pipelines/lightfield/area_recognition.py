"""Which area of a world a camera image was taken in: the coarse step of localization.

An area fits an image as well as the best of its own photos does. Fits become probabilities by a
power law, in which no area at all is a hypothesis of its own: areas that are alike share the
probability, and a place that the world does not hold fits none. The exponent and the fit of nothing
are learnt from the map's photos: each is looked up as if it were a camera image, once without the
photos from around its place, and once without the areas that show the place.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray, IntArray
from pipelines.artifacts.stages import Progress, no_progress
from pipelines.geometry.camera import Camera
from pipelines.lightfield.retrieval_index import (
    PhotoFeatures,
    RetrievalIndex,
    build_retrieval_index,
    describe,
    unit_vectors,
)

# Metres: photos nearer than this to the place of a photo that is looked up are left out. A robot
# stands between photos.
LEFT_OUT_AROUND = 0.3
# Exponents and fits of nothing that are tried.
EXPONENTS = np.geomspace(0.5, 16.0, 31)
FITS_OF_NOTHING = np.geomspace(1e-3, 1.0, 61)
# Without an example of it, the fit of nothing.
USUAL_FIT_OF_NOTHING = 0.05
SMALLEST_FIT = 1e-6
# An image of so many features is believed half.
FEW_FEATURES = 10.0
# Photos of the map that are looked up to learn from, and what draws them.
EXAMPLES = 300
SEED = 0


@dataclass(frozen=True)
class Calibration:
    """How fits become probabilities.

    Attributes:
        exponent: of the fits; the larger, the more a better fit counts.
        nothing: the fit at which an area is as probable as no area.
    """

    exponent: float
    nothing: float

    def probabilities(self, fits: FloatArray) -> tuple[FloatArray, float]:
        """Probabilities ``(A,)`` of areas with these fits, and that of none; their sum is 1."""
        ratios = np.maximum(fits, SMALLEST_FIT) / self.nothing
        powers = ratios**self.exponent
        total = 1.0 + float(powers.sum())
        return powers / total, 1.0 / total


@dataclass(frozen=True)
class Recognition:
    """Where an image may have been taken.

    Attributes:
        photos: ``(N,)`` numbers of the world's photos, most alike first.
        scores: ``(N,)`` how much of the image each of these shows.
        areas: ``(A,)`` probability of each area; areas that are alike share it.
        nothing: probability that no area shows what the image does. The sum of all is 1.
    """

    photos: IntArray
    scores: FloatArray
    areas: FloatArray
    nothing: float

    def likely_areas(self, share: float = 0.95) -> IntArray:
        """The fewest areas, most probable first, that have this share of the areas' probability."""
        order = np.argsort(-self.areas, kind="stable")
        shares = np.cumsum(self.areas[order]) / max(float(self.areas.sum()), 1e-300)
        return order[: 1 + int(np.searchsorted(shares, share))][: len(order)]


@dataclass(frozen=True)
class AreaRecognition:
    """Finds the areas in which an image may have been taken.

    Attributes:
        index: of all N photos of the world.
        home: ``(N,)`` the area in which each photo is at home; -1: in none.
        areas: A, how many there are.
        calibration: of the fits.
    """

    index: RetrievalIndex
    home: IntArray
    areas: int
    calibration: Calibration

    def recognise(
        self, image: ImageArray, camera: Camera, used: ImageArray | None = None
    ) -> Recognition:
        """The photos that show what an image shows, and the areas it may have been taken in.

        Args:
            image: ``(height, width, 3)`` RGB, as recorded; held upright or not.
            camera: that took it.
            used: ``(height, width)``, 0 where nothing shall be looked at; None: nowhere.
        """
        return self.recognise_features(describe(image, camera, used))

    def recognise_features(self, descriptors: ImageArray) -> Recognition:
        """The same for an image's features, as ``describe`` makes them."""
        scores = self.index.scores(unit_vectors(descriptors))
        areas, nothing = self.calibration.probabilities(area_fits(scores, self.home, self.areas))
        # Few features decide little: without any all hypotheses are equally probable.
        share = len(descriptors) / (len(descriptors) + FEW_FEATURES)
        areas = share * areas + (1.0 - share) / (self.areas + 1)
        nothing = share * nothing + (1.0 - share) / (self.areas + 1)
        order = np.argsort(-scores, kind="stable")
        return Recognition(order, scores[order], areas, nothing)


def area_fits(scores: FloatArray, home: IntArray, areas: int) -> FloatArray:
    """How well each area fits ``(A,)``: as the best of the photos that are at home there."""
    fits = np.zeros(areas)
    kept = home >= 0
    np.maximum.at(fits, home[kept], scores[kept])
    return fits


def learn_recognition(
    parts: Sequence[Callable[[], PhotoFeatures]],
    positions: FloatArray,
    home: IntArray,
    shown_in: Sequence[IntArray],
    progress: Progress = no_progress,
) -> AreaRecognition:
    """Learns to find the areas of a world from the features of its photos.

    Args:
        parts: as ``build_retrieval_index`` takes them.
        positions: ``(N, 3)`` of all photos, metres.
        home: ``(N,)`` the area in which each is at home; -1: in none.
        shown_in: of each area, the areas that may show what its photos show, itself among them.
        progress: told how far the work is.

    Raises:
        InputError: what a part raises.
    """
    rng = np.random.default_rng(SEED)
    index = build_retrieval_index(parts, len(home), rng, progress)
    described = np.unique(index.photos)
    described = described[home[described] >= 0]
    count = min(EXAMPLES, len(described))
    chosen = set(np.sort(rng.choice(described, count, replace=False)).tolist())
    examples = {
        photo: descriptors
        for part in parts
        for photo, descriptors in part().items()
        if photo in chosen
    }
    looked_up = progress(examples.items(), "look photos up", len(examples))
    calibration = calibrate(index, looked_up, positions, home, shown_in)
    return AreaRecognition(index, home, len(shown_in), calibration)


def calibrate(
    index: RetrievalIndex,
    examples: Iterable[tuple[int, ImageArray]],
    positions: FloatArray,
    home: IntArray,
    shown_in: Sequence[IntArray],
) -> Calibration:
    """Learns from the map's photos how fits become probabilities: the greatest likelihood.

    Args:
        index: of N photos.
        examples: numbers of photos that are at home somewhere, and their descriptors as
            ``describe`` makes them.
        positions: ``(N, 3)`` of all photos, metres.
        home: ``(N,)`` the area in which each is at home; -1: in none.
        shown_in: of each area, the areas that may show what its photos show, itself among them.
    """
    areas = len(shown_in)
    inside, right, outside = [], [], []
    for photo, descriptors in examples:
        scores = index.scores(unit_vectors(descriptors))
        around = np.linalg.norm(positions - positions[photo], axis=1) < LEFT_OUT_AROUND
        around[photo] = True
        inside.append(area_fits(np.where(around, 0.0, scores), home, areas))
        right.append(home[photo])
        elsewhere = inside[-1].copy()
        elsewhere[shown_in[home[photo]]] = 0.0
        if np.count_nonzero(elsewhere) > 0:
            outside.append(elsewhere)
    if not inside:
        return Calibration(1.0, USUAL_FIT_OF_NOTHING)
    return _most_likely(np.array(inside), np.array(right), np.array(outside).reshape(-1, areas))


def _most_likely(inside: FloatArray, right: IntArray, outside: FloatArray) -> Calibration:
    """The exponent and the fit of nothing under which the examples are most likely."""
    logs_inside = np.log(np.maximum(inside, SMALLEST_FIT))
    logs_outside = np.log(np.maximum(outside, SMALLEST_FIT))
    own = logs_inside[np.arange(len(right)), right]
    nothings = FITS_OF_NOTHING if len(outside) else np.array([USUAL_FIT_OF_NOTHING])
    best, likeliest = Calibration(1.0, USUAL_FIT_OF_NOTHING), -np.inf
    for exponent in EXPONENTS:
        sums_inside = _log_sums(exponent * logs_inside)
        sums_outside = _log_sums(exponent * logs_outside)
        for nothing in nothings:
            none = exponent * np.log(nothing)
            likelihood = np.mean(exponent * own - np.logaddexp(sums_inside, none))
            if len(outside):
                likelihood += np.mean(none - np.logaddexp(sums_outside, none))
            if likelihood > likeliest:
                best, likeliest = Calibration(float(exponent), float(nothing)), likelihood
    return best


def _log_sums(logs: FloatArray) -> FloatArray:
    """Logarithm of the sum of exponentials in each row."""
    return np.asarray(np.logaddexp.reduce(logs, axis=1))
