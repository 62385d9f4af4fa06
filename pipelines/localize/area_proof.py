"""In a world: whether what is seen is the room that it is taken for, and not one that is alike.

A world holds rooms that are alike, and the body may be in one that it does not hold. Furniture of
one kind fits in either: an image that shows it says much for both, several that agree with odometry
do not tell them apart, and what differs (a poster, the books on a shelf) is a small part of it. So
before the body is said to be tracked, the image is compared window by window with the view at its
place. In the room itself they agree as well as the map's photos agree with the views of the others;
where it is another one, some windows do not, however well the others do. Later on, a door frame
close by or a person in the view is no reason to give up a room that was proven.
"""

import numpy as np

from pipelines.localize.estimate import Mode
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import Observations
from pipelines.localize.outside_hypothesis import MovingAverage
from pipelines.localize.settings import LocalizerSettings
from pipelines.render.window_agreement import agreement

# A room is proven by so many images in a row whose windows agree on average by this share of what
# the map's photos do. In the right room of an office floor eight in ten images agree by 0.95 of it,
# in its twin the best three by 0.76.
PROVING_IMAGES, PROVING_SHARE = 3, 0.9
# It is doubted again where less than this is explained on average (``explained``).
DOUBTED_SHARE = 0.3
# While it is not proven, the estimate is right with this probability at most.
UNPROVEN_PROBABILITY = 0.5


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
            if len(self._latest) == PROVING_IMAGES and np.mean(self._latest) >= PROVING_SHARE:
                self._latest, self.is_given = (), True
                self._explained = MovingAverage(1.0)
        return self.is_given

    def _agreement(self, main: Mode, observations: Observations) -> float:
        """How well the finest image agrees with the view where it is aligned best.

        Returns:
            Share of what the map's photos agree by.
        """
        model = self._model
        widths = observations.widths_from(self._settings.fine_width)
        state = model.aligned(main.state, observations, widths).state
        observation = observations.by_width[widths[-1]].in_channels(model.channels)
        pose = model.space.poses(state) @ model.body_from_camera
        views, covered = model.renderer.render_many(pose[None], observation.intrinsics)
        own = agreement(observation.image, views[0], covered[0] & observation.used)
        usual = model.usual_agreement(observation.intrinsics.width)
        return own / usual if usual > 0.0 else 0.0
