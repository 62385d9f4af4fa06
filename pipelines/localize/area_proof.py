"""In a world: whether what is seen is the room that it is taken for, and not one that is alike.

A world holds rooms that are alike, and the body may be in one that it does not hold. Furniture of
one kind fits in either: an image that shows it says much for both, several that agree with odometry
do not tell them apart, and what differs (a poster, the books on a shelf) is a small part of it. So
before the body is said to be tracked, the image is compared window by window with the view at its
place. In the room itself nearly all windows agree; where it is another one, some do not, however
well the others do. Later on, a door frame close by or a person in the view is no reason to give up
a room that was proven.
"""

import cv2
import numpy as np

from pipelines.artifacts.arrays import BoolArray, Float32Array
from pipelines.localize.estimate import Mode
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import Observations
from pipelines.localize.outside_hypothesis import MovingAverage
from pipelines.localize.settings import LocalizerSettings
from pipelines.render.channels import ZERO

# A room is proven by so many images in a row whose windows agree so well on average. In the right
# room of an office floor eight in ten images do, in its twin the best three come to 0.6.
PROVING_IMAGES, PROVING_AGREEMENT = 3, 0.75
# It is doubted again where less than this is explained on average (``explained``).
DOUBTED_SHARE = 0.3
# While it is not proven, the estimate is right with this probability at most.
UNPROVEN_PROBABILITY = 0.5
# Windows are so many to the width of an image, half overlapping. One counts where so much of it is
# covered, and image or view show something: root mean square of a channel, as bytes.
WINDOWS_ACROSS, COVERED_SHARE, STRUCTURE = 10, 0.9, 25.0


class AreaProof:
    """Keeps how well images agreed with the place where the body is thought to be.

    Args:
        model: renders views and says how well images are explained.
        settings: of the particle filter: widths of the images.

    Attributes:
        is_given: whether the place is proven.
    """

    def __init__(self, model: MeasurementModel, settings: LocalizerSettings) -> None:
        self._model = model
        self._settings = settings
        self._explained = MovingAverage()
        self._latest: tuple[float, ...] = ()
        self.is_given = False

    def update(self, main: Mode | None, observations: Observations) -> bool:
        """Whether the place is proven, after an image.

        Args:
            main: the place where the body is thought to be; None: it is not in one place.
            observations: the image.
        """
        if main is None:
            self._latest, self.is_given = (), False
        elif self.is_given:
            fine = observations.by_width[self._settings.fine_width]
            share = self._model.explained(main.state, fine)
            self._explained = self._explained.updated(share)
            self.is_given = (self._explained.mean or 0.0) >= DOUBTED_SHARE
        else:
            self._latest = (*self._latest, self._agreement(main, observations))[-PROVING_IMAGES:]
            if len(self._latest) == PROVING_IMAGES and np.mean(self._latest) >= PROVING_AGREEMENT:
                self._latest, self.is_given = (), True
                self._explained = MovingAverage(1.0)
        return self.is_given

    def _agreement(self, main: Mode, observations: Observations) -> float:
        """How well the finest image agrees with the view at the place, where it is aligned best."""
        model = self._model
        widths = observations.widths_from(self._settings.fine_width)
        state = model.aligned(main.state, observations, widths).state
        observation = observations.by_width[widths[-1]].in_channels(model.channels)
        pose = model.space.poses(state) @ model.body_from_camera
        views, covered = model.renderer.render_many(pose[None], observation.intrinsics)
        return agreement(observation.image, views[0], covered[0] & observation.used)


def agreement(image: Float32Array, view: Float32Array, shown: BoolArray) -> float:
    """Mean over the windows of two images of how alike they are.

    Args:
        image: ``(H, W, 3)`` in channels of local contrast.
        view: ``(H, W, 3)`` in the same.
        shown: ``(H, W)`` pixels of both that are to be compared.

    Returns:
        Mean normalised correlation, at most 1; 0 where no window shows anything.
    """
    side = max(3, image.shape[1] // WINDOWS_ACROSS)
    known = np.where(shown[..., None], image - np.float32(ZERO), np.float32(0.0))
    rendered = np.where(shown[..., None], view - np.float32(ZERO), np.float32(0.0))

    def of_windows(values: Float32Array) -> Float32Array:
        means = cv2.boxFilter(values, -1, (side, side))
        half = side // 2
        rows, columns = (slice(half, length - half, half) for length in values.shape)
        return np.asarray(means[rows, columns], dtype=np.float32)

    own = of_windows((known**2).mean(axis=2))
    other = of_windows((rendered**2).mean(axis=2))
    both = of_windows((known * rendered).mean(axis=2))
    covered = of_windows(shown.astype(np.float32))
    counts = (covered >= COVERED_SHARE) & (np.maximum(own, other) >= STRUCTURE**2)
    if not counts.any():
        return 0.0
    return float(np.mean(both[counts] / np.sqrt(np.maximum(own * other, 1.0)[counts])))
