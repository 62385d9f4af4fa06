"""The hypothesis that the camera sees nothing that the map shows.

Beside all poses in the map stands "outside": another room, a wall of people, a picture of something
else. An image's evidence for it is 0, by the definition of evidence. A binary Bayes filter holds
the probability of the opposite, being inside: each image changes the odds by its marginal
likelihood, which is its evidence averaged over the prior of the poses. From one image to the next a
robot may leave the map, or come back into what it shows. How much images usually say, and how well
they are usually explained, are moving averages beside it: an image far below them is no proof of a
place either.
"""

import math
from dataclasses import dataclass, replace

# Probability that the next image does not show the map although this one does, and the reverse.
LEAVING, RETURNING = 0.01, 0.05
# Before the first image.
FIRST_INSIDE = 0.5
# Share of the latest value in a moving average.
RATE = 0.2


@dataclass(frozen=True)
class OutsideHypothesis:
    """A binary Bayes filter: does the camera see what the map shows?

    Attributes:
        inside: probability that it does; that of the outside hypothesis is one minus it.
    """

    inside: float = FIRST_INSIDE

    def predicted(self) -> "OutsideHypothesis":
        """Before the next image."""
        return replace(self, inside=(1.0 - LEAVING) * self.inside + RETURNING * (1.0 - self.inside))

    def updated(self, log_evidence: float) -> "OutsideHypothesis":
        """After an image.

        Args:
            log_evidence: logarithm of the image's marginal likelihood ratio, inside to outside.
        """
        log_odds = math.log(self.inside) - math.log1p(-self.inside) + log_evidence
        # Beyond this it is 0 or 1 in double precision.
        log_odds = min(max(log_odds, -30.0), 30.0)
        return replace(self, inside=1.0 / (1.0 + math.exp(-log_odds)))


@dataclass(frozen=True)
class MovingAverage:
    """An exponential moving average over images.

    Attributes:
        mean: None before the first image.
    """

    mean: float | None = None

    def updated(self, value: float) -> "MovingAverage":
        """After an image with this value."""
        before = value if self.mean is None else self.mean
        return MovingAverage(before + RATE * (value - before))

    def is_undercut(self, value: float, share: float) -> bool:
        """Whether a value is less than this share of the mean; False before the first image."""
        return self.mean is not None and value < share * self.mean
