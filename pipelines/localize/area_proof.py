"""In a world: whether what is seen is the room that it is taken for, and not one that is alike.

A world holds rooms that are alike, and the body may be in one that it does not hold. Furniture of
one kind fits in either, so that one image explained by half, and several that agree with odometry,
do not tell two rooms apart. In the room itself nearly all of an image is explained, as a rule; now
and then it is less (a door frame close by, a person), which is no reason to give up a room that was
proven before.
"""

from pipelines.localize.estimate import Mode
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import Observations
from pipelines.localize.outside_hypothesis import MovingAverage
from pipelines.localize.settings import LocalizerSettings

# A room is proven by so many images in a row of which this share is explained on average.
PROVING_IMAGES, PROVING_SHARE = 3, 0.85
# It is doubted again where less than this is explained on average.
DOUBTED_SHARE = 0.3
# While it is not proven, the estimate is right with this probability at most.
UNPROVEN_PROBABILITY = 0.5


class AreaProof:
    """Keeps how well images of a place were explained, one after the other.

    Args:
        model: says how well images are explained.
        settings: of the particle filter: widths of the images.
    """

    def __init__(self, model: MeasurementModel, settings: LocalizerSettings) -> None:
        self._model = model
        self._settings = settings
        self._average = MovingAverage()
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
            self._average = self._average.updated(self._model.explained(main.state, fine))
            self.is_given = (self._average.mean or 0.0) >= DOUBTED_SHARE
            self._latest = ()
        else:
            self._latest = (*self._latest, self._explained(main, observations))[-PROVING_IMAGES:]
            mean = sum(self._latest) / PROVING_IMAGES
            self.is_given = len(self._latest) == PROVING_IMAGES and mean >= PROVING_SHARE
            self._average = MovingAverage(mean)
        return self.is_given

    def _explained(self, main: Mode, observations: Observations) -> float:
        """Share of an image that is explained in the finest size, where it is aligned best."""
        widths = observations.widths_from(self._settings.fine_width)
        state = self._model.aligned(main.state, observations, widths).state
        return self._model.explained(state, observations.by_width[widths[-1]])
