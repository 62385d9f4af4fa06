"""Pose tracking: the refined estimate of a body that is followed.

A Kalman filter (``track``) joins odometry and alignments. Its consistency gate decides which
alignments it takes: one that ends too far from the prediction, or that loses evidence against it,
has ended in another minimum. The image is then aligned once more with the prediction as its prior.
The track begins with an alignment from the particles' main mode, and is given up when it leaves
that mode or when alignments are rejected for too long.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.alignment import Alignment
from pipelines.localize.estimate import Mode
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import Observation, Observations
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import sigmas_of
from pipelines.localize.status import is_same_place
from pipelines.localize.strategies import Posterior
from pipelines.localize.track import MOST_REJECTED, Track

# Errors of the model (reflections, a surface that is not quite there) reach farther than a tile of
# the image: the alignment's standard deviations times this cover the truth as often as they should.
MODEL_ERROR = 2.0
# States whose evidence differs by less, or by less than this share, fit an image equally well.
EVEN, EVEN_SHARE = 1.0, 0.03


class PoseTracker:
    """Follows a body from image to image, within the main mode of the particles.

    Args:
        model: aligns states with images and says how well images are explained.
        settings: of the particle filter: widths of the images that are aligned.
    """

    def __init__(self, model: MeasurementModel, settings: LocalizerSettings) -> None:
        self._model = model
        self._space = model.space
        self._settings = settings
        self._track: Track | None = None

    def predict(self, posterior: Posterior) -> None:
        """Moves the track by the motion before an image; forgets it where the motion is unknown.

        Args:
            posterior: the belief after the image, with the motion that led to it.
        """
        if self._track is None or posterior.motion is None:
            self._track = None
            return
        sigmas = sigmas_of(self._space, posterior.position_sigma, posterior.angle_sigma)
        self._track = self._track.predicted(self._space, posterior.motion, sigmas)

    def update(self, main: Mode, observations: Observations) -> Track | None:
        """The track after an image; None where neither it nor an alignment is in the main mode.

        Args:
            main: the particles' heaviest mode.
            observations: the image.
        """
        track = self._track
        if track is not None and (
            track.rejected >= MOST_REJECTED
            or not is_same_place(self._space, track.state, main.state)
        ):
            track = None
        if track is None:
            self._track = self._started(main, observations)
        else:
            self._track = self._continued(track, main, observations)
        return self._track

    def _started(self, main: Mode, observations: Observations) -> Track | None:
        """A new track at the alignment from a mode, where that stays in the mode's place."""
        aligned = self._aligned(main.state, observations)
        # Another place is not a finer answer to the same question.
        if not (_is_usable(aligned) and is_same_place(self._space, aligned.state, main.state)):
            return None
        fit = _Fit.of(self._model, aligned, self._images(observations))
        if not fit.is_supported:
            return None
        covariance = fit.inflation * aligned.covariance
        return Track(aligned.state, covariance, 0, aligned.state, fit.blur)

    def _continued(self, track: Track, main: Mode, observations: Observations) -> Track:
        """A predicted track after an image, by the alignment that passes the gate."""
        images = self._images(observations)
        start, before = self._explained_start(main.state, track, images[-1])
        aligned = self._aligned(start, observations)
        fit = _Fit.of(self._model, aligned, images)
        if not fit.is_supported:
            return track.without_image()
        # What is minimised is not what says where the body is: an alignment that loses evidence
        # has given up what fits for a compromise with what does not.
        least = before - _insignificant(before)
        # An image that is explained less counts less, but is gated like any other.
        if (
            _is_usable(aligned)
            and fit.evidence >= least
            and track.accepts(self._space, aligned, MODEL_ERROR**2)
        ):
            return replace(track.updated(self._space, aligned, fit.inflation), blur=fit.blur)
        prior = track.prior(fit.inflation)
        held = self._model.aligned(start, observations, self._widths(observations), prior)
        if self._model.evidence_at(held.state, images[-1]) < least:
            return track.without_image()
        return replace(track.held(self._space, held), blur=fit.blur)

    def _explained_start(
        self, mode: FloatArray, track: Track, observation: Observation
    ) -> tuple[FloatArray, float]:
        """Where an alignment begins, ``(D,)``, and the image's evidence for it.

        That is where the track is predicted, unless the image speaks against that and for the
        particles' mode: wheels that mislead while the camera sees nothing take the track so far
        that an alignment from there would end in another minimum.
        """
        predicted = self._model.evidence_at(track.state, observation)
        if predicted < 0.0:
            found = self._model.evidence_at(mode, observation)
            if found > _insignificant(predicted):
                return mode, found
        return track.state, predicted

    def _aligned(self, start: FloatArray, observations: Observations) -> Alignment:
        return self._model.aligned(start, observations, self._widths(observations))

    def _widths(self, observations: Observations) -> list[int]:
        """Widths of the images, coarse to fine, in which states are aligned."""
        return observations.widths_from(self._settings.fine_width)

    def _images(self, observations: Observations) -> list[Observation]:
        return [observations.by_width[width] for width in self._widths(observations)]


@dataclass(frozen=True)
class _Fit:
    """How well images of rising width are explained at an alignment.

    It is judged where the image was aligned: at the prediction it would be motion that is not
    explained.

    Attributes:
        evidence: of the finest image.
        is_supported: whether an image of any width speaks for the alignment. One that none speaks
            for has ended where nothing fits, and its covariance tells nothing of its error.
        inflation: factor on the alignment's covariance. Where light or contents have changed,
            errors are larger than an image's own tiles tell.
        blur: factor on the track's covariance. A blurred image is explained from afar, but aligned
            by its blurred details: errors of which the track knows nothing, since they are the same
            in the next image.
    """

    evidence: float
    is_supported: bool
    inflation: float
    blur: float

    @classmethod
    def of(cls, model: MeasurementModel, aligned: Alignment, images: list[Observation]) -> "_Fit":
        evidence = [model.evidence_at(aligned.state, image) for image in images]
        shares = list(map(model.explained_by, evidence, images))
        blur = max(1.0, shares[0] * len(shares) / sum(shares)) ** 2
        inflation = MODEL_ERROR**2 / shares[0] ** 2
        return cls(evidence[-1], max(evidence) > 0.0, inflation, blur)


def _is_usable(aligned: Alignment) -> bool:
    return math.isfinite(aligned.error) and bool(np.all(np.isfinite(aligned.covariance)))


def _insignificant(evidence: float) -> float:
    """Differences from this evidence that say nothing."""
    return max(EVEN, EVEN_SHARE * abs(evidence))
